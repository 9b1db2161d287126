//! The true robot of one run: its geometry, motion and sensors, the overhead camera included.
//!
//! Fixes arrive late, at most one per step. If two are due at the same step, the newer one arrives first and the older one
//! at the next free step. So a fix may be overtaken, and then arrives a step later than the file's delay.

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{
    Arena, DriveGeometry, Fix, Heading, Meters, MetersPerSecondSquared, ObservationKind, Point2, Radians,
    RadiansPerSecond,
};

use super::plan::{PlanarPose, StepCommand, first_step_from, last_step_until};
use super::scenario::{Accelerometer, Camera, CameraSees, Gyro, Kicks, MotionNoise, NominalRobot, Scenario};
use crate::random::RandomStream;
use crate::robot_body::draw_geometry;
use crate::scenario::ErrorSettings;
use crate::sensors::quantise;
use crate::wheels::PerWheel;

pub(super) fn nominal_geometry(robot: &NominalRobot) -> DriveGeometry {
    let radius_m = PerWheel { left: robot.wheel_radius_m, right: robot.wheel_radius_m };
    geometry(radius_m, robot.track_width_m, robot.tick_deg)
}

fn geometry(radius_m: PerWheel<f64>, track_width_m: f64, tick_deg: f64) -> DriveGeometry {
    DriveGeometry {
        left_wheel_radius: Meters(radius_m.left),
        right_wheel_radius: Meters(radius_m.right),
        track_width: Meters(track_width_m),
        tick: Radians(tick_deg.to_radians()),
    }
}

pub(super) fn true_geometry(scenario: &Scenario, seed: u64) -> DriveGeometry {
    let errors = ErrorSettings {
        radius_error_sigma: scenario.errors.radius_scale_sigma,
        radius_mismatch_sigma: scenario.errors.radius_difference_sigma,
        track_error_sigma: scenario.errors.track_scale_sigma,
        ..ErrorSettings::none()
    };
    let robot = &scenario.robot;
    let (radius_m, track_m) = draw_geometry(seed, &errors, robot.wheel_radius_m, robot.track_width_m);
    geometry(radius_m, track_m, robot.tick_deg)
}

pub(super) struct Robot {
    geometry: DriveGeometry,
    motion: MotionNoise,
    pub(super) pose: PlanarPose,
    left_rad: f64,
    right_rad: f64,
    kicker: Option<KickSource>,
    slip: RandomStream,
}

/// Rotation of both wheels over one step, as ideal encoders would measure it: without rounding, blind to slip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WheelTurn {
    pub left: Radians,
    pub right: Radians,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RobotMotion {
    pub(super) turn_rad: f64,
    pub(super) left_m: f64,
    pub(super) right_m: f64,
    /// Independent of slip.
    pub(super) wheels: WheelTurn,
}

impl Robot {
    pub(super) fn new(scenario: &Scenario, geometry: DriveGeometry, start: PlanarPose, seed: u64) -> Self {
        Self {
            geometry,
            motion: scenario.motion,
            pose: start,
            left_rad: 0.0,
            right_rad: 0.0,
            kicker: scenario.kicks.map(|kicks| KickSource::new(kicks, scenario.step_s, seed)),
            slip: RandomStream::new(seed, "slip"),
        }
    }

    pub(super) fn advance(&mut self, command: &StepCommand) -> RobotMotion {
        let side = command.side.as_ref();
        let commanded_rad = command.turn_rad + side.map_or(0.0, |side| side.correction_rad(&self.pose));
        let track_m = self.geometry.track_width.0;
        let left_m = command.forward_m - 0.5 * commanded_rad * track_m;
        let right_m = command.forward_m + 0.5 * commanded_rad * track_m;
        let wheels = WheelTurn {
            left: Radians(left_m / self.geometry.left_wheel_radius.0),
            right: Radians(right_m / self.geometry.right_wheel_radius.0),
        };
        self.left_rad += wheels.left.0;
        self.right_rad += wheels.right.0;
        let left_m = self.draw_slip(left_m);
        let right_m = self.draw_slip(right_m);
        let rolled_rad = (right_m - left_m) / track_m;
        let noise_rad = self.motion.turn_rad_per_sqrt_rad * rolled_rad.abs().sqrt();
        let kick_rad = self.kicker.as_mut().filter(|_| side.is_some()).map_or(0.0, KickSource::next_rad);
        let moved =
            RobotMotion { turn_rad: rolled_rad + noise_rad * self.slip.normal() + kick_rad, left_m, right_m, wheels };
        self.displace(&moved);
        moved
    }

    fn draw_slip(&mut self, travel_m: f64) -> f64 {
        let sigma_m = self.motion.wheel_travel_m_per_sqrt_m * travel_m.abs().sqrt();
        travel_m + sigma_m * self.slip.normal()
    }

