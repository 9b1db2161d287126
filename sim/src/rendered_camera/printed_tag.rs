//! A tag on white paper, as a picture of modules that is sampled with soft edges.

use posebridge_vision::tag36h11_modules;

/// Modules of a side, with the white around the black rim: that is the paper.
const MODULES: usize = 10;
/// Modules of the black rim's side.
const RIM_MODULES: f64 = 8.0;
/// Modules and what is beyond the paper.
const CELLS: usize = MODULES + 2;
/// Brightness of the print, paper being 1.
const INK: f32 = 0.08;

/// The modules are cells of a table with a rim of nothing around the paper.
#[derive(Clone, Debug)]
pub(crate) struct PrintedTag {
    cells: [[f32; CELLS]; CELLS],
    module_m: f32,
}

/// What a sample sees of a tag.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TagSample {
    /// The share that falls on the paper.
    pub(crate) cover: f32,
    /// Brightness times that share.
    pub(crate) brightness: f32,
}

/// How soft edges across one axis of a tag are in a sample that stands for a parallelogram: the share of its area on one side of an edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Softness {
    /// Half the extent of the parallelogram along the axis, and of that part of it that is equally wide, modules.
    reach: f32,
    flat: f32,
    /// The longer one of its sides' extents; twice the product of both.
    longer: f32,
    product: f32,
}

impl Softness {
    /// `extents` are those of the parallelogram's sides along the axis, modules.
    fn new(extents: [f32; 2]) -> Self {
        let [one, other] = extents.map(|extent| extent.abs().max(1e-6));
        // A sample that is longer than a module would see two edges.
        let scale = 1.0_f32.min(1.0 / (one + other));
        let (longer, shorter) = (scale * one.max(other), scale * one.min(other));
        let [reach, flat] = [f32::midpoint(longer, shorter), (longer - shorter) / 2.0];
        Self { reach, flat, longer, product: 2.0 * longer * shorter }
    }

    /// The share that lies behind an edge which is `from` before the sample's middle, modules.
    fn share(&self, from: f32) -> f32 {
        let distance = from.abs();
        if distance <= self.flat {
            return 0.5 + from / self.longer;
        }
        let rest = (self.reach - distance).max(0.0).powi(2) / self.product;
        if from > 0.0 { 1.0 - rest } else { rest }
    }
}

impl PrintedTag {
    /// `None` for an id that the family does not have.
    pub(crate) fn new(id: u16, side_m: f64) -> Option<Self> {
        let modules = tag36h11_modules(id)?;
        let mut cells = [[0.0; CELLS]; CELLS];
        for (cells, modules) in cells.iter_mut().skip(1).zip(&modules) {
            for (cell, is_white) in cells.iter_mut().skip(1).zip(modules) {
                *cell = if *is_white { 1.0 } else { INK };
            }
        }
        Some(Self { cells, module_m: (side_m / RIM_MODULES) as f32 })
    }

    /// Half the paper's side, m.
    pub(crate) fn half_m(&self) -> f64 {
        f64::from(self.module_m) * MODULES as f64 / 2.0
    }

    /// How soft edges across the tag's way up, or across its left, are in a sample whose sides extend so far along that axis, m.
    pub(crate) fn softness(&self, extents_m: [f32; 2]) -> Softness {
        Softness::new(extents_m.map(|extent_m| extent_m / self.module_m))
    }

    /// What the paper shows around a point, which lies so far along its way up and to its left from its middle, m, with the softness across
    /// both. Straight edges cover the area of the sample exactly, so that none is moved.
    pub(crate) fn sample(&self, up_m: f32, left_m: f32, softness: [Softness; 2]) -> TagSample {
        let half = MODULES as f32 / 2.0;
        let (row, column) = (half - up_m / self.module_m, half - left_m / self.module_m);
        let size = MODULES as f32;
        // Beyond the paper and its softness, or not a number.
        if !(row > -1.0 && row < size + 1.0 && column > -1.0 && column < size + 1.0) {
            return TagSample::default();
        }
        let [soft_up, soft_left] = softness;
        let (above, down) = edge_share(row, soft_up);
        let (before, across) = edge_share(column, soft_left);
        let mix = |row: usize| {
            let (one, other) = (self.cells[row][before], self.cells[row][before + 1]);
            one + across * (other - one)
        };
        let (upper, lower) = (mix(above), mix(above + 1));
        // At the paper's own edges the cell beyond is empty.
        let inside = |cell: usize, share: f32| match cell {
            0 => share,
            MODULES => 1.0 - share,
            _ => 1.0,
        };
        TagSample { cover: inside(above, down) * inside(before, across), brightness: upper + down * (lower - upper) }
    }
}

/// The cell before the edge that is nearest to `along`, and the share of the sample that lies behind that edge. Module 0 is cell 1.
fn edge_share(along: f32, softness: Softness) -> (usize, f32) {
    let edge = (along + 0.5).floor().clamp(0.0, MODULES as f32);
    (edge as usize, softness.share(along - edge))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_a_module_has_its_colour_and_an_edge_half_of_both() {
        let tag = PrintedTag::new(0, 0.08).unwrap();
        let modules = tag36h11_modules(0).unwrap();
        let soft = [tag.softness([0.003, 0.0]), tag.softness([0.0, 0.003])];
        for (row, line) in modules.iter().enumerate() {
            for (column, is_white) in line.iter().enumerate() {
                let [up_m, left_m] = [row, column].map(|index| 0.045 - 0.01 * index as f32);
                let sample = tag.sample(up_m, left_m, soft);
                assert_eq!(sample.cover, 1.0);
                let expected = if *is_white { 1.0 } else { INK };
                assert!((sample.brightness - expected).abs() < 1e-6, "{row} {column}");
            }
        }
        let edge = tag.sample(0.04, 0.035, soft);
        assert!((edge.brightness - f32::midpoint(1.0, INK)).abs() < 1e-4, "{edge:?}");
        let paper = tag.sample(0.05, 0.0, soft);
        assert!((paper.cover - 0.5).abs() < 1e-4 && (paper.brightness - 0.5).abs() < 1e-4, "{paper:?}");
        let beyond = tag.sample(0.0, 0.06, soft);
        assert_eq!((beyond.cover, beyond.brightness), (0.0, 0.0));
        // Along a diagonal the sample is a triangle on either side.
        let turned = tag.softness([0.002, -0.002]);
        for (from, share) in [(-0.2, 0.0), (-0.1, 0.125), (0.0, 0.5), (0.1, 0.875), (0.2, 1.0)] {
            assert!((turned.share(from) - share).abs() < 1e-6, "{from}: {}", turned.share(from));
        }
        assert!(PrintedTag::new(587, 0.1).is_none());
    }
}
