//! Solid bodies as pixels, without a GPU, and pixels as moving pictures.
//!
//! A [`Scene`] is what is seen: convex [`Solid`]s, which rays are cast at, and [`Overlay`]s, flat lines and rings that are drawn over them
//! by how near they are. A [`Camera`] says from where. [`render`] makes an [`Image`] of both; a [`Font`] writes on it. A [`Film`] puts images
//! one after the other into a file.
//!
//! Everything is a pure function: the same scene gives the same pixels, and the same pixels the same file. Nothing here knows what is shown.
//!
//! **Why rays and no triangles.** Capsules, cylinders, boxes and spheres have exact intersections with a ray. So round things are round at
//! every size, and what is drawn is the very shape that collides.

mod camera;
pub mod color;
mod film;
mod font;
mod image;
mod light;
mod overlay;
mod render;
mod scene;
mod solid;
mod vector;

pub use camera::{Camera, View};
pub use color::Color;
pub use film::{Film, FilmError, Format};
pub use font::Font;
pub use image::Image;
pub use overlay::Overlay;
pub use render::render;
pub use scene::{Body, Scene};
pub use solid::Solid;
pub use vector::Vector;
