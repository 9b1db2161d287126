//! The true robot of one run: its geometry, its motion, and the sensors of its motion.

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{DriveGeometry, Meters, MetersPerSecondSquared, ObservationKind, Radians, RadiansPerSecond};

use super::plan::{PlanarPose, StepCommand};
use super::scenario::{Accelerometer, Gyro, Kicks, MotionNoise, NominalRobot, Scenario};
use super::slips::{GearPlay, WheelSpinner};
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
    /// Where the plan's origin lies since the robot was kidnapped.
    plan_origin: Option<PlanarPose>,
    left_rad: f64,
    right_rad: f64,
    play: Option<PerWheel<GearPlay>>,
    spinner: Option<WheelSpinner>,
    kicker: Option<KickSource>,
    slip: RandomStream,
}

/// Rotation of both wheels over one step, as ideal encoders would measure it: without rounding and play, blind to slip.
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
            plan_origin: None,
            left_rad: 0.0,
            right_rad: 0.0,
            play: (scenario.robot.backlash_deg > 0.0).then(|| GearPlay::of_wheels(scenario.robot.backlash_deg, seed)),
            spinner: scenario.slip_bursts.map(|bursts| WheelSpinner::new(bursts, scenario, seed)),
            kicker: scenario.kicks.map(|kicks| KickSource::new(kicks, scenario.step_s, seed)),
            slip: RandomStream::new(seed, "slip"),
        }
    }

    /// `step` counts from 1.
    pub(super) fn advance(&mut self, step: usize, command: &StepCommand) -> RobotMotion {
        let side = command.side.as_ref();
        let commanded_rad = command.turn_rad + side.map_or(0.0, |side| side.correction_rad(&self.pose_in_plan()));
        let track_m = self.geometry.track_width.0;
        let mut left_m = command.forward_m - 0.5 * commanded_rad * track_m;
        let mut right_m = command.forward_m + 0.5 * commanded_rad * track_m;
        let mut wheels = WheelTurn {
            left: Radians(left_m / self.geometry.left_wheel_radius.0),
            right: Radians(right_m / self.geometry.right_wheel_radius.0),
        };
        self.left_rad += wheels.left.0;
        self.right_rad += wheels.right.0;
        if let Some(play) = &mut self.play {
            wheels = WheelTurn {
                left: Radians(play.left.follow(wheels.left.0)),
                right: Radians(play.right.follow(wheels.right.0)),
            };
            left_m = wheels.left.0 * self.geometry.left_wheel_radius.0;
            right_m = wheels.right.0 * self.geometry.right_wheel_radius.0;
        }
        if let Some(spinner) = &mut self.spinner {
            let spin_rad = spinner.spin_rad(step, self.geometry.tick.0);
            self.left_rad += spin_rad.left;
            self.right_rad += spin_rad.right;
        }
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

    /// Moves the robot by hand by so much of the arena; its wheels stand. Returns the motion that its gyro feels.
    pub(super) fn carry(&mut self, shift_m: (f64, f64), turn_rad: f64) -> RobotMotion {
        let in_plan = self.pose_in_plan();
        self.pose = PlanarPose {
            x_m: self.pose.x_m + shift_m.0,
            y_m: self.pose.y_m + shift_m.1,
            heading_rad: wrap_rad(self.pose.heading_rad + turn_rad),
        };
        self.plan_origin = Some(self.pose.compose(in_plan.inverse()));
        RobotMotion { turn_rad, ..RobotMotion::default() }
    }

    /// The first step of each slip burst in a drive of so many steps.
    pub(super) fn slip_bursts(&self, steps: usize) -> Vec<usize> {
        let firsts = self.spinner.iter().flat_map(|spinner| &spinner.firsts);
        firsts.map(|(first, _)| *first).filter(|first| *first <= steps).collect()
    }

    /// Where the controller believes the robot to be.
    fn pose_in_plan(&self) -> PlanarPose {
        self.plan_origin.map_or(self.pose, |origin| origin.inverse().compose(self.pose))
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
    /// What it shows per true rate.
    factor: f64,
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
            factor: 1.0 + gyro.scale_sigma * RandomStream::new(seed, "gyro scale").normal(),
            noise: RandomStream::new(seed, "gyro"),
            walk,
        }
    }

    pub(super) fn observe(&mut self, turn_rad: f64) -> ObservationKind {
        let rate_deg_per_s = self.factor * turn_rad.to_degrees() / self.step_s
            + self.bias_deg_per_s
            + self.gyro.sigma_deg_per_s * self.noise.normal();
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
