//! Colours: amounts of light while they are computed with, sRGB in pictures.

/// Amounts of red, green and blue light, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Color(pub [f32; 3]);

impl Color {
    /// No light.
    pub const BLACK: Self = Self([0.0; 3]);

    /// The colour that sRGB writes like this.
    pub fn srgb([red, green, blue]: [u8; 3]) -> Self {
        Self([red, green, blue].map(|level| {
            let level = f32::from(level) / 255.0;
            if level <= 0.04045 { level / 12.92 } else { ((level + 0.055) / 1.055).powf(2.4) }
        }))
    }

    /// As sRGB writes it; more light than 1 is 1.
    pub fn to_srgb(self) -> [u8; 3] {
        self.0.map(|light| {
            let light = light.clamp(0.0, 1.0);
            let level = if light <= 0.0031308 {
                12.92 * light
            } else {
                1.055 * light.powf(1.0 / 2.4) - 0.055
            };
            (255.0 * level).round() as u8
        })
    }

    /// `share` of `other` and the rest of this.
    pub fn mixed(self, other: Self, share: f32) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + share * (other.0[i] - self.0[i])))
    }

    /// So much of its light.
    pub fn scaled(self, factor: f32) -> Self {
        Self(self.0.map(|light| factor * light))
    }

    /// What a surface of this colour gives back of a light.
    pub(crate) fn lit(self, light: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * light.0[i]))
    }

    /// Both lights together.
    pub(crate) fn plus(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_there_and_back_is_the_same() {
        for level in 0..=255 {
            let written = [level, 255 - level, level / 2];
            assert_eq!(Color::srgb(written).to_srgb(), written);
        }
    }

    #[test]
    fn half_of_the_light_is_188() {
        // IEC 61966-2-1: 1.055 · 0.5^(1/2.4) − 0.055 = 0.7354, of 255.
        assert_eq!(Color([0.5; 3]).to_srgb(), [188; 3]);
        assert_eq!(Color([2.0, -1.0, 1.0]).to_srgb(), [255, 0, 255]);
    }
}
