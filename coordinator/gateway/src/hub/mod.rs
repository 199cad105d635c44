//! The learner's end: stands for all workers of all hosts.

mod admission;
mod doors;
mod hosts;
mod policies;
mod ports;
mod reception;

use std::collections::BTreeSet;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use channels::Role;
use proto::gateway::pieces::Content;
use proto::gateway::wire::HubBeat;
use proto::message::{self, HEARTBEAT, Order, RunEnd, Status, WORKERS_OF_A_HOST, WorkerId};
use proto::{ExitCode, ExitError};
use zenoh::qos::CongestionControl;
use zenoh::query::Query;
use zenoh::{Session, Wait as _};

use self::admission::Admission;
use self::doors::{Doors, Event};
use self::hosts::Hosts;
use self::policies::Policies;
use self::ports::Ports;
use self::reception::Reception;
use crate::arguments::HubArguments;
use crate::network::{self, Asked};
use crate::orders::{InFlight, Single, Task};
use crate::{bells, keys};

/// How long the last word to hosts may take to get away.
const LAST_WORD: Duration = Duration::from_millis(100);

/// Works until the run is over.
pub fn run(arguments: &HubArguments) -> Result<(), ExitError> {
    process::child::die_with_parent(arguments.parent)?;
    let reception = Reception::read(arguments)?;
    let (events, inbox) = mpsc::channel();
    let ports = Ports::open(arguments, &reception.config)?;
    bells::listen(&ports.domain, ports.sizes, Role::Workers, events.clone(), || Event::Bell)?;
    let admission = Admission::read(arguments)?;
    let session = network::open(admission.end(&arguments.listen))?;
    let doors = Doors::open(&session, &reception.session, &events)?;
    let deadline = Duration::from_secs_f64(reception.config.run.order_deadline_s);
    let mut hub = Hub {
        session,
        admission,
        events,
        hosts: Hosts::new(arguments.incarnation),
        in_flight: InFlight::default(),
        audits: BTreeSet::new(),
        policies: Policies::default(),
        incarnation: arguments.incarnation,
        deadline,
        said: None,
        reception,
        ports,
    };
    tracing::info!(endpoint = arguments.listen, "waiting for hosts");
    let result = hub.serve(&inbox);
    drop(doors);
    if let Err(error) = hub.session.close().wait() {
        tracing::warn!(%error, "the network was not left in order");
    }
    result
}

/// The one thread that owns the ports.
struct Hub {
    session: Session,
    admission: Admission,
    events: Sender<Event>,
    reception: Reception,
    hosts: Hosts,
    in_flight: InFlight,
    /// Those of them whose blocks are for comparison, and not for the learner.
    audits: BTreeSet<(WorkerId, u32, Task)>,
    policies: Policies,
    incarnation: u32,
    /// How long an order may take.
    deadline: Duration,
    /// When hosts and coordinator heard of this hub last.
    said: Option<Instant>,
    ports: Ports,
}

