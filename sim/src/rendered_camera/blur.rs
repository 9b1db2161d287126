//! The blur of a lens: a Gaussian of the same width all over the picture.

use std::ops::Range;

/// Pixels from `left` and `top` up to and without `right` and `bottom`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PixelBox {
    pub(crate) left: usize,
    pub(crate) top: usize,
    pub(crate) right: usize,
    pub(crate) bottom: usize,
}

impl PixelBox {
    pub(crate) const fn columns(&self) -> Range<usize> {
        self.left..self.right
    }

    pub(crate) const fn rows(&self) -> Range<usize> {
        self.top..self.bottom
    }

    /// `margin` wider on each side, as far as the picture goes.
    pub(crate) fn grown(&self, margin: usize, width: usize, height: usize) -> Self {
        Self {
            left: self.left.saturating_sub(margin),
            top: self.top.saturating_sub(margin),
            right: (self.right + margin).min(width),
            bottom: (self.bottom + margin).min(height),
        }
    }
}

/// The weights of a Gaussian at whole pixels, from its middle outwards. Pixels are means over their area, so that this is the same
/// convolution wherever an edge lies between two of them.
#[derive(Clone, Debug)]
pub(crate) struct Blur {
    weights: Vec<f32>,
    between: Vec<f32>,
}

impl Blur {
    pub(crate) fn new(sigma_px: f64) -> Self {
        let reach = (4.0 * sigma_px).ceil() as usize;
        let weight = |offset: usize| (-0.5 * (offset as f64 / sigma_px.max(1e-9)).powi(2)).exp();
        let total = 1.0 + 2.0 * (1..=reach).map(weight).sum::<f64>();
        Self { weights: (0..=reach).map(|offset| (weight(offset) / total) as f32).collect(), between: Vec::new() }
    }

    pub(crate) const fn reach(&self) -> usize {
        self.weights.len() - 1
    }

    /// The blurred pixels of `area` in a picture of `width` columns, in rows; beyond the picture its edge goes on.
    pub(crate) fn run(&mut self, picture: &[f32], width: usize, area: PixelBox, blurred: &mut Vec<f32>) {
        let height = picture.len() / width;
        let reach = self.reach();
        let columns = area.right - area.left;
        let source = area.grown(reach, width, height);
        self.between.clear();
        for row in source.rows() {
            let line = &picture[row * width..(row + 1) * width];
            let at = |column: usize| {
                let mut sum = self.weights[0] * line[column];
                for (offset, weight) in self.weights.iter().enumerate().skip(1) {
                    sum += weight * (line[column.saturating_sub(offset)] + line[(column + offset).min(width - 1)]);
                }
                sum
            };
            self.between.extend(area.columns().map(at));
        }
        blurred.clear();
        for row in area.rows() {
            let line = |row: usize| {
                let start = (row.clamp(source.top, source.bottom - 1) - source.top) * columns;
                &self.between[start..start + columns]
            };
            let begins = blurred.len();
            blurred.extend(line(row).iter().map(|value| self.weights[0] * value));
            for (offset, weight) in self.weights.iter().enumerate().skip(1) {
                let (above, below) = (line(row.saturating_sub(offset)), line(row + offset));
                for ((sum, above), below) in blurred[begins..].iter_mut().zip(above).zip(below) {
                    *sum += weight * (above + below);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_becomes_a_gaussian_of_the_same_sum_and_a_box_has_the_pixels_of_the_whole() {
        let (width, height) = (21, 17);
        let mut picture = vec![0.0; width * height];
        picture[8 * width + 10] = 1.0;
        let mut blur = Blur::new(1.2);
        let (mut whole, mut part) = (Vec::new(), Vec::new());
        blur.run(&picture, width, PixelBox { left: 0, top: 0, right: width, bottom: height }, &mut whole);
        let sum: f32 = whole.iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        let variance: f32 = (0..width * height).map(|i| whole[i] * ((i % width) as f32 - 10.0).powi(2)).sum();
        assert!((variance - 1.44).abs() < 0.01, "{variance}");
        let area = PixelBox { left: 3, top: 5, right: 12, bottom: 17 };
        blur.run(&picture, width, area, &mut part);
        for (index, value) in part.iter().enumerate() {
            let (column, row) = (3 + index % 9, 5 + index / 9);
            assert!((value - whole[row * width + column]).abs() < 1e-7);
        }
        let mut none = Blur::new(0.0);
        none.run(&picture, width, PixelBox { left: 0, top: 0, right: width, bottom: height }, &mut whole);
        assert_eq!(whole, picture);
    }
}
