//! What comes in: through the network's callbacks, and from `octopus join`.

use std::sync::mpsc::Sender;

use proto::gateway::Told;
use proto::gateway::wire::{HubBeat, Welcome};
use proto::message;
use proto::{ExitCode, ExitError};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait as _};

use crate::keys;
use crate::network::Asked;

/// What other threads put down for the one that owns the ports.
pub(super) enum Event {
    /// Blocks or words of workers may have come.
    Bell,
    /// The run wants something to be done.
    Order(Query),
    /// The hub is there.
    Beat(HubBeat),
    /// `octopus join` wants something.
    Told(Told),
    /// What came of the question for a policy.
    Policy(u64, Box<Asked>),
}

/// Puts down what `octopus join` says on standard input, until that is closed.
pub(super) fn listen(events: Sender<Event>) -> Result<(), ExitError> {
    let listen = move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            let Ok(told) = serde_json::from_str(&line) else { continue };
            if events.send(Event::Told(told)).is_err() {
                return;
            }
        }
    };
    let thread = std::thread::Builder::new().name("input".to_owned()).spawn(listen);
    thread.map(drop).map_err(|error| {
        ExitError::new(ExitCode::Environment, format!("cannot start a thread: {error}"))
    })
}

/// Where the network's callbacks put events down, while this lives.
pub(super) struct Doors {
    _orders: Queryable<()>,
    _beats: Subscriber<()>,
    _token: LivelinessToken,
}

impl Doors {
    pub(super) fn open(
        session: &Session,
        name: &str,
        welcome: &Welcome,
        events: &Sender<Event>,
    ) -> zenoh::Result<Self> {
        let (orders, beats) = (events.clone(), events.clone());
        let key = |what| keys::of_host(&welcome.session, name, welcome.host, what);
        Ok(Self {
            // Nobody takes events any more when the host ends; what comes then is for nobody.
            _orders: session
                .declare_queryable(key("order"))
                .callback(move |query| drop(orders.send(Event::Order(query))))
                .wait()?,
            _beats: session
                .declare_subscriber(keys::BEAT)
                .callback(move |sample| {
                    if let Ok(beat) = message::decode(&sample.payload().to_bytes()) {
                        let _ = beats.send(Event::Beat(beat));
                    }
                })
                .wait()?,
            _token: session.liveliness().declare_token(key("alive")).wait()?,
        })
    }
}
