//! Certificates by which the machines of a run know each other.
//!
//! A directory of certificates has an **authority**, which signs all others; the **learner**'s certificate, which is for
//! the addresses at which its machine is reached; and one for each **host**, which is for its name. They are for these
//! roles alone: a host cannot pose as the learner, nor the learner as a host. Names of files are [`proto::certificates`]'.
//!
//! * [`issue`]: makes a directory, and adds hosts to it. Nothing is ever overwritten.
//! * [`examine`]: reads what is there, and says what is wrong with it before a network has to.
//!
//! What the gateways of a run do with certificates is theirs; they do not use this crate.
//!
//! ```
//! use std::time::SystemTime;
//!
//! use certificates::examine;
//! use certificates::issue::{Wanted, issue};
//! use proto::certificates::{CertificateDir, LEARNER};
//!
//! let place = std::env::temp_dir().join(format!("octopus-doc-{}", std::process::id()));
//! let dir = CertificateDir::new(&place);
//! let wanted = Wanted { hosts: vec!["lab-2".to_owned()], learner: Vec::new(), days: 365 };
//! let now = SystemTime::now();
//! assert_eq!(issue(&dir, &wanted, now).unwrap(), ["authority", "learner", "lab-2"]);
//! examine::check(&dir, LEARNER, now).unwrap();
//! assert_eq!(examine::own_host(&dir, None).unwrap(), "lab-2");
//! # std::fs::remove_dir_all(&place).unwrap();
//! ```

pub mod examine;
pub mod issue;

mod times;
