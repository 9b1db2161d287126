//! A step along a circular arc and its derivatives.
//!
//! ```text
//! a = th + dth / 2      x' = x + c d cos a      y' = y + c d sin a      th' = th + dth      c = sin(dth/2) / (dth/2)
//! ```
//! Source: Paper 1 (Valera et al.), equation 13, which has c = 1 (the midpoint rule); docs/maths/pose.md section 2.

use super::lie::chord_ratio;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BodyStep {
    /// Distance along the path of the body's origin, forward positive.
    pub forward_m: f64,
    /// Change of heading, counter-clockwise positive.
    pub turn_rad: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepRule {
    /// The chord of the arc: exact for constant curvature.
    Arc,
    /// The complete distance along the mean heading, as the papers write it.
    Midpoint,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    pub dx_m: f64,
    pub dy_m: f64,
    /// Derivatives of (dx, dy) by the heading at the start.
    pub by_heading: [f64; 2],
    /// Derivatives of (dx, dy) by the distance.
    pub by_forward: [f64; 2],
    /// Derivatives of (dx, dy) by the change of heading.
    pub by_turn: [f64; 2],
}

/// The displacement of a step, in the frame of the heading.
pub fn displace(heading_rad: f64, step: BodyStep, rule: StepRule) -> Displacement {
    let (chord, chord_by_turn) = match rule {
        StepRule::Arc => chord_ratio(step.turn_rad),
        StepRule::Midpoint => (1.0, 0.0),
    };
    let (sin, cos) = (heading_rad + 0.5 * step.turn_rad).sin_cos();
    let d = step.forward_m;
    Displacement {
        dx_m: chord * d * cos,
        dy_m: chord * d * sin,
        by_heading: [-chord * d * sin, chord * d * cos],
        by_forward: [chord * cos, chord * sin],
        by_turn: [chord_by_turn * d * cos - 0.5 * chord * d * sin, chord_by_turn * d * sin + 0.5 * chord * d * cos],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_quarter_circle_ends_where_geometry_says() {
        let step = BodyStep { forward_m: FRAC_PI_2, turn_rad: FRAC_PI_2 };
        let moved = displace(0.0, step, StepRule::Arc);
        assert!((moved.dx_m - 1.0).abs() < 1e-12 && (moved.dy_m - 1.0).abs() < 1e-12);
    }

    #[test]
    fn derivatives_agree_with_central_differences() {
        let h = 1e-6;
        for rule in [StepRule::Arc, StepRule::Midpoint] {
            for (heading, d, turn) in [(0.3, 0.2, 0.0), (-2.9, -0.1, 1e-4), (PI, 0.05, 2.4), (1.0, 0.3, -1.9e-3)] {
                let moved = |heading: f64, forward_m: f64, turn_rad: f64| {
                    let step = BodyStep { forward_m, turn_rad };
                    displace(heading, step, rule)
                };
                let at = |heading: f64, d: f64, turn: f64| {
                    let m = moved(heading, d, turn);
                    [m.dx_m, m.dy_m]
                };
                let m = moved(heading, d, turn);
                for axis in 0..2 {
                    let by_heading = (at(heading + h, d, turn)[axis] - at(heading - h, d, turn)[axis]) / (2.0 * h);
                    let by_forward = (at(heading, d + h, turn)[axis] - at(heading, d - h, turn)[axis]) / (2.0 * h);
                    let by_turn = (at(heading, d, turn + h)[axis] - at(heading, d, turn - h)[axis]) / (2.0 * h);
                    assert!((m.by_heading[axis] - by_heading).abs() < 1e-8);
                    assert!((m.by_forward[axis] - by_forward).abs() < 1e-8);
                    assert!((m.by_turn[axis] - by_turn).abs() < 1e-8, "{rule:?} {turn} {axis}");
                }
            }
        }
    }
}
