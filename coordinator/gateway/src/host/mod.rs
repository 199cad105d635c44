//! The workers' end: coordinator and learner of the workers of its machine, as far as they can tell.

mod doors;
mod join;
mod ports;
mod workers;

use std::io::BufRead as _;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use channels::Role;
use proto::certificates::CertificateDir;
use proto::gateway::pieces::Content;
use proto::gateway::wire::{HostBeat, HubBeat, Welcome};
use proto::gateway::{Place, Said, Told};
use proto::message::{self, HEARTBEAT, Order, PortId, RunEnd, Status};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use zenoh::query::Query;
use zenoh::{Session, Wait as _};

use self::doors::{Doors, Event, listen};
use self::ports::{HostPorts, Made};
use self::workers::Workers;
use crate::arguments::HostArguments;
use crate::network::{self, End};
use crate::orders::{Single, Task};
use crate::{bells, handshake, keys};

/// How long a policy may take on its way.
const POLICY_DEADLINE: Duration = Duration::from_secs(30);
/// How long it may take at least to connect to a run that is there.
const LEAST_WAIT: Duration = Duration::from_secs(2);

/// Joins a run and works for it until it is over.
pub fn run(arguments: &HostArguments) -> Result<(), ExitError> {
    process::child::die_with_parent(arguments.parent)?;
    let result = connect(arguments).and_then(|session| {
        let result = work(arguments, &session);
        if let Err(error) = session.close().wait() {
            tracing::warn!(%error, "the network was not left in order");
        }
        result
    });
    if let Err(error) = &result {
        // Who started this one may be gone.
        let _ = join::say(&Said::Failed(error.message.clone()));
    }
    result
}

/// Connects to the run, with certificates if there are any.
fn connect(arguments: &HostArguments) -> Result<Session, ExitError> {
    let HostArguments { connect, name, .. } = arguments;
    let wait = Duration::from_secs_f64(arguments.wait);
    let Some(path) = &arguments.certificates else {
        return network::open(End::Connect(connect, wait, None));
    };
    let dir = CertificateDir::new(path);
    // What is left is for the network to find the same again, which may be busy.
    let left = handshake::shake(connect, &dir, name, wait)?.max(LEAST_WAIT);
    network::open(End::Connect(connect, left, Some((&dir, name))))
}

fn work(arguments: &HostArguments, session: &Session) -> Result<(), ExitError> {
    let welcome = join::join(arguments, session)?;
    join::say(&Said::Joined(welcome.host))?;
    let mut line = String::new();
    let read = std::io::stdin().lock().read_line(&mut line);
    let place = read.ok().and_then(|_| serde_json::from_str::<Place>(&line).ok());
    let Some(place) = place else {
        let message = "who started this gateway did not say where the services are";
        return Err(ExitError::new(ExitCode::Failure, message));
    };
    let (events, inbox) = mpsc::channel();
    let ports = HostPorts::open(&place, &RunDir::new(&arguments.run_dir))?;
    for role in [Role::Learner, Role::Coordinator] {
        bells::listen(&ports.domain, ports.sizes, role, events.clone(), || Event::Bell)?;
    }
    listen(events.clone())?;
    let doors = Doors::open(session, &arguments.name, &welcome, &events).map_err(|error| {
        ExitError::new(ExitCode::Failure, format!("the network cannot be used: {error}"))
    })?;
    let mut host = Host {
        session,
        name: &arguments.name,
        welcome,
        events,
        ports,
        wanted: arguments.workers,
        workers: Workers::default(),
        policies: Vec::new(),
        asking: false,
        heard: Instant::now(),
        wait: Duration::from_secs_f64(arguments.wait),
        said: None,
    };
    let result = host.serve(&inbox);
    drop(doors);
    result
}

/// Whether the run goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Course {
    GoesOn,
    Over,
}

/// The one thread that owns the ports.
struct Host<'a> {
    session: &'a Session,
    name: &'a str,
    welcome: Welcome,
    events: Sender<Event>,
    ports: HostPorts,
    /// How many workers the run wants of this machine.
    wanted: u32,
    workers: Workers<Query>,
    /// Versions that workers have been given.
    policies: Vec<u64>,
    /// Whether a policy is on its way.
    asking: bool,
    /// When the hub was heard last.
    heard: Instant,
    wait: Duration,
    /// When the hub heard of this host last.
    said: Option<Instant>,
}

