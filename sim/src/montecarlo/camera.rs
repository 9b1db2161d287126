//! The camera: noise, outliers, blackout, and fixes that arrive late, at most one per step.
//!
//! Where two fixes are due at the same step the newer one goes first and the older one waits for the next free step. So a fix
//! may be overtaken, and one that was overtaken is later than the file's delay says, by a step.

use posebridge_telemetry::{Arena, Fix, Heading, Meters, Observed, Point2};

use super::drive::{first_step_from, last_step_until};
use super::scenario::{Camera, CameraSees};
use crate::random::Stream;

/// The camera of one run, with the fixes that are on their way.
pub(super) struct CameraSensor {
    camera: Camera,
    step_s: f64,
    noise: Stream,
    delay: Stream,
    outliers: Stream,
    /// Fixes on their way, oldest first.
    under_way: Vec<UnderWay>,
}

/// A fix on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UnderWay {
    /// The step of its stamp.
    pub(super) taken: usize,
    /// What it says.
    pub(super) observed: Observed,
    due: usize,
}

impl CameraSensor {
    pub(super) fn new(camera: Camera, step_s: f64, seed: u64) -> Self {
        Self {
            camera,
            step_s,
            noise: Stream::new(seed, "camera"),
            delay: Stream::new(seed, "camera delay"),
            outliers: Stream::new(seed, "camera outliers"),
            under_way: Vec::new(),
        }
    }

    /// Looks at the robot, if it is time to.
    pub(super) fn look(&mut self, step: usize, (x_m, y_m, heading_rad): (f64, f64, f64)) {
        if !step.is_multiple_of(self.camera.every_steps as usize) {
            return;
        }
        let [dx_m, dy_m, turn_rad] = self.error();
        let due = step + self.drawn_delay();
        if self.is_dark(step) {
            return;
        }
        let fix = Fix {
            position: Point2::<Arena>::new(Meters(x_m + dx_m), Meters(y_m + dy_m)),
            heading: match self.camera.sees {
                CameraSees::Pose => Some(Heading::from_rad(heading_rad + turn_rad)),
                CameraSees::Position => None,
            },
            covariance: None,
            tag_in_body: Point2::ORIGIN,
            reset_counter: 0,
        };
        self.under_way.push(UnderWay { taken: step, observed: Observed::Fix(fix), due });
    }

    /// The fix that arrives at this step, if any.
    pub(super) fn arriving(&mut self, step: usize) -> Option<UnderWay> {
        let newest_due = self.under_way.iter().rposition(|fix| fix.due <= step)?;
        Some(self.under_way.remove(newest_due))
    }

    /// The error of a fix: x and y in metres, heading in radians. Always the same number of draws.
    fn error(&mut self) -> [f64; 3] {
        let position_m = self.camera.true_noise_factor * self.camera.position_sigma_m;
        let heading_rad = self.camera.true_noise_factor * self.camera.heading_sigma_deg.to_radians();
        let mut error = [position_m, position_m, heading_rad].map(|sigma| sigma * self.noise.normal());
        if let Some(outliers) = self.camera.outliers {
            let is_outlier = self.outliers.happens(outliers.probability);
            for value in &mut error {
                let more = outliers.sigma_m_rad * self.outliers.normal();
                if is_outlier {
                    *value += more;
                }
            }
        }
        error
    }

    fn drawn_delay(&mut self) -> usize {
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
