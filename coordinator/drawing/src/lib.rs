//! Pictures as SVG: panels of lines, bands and boxes in columns.
//!
//! A [`Panel`] is one coordinate system: two [`Axis`], and the [`Item`]s that are drawn between them. [`render`] puts panels
//! together as a [`Layout`] says. All colours are of one small set, the [`palette`], so that the style sheet of a page can
//! replace them where it is dark.

mod axis;
pub mod palette;
mod panel;
mod render;

pub use axis::{Axis, Scale};
pub use panel::{Item, Link, Panel, Place, Quantiles, line};
pub use render::{Layout, render};
