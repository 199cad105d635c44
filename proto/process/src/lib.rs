//! What every process of a run does first, and the clocks by which it measures.
//!
//! * [`child`]: a child dies with its parent, and may stay on one processor;
//! * [`certificates`]: which hosts have some;
//! * [`input`]: what a child reads, regular files of limited length;
//! * [`originals`]: a run's configuration and robot, as they were when it began;
//! * [`logging`]: where the logs of a child go;
//! * [`clock`]: clocks that all processes of a machine share, and processor time.

pub mod certificates;
pub mod child;
pub mod clock;
pub mod input;
pub mod logging;
pub mod originals;
