//! Few colours that stand for many.

use std::collections::{BTreeMap, HashMap};

use color_quant::NeuQuant;

use crate::Image;

/// Colours of a palette, at most.
pub(super) const COLORS: usize = 255;

/// Times that a colour counts at most when the others are chosen: the ground has a colour of its own, however large it is.
const WEIGHT: usize = 64;

/// Squared distance of colours that nobody tells apart in a moving picture, see [`distance`].
const ALIKE: u32 = 60;

/// The colours of a film.
#[derive(Debug)]
pub(super) struct Palette {
    colors: Vec<[u8; 3]>,
    /// Nearest colours that were asked for.
    known: HashMap<[u8; 3], u8>,
}

impl Palette {
    /// Colours by which those of pictures are shown well. Those that are most frequent are exact.
    pub(super) fn of(pictures: &[Image]) -> Self {
        let mut counts: BTreeMap<[u8; 3], usize> = BTreeMap::new();
        for pixel in pictures.iter().flat_map(|picture| &picture.pixels) {
            *counts.entry(*pixel).or_default() += 1;
        }
        let known = HashMap::new();
        if counts.len() <= COLORS {
            return Self { colors: counts.into_keys().collect(), known };
        }
        let ground = counts.iter().max_by_key(|(_, count)| **count).map(|(color, _)| *color);
        let rgba = |(color, count): (&[u8; 3], &usize)| {
            let [red, green, blue] = *color;
            std::iter::repeat_n([red, green, blue, 255], (*count).min(WEIGHT))
        };
        let pixels: Vec<u8> = counts.iter().flat_map(rgba).flatten().collect();
        let chosen = NeuQuant::new(1, COLORS - 1, &pixels).color_map_rgb();
        let chosen = chosen.chunks_exact(3).map(|color| [color[0], color[1], color[2]]);
        Self { colors: ground.into_iter().chain(chosen).collect(), known }
    }

    /// Red, green and blue of all, and nothing for what is left of 256.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut bytes = self.colors.concat();
        bytes.resize(3 * 256, 0);
        bytes
    }

    /// Index of the nearest colour.
    pub(super) fn nearest(&mut self, color: [u8; 3]) -> u8 {
        let colors = &self.colors;
        *self.known.entry(color).or_insert_with(|| {
            let nearest =
                (0..colors.len()).min_by_key(|index| distance(colors[*index], color)).unwrap_or(0);
            nearest as u8
        })
    }

    /// A picture in these colours. Where `before`, which is in them, is as good or hardly worse, it stays.
    pub(super) fn shown(&mut self, image: &Image, before: Option<&Image>) -> Image {
        let mut shown = image.clone();
        for (index, pixel) in shown.pixels.iter_mut().enumerate() {
            let wanted = *pixel;
            let nearest = usize::from(self.nearest(wanted));
            let nearest = self.colors[nearest];
            *pixel = match before {
                Some(before)
                    if distance(before.pixels[index], wanted)
                        <= distance(nearest, wanted).max(ALIKE) =>
                {
                    before.pixels[index]
                }
                _ => nearest,
            };
        }
        shown
    }
}

/// Squared distance of two colours, weighed as eyes do.
fn distance(a: [u8; 3], b: [u8; 3]) -> u32 {
    let weights = [2, 4, 3];
    (0..3).map(|i| weights[i] * u32::from(a[i].abs_diff(b[i])).pow(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colours_are_exact() {
        let mut image = Image::filled(4, 4, [9, 8, 7]);
        image.pixels[5] = [1, 2, 3];
        let mut palette = Palette::of(std::slice::from_ref(&image));
        assert_eq!(palette.shown(&image, None), image);
        assert_eq!(palette.bytes().len(), 768);
    }

    #[test]
    fn many_colours_are_near_and_the_ground_is_exact() {
        let mut image = Image::filled(64, 64, [244, 246, 248]);
        for (index, pixel) in image.pixels.iter_mut().enumerate().take(3000) {
            *pixel = [(index / 16) as u8, (index % 256) as u8, 90];
        }
        let mut palette = Palette::of(std::slice::from_ref(&image));
        let shown = palette.shown(&image, None);
        assert_eq!(shown.pixels[4000], [244, 246, 248]);
        let worst = image.pixels.iter().zip(&shown.pixels).map(|(a, b)| distance(*a, *b)).max();
        assert!(worst.is_some_and(|worst| worst < 4000), "{worst:?}");
        // What nearly stays the same does.
        let mut next = image.clone();
        next.pixels[10][0] ^= 1;
        assert_eq!(palette.shown(&next, Some(&shown)), shown);
    }
}
