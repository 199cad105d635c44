//! How much and for how long a client may take.

use std::time::Duration;

/// Bounds of the service, with defaults for a laboratory's network.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Time for a request's head, and for which a connection may stay idle between two requests.
    pub head_time: Duration,
    /// Time that a client may make the service wait, sending or receiving, for every
    /// [`pace_bytes`](Self::pace_bytes); a slower one is cut off.
    pub pace_time: Duration,
    /// Bytes that a client must move in [`pace_time`](Self::pace_time).
    pub pace_bytes: u64,
    /// Connections at a time; for more, those that have shown no token are ended, or those that have
    /// been there for [`connection_time`](Self::connection_time).
    pub connections: usize,
    /// Time for which a connection that has shown the token keeps its place while others wait.
    pub connection_time: Duration,
    /// Uploads at a time; more are refused.
    pub uploads: usize,
    /// Downloads of archives at a time, each of which holds a thread; more are refused.
    pub archives: usize,
    /// Pages that are told what happens, at a time; more are refused.
    pub watchers: usize,
    /// Largest uploaded archive (bytes).
    pub upload_bytes: u64,
    /// Beside a live run: that many times the largest checkpoint that it has made,
    pub live_upload_states: u64,
    /// but at least this (bytes), and never more than [`upload_bytes`](Self::upload_bytes).
    pub live_upload_bytes: u64,
    /// Changes of the store at a time, each of which holds a thread while another program has the
    /// store's lock; more are refused.
    pub changes: usize,
    /// Time for which a change waits for the store's lock.
    pub lock_time: Duration,
    /// Beside a live run: all uploads that are there together, in largest uploads.
    pub live_uploads: u64,
    /// What stays free on the disk whatever is uploaded (bytes).
    pub disk_reserve: u64,
    /// Largest JSON body (bytes).
    pub json_bytes: u64,
    /// Time for a live run to do what it is asked.
    pub command_time: Duration,
    /// Time for requests under way when the service stops.
    pub stop_time: Duration,
}

impl Limits {
    /// Largest head of a request (bytes); more than any client sends without ill will.
    pub(super) const HEAD_BYTES: usize = 16 * 1024;
    /// Largest buffer of a connection (bytes).
    pub(super) const BUFFER_BYTES: usize = 128 * 1024;
    /// Most header fields of a request.
    pub(super) const HEAD_FIELDS: usize = 64;
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            head_time: Duration::from_secs(10),
            pace_time: Duration::from_secs(30),
            pace_bytes: 64 * 1024,
            connections: 512,
            connection_time: Duration::from_mins(1),
            uploads: 8,
            archives: 16,
            watchers: 64,
            upload_bytes: 4 << 30,
            live_upload_states: 4,
            live_upload_bytes: 64 << 20,
            live_uploads: 8,
            disk_reserve: 1 << 30,
            changes: 8,
            lock_time: Duration::from_secs(5),
            json_bytes: 64 * 1024,
            command_time: Duration::from_mins(1),
            stop_time: Duration::from_secs(2),
        }
    }
}
