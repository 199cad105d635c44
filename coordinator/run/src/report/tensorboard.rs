//! TensorBoard's event files, written without TensorFlow.
//!
//! An event file is a sequence of TFRecords, each of them
//!
//! ```text
//! length of the data     u64, little-endian
//! masked CRC-32C of it   u32
//! data                   an Event message of tensorflow/core/util/event.proto
//! masked CRC-32C of it   u32
//! ```
//!
//! where the mask is a rotation by 15 bits plus a constant. Of the Event message this writer uses
//! `wall_time` (1), `step` (2), `file_version` (3), `summary` (5) and `session_log` (7); a summary
//! is a list (1) of values with `tag` (1) and `simple_value` (2). The step is the number of
//! env-steps, so curves of runs with different sizes lie over each other.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context as _;

use super::evaluations::Evaluated;
use super::line::Line;
use crate::selection::{MeanErrors, Means};

/// An open event file.
#[derive(Debug)]
pub struct EventWriter {
    path: PathBuf,
    file: File,
}

impl EventWriter {
    /// Starts a new event file in `directory`. TensorBoard reads the files of a directory in the
    /// order of their names, which begin with the time.
    pub fn create(directory: &Path) -> anyhow::Result<Self> {
        std::fs::create_dir_all(directory)
            .with_context(|| format!("{}: cannot be created", directory.display()))?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let (seconds, nanoseconds) = (now.as_secs(), now.subsec_nanos());
        let process = std::process::id();
        let path = directory
            .join(format!("events.out.tfevents.{seconds}{nanoseconds:09}.{process}.spaceoctopus"));
        let file = OpenOptions::new()
            .append(true)
            .create_new(true)
            .open(&path)
            .with_context(|| format!("{}: cannot be created", path.display()))?;
        let mut writer = Self { path, file };
        writer.write(&file_version(wall_time()))?;
        Ok(writer)
    }

    /// Makes TensorBoard forget all it read of steps after `env_steps`: those iterations were not
    /// in the checkpoint and come again.
    pub fn forget_after(&mut self, env_steps: u64) -> anyhow::Result<()> {
        self.write(&session_start(wall_time(), env_steps + 1))
    }

    /// Appends the scalars of a line.
    pub fn append(&mut self, line: &Line) -> anyhow::Result<()> {
        let scalars = scalars(line);
        self.write(&summary(wall_time(), line.env_steps, &scalars))
    }

    /// Appends the scalars of an evaluation.
    pub fn append_evaluation(&mut self, evaluated: &Evaluated) -> anyhow::Result<()> {
        let Means { tail, min } = &evaluated.errors;
        let mut scalars = vec![("evaluation/score".to_owned(), evaluated.score as f32)];
        for (kind, errors) in [("", tail), ("min_", min)] {
            let MeanErrors { position, orientation, base } = *errors;
            let values = [("position", position), ("orientation", orientation), ("base", base)];
            let named =
                values.map(|(name, error)| (format!("evaluation/{kind}{name}"), error as f32));
            scalars.extend(named);
        }
        self.write(&summary(wall_time(), evaluated.env_steps, &scalars))
    }

    /// Makes the events durable.
    pub fn sync(&self) -> anyhow::Result<()> {
        self.file
            .sync_all()
            .with_context(|| format!("{}: cannot be made durable", self.path.display()))
    }

    fn write(&mut self, event: &[u8]) -> anyhow::Result<()> {
        self.file
            .write_all(&record(event))
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }
}

/// The tags and values of a line. Tags are the columns of the table, put into folders.
fn scalars(line: &Line) -> Vec<(String, f32)> {
    line.cells()
        .into_iter()
        .filter_map(|(name, cell)| {
            let value = cell.number().filter(|value| value.is_finite())? as f32;
            let tag = match name.as_ref() {
                "env_steps" | "policy_version" => return None,
                "return_mean" => "returns/mean".to_owned(),
                "policy_loss" | "value_loss" | "entropy" | "kl" | "clip_fraction"
                | "explained_variance" => format!("losses/{name}"),
                "actor_grad_norm" | "critic_grad_norm" | "actor_lr" | "critic_lr"
                | "action_std" => format!("optimizer/{name}"),
                "iteration" | "wall_s" | "env_steps_per_s" | "workers" | "restarts" => {
                    format!("run/{name}")
                }
                dotted => match dotted.split_once('.') {
                    Some(("returns", agent)) => format!("returns/agent{agent}"),
                    Some((group, name)) => format!("{group}/{name}"),
                    None => format!("run/{dotted}"),
                },
            };
            Some((tag, value))
        })
        .collect()
}

fn wall_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

/// Frames `data` as a TFRecord.
pub(super) fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let mut framed = Vec::with_capacity(data.len() + 16);
    framed.extend(length);
    framed.extend(masked_crc(&length).to_le_bytes());
    framed.extend(data);
    framed.extend(masked_crc(data).to_le_bytes());
    framed
}

/// CRC-32C, rotated and shifted: TFRecord's guard against data that contains its own checksum.
pub(super) fn masked_crc(data: &[u8]) -> u32 {
    crc32c::crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

pub(super) fn file_version(wall_time: f64) -> Vec<u8> {
    let mut event = Message::default();
    event.double(1, wall_time);
    event.bytes(3, b"brain.Event:2");
    event.0
}

pub(super) fn session_start(wall_time: f64, step: u64) -> Vec<u8> {
    const START: u64 = 1;
    let mut log = Message::default();
    log.varint(1, START);
    let mut event = Message::default();
    event.double(1, wall_time);
    event.varint(2, step);
    event.bytes(7, &log.0);
    event.0
}

pub(super) fn summary(wall_time: f64, step: u64, scalars: &[(String, f32)]) -> Vec<u8> {
    let mut summary = Message::default();
    for (tag, number) in scalars {
        let mut value = Message::default();
        value.bytes(1, tag.as_bytes());
        value.float(2, *number);
        summary.bytes(1, &value.0);
    }
    let mut event = Message::default();
    event.double(1, wall_time);
    event.varint(2, step);
    event.bytes(5, &summary.0);
    event.0
}

/// A protocol-buffers message in the making.
#[derive(Debug, Default)]
struct Message(Vec<u8>);

impl Message {
    fn raw_varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn key(&mut self, field: u64, wire_type: u64) {
        self.raw_varint(field << 3 | wire_type);
    }

    fn varint(&mut self, field: u64, value: u64) {
        self.key(field, 0);
        self.raw_varint(value);
    }

    fn double(&mut self, field: u64, value: f64) {
        self.key(field, 1);
        self.0.extend(value.to_le_bytes());
    }

    fn bytes(&mut self, field: u64, value: &[u8]) {
        self.key(field, 2);
        self.raw_varint(value.len() as u64);
        self.0.extend(value);
    }

    fn float(&mut self, field: u64, value: f32) {
        self.key(field, 5);
        self.0.extend(value.to_le_bytes());
    }
}
