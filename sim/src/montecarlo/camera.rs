//! A camera that watches the arena: late fixes with noise, outliers, and errors that fixes share.
//!
//! Fixes arrive late, at most one per step. If two are due at the same step, the newer one arrives first and the older one
//! at the next free step. So a fix may be overtaken, and then arrives a step later than the file's delay.

use posebridge_telemetry::{Arena, Fix, Heading, Meters, ObservationKind, Point2};

use super::arena_sensors::StampClock;
use super::disturbances::FixBursts;
use super::plan::{PlanarPose, first_step_from, last_step_until};
use super::scenario::{Camera, CameraSees, Scenario};
use super::schedule::starts;
use crate::random::RandomStream;

pub(super) struct CameraSensor {
    camera: Camera,
    step_s: f64,
    errors: SharedErrors,
    pub(super) stamps: StampClock,
    noise: RandomStream,
    delay: RandomStream,
    outliers: RandomStream,
    /// In transit, oldest first.
    pending: Vec<PendingFix>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PendingFix {
    pub(super) taken_step: usize,
    pub(super) observed: ObservationKind,
    due_step: usize,
}

impl CameraSensor {
    /// `name` is that of its random streams.
    pub(super) fn new(camera: Camera, name: &'static str, scenario: &Scenario, seed: u64) -> Self {
        Self {
            camera,
            step_s: scenario.step_s,
            errors: SharedErrors::new(&camera, name, scenario, seed),
            stamps: StampClock::new(camera.stamps, name, seed),
            noise: RandomStream::new(seed, name),
            delay: RandomStream::new(seed, &format!("{name} delay")),
            outliers: RandomStream::new(seed, &format!("{name} outliers")),
            pending: Vec::new(),
        }
    }

    pub(super) fn observe(&mut self, step: usize, robot: &PlanarPose) {
        if !step.is_multiple_of(self.camera.every_steps as usize) {
            return;
        }
        let [dx_m, dy_m, turn_rad] = self.error();
        let due = step + self.draw_delay();
        if self.is_dark(step) {
            return;
        }
        let [x_m, y_m] = self.errors.shown_position(step, robot);
        let fix = Fix {
            position: Point2::<Arena>::new(Meters(x_m + dx_m), Meters(y_m + dy_m)),
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

    pub(super) fn next_arrival(&mut self, step: usize) -> Option<PendingFix> {
        let newest_due = self.pending.iter().rposition(|fix| fix.due_step <= step)?;
        Some(self.pending.remove(newest_due))
    }

    /// Error of a fix: x and y in metres, heading in radians. Always the same number of draws.
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

/// Errors that several fixes of one camera have in common.
struct SharedErrors {
    camera: Camera,
    name: &'static str,
    seed: u64,
    bias_m: [f64; 2],
    /// A corner of the patches, m.
    patch_corner_m: [f64; 2],
    bursts: Vec<FixBurst>,
}

/// Fixes of these steps, both included, are off by this.
struct FixBurst {
    first: usize,
    last: usize,
    offset_m: [f64; 2],
    /// The robot's position at its beginning, once it is known.
    began_at_m: Option<[f64; 2]>,
}

impl SharedErrors {
    fn new(camera: &Camera, name: &'static str, scenario: &Scenario, seed: u64) -> Self {
        let mut bias = RandomStream::new(seed, &format!("{name} bias"));
        let mut stream = RandomStream::new(seed, &format!("{name} bursts"));
        let bursts =
            camera.bursts.map_or_else(Vec::new, |FixBursts { first_s, every_s, lasts_s, offset_m, .. }| {
                let firsts = starts(first_s, every_s, scenario, &mut stream);
                let bursts = firsts.into_iter().map(|first| {
                    let (sin, cos) = stream.uniform(0.0, std::f64::consts::TAU).sin_cos();
                    let last = first + last_step_until(lasts_s, scenario.step_s);
                    FixBurst { first, last, offset_m: [offset_m * cos, offset_m * sin], began_at_m: None }
                });
                bursts.collect()
            });
        let mut corner = RandomStream::new(seed, &format!("{name} patches"));
        let size_m = camera.patches.map_or(0.0, |patches| patches.size_m);
        Self {
            camera: *camera,
            name,
            seed,
            bias_m: [0, 1].map(|_| camera.bias_sigma_m * bias.normal()),
            patch_corner_m: [0, 1].map(|_| corner.uniform(0.0, size_m)),
            bursts,
        }
    }

    /// Where the camera would see the robot without noise, m.
    fn shown_position(&mut self, step: usize, robot: &PlanarPose) -> [f64; 2] {
        let mut shown_m = [robot.x_m, robot.y_m];
        if let Some(burst) = self.bursts.iter_mut().find(|burst| (burst.first..=burst.last).contains(&step)) {
            let began_at_m = *burst.began_at_m.get_or_insert(shown_m);
            if self.camera.bursts.is_some_and(|bursts| !bursts.follows_robot) {
                shown_m = began_at_m;
            }
            shown_m = add(shown_m, burst.offset_m);
        }
        add(add(shown_m, self.bias_m), self.patch_error_m(robot))
    }

    fn patch_error_m(&self, robot: &PlanarPose) -> [f64; 2] {
        let Some(patches) = self.camera.patches else { return [0.0; 2] };
        let [x_m, y_m] = self.patch_corner_m;
        let [column, row] = [robot.x_m - x_m, robot.y_m - y_m].map(|along_m| (along_m / patches.size_m).floor() as i64);
        let mut stream = RandomStream::new(self.seed, &format!("{} patch {column} {row}", self.name));
        [0, 1].map(|_| patches.sigma_m * stream.normal())
    }
}

fn add([x, y]: [f64; 2], [dx, dy]: [f64; 2]) -> [f64; 2] {
    [x + dx, y + dy]
}
