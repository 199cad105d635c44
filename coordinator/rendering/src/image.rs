//! A picture in memory.

use crate::Color;

/// Pixels, row after row from the top, each red, green and blue in sRGB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width · height` pixels.
    pub pixels: Vec<[u8; 3]>,
}

impl Image {
    /// All of one colour.
    pub fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        Self { width, height, pixels: vec![color; width * height] }
    }

    /// The pixel in a column and a row.
    ///
    /// # Panics
    /// If there is no such pixel.
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        assert!(x < self.width && y < self.height, "pixel {x}, {y}");
        self.pixels[y * self.width + x]
    }

    /// Covers a share of a pixel with a colour; pixels outside of the picture are none.
    pub(crate) fn blend(&mut self, x: i64, y: i64, color: Color, share: f32) {
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        if inside && share > 0.0 {
            let pixel = &mut self.pixels[y as usize * self.width + x as usize];
            *pixel = Color::srgb(*pixel).mixed(color, share.min(1.0)).to_srgb();
        }
    }
}
