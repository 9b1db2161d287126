//! The pattern of a tag as a camera shows it: blurred.

use nalgebra::Point2;

use crate::normal_table::{NORMAL, normal};
use crate::tag36h11::AROUND;

/// Most modules that the blur reaches along one direction.
const REACH: usize = 5;

/// The modules of a tag and of the white around it: 1 for white.
pub(crate) struct BlurredPattern([[f64; AROUND]; AROUND]);

/// Brightness of the pattern at a place, 0 to 1, and its derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PatternLevel {
    pub(crate) value: f64,
    pub(crate) by_u: f64,
    pub(crate) by_v: f64,
    /// By the logarithms of the standard deviations.
    pub(crate) by_log_blur: [f64; 2],
}

impl BlurredPattern {
    /// Of the modules of a tag.
    pub(crate) fn new(modules: [[bool; AROUND]; AROUND]) -> Self {
        Self(modules.map(|line| line.map(|is_white| f64::from(u8::from(is_white)))))
    }

    /// Whether the pattern changes within `reach` modules.
    pub(crate) fn has_edge(&self, at: Point2<f64>, reach: f64) -> bool {
        let module = |of: f64| (of + 1.0).clamp(0.0, AROUND as f64 - 1.0) as usize;
        let white = self.0[module(at.y)][module(at.x)];
        let around = [(-reach, 0.0), (reach, 0.0), (0.0, -reach), (0.0, reach)];
        around.into_iter().any(|(u, v)| self.0[module(at.y + v)][module(at.x + u)] != white)
    }

    /// At `at`, in modules from the rim's first corner, blurred by Gaussians of these standard deviations along both directions, modules.
    /// `None` outside the white.
    pub(crate) fn level(&self, at: Point2<f64>, blur: [f64; 2]) -> Option<PatternLevel> {
        let across = AxisWeights::new(at.x + 1.0, blur[0])?;
        let down = AxisWeights::new(at.y + 1.0, blur[1])?;
        let mut level = PatternLevel::default();
        for (line, row) in self.0[down.first..].iter().zip(down.modules()) {
            let (mut value, mut by_u, mut by_log) = (0.0, 0.0, 0.0);
            for (white, column) in line[across.first..].iter().zip(across.modules()) {
                value += white * column.share;
                by_u += white * column.by_position;
                by_log += white * column.by_log_blur;
            }
            level.value += row.share * value;
            level.by_u += row.share * by_u;
            level.by_v += row.by_position * value;
            level.by_log_blur[0] += row.share * by_log;
            level.by_log_blur[1] += row.by_log_blur * value;
        }
        Some(level)
    }
}

/// What the modules around a position contribute to its brightness, along one direction.
struct AxisWeights {
    first: usize,
    count: usize,
    modules: [ModuleWeight; REACH],
}

#[derive(Clone, Copy, Default)]
struct ModuleWeight {
    share: f64,
    by_position: f64,
    by_log_blur: f64,
}

impl AxisWeights {
    /// `position` in modules from the outer edge of the white.
    fn new(position: f64, blur: f64) -> Option<Self> {
        if !(0.0..AROUND as f64).contains(&position) {
            return None;
        }
        let table = NORMAL.as_slice();
        let reach = (3.0 * blur).min(REACH as f64 / 2.0 - 0.5);
        let first = (position - reach) as usize;
        let last = ((position + reach) as usize).min(AROUND - 1);
        let count = (last + 1 - first).min(REACH);
        let mut modules = [ModuleWeight::default(); REACH];
        // The first and the last one go on for ever, so that the shares sum to one.
        let mut before = ModuleWeight::default();
        for (index, module) in modules.iter_mut().enumerate().take(count) {
            let until = if index + 1 == count {
                ModuleWeight { share: 1.0, ..ModuleWeight::default() }
            } else {
                let z = ((first + index + 1) as f64 - position) / blur;
                let (below, density) = normal(table, z);
                ModuleWeight { share: below, by_position: density / blur, by_log_blur: density * z }
            };
            *module = ModuleWeight {
                share: until.share - before.share,
                by_position: before.by_position - until.by_position,
                by_log_blur: before.by_log_blur - until.by_log_blur,
            };
            before = until;
        }
        Some(Self { first, count, modules })
    }

    fn modules(&self) -> &[ModuleWeight] {
        &self.modules[..self.count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tag36h11::tag36h11_modules;

    #[test]
    fn derivatives_are_those_of_differences() {
        let pattern = BlurredPattern::new(tag36h11_modules(0).unwrap());
        let step = 1e-4_f64;
        for index in 0..400 {
            let at = Point2::new(-0.4 + 0.0217 * f64::from(index), 8.3 - 0.0211 * f64::from(index));
            let blur = [0.2 + 0.0017 * f64::from(index), 0.75 - 0.0013 * f64::from(index)];
            // Where a module enters or leaves the reach, the level jumps by a thousandth.
            let jumps = |position: f64, blur: f64| {
                [position - 3.0 * blur, position + 3.0 * blur].iter().any(|edge| (edge - edge.round()).abs() < 0.01)
            };
            if jumps(at.x, blur[0]) || jumps(at.y, blur[1]) {
                continue;
            }
            let value = |du: f64, dv: f64, factors: [f64; 2]| {
                let at = Point2::new(at.x + du, at.y + dv);
                pattern.level(at, [blur[0] * factors[0], blur[1] * factors[1]]).unwrap().value
            };
            let level = pattern.level(at, blur).unwrap();
            let (more, less) = (step.exp(), (-step).exp());
            let differences = [
                value(step, 0.0, [1.0; 2]) - value(-step, 0.0, [1.0; 2]),
                value(0.0, step, [1.0; 2]) - value(0.0, -step, [1.0; 2]),
                value(0.0, 0.0, [more, 1.0]) - value(0.0, 0.0, [less, 1.0]),
                value(0.0, 0.0, [1.0, more]) - value(0.0, 0.0, [1.0, less]),
            ];
            let derivatives = [level.by_u, level.by_v, level.by_log_blur[0], level.by_log_blur[1]];
            for (derivative, difference) in derivatives.into_iter().zip(differences) {
                // The table is linear between its values.
                assert!(
                    (derivative - difference / (2.0 * step)).abs() < 0.03,
                    "{at} {blur:?}: {derivative} {difference}"
                );
            }
        }
    }

    #[test]
    fn without_blur_a_module_is_black_or_white() {
        let pattern = BlurredPattern::new(tag36h11_modules(0).unwrap());
        let level = |u: f64, v: f64| pattern.level(Point2::new(u, v), [0.01; 2]).unwrap().value;
        assert_eq!([level(-0.5, 4.0), level(0.5, 4.5), level(7.5, 0.5), level(8.5, 8.5)], [1.0, 0.0, 0.0, 1.0]);
        // The first row of the code is 110101.
        let first: Vec<f64> = (0..6).map(|column| level(1.5 + f64::from(column), 1.5)).collect();
        assert_eq!(first, [1.0, 1.0, 0.0, 1.0, 0.0, 1.0]);
        assert!(pattern.level(Point2::new(-1.1, 4.0), [0.5; 2]).is_none());
        assert!((level(0.0, 4.0) - 0.5).abs() < 1e-6);
    }
}
