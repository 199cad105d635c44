//! A robot's constants, laid out for the hot path: of its dynamics ([`Model`]), and of what can touch.

mod collision;
mod constants;
mod shape;

pub use collision::{CollisionModel, ContactKind, FixedBody, MovingBody, Pair, Partner};
pub use constants::{
    AngleContactModel, ArmModel, LinkModel, Masses, Model, RigidInertia, SignedPermutation,
    Sparsity, Twist,
};
pub use shape::{Bound, Core, FixedBox, Rounded};
