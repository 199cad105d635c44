//! How long a block takes from one process to a tensor in another: through the run's own channel,
//! and the same bytes through a pipe and a Unix socket.
//!
//! The receiver asks for a block with one byte through a pipe and goes to sleep; the sender writes
//! the block's numbers, takes the time, and sends. So the receiver is idle whenever a block arrives,
//! as a learner is that waits for the last shard of an iteration, and what is measured is a latency,
//! not a throughput. The time ends when the tensors exist.

use std::fs::File;
use std::hint::black_box;
use std::io::{Read, Write};
use std::os::fd::AsFd as _;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use channels::{ArrayReceiver, ArraySender, BellListener, ChannelSizes, Channels, Domain, Role};
use process::clock::{monotonic, thread_cpu};
use proto::config::Config;
use proto::layout::{BlockHeader, BlockLayout, Dimensions};
use proto::statistics::percentile;
use proto::{ExitCode, ExitError};
use serde_json::{Value, json};

use super::Common;
use crate::memory::view;

/// How the bytes travel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Way {
    /// Through the run's channel for blocks: shared memory and a bell.
    Channel,
    /// Through a pipe, into memory that is there already.
    Pipe,
    /// Through a Unix socket, likewise.
    Socket,
    /// A header alone through a pipe: what it takes to wake a process.
    Wake,
}

impl Way {
    fn as_str(self) -> &'static str {
        match self {
            Self::Channel => "channel",
            Self::Pipe => "pipe",
            Self::Socket => "socket",
            Self::Wake => "wake",
        }
    }
}

/// Options of `learner bench receive`.
#[derive(Debug, Clone, clap::Args)]
pub struct ReceiveArguments {
    #[command(flatten)]
    common: Common,
    /// Name under which the shared memory lives; made by the parent.
    #[arg(long, value_name = "NAME")]
    domain: String,
    /// How the bytes travel.
    #[arg(long, value_enum)]
    way: Way,
    /// Stop after so many blocks, or after the time.
    #[arg(long, value_name = "N")]
    blocks: usize,
}

/// Options of `learner bench send`.
#[derive(Debug, Clone, clap::Args)]
pub struct SendArguments {
    #[command(flatten)]
    common: Common,
    /// Name under which the shared memory lives.
    #[arg(long, value_name = "NAME")]
    domain: String,
    /// How the bytes travel.
    #[arg(long, value_enum)]
    way: Way,
}

/// Blocks before those that count: connections and pages are made by them.
const WARM_UP: usize = 20;
/// `f32` before the block in a stream: the time of sending, and room to keep the block aligned.
const HEAD: usize = 16;
/// How long a channel waits for room.
const DEADLINE: Duration = Duration::from_secs(10);

fn failed(what: &str, error: &std::io::Error) -> ExitError {
    ExitError::new(ExitCode::Failure, format!("{what}: {error}"))
}

/// The receiver: starts the sender, takes its blocks, and says how long they took.
pub(super) fn receive(arguments: &ReceiveArguments) -> Result<Value, ExitError> {
    let (config, dimensions) = arguments.common.begin()?;
    let layout = BlockLayout::new(&dimensions);
    let mut source = Source::open(arguments, &config, &dimensions)?;
    let mut latencies = Vec::with_capacity(arguments.blocks);
    let mut cpu = 0.0;
    let start = Instant::now();
    for block in 0..arguments.blocks + WARM_UP {
        let counts = block >= WARM_UP;
        let enough = start.elapsed().as_secs_f64() >= arguments.common.seconds;
        if latencies.len() >= 2 && enough {
            break;
        }
        source.ask()?;
        let begun = thread_cpu();
        let (sent, seen) = source.take(&layout, &dimensions)?;
        if counts {
            cpu += thread_cpu() - begun;
            latencies.push(seen.saturating_sub(sent).as_secs_f64() * 1e6);
        }
    }
    let sender_cpu_us = source.finish()?;
    let blocks = latencies.len();
    latencies.sort_by(f64::total_cmp);
    Ok(json!({
        "min_us": percentile(&latencies, 0.0),
        "p50_us": percentile(&latencies, 0.5),
        "p99_us": percentile(&latencies, 0.99),
        "max_us": percentile(&latencies, 1.0),
        "blocks": blocks,
        "block_bytes": 4 * layout.len,
        "sender_cpu_us": sender_cpu_us,
        "receiver_cpu_us": 1e6 * cpu / blocks as f64,
    }))
}

/// The receiving end.
struct Source {
    sender: Child,
    requests: ChildStdin,
    way: Way,
    end: End,
    /// What the sender says at the end, if blocks do not come the same way.
    stdout: Option<Box<dyn Read>>,
}

