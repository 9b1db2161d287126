//! The camera: noise, outliers, blackout, and fixes that arrive late, at most one per step.
//!
//! If two fixes are due at the same step, the newer one arrives first and the older one at the next free step. So a fix
//! may be overtaken, and then arrives a step later than the file's delay.

use posebridge_telemetry::{Arena, Fix, Heading, Meters, ObservationKind, Point2};

use super::grid::{first_step_from, last_step_until};
use super::pose::PlanarPose;
use super::scenario::{Camera, CameraSees};
use crate::random::RandomStream;

/// The camera of one run, with the fixes that are on their way.
pub(super) struct CameraSensor {
    camera: Camera,
    step_s: f64,
    noise: RandomStream,
    delay: RandomStream,
    outliers: RandomStream,
    /// Fixes on their way, oldest first.
    pending: Vec<PendingFix>,
}

/// A fix on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PendingFix {
    /// The step of its stamp.
    pub(super) taken_step: usize,
    /// Its fix.
    pub(super) observed: ObservationKind,
    due_step: usize,
}

impl CameraSensor {
    pub(super) fn new(camera: Camera, step_s: f64, seed: u64) -> Self {
        Self {
            camera,
            step_s,
            noise: RandomStream::new(seed, "camera"),
            delay: RandomStream::new(seed, "camera delay"),
            outliers: RandomStream::new(seed, "camera outliers"),
            pending: Vec::new(),
        }
    }

    /// Looks at the robot, if it is time to.
    pub(super) fn observe(&mut self, step: usize, robot: &PlanarPose) {
        if !step.is_multiple_of(self.camera.every_steps as usize) {
            return;
        }
        let [dx_m, dy_m, turn_rad] = self.error();
        let due = step + self.draw_delay();
        if self.is_dark(step) {
            return;
        }
        let fix = Fix {
            position: Point2::<Arena>::new(Meters(robot.x_m + dx_m), Meters(robot.y_m + dy_m)),
            heading: match self.camera.sees {
                CameraSees::Pose => Some(Heading::from_rad(robot.heading_rad + turn_rad)),
                CameraSees::Position => None,
            },
            covariance: None,
            tag_in_body: Point2::ORIGIN,
            reset_counter: 0,
        };
        self.pending.push(PendingFix { taken_step: step, observed: ObservationKind::Fix(fix), due_step: due });
    }

    /// The fix that arrives at this step, if any.
    pub(super) fn next_arrival(&mut self, step: usize) -> Option<PendingFix> {
        let newest_due = self.pending.iter().rposition(|fix| fix.due_step <= step)?;
        Some(self.pending.remove(newest_due))
    }

    /// The error of a fix: x and y in metres, heading in radians. Always the same number of draws.
    fn error(&mut self) -> [f64; 3] {
        let position_m = self.camera.true_noise_factor * self.camera.position_sigma_m;
        let heading_rad = self.camera.true_noise_factor * self.camera.heading_sigma_deg.to_radians();
        let mut error = [position_m, position_m, heading_rad].map(|sigma| sigma * self.noise.normal());
        if let Some(outliers) = self.camera.outliers {
            let is_outlier = self.outliers.bernoulli(outliers.probability);
            for value in &mut error {
                let more = outliers.sigma_m_rad * self.outliers.normal();
                if is_outlier {
                    *value += more;
                }
            }
        }
        error
    }

    fn draw_delay(&mut self) -> usize {
        let spread = self.camera.delay_spread_steps;
        let least = self.camera.delay_steps - spread;
        let more = self.delay.uniform(0.0, f64::from(2 * spread + 1)).floor() as u32;
        (least + more.min(2 * spread)) as usize
    }

    fn is_dark(&self, step: usize) -> bool {
        self.camera.blackout.is_some_and(|dark| {
            let from = first_step_from(dark.from_s, self.step_s);
            (from..=last_step_until(dark.to_s, self.step_s)).contains(&step)
        })
    }
}
