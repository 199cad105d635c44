//! The colours of all pictures.

use std::fmt;

use plotters::style::RGBColor;

/// A colour. Its text is CSS's, `#RRGGBB`, as SVG written by hand wants it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Color(u8, u8, u8);

/// Of letters, and of what everything else is compared with.
pub const INK: Color = Color(38, 50, 56);
/// Of what should not catch the eye: axes and their labels.
pub const FAINT: Color = Color(96, 112, 120);
/// Of the lines behind what is drawn.
pub const GRID: Color = Color(226, 231, 234);
/// Behind a picture that stands by itself.
pub(crate) const GROUND: Color = Color(255, 255, 255);
/// Of what is drawn: Okabe and Ito's colours, which all eyes tell apart.
pub const COLORS: [Color; 6] = [
    Color(0, 114, 178),
    Color(213, 94, 0),
    Color(0, 158, 115),
    Color(204, 121, 167),
    Color(230, 159, 0),
    Color(86, 180, 233),
];

/// The colour at a place of [`COLORS`], which begin anew after the last.
pub(crate) fn nth(place: usize) -> RGBColor {
    COLORS[place % COLORS.len()].rgb()
}

impl Color {
    /// Red, green and blue in sRGB.
    pub const fn bytes(self) -> [u8; 3] {
        [self.0, self.1, self.2]
    }

    pub(crate) const fn rgb(self) -> RGBColor {
        RGBColor(self.0, self.1, self.2)
    }
}

impl fmt::Display for Color {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(red, green, blue) = self;
        write!(f, "#{red:02X}{green:02X}{blue:02X}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_written_as_in_css() {
        assert_eq!(
            [INK, FAINT, GRID].map(|color| color.to_string()),
            ["#263238", "#607078", "#E2E7EA"]
        );
        assert_eq!(nth(COLORS.len() + 1), COLORS[1].rgb());
    }
}
