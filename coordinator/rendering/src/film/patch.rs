//! What differs between a picture and the next.

use crate::Image;

/// A rectangle of a picture and those of its pixels that are new.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Patch {
    /// Column and row of its upper left corner.
    pub(super) left: usize,
    pub(super) top: usize,
    /// Pixels of a row, and rows; at least one each.
    pub(super) width: usize,
    pub(super) height: usize,
    /// Row after row; nothing where a pixel stays as it is.
    pub(super) pixels: Vec<Option<[u8; 3]>>,
}

impl Patch {
    /// All of a picture.
    pub(super) fn whole(image: &Image) -> Self {
        let pixels = image.pixels.iter().copied().map(Some).collect();
        Self { left: 0, top: 0, width: image.width, height: image.height, pixels }
    }

    /// What has to be drawn over `before` so that it becomes `after`; one pixel that stays, if nothing has. Its corner lies on a multiple of `grid`.
    ///
    /// # Panics
    /// If they differ in size.
    pub(super) fn between(before: &Image, after: &Image, grid: usize) -> Self {
        let size = |image: &Image| (image.width, image.height);
        assert_eq!(size(before), size(after), "pictures of one film");
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for (index, (a, b)) in before.pixels.iter().zip(&after.pixels).enumerate() {
            if a != b {
                let at = [index % after.width, index / after.width];
                for i in 0..2 {
                    low[i] = low[i].min(at[i] - at[i] % grid);
                    high[i] = high[i].max(at[i] + 1);
                }
            }
        }
        if high[0] == 0 {
            return Self { left: 0, top: 0, width: 1, height: 1, pixels: vec![None] };
        }
        let mut pixels = Vec::with_capacity((high[0] - low[0]) * (high[1] - low[1]));
        for y in low[1]..high[1] {
            for index in y * after.width + low[0]..y * after.width + high[0] {
                let (a, b) = (before.pixels[index], after.pixels[index]);
                pixels.push((a != b).then_some(b));
            }
        }
        let [left, top] = low;
        Self { left, top, width: high[0] - left, height: high[1] - top, pixels }
    }

    /// Red, green, blue and cover of every pixel.
    pub(super) fn rgba(&self) -> Vec<u8> {
        let pixel = |pixel: &Option<[u8; 3]>| pixel.map_or([0; 4], |[r, g, b]| [r, g, b, 255]);
        self.pixels.iter().flat_map(pixel).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patch_holds_what_differs_and_no_more() {
        let before = Image::filled(8, 6, [1; 3]);
        let mut after = before.clone();
        assert_eq!(Patch::between(&before, &after, 1).pixels, [None]);
        after.pixels[2 * 8 + 3] = [2; 3];
        after.pixels[4 * 8 + 5] = [3; 3];
        let patch = Patch::between(&before, &after, 1);
        assert_eq!((patch.left, patch.top, patch.width, patch.height), (3, 2, 3, 3));
        assert_eq!(patch.pixels.iter().flatten().count(), 2);
        assert_eq!((patch.pixels[0], patch.pixels[8]), (Some([2; 3]), Some([3; 3])));
        let patch = Patch::between(&before, &after, 2);
        assert_eq!((patch.left, patch.top, patch.width, patch.height), (2, 2, 4, 3));
        assert_eq!(patch.rgba()[4..8], [2, 2, 2, 255]);
        assert_eq!(Patch::whole(&after).pixels.len(), 48);
    }
}
