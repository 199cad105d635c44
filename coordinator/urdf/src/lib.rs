//! A robot from URDF, as other programs describe it, to the description that ours are trained with.
//!
//! ```text
//! text ── document: links and joints, every number checked
//!            └── tree: the base, and the moving links of each arm; what is fixed belongs to what it is fixed to
//!                  └── chain: Denavit–Hartenberg rows of the joints' axes, and the frames that they lead to
//!                        └── bodies: masses, inertias and shapes in these frames
//! ```
//!
//! `import` goes this way; `names` says what arms and links are called, `alike` whether arms are built alike.
//!
//! The robot moves as the URDF's does: the same masses, the same axes. Angles count from another zero, which the home angles take
//! up: the URDF's zero is home. What a URDF has and our robots have not is told, see [`Imported::notes`].

mod alike;
mod bodies;
mod chain;
mod document;
mod error;
mod import;
mod names;
mod tree;

pub use error::UrdfError;
pub use import::{Imported, import};
