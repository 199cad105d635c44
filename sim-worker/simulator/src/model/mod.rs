//! A robot's constants, laid out for the hot path: of its dynamics ([`Model`]), and of what can touch.

mod collision;
mod constants;
mod shape;

pub use collision::ContactKind;
pub(crate) use collision::{FixedBody, Pair, Partner};
pub use constants::Model;
pub(crate) use constants::{AngleContactModel, ArmModel, LinkModel, RigidInertia, Sparsity, Twist};
pub(crate) use shape::{Bound, Core, FixedBox, Rounded};
