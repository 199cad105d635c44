//! Pictures as SVG: panels of lines, bands and boxes, and the learning curves of several runs.

pub mod families;
pub mod learning;
pub(crate) mod panels;
pub mod recorded;
