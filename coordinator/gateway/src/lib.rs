//! What carries a run to other machines, and the only crate that knows that there are any.
//!
//! ```text
//! learner's machine                                    another machine
//!  coordinator ── orders ──▶ gateway  ═══ queries ══▶  gateway ── orders ──▶ sim-worker × N
//!  learner ◀──── rollouts ──  (hub)   ◀══ replies ═══  (host)  ◀── rollouts ──┘   ▲
//!  learner ───── policy ───▶          ◀══ queries ═══          ──── policy ───────┘
//! ```
//!
//! Both ends of the network are this program. The **hub** is a child of the coordinator: it opens the run's services
//! as a worker does, and stands for all workers of all hosts. The **host** is a child of `octopus join`, which creates
//! the same services on its machine and starts ordinary workers there: towards them the gateway is coordinator and
//! learner. So workers, scheduler, learner and channels know nothing of networks, and nobody who trains on one machine
//! builds or links any.
//!
//! # What goes over the network
//!
//! **Pulled, never pushed.** An order is a query to its host, and the block the reply to it; a policy is announced by its
//! number and then asked for by each host. Who asks has room for the answer, so nothing is dropped because a queue was
//! full, and a host that stands still holds nobody up: pushed blocks to one dead host stalled all others for 5 s. Large
//! answers come in [pieces] with a place and a checksum. A host that dies or is cut off gives no error, only pieces that
//! do not come: they are counted.
//!
//! **Nothing waits for a host.** Its liveliness token tells within milliseconds that it is gone; one that is cut off or
//! stands still is not heard for [`SILENCE`]. Then its workers are none of the run any more, what they were ordered is
//! ordered elsewhere, and a block of theirs that comes all the same is dropped: it is accounted for as lost. The same
//! becomes of a worker of which an order has not come back for `run.order_deadline_s`. Who is heard again has workers
//! again, of another incarnation.
//!
//! **One thread owns the ports** of iceoryx2, which may not wander between threads, and takes [events] from all others:
//! bells, queries, replies. Callbacks of the network only put an event down. What may wait for the network, an answer in
//! pieces or a question, has a thread for its time.
//!
//! **One way back.** A hub that is replaced, because it or the learner died, has another [session name]: the host then
//! ends, and `octopus join` joins anew with fresh workers, for those of before may hold policies of a future that is
//! undone.
//!
//! The learner's side is a router and listens, hosts are clients and try to connect for ever. Nothing is looked for by
//! multicast or gossip: whoever has not been told the endpoint does not find it.
//!
//! # Who may join
//!
//! Over QUIC both ends show certificates of one authority (TLS 1.3), and each host is confined to keys below the name in
//! its own (`access.rs`). Who may join are the hosts whose certificates lie in the run's directory. The hub looks into it and
//! ends when they become others, because the network takes its rules once: it is replaced by one that knows them. Before a host connects it shakes hands once by itself, to tell its
//! owner what does not fit (`handshake.rs`). Certificates are made and judged by the crate `certificates`.
//!
//! Over TCP links are neither encrypted nor is anybody asked who they are; that is why `octopus` asks for `--insecure`
//! beyond this machine. The network's third kind of link, TLS over TCP, is not built: it is known to damage memory.
//!
//! What the network leaves open: it takes one handshake at a time, so that whoever reaches the port and falls silent in
//! the middle of one keeps others from joining for half a minute. Hosts that have joined are not concerned. And a host
//! takes a run for its own, too, whose certificate a public authority has given for the endpoint's name.
//!
//! [pieces]: proto::gateway::pieces
//! [events]: hub
//! [session name]: proto::gateway::wire::Welcome::session

pub mod arguments;
pub mod host;
pub mod hub;

mod access;
mod bells;
mod handshake;
mod keys;
mod network;
mod orders;
mod witness;

use std::time::Duration;

/// A host that has not been heard for so long has no workers until it is heard again.
pub const SILENCE: Duration = Duration::from_secs(3);