enum End {
    Channel(Box<ChannelEnd>),
    Stream { stream: Box<dyn Read>, buffer: Vec<f32> },
}

struct ChannelEnd {
    blocks: ArrayReceiver<BlockHeader>,
    bell: BellListener,
    // Dropped last: ports must not outlive their services.
    _channels: Channels,
}

impl Source {
    fn open(
        arguments: &ReceiveArguments,
        config: &Config,
        dimensions: &Dimensions,
    ) -> Result<Self, ExitError> {
        let way = arguments.way;
        // Before the sender is: a block finds its receiver.
        let channel = if way == Way::Channel {
            let channels = open_channels(&arguments.domain, config, dimensions)?;
            let (blocks, bell) = (channels.block_receiver()?, channels.listener(Role::Learner)?);
            Some(End::Channel(Box::new(ChannelEnd { blocks, bell, _channels: channels })))
        } else {
            None
        };
        let pair = (way == Way::Socket).then(UnixStream::pair).transpose();
        let pair = pair.map_err(|error| failed("cannot make a pair of sockets", &error))?;
        let (ours, stdout) = match pair {
            Some((ours, theirs)) => (Some(ours), Stdio::from(std::os::fd::OwnedFd::from(theirs))),
            None => (None, Stdio::piped()),
        };
        let mut sender = spawn_sender(arguments, stdout)?;
        let requests = sender.stdin.take().expect("its standard input is a pipe");
        let stream: Box<dyn Read> = match ours {
            Some(socket) => Box::new(socket),
            None => Box::new(sender.stdout.take().expect("its standard output is a pipe")),
        };
        let (end, stdout) = if let Some(end) = channel {
            (end, Some(stream))
        } else {
            let len = if way == Way::Wake { 0 } else { BlockLayout::new(dimensions).len };
            (End::Stream { stream, buffer: vec![0.0; HEAD + len] }, None)
        };
        Ok(Self { sender, requests, way, end, stdout })
    }

    /// Asks for the next block.
    fn ask(&mut self) -> Result<(), ExitError> {
        self.requests.write_all(&[1]).map_err(|error| failed("the sender is gone", &error))
    }

    /// Waits for a block; returns when it was sent and when its tensors existed.
    fn take(
        &mut self,
        layout: &BlockLayout,
        dimensions: &Dimensions,
    ) -> Result<(Duration, Duration), ExitError> {
        match &mut self.end {
            End::Channel(end) => loop {
                if let Some(block) = end.blocks.try_receive()? {
                    touch(block.payload(), layout, dimensions);
                    let seen = monotonic();
                    return Ok((Duration::from_nanos(block.header().rollout_ns), seen));
                }
                end.bell.wait(Duration::from_secs(1));
                if let Ok(Some(status)) = self.sender.try_wait() {
                    let message = format!("the sender ended early: {status}");
                    return Err(ExitError::new(ExitCode::Failure, message));
                }
            },
            End::Stream { stream, buffer } => {
                stream
                    .read_exact(bytemuck::cast_slice_mut(buffer))
                    .map_err(|error| failed("the sender is gone", &error))?;
                let (head, block) = buffer.split_at(HEAD);
                if self.way != Way::Wake {
                    touch(block, layout, dimensions);
                }
                let seen = monotonic();
                let sent: [u8; 8] = std::array::from_fn(|i| bytemuck::cast_slice(head)[i]);
                Ok((Duration::from_nanos(u64::from_le_bytes(sent)), seen))
            }
        }
    }

    /// Ends the sender; returns its processor time a block (µs).
    fn finish(self) -> Result<f64, ExitError> {
        let Self { mut sender, requests, end, stdout, .. } = self;
        drop(requests);
        let mut stream = match end {
            End::Stream { stream, .. } => Some(stream),
            End::Channel(_) => stdout,
        };
        let mut answer = [0; 8];
        if let Some(stream) = &mut stream {
            stream.read_exact(&mut answer).map_err(|error| failed("the sender is gone", &error))?;
        }
        let _ = sender.wait();
        Ok(f64::from_le_bytes(answer))
    }
}

/// Makes the tensors that an update begins with, where the block lies.
#[expect(unsafe_code, reason = "only here is it known how long a block's tensors live")]
fn touch(block: &[f32], layout: &BlockLayout, dimensions: &Dimensions) {
    let [a, t, n, o, s] = [
        dimensions.n_agents,
        dimensions.n_steps,
        dimensions.n_envs,
        dimensions.observation,
        dimensions.state,
    ]
    .map(|size| size as i64);
    for (range, shape) in [
        (&layout.observation, &[a, t + 1, n, o][..]),
        (&layout.state, &[t + 1, n, s]),
        (&layout.action, &[a, t, n, dimensions.n_actions as i64]),
        (&layout.reward, &[a, t, n]),
    ] {
        // SAFETY: the tensor is gone at the end of this turn, and nobody writes it.
        black_box(&unsafe { view(&block[range.clone()], shape) });
    }
}

