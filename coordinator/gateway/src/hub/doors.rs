//! What comes in through the network's callbacks.

use std::sync::mpsc::Sender;

use proto::message::{self, HostId};
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait as _};

use crate::keys;
use crate::network::Asked;
use crate::orders::Single;
use crate::wire::HostBeat;

/// What other threads put down for the one that owns the ports.
pub(super) enum Event {
    /// Orders or policies may have come.
    Bell,
    /// A host wants to join.
    Hello(Query),
    /// A host wants a policy.
    Policy(Query),
    /// A host is there.
    Beat(HostId, HostBeat),
    /// A host is not there any more.
    Gone(HostId),
    /// What came of an order.
    Answered(Single, Box<Asked>),
}

/// Where the network's callbacks put events down, while this lives.
pub(super) struct Doors {
    _hello: Queryable<()>,
    _policies: Queryable<()>,
    _beats: Subscriber<()>,
    _alive: Subscriber<()>,
}

impl Doors {
    pub(super) fn open(
        session: &Session,
        name: &str,
        events: &Sender<Event>,
    ) -> zenoh::Result<Self> {
        // Nobody takes events any more when the hub ends; what comes then is for nobody.
        let put = |event: Event, events: &Sender<Event>| drop(events.send(event));
        let to = || events.clone();
        let (hello, policies, beats, alive) = (to(), to(), to(), to());
        Ok(Self {
            _hello: session
                .declare_queryable(keys::HELLO)
                .callback(move |query| put(Event::Hello(query), &hello))
                .wait()?,
            _policies: session
                .declare_queryable(keys::policies(name))
                .callback(move |query| put(Event::Policy(query), &policies))
                .wait()?,
            _beats: session
                .declare_subscriber(keys::of_hosts(name, "beat"))
                .callback(move |sample| {
                    let beat = message::decode(&sample.payload().to_bytes());
                    if let (Some(host), Ok(beat)) = (keys::host(sample.key_expr()), beat) {
                        put(Event::Beat(host, beat), &beats);
                    }
                })
                .wait()?,
            _alive: session
                .liveliness()
                .declare_subscriber(keys::of_hosts(name, "alive"))
                .callback(move |sample| {
                    if let (SampleKind::Delete, Some(host)) =
                        (sample.kind(), keys::host(sample.key_expr()))
                    {
                        put(Event::Gone(host), &alive);
                    }
                })
                .wait()?,
        })
    }
}