impl Host<'_> {
    fn serve(&mut self, inbox: &Receiver<Event>) -> Result<(), ExitError> {
        loop {
            match inbox.recv_timeout(HEARTBEAT / 2) {
                Ok(event) => {
                    if self.take(event)? == Course::Over {
                        return Ok(());
                    }
                    for event in inbox.try_iter() {
                        if self.take(event)? == Course::Over {
                            return Ok(());
                        }
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                // This thread has a sender itself.
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            // Workers that have just come get the policies of before.
            self.ports.policy.update_connections();
            self.hear_workers()?;
            self.take_blocks()?;
            self.send_orders()?;
            if self.heard.elapsed() > self.wait {
                let message =
                    format!("the run has not been heard for {} s", self.wait.as_secs_f64());
                return Err(ExitError::new(ExitCode::Failure, message));
            }
            if self.said.is_none_or(|said| said.elapsed() >= HEARTBEAT) {
                self.said = Some(Instant::now());
                self.say();
            }
        }
    }

    fn take(&mut self, event: Event) -> Result<Course, ExitError> {
        match event {
            // What has come is looked at after all events.
            Event::Bell => {}
            Event::Order(query) => self.take_order(query),
            Event::Beat(beat) => return self.hear_hub(&beat),
            Event::Told(Told::Leave { worker, incarnation }) => {
                self.send_home(worker, incarnation)?;
            }
            Event::Policy(version, asked) => {
                self.asking = false;
                if self.ports.policy(version, &asked)? {
                    self.policies.push(version);
                } else {
                    tracing::warn!(version, missing = asked.answer.missing(), trouble = ?asked.trouble, "no policy");
                }
            }
        }
        Ok(Course::GoesOn)
    }

    fn hear_hub(&mut self, beat: &HubBeat) -> Result<Course, ExitError> {
        self.heard = Instant::now();
        let mut hosts = beat.hosts.iter();
        let known = hosts.find(|(host, _)| *host == self.welcome.host);
        let Some((_, wanted)) = known.filter(|_| beat.session == self.welcome.session) else {
            let message = "the run has begun anew; this machine has to join again";
            return Err(ExitError::new(ExitCode::Failure, message));
        };
        match beat.end {
            None => {}
            Some(RunEnd::Over) => return Ok(Course::Over),
            Some(RunEnd::Stopped) => {
                let message = "the run was stopped before its budget was done";
                return Err(ExitError::new(ExitCode::Failure, message));
            }
        }
        if *wanted != self.wanted {
            self.wanted = *wanted;
            join::say(&Said::Scale(*wanted))?;
        }
        // Oldest first: workers take the order in which they come for that of the versions.
        let wanted = beat.policies.iter().find(|version| !self.policies.contains(version));
        if let Some(&version) = wanted
            && !self.asking
        {
            self.ask_for_policy(version);
        }
        Ok(Course::GoesOn)
    }

    /// Asks for a policy, on a thread of its own.
    fn ask_for_policy(&mut self, version: u64) {
        self.asking = true;
        let key = keys::policy(&self.welcome.session, version);
        let (session, events) = (self.session.clone(), self.events.clone());
        let most = 4 * self.ports.sizes.policy_len;
        let ask = move || {
            let asked = network::ask(&session, &key, Vec::new(), POLICY_DEADLINE, most);
            let _ = events.send(Event::Policy(version, Box::new(asked)));
        };
        if let Err(error) = std::thread::Builder::new().name("policy".to_owned()).spawn(ask) {
            tracing::error!(%error, "cannot start a thread");
            self.asking = false;
        }
    }

    fn take_order(&mut self, query: Query) {
        let bytes = query.payload().map(|payload| payload.to_bytes().into_owned());
        let order = match message::decode(&bytes.unwrap_or_default()) {
            Ok(order) => order,
            Err(error) => return tracing::error!(error, "an order cannot be read"),
        };
        if let Some(single) = Single::all(&order).pop() {
            self.workers.ordered(single, query);
        }
    }

    /// Sends what workers have not been sent.
    fn send_orders(&mut self) -> Result<(), ExitError> {
        for (order, port) in self.workers.unsent() {
            let missed = self.ports.orders.send(&order.order())?;
            if missed.includes(port) {
                self.workers.missed(&order);
            }
        }
        Ok(())
    }

    fn hear_workers(&mut self) -> Result<(), ExitError> {
        while let Some(status) = self.ports.status()? {
            match &status {
                Status::Ready { worker, incarnation, orders }
                | Status::Heartbeat { worker, incarnation, orders } => {
                    self.worker_lives(*worker, *incarnation, *orders);
                }
                Status::EvaluationDone { worker, chunk, .. } => {
                    self.answer(
                        *worker,
                        Task::Evaluation(*chunk),
                        &Content::Status,
                        &message::encode(&status),
                    );
                }
                Status::Failed { worker, message: text, fault, .. } => {
                    tracing::error!(worker, text);
                    if let Some(fault) = fault {
                        let task = Task::Block { iteration: fault.iteration, shard: fault.shard };
                        self.answer(*worker, task, &Content::Status, &message::encode(&status));
                    }
                }
                // The block speaks for itself.
                _ => {}
            }
        }
        Ok(())
    }

    /// A worker says that it is there. One that the run does not know is told to it at once.
    fn worker_lives(&mut self, worker: u32, incarnation: u32, orders: PortId) {
        if self.workers.lives(worker, incarnation, orders) {
            self.said = None;
        }
    }

    /// Has a worker go. The run is told first, so that nothing is asked of it any more; what it had to make is made by
    /// others.
    fn send_home(&mut self, worker: u32, incarnation: u32) -> Result<(), ExitError> {
        if self.workers.leaves(worker, incarnation) {
            self.say();
            self.workers.forget(worker);
        }
        // One that has no room for it is sent home again when it is heard again.
        self.ports.orders.send(&Order::Leave { worker, incarnation })?;
        Ok(())
    }

    fn take_blocks(&mut self) -> Result<(), ExitError> {
        while let Some(block) = self.ports.blocks.try_receive()? {
            let Made { worker, task, content } = Made::of(block.header());
            let bytes: &[u8] = bytemuck::cast_slice(block.payload());
            if let Some(query) = self.workers.done(worker, task) {
                network::answer(query, network::cut(&content, bytes));
            }
        }
        Ok(())
    }

    fn answer(&mut self, worker: u32, task: Task, content: &Content, bytes: &[u8]) {
        if let Some(query) = self.workers.done(worker, task) {
            network::answer(query, network::cut(content, bytes));
        }
    }

    /// Tells the hub which workers there are. What is lost on the way comes again soon.
    fn say(&self) {
        let key = keys::of_host(&self.welcome.session, self.name, self.welcome.host, "beat");
        let beat = HostBeat { workers: self.workers.numbers() };
        if let Err(error) = self.session.put(key, message::encode(&beat)).wait() {
            tracing::warn!(%error, "the run could not be told that this host is there");
        }
    }
}
