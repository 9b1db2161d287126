//! The plan of a drive: laps of a square, or a weave.

use std::f64::consts::FRAC_PI_2;

use posebridge_telemetry::quantities::wrap_rad;

use super::course::{Course, Laps, Weave};
use super::plan::{DrivePlan, LineTracker, StepCommand};
use super::pose::PlanarPose;
use super::spline;

impl DrivePlan {
    /// The plan of a course on a grid of `step_s`.
    pub(super) fn new(course: &Course, step_s: f64) -> Self {
        match course {
            Course::Laps(laps) => Self::from_laps(laps, step_s),
            Course::Weave(weave) => Self::from_weave(weave, step_s),
            Course::Spline(spline) => spline::plan(spline, step_s),
        }
    }

    fn from_laps(laps: &Laps, step_s: f64) -> Self {
        let mut route = LapPlanner { laps: *laps, step_s, at_m: (0.0, 0.0), heading_rad: 0.0, commands: Vec::new() };
        route.push_rest(laps.rest_s);
        for lap in 0..laps.laps {
            // Left and right in turn, so that a wrong track width and unequal wheels do not look alike.
            let left = if lap % 2 == 0 { 1.0 } else { -1.0 };
            for _ in 0..4 {
                route.push_side();
                route.push_rest(laps.rest_after_side_s);
                route.push_turn(left * FRAC_PI_2);
                route.push_rest(laps.rest_after_turn_s);
            }
            route.push_turn(left * FRAC_PI_2);
            route.push_rest(laps.rest_after_lap_s);
        }
        Self { start: PlanarPose::default(), commands: route.commands }
    }

    fn from_weave(weave: &Weave, step_s: f64) -> Self {
        let steps = (weave.duration_s / step_s).round() as usize;
        let commands = (0..steps).map(|step| {
            let middle_s = (step as f64 + 0.5) * step_s;
            let rate = (weave.turn_pulsation_rad_per_s * middle_s).sin();
            StepCommand {
                forward_m: weave.speed_m_per_s * step_s,
                turn_rad: weave.turn_amplitude_rad_per_s * rate * step_s,
                side: None,
            }
        });
        Self { start: PlanarPose::default(), commands: commands.collect() }
    }
}

/// A plan of laps while it is made: where the robot ideally is.
struct LapPlanner {
    laps: Laps,
    step_s: f64,
    at_m: (f64, f64),
    heading_rad: f64,
    commands: Vec<StepCommand>,
}

impl LapPlanner {
    fn push_rest(&mut self, rest_s: f64) {
        let steps = (rest_s / self.step_s).round() as usize;
        self.commands.extend(std::iter::repeat_n(StepCommand::default(), steps));
    }

    fn push_side(&mut self) {
        let laps = self.laps;
        let side = LineTracker {
            from_m: self.at_m,
            heading_rad: self.heading_rad,
            heading_gain: laps.heading_gain,
            lateral_gain_rad_per_m: laps.lateral_gain_rad_per_m,
            most_turn_rad: laps.most_turn_rad,
        };
        let parts = ramped(laps.side_m, laps.speed_m_per_s * self.step_s, laps.ramp_steps);
        self.commands.extend(parts.into_iter().map(|forward_m| StepCommand {
            forward_m,
            turn_rad: 0.0,
            side: Some(side),
        }));
        let (sin, cos) = self.heading_rad.sin_cos();
        self.at_m.0 += laps.side_m * cos;
        self.at_m.1 += laps.side_m * sin;
    }

    fn push_turn(&mut self, turn_rad: f64) {
        let parts = ramped(turn_rad.abs(), self.laps.turn_rate_rad_per_s * self.step_s, self.laps.ramp_steps);
        let sign = turn_rad.signum();
        self.commands.extend(parts.into_iter().map(|part| StepCommand {
            forward_m: 0.0,
            turn_rad: sign * part,
            side: None,
        }));
        self.heading_rad = wrap_rad(self.heading_rad + turn_rad);
    }
}

/// An amount in parts of about `per_step`, rising and falling over `ramp_steps` at both ends, which makes it longer by as many steps.
fn ramped(amount: f64, per_step: f64, ramp_steps: u32) -> Vec<f64> {
    let ramp = ramp_steps as usize;
    let total = ((amount / per_step).round() as usize).max(1) + ramp;
    let share = |step: usize| ((step + 1).min(total - step) as f64 / (ramp + 1) as f64).min(1.0);
    let whole: f64 = (0..total).map(share).sum();
    (0..total).map(|step| share(step) * amount / whole).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramped_amount_is_whole_six_steps_longer_and_even_in_the_middle() {
        let parts = ramped(3.0, 0.01, 6);
        assert_eq!(parts.len(), 306);
        assert!((parts.iter().sum::<f64>() - 3.0).abs() < 1e-12);
        // By hand: six parts of 1/7 to 6/7 at each end are worth six whole ones.
        assert!((parts[0] - 0.01 / 7.0).abs() < 1e-12);
        assert!((parts[6] - 0.01).abs() < 1e-12);
        assert_eq!(parts[5], parts[300]);
    }

    #[test]
    fn an_amount_shorter_than_its_ramps_is_still_whole() {
        for amount in [1e-9, 0.02, 0.05] {
            let parts = ramped(amount, 0.01, 6);
            assert!((parts.iter().sum::<f64>() / amount - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn left_of_the_line_the_controller_turns_right() {
        let side = LineTracker {
            from_m: (3.0, 0.0),
            heading_rad: FRAC_PI_2,
            heading_gain: 0.1,
            lateral_gain_rad_per_m: 0.1,
            most_turn_rad: 0.03,
        };
        // Heading north, 0.1 m west of the line: left of it.
        assert!((side.correction_rad(&PlanarPose { x_m: 2.9, y_m: 1.0, heading_rad: FRAC_PI_2 }) + 0.01).abs() < 1e-12);
        assert!(
            (side.correction_rad(&PlanarPose { x_m: 3.0, y_m: 1.0, heading_rad: FRAC_PI_2 - 0.2 }) - 0.02).abs()
                < 1e-12
        );
        assert!((side.correction_rad(&PlanarPose { x_m: 3.0, y_m: 1.0, heading_rad: 0.0 }) - 0.03).abs() < 1e-12);
    }
}