fn open_channels(
    domain: &str,
    config: &Config,
    dimensions: &Dimensions,
) -> Result<Channels, ExitError> {
    let domain = Domain::parse(domain)?;
    Ok(Channels::open(&domain, ChannelSizes::new(config, dimensions))?)
}

fn spawn_sender(arguments: &ReceiveArguments, stdout: Stdio) -> Result<Child, ExitError> {
    let program = std::env::current_exe().map_err(|error| failed("no program", &error))?;
    let run_dir: &Path = &arguments.common.run_dir;
    Command::new(program)
        .args(["bench", "send", "--way", arguments.way.as_str(), "--domain", &arguments.domain])
        .arg("--run-dir")
        .arg(run_dir)
        .args(["--seconds", "0", "--parent", &std::process::id().to_string()])
        .stdin(Stdio::piped())
        .stdout(stdout)
        .spawn()
        .map_err(|error| failed("the sender cannot be started", &error))
}

/// The sender: one block for every byte of standard input, then its processor time a block.
pub(super) fn send(arguments: &SendArguments) -> Result<(), ExitError> {
    let (config, dimensions) = arguments.common.begin()?;
    let mut sink = Sink::open(arguments, &config, &dimensions)?;
    let mut requests = std::io::stdin().lock();
    let (mut sent, mut cpu) = (0_usize, 0.0);
    while requests.read_exact(&mut [0]).is_ok() {
        let used = sink.send(sent as f32)?;
        if sent >= WARM_UP {
            cpu += used;
        }
        sent += 1;
    }
    let blocks = sent.saturating_sub(WARM_UP).max(1) as f64;
    let answer = (1e6 * cpu / blocks).to_le_bytes();
    stdout()?.write_all(&answer).map_err(|error| failed("the receiver is gone", &error))
}

/// The sending end.
enum Sink {
    /// The services are dropped after their port.
    Channel(Box<(ArraySender<BlockHeader>, Channels)>),
    Stream {
        stream: File,
        buffer: Vec<f32>,
        sent: usize,
    },
}

impl Sink {
    fn open(
        arguments: &SendArguments,
        config: &Config,
        dimensions: &Dimensions,
    ) -> Result<Self, ExitError> {
        if arguments.way == Way::Channel {
            let channels = open_channels(&arguments.domain, config, dimensions)?;
            return Ok(Self::Channel(Box::new((channels.block_sender(DEADLINE)?, channels))));
        }
        let len = BlockLayout::new(dimensions).len;
        let buffer = vec![0.0; HEAD + len];
        let sent = if arguments.way == Way::Wake { HEAD } else { buffer.len() };
        Ok(Self::Stream { stream: stdout()?, buffer, sent })
    }

    /// Writes the block as a simulator would, then sends it. Returns the processor time (s) of
    /// all but the writing, which every way has.
    fn send(&mut self, number: f32) -> Result<f64, ExitError> {
        match self {
            Self::Channel(end) => {
                let blocks = &end.0;
                let begun = thread_cpu();
                let mut sample = blocks.loan()?;
                let loaned = thread_cpu() - begun;
                sample.payload_mut().fill(number);
                let begun = thread_cpu();
                let header = BlockHeader {
                    rollout_ns: monotonic().as_nanos() as u64,
                    ..BlockHeader::default()
                };
                *sample.header_mut() = header;
                blocks.send(sample)?;
                Ok(loaned + (thread_cpu() - begun))
            }
            Self::Stream { stream, buffer, sent } => {
                buffer[HEAD..].fill(number);
                let begun = thread_cpu();
                let bytes: &mut [u8] = bytemuck::cast_slice_mut(buffer);
                bytes[..8].copy_from_slice(&(monotonic().as_nanos() as u64).to_le_bytes());
                stream
                    .write_all(&bytes[..4 * *sent])
                    .map_err(|error| failed("the receiver is gone", &error))?;
                Ok(thread_cpu() - begun)
            }
        }
    }
}

/// Standard output without the library's buffer.
fn stdout() -> Result<File, ExitError> {
    let descriptor = std::io::stdout().as_fd().try_clone_to_owned();
    Ok(File::from(descriptor.map_err(|error| failed("standard output", &error))?))
}
