//! Letters on pictures.

use ab_glyph::{Font as _, FontRef, PxScale, ScaleFont as _, point};

use crate::{Color, Image};

/// Roboto by Google (Apache-2.0), its Latin letters, digits and signs; see `fonts/README.md`.
const ROBOTO: &[u8] = include_bytes!("../fonts/roboto.ttf");

/// The font of captions. Its digits are all of one width, so that numbers that change stand still.
#[derive(Debug)]
pub struct Font(FontRef<'static>);

impl Default for Font {
    fn default() -> Self {
        Self(FontRef::try_from_slice(ROBOTO).expect("a font that a test reads"))
    }
}

impl Font {
    /// Width of a text (px) in letters of a size (px).
    pub fn width(&self, text: &str, size: f32) -> f32 {
        let font = self.0.as_scaled(PxScale::from(size));
        text.chars().map(|letter| font.h_advance(font.glyph_id(letter))).sum()
    }

    /// Writes a text that begins at `left` on a base line (px from the upper left corner).
    pub fn write(
        &self,
        image: &mut Image,
        text: &str,
        [left, base]: [f32; 2],
        size: f32,
        color: Color,
    ) {
        let font = self.0.as_scaled(PxScale::from(size));
        let mut x = left;
        for letter in text.chars() {
            let id = font.glyph_id(letter);
            let glyph = id.with_scale_and_position(PxScale::from(size), point(x, base));
            x += font.h_advance(id);
            let Some(outline) = self.0.outline_glyph(glyph) else { continue };
            let corner = outline.px_bounds().min;
            outline.draw(|column, row, share| {
                let at = (corner.x as i64 + i64::from(column), corner.y as i64 + i64::from(row));
                image.blend(at.0, at.1, color, share);
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_where_it_was_asked_for_and_as_wide_as_was_said() {
        let font = Font::default();
        let mut image = Image::filled(120, 40, [255; 3]);
        font.write(&mut image, "12 mm", [10.0, 30.0], 20.0, Color::BLACK);
        let dark = |x: usize| (0..40).any(|y| image.pixel(x, y) != [255; 3]);
        let columns: Vec<usize> = (0..120).filter(|x| dark(*x)).collect();
        let end = 10.0 + font.width("12 mm", 20.0);
        assert!((10..14).contains(&columns[0]), "{columns:?}");
        assert!((end - 4.0..=end).contains(&(columns[columns.len() - 1] as f32)), "{end}");
        assert!((0..120).all(|x| (31..40).all(|y| image.pixel(x, y) == [255; 3])), "below");
    }

    #[test]
    fn digits_are_of_one_width() {
        let font = Font::default();
        for digit in ["1", "4", "7", "8"] {
            assert_eq!(font.width(digit, 16.0), font.width("0", 16.0));
        }
        // Letters that captions need have shapes of their own.
        let missing = font.0.glyph_id('\u{1F600}');
        for letter in "0123456789.-·×° stepmrdhanbo".chars() {
            assert_ne!(font.0.glyph_id(letter), missing, "{letter}");
        }
    }

    #[test]
    fn what_does_not_fit_is_cut_off() {
        let mut image = Image::filled(20, 10, [255; 3]);
        Font::default().write(&mut image, "wide", [-8.0, 20.0], 40.0, Color::BLACK);
        assert!(image.pixels.iter().any(|pixel| *pixel != [255; 3]));
    }
}
