//! Films as WebP: pictures packed without loss, in the container that Google's specification of WebP describes under "Extended File Format".
//!
//! The encoder writes single pictures; the container around several is put together here.

use image_webp::{ColorType, WebPEncoder};

use super::format::{FilmError, Format};
use super::patch::Patch;
use crate::Image;

/// Flags of the whole: some pixels cover nothing, and there are several pictures.
const ALPHA: u8 = 1 << 4;
const ANIMATION: u8 = 1 << 1;
/// Bytes of a single picture's file before its chunk.
const HEADER: usize = 12;

#[derive(Debug)]
pub(super) struct WebP {
    /// What follows `RIFF`, the length and `WEBP`.
    chunks: Vec<u8>,
    shown: Option<Image>,
}

/// The three low bytes of a number.
fn three(number: u64) -> [u8; 3] {
    let [a, b, c, ..] = number.to_le_bytes();
    [a, b, c]
}

/// Appends a chunk; chunks begin at even places.
fn push(chunks: &mut Vec<u8>, name: [u8; 4], content: &[u8]) {
    chunks.extend(name);
    chunks.extend((content.len() as u32).to_le_bytes());
    chunks.extend(content);
    if content.len() % 2 == 1 {
        chunks.push(0);
    }
}

impl WebP {
    pub(super) fn new(size: [u16; 2]) -> Self {
        let mut chunks = Vec::new();
        let mut canvas = vec![ALPHA | ANIMATION, 0, 0, 0];
        canvas.extend(size.iter().flat_map(|side| three(u64::from(*side) - 1)));
        push(&mut chunks, *b"VP8X", &canvas);
        // No colour behind it, and no end of its repetitions.
        push(&mut chunks, *b"ANIM", &[0; 6]);
        Self { chunks, shown: None }
    }

    pub(super) fn add(&mut self, image: &Image, [from, until]: [u64; 2]) -> Result<(), FilmError> {
        // Corners are counted in pairs of pixels.
        let patch = match &self.shown {
            Some(before) => Patch::between(before, image, 2),
            None => Patch::whole(image),
        };
        self.shown = Some(image.clone());
        let mut picture = Vec::new();
        let (width, height) = (patch.width as u32, patch.height as u32);
        WebPEncoder::new(&mut picture)
            .encode(&patch.rgba(), width, height, ColorType::Rgba8)
            .map_err(|error| Format::WebP.error(&error))?;
        let mut frame = Vec::with_capacity(picture.len() + 16);
        for number in [patch.left / 2, patch.top / 2, patch.width - 1, patch.height - 1] {
            frame.extend(three(number as u64));
        }
        frame.extend(three((until - from).min(0x00ff_ffff)));
        // Drawn over what is there, which stays afterwards.
        frame.push(0);
        frame.extend(&picture[HEADER..]);
        push(&mut self.chunks, *b"ANMF", &frame);
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Vec<u8>, FilmError> {
        let length = u32::try_from(self.chunks.len() + 4)
            .map_err(|_| Format::WebP.error(&"it is larger than 4 GiB"))?;
        let mut file = Vec::with_capacity(self.chunks.len() + HEADER);
        file.extend(b"RIFF");
        file.extend(length.to_le_bytes());
        file.extend(b"WEBP");
        file.extend(self.chunks);
        Ok(file)
    }
}
