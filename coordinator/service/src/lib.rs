//! A run and its checkpoints over HTTP.
//!
//! * [`live`]: a live run as others see it, and what it can be asked to do; [`history`]: what has happened in it of late;
//! * [`http`]: the service;
//! * [`page`]: what the service shows in a browser;
//! * [`client`]: who asks it, and [`peer`], whom a client believes.

pub mod client;
pub mod history;
pub mod http;
pub mod live;
pub mod page;
pub mod peer;
