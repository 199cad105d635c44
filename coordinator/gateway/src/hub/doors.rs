//! Where the network comes in: its callbacks only put events down.

use std::sync::mpsc::Sender;

use proto::gateway::wire::HostBeat;
use proto::message::{self, HostId};
use proto::{ExitCode, ExitError};
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait as _};

use crate::keys;
use crate::network::Asked;
use crate::orders::Single;

/// What other threads put down for the one that owns the ports.
pub(super) enum Event {
    /// Orders or policies may have come.
    Bell,
    /// A host wants to join.
    Hello(Query),
    /// A host wants to know why it has no answer.
    Stranger(Query),
    /// A host wants a policy.
    Policy(Query),
    /// A host of this name is there.
    Beat(HostId, String, HostBeat),
    /// A host of this name is not there any more.
    Gone(HostId, String),
    /// What came of an order.
    Answered(Single, Box<Asked>),
}

/// Where the network's callbacks put events down, while this lives.
pub(super) struct Doors {
    _hello: Queryable<()>,
    _strangers: Queryable<()>,
    _policies: Queryable<()>,
    _beats: Subscriber<()>,
    _alive: Subscriber<()>,
}

impl Doors {
    pub(super) fn open(
        session: &Session,
        name: &str,
        events: &Sender<Event>,
    ) -> Result<Self, ExitError> {
        Self::try_open(session, name, events).map_err(|error| {
            ExitError::new(ExitCode::Failure, format!("the network cannot be used: {error}"))
        })
    }

    fn try_open(session: &Session, name: &str, events: &Sender<Event>) -> zenoh::Result<Self> {
        // Nobody takes events any more when the hub ends; what comes then is for nobody.
        let put = |event: Event, events: &Sender<Event>| drop(events.send(event));
        let to = || events.clone();
        let (hello, strangers, policies, beats, alive) = (to(), to(), to(), to(), to());
        Ok(Self {
            _hello: session
                .declare_queryable(keys::HELLOS)
                .callback(move |query| put(Event::Hello(query), &hello))
                .wait()?,
            _strangers: session
                .declare_queryable(keys::STRANGERS)
                .callback(move |query| put(Event::Stranger(query), &strangers))
                .wait()?,
            _policies: session
                .declare_queryable(keys::policies(name))
                .callback(move |query| put(Event::Policy(query), &policies))
                .wait()?,
            _beats: session
                .declare_subscriber(keys::of_hosts(name, "beat"))
                .callback(move |sample| {
                    let beat = message::decode(&sample.payload().to_bytes());
                    if let (Some((host, name)), Ok(beat)) = (keys::host(sample.key_expr()), beat) {
                        put(Event::Beat(host, name.to_owned(), beat), &beats);
                    }
                })
                .wait()?,
            _alive: session
                .liveliness()
                .declare_subscriber(keys::of_hosts(name, "alive"))
                .callback(move |sample| {
                    if let (SampleKind::Delete, Some((host, name))) =
                        (sample.kind(), keys::host(sample.key_expr()))
                    {
                        put(Event::Gone(host, name.to_owned()), &alive);
                    }
                })
                .wait()?,
        })
    }
}
