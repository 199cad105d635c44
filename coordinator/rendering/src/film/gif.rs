//! Films as GIF: one palette for all, the last place of which is for what stays as it is.

use std::borrow::Cow;

use gif::{DisposalMethod, Encoder, Frame, Repeat};

use super::format::{FilmError, Format};
use super::palette::{COLORS, Palette};
use super::patch::Patch;
use crate::Image;

/// Index of what stays.
const STAYS: u8 = COLORS as u8;

pub(super) struct Gif {
    encoder: Encoder<Vec<u8>>,
    palette: Palette,
    /// What is seen now.
    shown: Option<Image>,
}

impl std::fmt::Debug for Gif {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gif").field("palette", &self.palette).finish_non_exhaustive()
    }
}

impl Gif {
    pub(super) fn new(size: [u16; 2], examples: &[Image]) -> Result<Self, FilmError> {
        let palette = Palette::of(examples);
        let new = || {
            let mut encoder = Encoder::new(Vec::new(), size[0], size[1], &palette.bytes())?;
            encoder.set_repeat(Repeat::Infinite)?;
            Ok(encoder)
        };
        let encoder = new().map_err(|error: gif::EncodingError| Format::Gif.error(&error))?;
        Ok(Self { encoder, palette, shown: None })
    }

    pub(super) fn add(&mut self, image: &Image, [from, until]: [u64; 2]) -> Result<(), FilmError> {
        let shown = self.palette.shown(image, self.shown.as_ref());
        let patch = match &self.shown {
            Some(before) => Patch::between(before, &shown, 1),
            None => Patch::whole(&shown),
        };
        self.shown = Some(shown);
        let index = |pixel: &Option<[u8; 3]>| pixel.map_or(STAYS, |c| self.palette.nearest(c));
        let buffer: Vec<u8> = patch.pixels.iter().map(index).collect();
        // Hundredths of a second, rounded so that the whole is never off by more than half of one.
        let hundredths = |ms: u64| (ms + 5) / 10;
        let frame = Frame {
            delay: (hundredths(until) - hundredths(from)).clamp(1, u16::MAX.into()) as u16,
            dispose: DisposalMethod::Keep,
            transparent: Some(STAYS),
            left: patch.left as u16,
            top: patch.top as u16,
            width: patch.width as u16,
            height: patch.height as u16,
            buffer: Cow::Owned(buffer),
            ..Frame::default()
        };
        self.encoder.write_frame(&frame).map_err(|error| Format::Gif.error(&error))
    }

    pub(super) fn finish(self) -> Result<Vec<u8>, FilmError> {
        self.encoder.into_inner().map_err(|error| Format::Gif.error(&error))
    }
}