impl Hub {
    fn serve(&mut self, inbox: &Receiver<Event>) -> Result<(), ExitError> {
        loop {
            match inbox.recv_timeout(HEARTBEAT / 2) {
                Ok(event) => {
                    self.take(event)?;
                    for event in inbox.try_iter() {
                        self.take(event)?;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                // This thread has a sender itself.
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            self.take_policies()?;
            if let Some(end) = self.take_orders()? {
                self.tell_hosts(Some(end));
                std::thread::sleep(LAST_WORD);
                return Ok(());
            }
            for host in self.hosts.expire(Instant::now()) {
                tracing::warn!(host, "has not been heard for too long");
                self.said = None;
            }
            if self.said.is_none_or(|said| said.elapsed() >= HEARTBEAT) {
                self.said = Some(Instant::now());
                if self.admission.has_changed() {
                    // The network takes its rules when it opens, and keeps its port as long as its process lives.
                    let message = "others may join now; a gateway with their names takes over";
                    return Err(ExitError::new(ExitCode::Failure, message));
                }
                self.tell_hosts(None);
                self.ports.say(&Status::Hosts {
                    incarnation: self.incarnation,
                    orders: self.ports.orders.port(),
                    refused: self.hosts.refused(),
                    hosts: self.hosts.report(),
                })?;
            }
        }
    }

    fn take(&mut self, event: Event) -> Result<(), ExitError> {
        match event {
            // What has come is looked at after all events.
            Event::Bell => {}
            Event::Hello(query) => self.reception.receive(query, &mut self.hosts),
            Event::Policy(query) => self.hand_out(query),
            Event::Stranger(query) => Reception::explain(query, &self.admission.names),
            Event::Beat(host, name, _) if !self.hosts.is_called(host, &name) => {}
            Event::Beat(host, _, beat) => {
                if self.hosts.heard(host, &beat.workers, Instant::now()) {
                    self.said = None;
                }
            }
            Event::Gone(host, name) => {
                if self.hosts.is_called(host, &name) && self.hosts.gone(host) {
                    tracing::warn!(host, "is gone");
                    self.said = None;
                }
            }
            Event::Answered(order, asked) => self.deliver(&order, &asked)?,
        }
        Ok(())
    }

    /// Tells hosts which policies there are. What is lost on the way comes again soon.
    fn tell_hosts(&self, end: Option<RunEnd>) {
        let beat = HubBeat {
            session: self.reception.session.clone(),
            policies: self.policies.versions(),
            hosts: self.hosts.wanted(),
            end,
        };
        let congestion =
            if end.is_some() { CongestionControl::Block } else { CongestionControl::Drop };
        let put = self.session.put(keys::BEAT, message::encode(&beat));
        if let Err(error) = put.congestion_control(congestion).wait() {
            tracing::warn!(%error, "hosts could not be told what there is");
        }
    }

    fn take_policies(&mut self) -> Result<(), ExitError> {
        while let Some(sample) = self.ports.policy.try_receive()? {
            let version = sample.header().version;
            self.policies.add(version, bytemuck::cast_slice(sample.payload()).to_vec());
            self.tell_hosts(None);
        }
        Ok(())
    }

    /// Answers with a policy; a question for one that is gone has no answer.
    fn hand_out(&self, query: Query) {
        let Some(version) = keys::version(query.key_expr()) else { return };
        if let Some(bytes) = self.policies.get(version) {
            network::answer(query, network::cut(&Content::Policy(version), bytes));
        }
    }

    /// Takes all orders that have come; how the run ends, if it does.
    fn take_orders(&mut self) -> Result<Option<RunEnd>, ExitError> {
        loop {
            let order = match self.ports.orders.try_receive() {
                Ok(Some(order)) => order,
                Ok(None) => return Ok(None),
                // A garbled one is passed over; it will be sent again.
                Err(error @ channels::ChannelError::Decode { .. }) => {
                    tracing::error!("{error}");
                    continue;
                }
                Err(error) => return Err(error.into()),
            };
            match &order {
                Order::Stop(end) => return Ok(Some(*end)),
                Order::Refuse { name } if self.hosts.refuse(name) => {
                    tracing::warn!(name, "makes other bits and is refused");
                    self.said = None;
                }
                Order::ScaleHost { host, workers } => {
                    let done = self.hosts.scale(*host, *workers);
                    tracing::info!(host, workers, done, "is to have another number of workers");
                    // What cannot be is said when the next word is due: at once it would be asked for again, without end.
                    if done {
                        self.said = None;
                    }
                }
                _ => {}
            }
            let is_audit = matches!(order, Order::Audit { .. });
            for single in Single::all(&order) {
                if single.worker >= WORKERS_OF_A_HOST {
                    if is_audit {
                        self.audits.insert(single.key());
                    }
                    self.ask(single);
                }
            }
        }
    }

    /// Asks a host for what one of its workers is ordered, on a thread of its own.
    fn ask(&mut self, order: Single) {
        let Some((host, local)) = self.hosts.find(order.worker, order.incarnation) else {
            self.audits.remove(&order.key());
            return;
        };
        if !self.in_flight.begin(&order) {
            return;
        }
        let question = message::encode(&Single { worker: local, ..order }.order());
        let name = self.hosts.name(host).unwrap_or_default();
        let key = keys::of_host(&self.reception.session, name, host, "order");
        let (session, events) = (self.session.clone(), self.events.clone());
        let (patience, most) = (self.deadline, self.ports.longest_answer());
        let ask = move || {
            let asked = network::ask(&session, &key, question, patience, most);
            let _ = events.send(Event::Answered(order, Box::new(asked)));
        };
        if let Err(error) = std::thread::Builder::new().name("order".to_owned()).spawn(ask) {
            tracing::error!(%error, "cannot start a thread");
            // Its worker is none until its host is heard again: what it was ordered is open for others then.
            self.in_flight.end(&order);
            self.audits.remove(&order.key());
            self.hosts.dismiss(order.worker);
            self.said = None;
        }
    }

    /// Gives on what came of an order, if its worker is still one.
    fn deliver(&mut self, order: &Single, asked: &Asked) -> Result<(), ExitError> {
        self.in_flight.end(order);
        let is_audit = self.audits.remove(&order.key());
        let Single { worker, incarnation, task, .. } = *order;
        self.hosts.missed(worker, asked.answer.missing());
        if let Some(trouble) = &asked.trouble {
            tracing::warn!(worker, ?task, trouble, "an answer is not what it should be");
        }
        if self.hosts.find(worker, incarnation).is_none() {
            tracing::debug!(worker, ?task, "comes too late and is dropped");
            return Ok(());
        }
        let done = match asked.answer.whole() {
            Some((Content::Block(header), len)) if is_audit => {
                let said = self.ports.audited(order, header, &asked.answer, len)?;
                if said {
                    self.hosts.delivered(worker, len);
                }
                said
            }
            Some((Content::Block(header), len)) => {
                let sent = self.ports.block(order, header, &asked.answer, len)?;
                if sent {
                    self.hosts.delivered(worker, len);
                }
                sent
            }
            Some((Content::Status, len)) => self.ports.status(order, &asked.answer, len)?,
            Some((Content::Policy(_), _)) | None => false,
        };
        if !done {
            tracing::warn!(worker, ?task, "an order has not come back and is given up");
            self.hosts.dismiss(worker);
            self.said = None;
        }
        Ok(())
    }
}
