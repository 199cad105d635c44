//! Moving pictures as files: GIF, APNG and WebP.
//!
//! After the first picture a film holds only what changes: a rectangle around it, and of that only the pixels that differ.

mod apng;
mod format;
mod gif;
mod palette;
mod patch;
mod webp;

pub use self::format::{FilmError, Format};
use crate::Image;

/// A film that grows by a picture at a time, and begins anew when it is over.
#[derive(Debug)]
pub struct Film {
    writer: Writer,
    /// When the last picture's time was over (ms).
    until: u64,
}

#[derive(Debug)]
enum Writer {
    Gif(gif::Gif),
    Apng(apng::Apng),
    WebP(webp::WebP),
}

impl Film {
    /// A film of so many pictures of this size (px). `examples` are pictures like those that will come; where there are few colours, they are chosen by them.
    pub fn new(
        format: Format,
        size: [usize; 2],
        pictures: u32,
        examples: &[Image],
    ) -> Result<Self, FilmError> {
        let fit = size.map(|side| u16::try_from(side).ok().filter(|side| *side > 0));
        let [Some(width), Some(height)] = fit else {
            return Err(format.error(&format!("{} × {} pixels", size[0], size[1])));
        };
        let writer = match format {
            Format::Gif => Writer::Gif(gif::Gif::new([width, height], examples)?),
            Format::Apng => Writer::Apng(apng::Apng::new([width, height], pictures)?),
            Format::WebP => Writer::WebP(webp::WebP::new([width, height])),
        };
        Ok(Self { writer, until: 0 })
    }

    /// The next picture, shown until this time after the beginning (ms).
    ///
    /// # Panics
    /// If the picture has another size, or the time is over.
    pub fn add(&mut self, image: &Image, until: u64) -> Result<(), FilmError> {
        assert!(until > self.until, "{until} ms");
        let time = [self.until, until];
        self.until = until;
        match &mut self.writer {
            Writer::Gif(gif) => gif.add(image, time),
            Writer::Apng(apng) => apng.add(image, time),
            Writer::WebP(webp) => webp.add(image, time),
        }
    }

    /// The file, after the last picture.
    pub fn finish(self) -> Result<Vec<u8>, FilmError> {
        match self.writer {
            Writer::Gif(gif) => gif.finish(),
            Writer::Apng(apng) => apng.finish(),
            Writer::WebP(webp) => webp.finish(),
        }
    }
}

#[cfg(test)]
mod tests;