    fn displace(&mut self, moved: &RobotMotion) {
        let half_rad = 0.5 * moved.turn_rad;
        // sin(x)/x; its series below a turn at which the quotient would lose digits.
        let chord = if half_rad.abs() < 1e-4 { 1.0 - half_rad * half_rad / 6.0 } else { half_rad.sin() / half_rad };
        let forward_m = chord * 0.5 * (moved.left_m + moved.right_m);
        let (sin, cos) = (self.pose.heading_rad + half_rad).sin_cos();
        self.pose.x_m += forward_m * cos;
        self.pose.y_m += forward_m * sin;
        self.pose.heading_rad = wrap_rad(self.pose.heading_rad + moved.turn_rad);
    }

    /// Encoder reading: rotation since the start, rounded down to whole counts.
    pub(super) fn wheel_angles(&self) -> ObservationKind {
        let tick_rad = self.geometry.tick.0;
        let floored = |angle_rad: f64| Radians((angle_rad / tick_rad).floor() * tick_rad);
        ObservationKind::WheelAngles { left: floored(self.left_rad), right: floored(self.right_rad) }
    }
}

/// Disturbances on straight sides: turns that the encoders do not measure.
struct KickSource {
    kicks: Kicks,
    per_step: f64,
    left_over: u32,
    part_rad: f64,
    stream: RandomStream,
}

impl KickSource {
    fn new(kicks: Kicks, step_s: f64, seed: u64) -> Self {
        Self {
            kicks,
            per_step: kicks.probability_per_s * step_s,
            left_over: 0,
            part_rad: 0.0,
            stream: RandomStream::new(seed, "kicks"),
        }
    }

    /// The kick's turn in this step of a side. A kick runs to its end before another begins, on the next side if this one ends.
    fn next_rad(&mut self) -> f64 {
        if self.left_over == 0 {
            if !self.stream.bernoulli(self.per_step) {
                return 0.0;
            }
            let size_deg = self.stream.uniform(self.kicks.least_deg, self.kicks.most_deg);
            self.left_over = self.kicks.spread_steps;
            self.part_rad = self.stream.sign() * size_deg.to_radians() / f64::from(self.left_over);
        }
        self.left_over -= 1;
        self.part_rad
    }
}

pub(super) struct GyroSensor {
    gyro: Gyro,
    step_s: f64,
    bias_deg_per_s: f64,
    noise: RandomStream,
    walk: RandomStream,
}

impl GyroSensor {
    pub(super) fn new(gyro: Gyro, step_s: f64, seed: u64) -> Self {
        let mut walk = RandomStream::new(seed, "gyro bias");
        Self {
            gyro,
            step_s,
            bias_deg_per_s: gyro.bias_sigma_deg_per_s * walk.normal(),
            noise: RandomStream::new(seed, "gyro"),
            walk,
        }
    }

    pub(super) fn observe(&mut self, turn_rad: f64) -> ObservationKind {
        let rate_deg_per_s =
            turn_rad.to_degrees() / self.step_s + self.bias_deg_per_s + self.gyro.sigma_deg_per_s * self.noise.normal();
        self.bias_deg_per_s += self.gyro.bias_walk_deg_per_s_sqrt_s * self.step_s.sqrt() * self.walk.normal();
        let rounded = quantise(rate_deg_per_s, self.gyro.resolution_deg_per_s);
        ObservationKind::TurnRate(RadiansPerSecond(rounded.to_radians()))
    }
}

/// The accelerometers at both wheels: mean over the step of a speed that is constant within each step.
pub(super) struct Accelerometers {
    sigma_m_per_s2: f64,
    step_s: f64,
    before: RobotMotion,
    noise: RandomStream,
}

impl Accelerometers {
    pub(super) fn new(settings: Accelerometer, step_s: f64, seed: u64) -> Self {
        Self {
            sigma_m_per_s2: settings.sigma_m_per_s2,
            step_s,
            before: RobotMotion::default(),
            noise: RandomStream::new(seed, "accelerometers"),
        }
    }

    pub(super) fn observe(&mut self, moved: &RobotMotion) -> ObservationKind {
        let mut of_wheel = |now_m: f64, before_m: f64| {
            let mean = (now_m - before_m) / (self.step_s * self.step_s);
            MetersPerSecondSquared(mean + self.sigma_m_per_s2 * self.noise.normal())
        };
        let observed = ObservationKind::WheelAccelerations {
            left: of_wheel(moved.left_m, self.before.left_m),
            right: of_wheel(moved.right_m, self.before.right_m),
        };
        self.before = *moved;
        observed
    }
}

pub(super) struct CameraSensor {
    camera: Camera,
    step_s: f64,
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
