//! Plans on request: a question, the time to answer it, and what is said of the answer.

mod answer;
mod held_out;
mod picture;
mod proposals;
mod report;

pub use self::answer::{Answer, answer};
pub use self::held_out::{HeldOut, held_out};
pub use self::picture::picture;
pub use self::report::{Report, sentence};
