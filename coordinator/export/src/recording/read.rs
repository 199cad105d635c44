//! Reading a recording back.

use std::borrow::Cow;

use mcap::read::{LinearReader, attachment};
use mcap::records::{Record, op};

use super::TOPICS;
use super::commanded::{MOTION, MotionFile, ROBOT, Recorded};

/// Longest attachment that is read (bytes).
const LONGEST: u64 = 256 << 20;

impl Recorded {
    /// The motion that an MCAP file of [`Recording`](super::Recording) keeps, if its messages, which viewers draw, are there and have
    /// their checksums.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn read(file: &[u8]) -> Result<Self, String> {
        let damaged = |what: &str| format!("is cut off or damaged ({what}); record it again");
        let summary = mcap::Summary::read(file).map_err(|error| damaged(&error.to_string()))?;
        let summary = summary.ok_or_else(|| damaged("it has no summary"))?;
        let part = |name: &str| -> Result<Vec<u8>, String> {
            let mut found = summary.attachment_indexes.iter().filter(|index| index.name == name);
            let index = found.next().ok_or_else(|| {
                format!("has no attachment {name}: it is no recording of `octopus record`")
            })?;
            let end = index.offset.checked_add(index.length);
            if end.is_none_or(|end| end > file.len() as u64) {
                return Err(damaged(&format!("{name} is cut short")));
            }
            if index.data_size > LONGEST {
                return Err(format!("{name} is longer than {} MiB", LONGEST >> 20));
            }
            let read = attachment(file, index).map_err(|error| format!("{name}: {error}"))?;
            Ok(Cow::into_owned(read.data))
        };
        let robot = String::from_utf8(part(ROBOT)?).map_err(|_| format!("{ROBOT} is no text"))?;
        let recorded = MotionFile::read(&part(MOTION)?, &robot)?;
        let messages = messages(file).map_err(|what| format!("its messages: {what}"))?;
        let expected = TOPICS * (recorded.states.len() + 1);
        if messages != expected {
            return Err(format!("it has {messages} messages, expected {expected}"));
        }
        Ok(recorded)
    }
}

/// How many messages a file has. They stand in chunks, each with its checksum.
///
/// mcap's own readers of messages trust the lengths in a chunk: a wrong one ends them with a panic where sums are checked.
fn messages(file: &[u8]) -> Result<usize, String> {
    let mut messages = 0;
    for record in LinearReader::new(file).map_err(|error| error.to_string())? {
        let Record::Chunk { header, data } = record.map_err(|error| error.to_string())? else {
            continue;
        };
        let is_whole = header.compression.is_empty()
            && header.uncompressed_size == data.len() as u64
            && header.uncompressed_crc == crc32fast::hash(&data);
        if !is_whole {
            return Err("a chunk of them is damaged, or compressed".to_owned());
        }
        messages += messages_in(&data).ok_or("a chunk of them is cut off")?;
    }
    Ok(messages)
}

/// How many messages a chunk has: records of a code, a length and as many bytes.
fn messages_in(mut records: &[u8]) -> Option<usize> {
    let mut messages = 0;
    while let Some((&code, rest)) = records.split_first() {
        let (length, rest) = rest.split_first_chunk()?;
        records = rest.get(usize::try_from(u64::from_le_bytes(*length)).ok()?..)?;
        messages += usize::from(code == op::MESSAGE);
    }
    Some(messages)
}
