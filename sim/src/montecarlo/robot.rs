//! The true robot of one run: its geometry, its motion and the sensors on board.

use posebridge_telemetry::{
    DriveGeometry, Meters, MetersPerSecondSquared, ObservationKind, Radians, RadiansPerSecond, quantities::wrap_rad,
};

use super::plan::StepCommand;
use super::pose::PlanarPose;
use super::scenario::{Accelerometer, Gyro, Kicks, MotionNoise, NominalRobot, Scenario};
use crate::random::RandomStream;

/// The nominal geometry.
pub(super) fn nominal_geometry(robot: &NominalRobot) -> DriveGeometry {
    DriveGeometry {
        left_wheel_radius: Meters(robot.wheel_radius_m),
        right_wheel_radius: Meters(robot.wheel_radius_m),
        track_width: Meters(robot.track_width_m),
        tick: Radians(robot.tick_deg.to_radians()),
    }
}

/// The true geometry of a run.
pub(super) fn draw_geometry(scenario: &Scenario, seed: u64) -> DriveGeometry {
    let mut stream = RandomStream::new(seed, "geometry");
    let errors = &scenario.errors;
    let mean = errors.radius_scale_sigma * stream.normal();
    let difference = errors.radius_difference_sigma * stream.normal();
    let track = errors.track_scale_sigma * stream.normal();
    let robot = &scenario.robot;
    DriveGeometry {
        left_wheel_radius: Meters(robot.wheel_radius_m * (1.0 + mean - difference / 2.0)),
        right_wheel_radius: Meters(robot.wheel_radius_m * (1.0 + mean + difference / 2.0)),
        track_width: Meters(robot.track_width_m * (1.0 + track)),
        tick: Radians(robot.tick_deg.to_radians()),
    }
}

/// Where the robot is, what its wheels have done, and what pushes it.
pub(super) struct Robot {
    geometry: DriveGeometry,
    motion: MotionNoise,
    pub(super) pose: PlanarPose,
    left_rad: f64,
    right_rad: f64,
    kicker: Option<KickSource>,
    slip: RandomStream,
}

/// The rotation of both wheels over one step, as encoders without counts would measure it: free of rounding, blind to slip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WheelTurn {
    /// Of the left wheel, forward positive.
    pub left: Radians,
    /// Of the right wheel, forward positive.
    pub right: Radians,
}

/// What one step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RobotMotion {
    /// The true turn, in radians.
    pub(super) turn_rad: f64,
    /// Travel of the left wheel, in metres.
    pub(super) left_m: f64,
    /// Travel of the right wheel, in metres.
    pub(super) right_m: f64,
    /// Rotation of the wheels, slip or not.
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

    /// Obeys a command for one step.
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

    /// The encoders' reading: rotation since the start, floored to whole counts.
    pub(super) fn wheel_angles(&self) -> ObservationKind {
        let tick_rad = self.geometry.tick.0;
        let floored = |angle_rad: f64| Radians((angle_rad / tick_rad).floor() * tick_rad);
        ObservationKind::WheelAngles { left: floored(self.left_rad), right: floored(self.right_rad) }
    }
}

/// Turns the robot on its sides, unseen by the encoders.
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

    /// The turn of this step on a side; a kick runs to its end before another can begin, on the next side if this one ends.
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

/// The gyro.
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

    /// Its reading for a step with this true turn.
    pub(super) fn observe(&mut self, turn_rad: f64) -> ObservationKind {
        let rate_deg_per_s =
            turn_rad.to_degrees() / self.step_s + self.bias_deg_per_s + self.gyro.sigma_deg_per_s * self.noise.normal();
        self.bias_deg_per_s += self.gyro.bias_walk_deg_per_s_sqrt_s * self.step_s.sqrt() * self.walk.normal();
        let resolution = self.gyro.resolution_deg_per_s;
        let rounded =
            if resolution > 0.0 { (rate_deg_per_s / resolution).round() * resolution } else { rate_deg_per_s };
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
