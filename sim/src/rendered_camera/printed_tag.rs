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

    /// What the paper shows around a point, which lies so far along its way up and to its left from its middle, m. `footprint_m` is the
    /// side of the square that the sample stands for. Each edge becomes a ramp as wide as that square and centred on the edge, so that
    /// samples side by side cover edges along their rows without a gap, and no edge is moved.
    pub(crate) fn sample(&self, up_m: f32, left_m: f32, footprint_m: f32) -> TagSample {
        let half = MODULES as f32 / 2.0;
        let (row, column) = (half - up_m / self.module_m, half - left_m / self.module_m);
        let size = MODULES as f32;
        // Beyond the paper and its ramp, or not a number.
        if !(row > -1.0 && row < size + 1.0 && column > -1.0 && column < size + 1.0) {
            return TagSample::default();
        }
        let steepness = 1.0 / (footprint_m / self.module_m).clamp(1e-3, 1.0);
        let (above, down) = edge_share(row, steepness);
        let (before, across) = edge_share(column, steepness);
        let mix = |row: usize| {
            let (one, other) = (self.cells[row][before], self.cells[row][before + 1]);
            one + across * (other - one)
        };
        let (upper, lower) = (mix(above), mix(above + 1));
        let inside = |along: f32| {
            let enters = (along * steepness + 0.5).clamp(0.0, 1.0);
            let leaves = ((size - along) * steepness + 0.5).clamp(0.0, 1.0);
            enters * leaves
        };
        TagSample { cover: inside(row) * inside(column), brightness: upper + down * (lower - upper) }
    }
}

/// The cell before the edge that is nearest to `along`, and the share of the sample that lies behind that edge. Module 0 is cell 1.
fn edge_share(along: f32, steepness: f32) -> (usize, f32) {
    let size = MODULES as f32;
    let edge = (along + 0.5).floor().clamp(0.0, size);
    (edge as usize, ((along - edge) * steepness + 0.5).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_a_module_has_its_colour_and_an_edge_half_of_both() {
        let tag = PrintedTag::new(0, 0.08).unwrap();
        let modules = tag36h11_modules(0).unwrap();
        for (row, line) in modules.iter().enumerate() {
            for (column, is_white) in line.iter().enumerate() {
                let [up_m, left_m] = [row, column].map(|index| 0.045 - 0.01 * index as f32);
                let sample = tag.sample(up_m, left_m, 0.003);
                assert_eq!(sample.cover, 1.0);
                let expected = if *is_white { 1.0 } else { INK };
                assert!((sample.brightness - expected).abs() < 1e-6, "{row} {column}");
            }
        }
        let edge = tag.sample(0.04, 0.035, 0.003);
        assert!((edge.brightness - f32::midpoint(1.0, INK)).abs() < 1e-4, "{edge:?}");
        let paper = tag.sample(0.05, 0.0, 0.003);
        assert!((paper.cover - 0.5).abs() < 1e-4 && (paper.brightness - 0.5).abs() < 1e-4, "{paper:?}");
        let beyond = tag.sample(0.0, 0.06, 0.003);
        assert_eq!((beyond.cover, beyond.brightness), (0.0, 0.0));
        assert!(PrintedTag::new(587, 0.1).is_none());
    }
}
