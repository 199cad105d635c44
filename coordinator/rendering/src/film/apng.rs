//! Films as APNG.

use std::cell::RefCell;
use std::io::Write;
use std::rc::Rc;

use png::{BitDepth, BlendOp, ColorType, Compression, DisposeOp, Encoder, EncodingError};

use super::format::{FilmError, Format};
use super::patch::Patch;
use crate::Image;

/// Bytes that are still there when who writes them is gone.
#[derive(Debug, Clone, Default)]
struct Shared(Rc<RefCell<Vec<u8>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

pub(super) struct Apng {
    writer: png::Writer<Shared>,
    bytes: Shared,
    shown: Option<Image>,
}

impl std::fmt::Debug for Apng {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Apng").finish_non_exhaustive()
    }
}

impl Apng {
    pub(super) fn new(size: [u16; 2], pictures: u32) -> Result<Self, FilmError> {
        let bytes = Shared::default();
        let new = || {
            let [width, height] = size.map(u32::from);
            let mut encoder = Encoder::new(bytes.clone(), width, height);
            encoder.set_color(ColorType::Rgba);
            encoder.set_depth(BitDepth::Eight);
            encoder.set_compression(Compression::High);
            encoder.set_animated(pictures, 0)?;
            encoder.write_header()
        };
        let writer = new().map_err(|error: EncodingError| Format::Apng.error(&error))?;
        Ok(Self { writer, bytes, shown: None })
    }

    pub(super) fn add(&mut self, image: &Image, [from, until]: [u64; 2]) -> Result<(), FilmError> {
        let patch = match &self.shown {
            Some(before) => Patch::between(before, image, 1),
            None => Patch::whole(image),
        };
        let delay = u16::try_from(until - from).unwrap_or(u16::MAX);
        let first = self.shown.is_none();
        let writer = &mut self.writer;
        let mut write = || {
            writer.set_frame_delay(delay, 1000)?;
            if !first {
                writer.reset_frame_position()?;
                writer.set_frame_dimension(patch.width as u32, patch.height as u32)?;
                writer.set_frame_position(patch.left as u32, patch.top as u32)?;
                writer.set_blend_op(BlendOp::Over)?;
                writer.set_dispose_op(DisposeOp::None)?;
            }
            writer.write_image_data(&patch.rgba())
        };
        write().map_err(|error: EncodingError| Format::Apng.error(&error))?;
        self.shown = Some(image.clone());
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Vec<u8>, FilmError> {
        self.writer.finish().map_err(|error| Format::Apng.error(&error))?;
        Ok(self.bytes.0.take())
    }
}
