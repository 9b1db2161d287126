//! The true motion of the robot: motors, backlash, true wheel sizes, slip.
//!
//! Only the sensors and the truth log read it; the firmware never does.
//!
//! # Model
//! ```text
//! s_l, s_r   travel of the wheels = true radius times wheel rotation, less what slips away, plus k sqrt(|ds|) n
//! turn       (s_r - s_l) / true track + k sqrt(|dtheta|) n + kicks
//! pose       an exact arc of (s_l + s_r) / 2 and turn
//! ```
//! [`crate::faults`] adds the faults that a person causes.
//!
//! # Sources
//! docs/simulator.md, sections 1 and 2.

use posebridge_telemetry::{Arena, Heading, Meters, Pose, SlippingWheel, TimeDelta};

use crate::faults::{Displacement, RobotFaults};
use crate::motor::{Backlash, Motor};
use crate::random::RandomStream;
use crate::scenario::{ErrorSettings, Scenario};
use crate::time_step::STEP_S;
use crate::wheels::PerWheel;

/// Kicks are spread over this time, in seconds.
const KICK_S: f64 = 0.2;
/// A kick turns by this much, in degrees.
const KICK_DEG: (f64, f64) = (3.0, 8.0);
/// A slip event spins a wheel by this many degrees of its rotation.
const SLIP_DEG: (f64, f64) = (10.0, 40.0);
/// A battery is not simulated below this voltage: a brick switches off there.
const LOWEST_BATTERY_V: f64 = 5.0;

/// The moving robot.
#[derive(Clone, Debug)]
pub(crate) struct RobotBody {
    motors: PerWheel<Motor>,
    backlash: PerWheel<Backlash>,
    radius_m: PerWheel<f64>,
    track_m: f64,
    battery_v: f64,
    battery_drop_v_per_step: f64,
    slip: WheelSlip,
    faults: RobotFaults,
    pose: Pose<Arena>,
    wheel_speed_m_per_s: PerWheel<f64>,
    turned_rad: f64,
}

impl RobotBody {
    /// The robot of a scenario, at rest at `start`, its errors drawn.
    pub(crate) fn new(scenario: &Scenario, start: Pose<Arena>) -> Self {
        let robot = &scenario.robot;
        let errors = &scenario.errors;
        let mut draw = RandomStream::new(scenario.seed, "geometry");
        let mean = errors.radius_error + errors.radius_error_sigma * draw.normal();
        let mismatch = errors.radius_mismatch + errors.radius_mismatch_sigma * draw.normal();
        let track = errors.track_error + errors.track_error_sigma * draw.normal();
        let radius_m = PerWheel {
            left: robot.wheel_radius_m * (1.0 + mean - 0.5 * mismatch),
            right: robot.wheel_radius_m * (1.0 + mean + 0.5 * mismatch),
        };
        let backlash = Backlash::new(robot.backlash_deg.to_radians());
        Self {
            motors: radius_m.map(|r| Motor::new(robot.motor.constants(0.5 * robot.mass_kg * r * r))),
            backlash: PerWheel { left: backlash, right: backlash },
            radius_m,
            track_m: robot.track_width_m * (1.0 + track),
            battery_v: robot.battery_v,
            battery_drop_v_per_step: robot.battery_drop_v_per_min / 60.0 * STEP_S,
            slip: WheelSlip::new(scenario.seed, *errors),
            faults: RobotFaults::default(),
            pose: start,
            wheel_speed_m_per_s: PerWheel::default(),
            turned_rad: 0.0,
        }
    }

    /// Lets the motors run for one step at these duties, each from -1 to 1 of the battery's voltage.
    pub(crate) fn step(&mut self, duty: PerWheel<f64>) {
        self.battery_v = (self.battery_v - self.battery_drop_v_per_step).max(LOWEST_BATTERY_V.min(self.battery_v));
        let battery_v = self.battery_v;
        let rotation = self.motors.as_mut().zip(self.backlash.as_mut()).zip(duty).map(|((motor, play), duty)| {
            motor.step(battery_v * duty);
            play.follow(motor.angle_rad())
        });
        let rolled = self.radius_m.zip(rotation).map(|(r, angle)| r * angle);
        self.wheel_speed_m_per_s = rolled.map(|travel| travel / STEP_S);
        let grip = self.faults.grip();
        if let Some((pose, turned_rad)) = self.faults.step_carried() {
            // In the air nothing that the wheels do moves anything.
            self.pose = pose;
            self.turned_rad += turned_rad;
            return;
        }
        let gripped = self.slip.grip(rotation).zip(self.radius_m);
        let travel = gripped.zip(grip).map(|((angle, r), share)| r * angle * share);
        let travel = travel.map(|s| self.slip.travel(s));
        let turn = self.slip.turn((travel.right - travel.left) / self.track_m);
        self.advance(0.5 * (travel.left + travel.right), turn);
    }

    /// A hand lifts the robot and puts it down elsewhere.
    pub(crate) const fn lift(&mut self, by: Displacement) {
        self.faults.lift(self.pose, by);
    }

    /// A wheel loses this share of its grip for a while.
    pub(crate) fn reduce_grip(&mut self, wheel: SlippingWheel, share: f64, duration: TimeDelta) {
        self.faults.reduce_grip(wheel, share, duration);
    }

    fn advance(&mut self, forward_m: f64, turn_rad: f64) {
        let direction = self.pose.heading.rad() + 0.5 * turn_rad;
        let half = 0.5 * turn_rad;
        // The chord of an arc; its series below 1 mrad is exact to 1e-13.
        let chord =
            if half.abs() < 1e-3 { forward_m * (1.0 - half * half / 6.0) } else { forward_m * half.sin() / half };
        self.pose = Pose::new(
            Meters(self.pose.x.0 + chord * direction.cos()),
            Meters(self.pose.y.0 + chord * direction.sin()),
            Heading::from_rad(self.pose.heading.rad() + turn_rad),
        );
        self.turned_rad += turn_rad;
    }

    /// Where the robot is.
    pub(crate) const fn pose(&self) -> Pose<Arena> {
        self.pose
    }

    /// Total rotation of the shafts on which the encoders sit, in radians.
    pub(crate) fn shaft_rad(&self) -> PerWheel<f64> {
        self.motors.map(|motor| motor.angle_rad())
    }

    /// Rolling speed of both wheels without the noise of slip, in metres per second.
    pub(crate) const fn wheel_speed_m_per_s(&self) -> PerWheel<f64> {
        self.wheel_speed_m_per_s
    }

    /// Total turn of the body since the beginning, slip included, in radians.
    pub(crate) const fn turned_rad(&self) -> f64 {
        self.turned_rad
    }

    /// What the battery gives at this moment, in volts.
    pub(crate) const fn battery_v(&self) -> f64 {
        self.battery_v
    }

    /// Along the body's x axis, in metres per second, slip left out.
    pub(crate) fn forward_m_per_s(&self) -> f64 {
        0.5 * (self.wheel_speed_m_per_s.left + self.wheel_speed_m_per_s.right)
    }

    /// About the vertical, in radians per second, slip left out.
    pub(crate) fn turn_rad_per_s(&self) -> f64 {
        (self.wheel_speed_m_per_s.right - self.wheel_speed_m_per_s.left) / self.track_m
    }

    /// Whether both motors stand.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.motors.left.speed_rad_per_s() == 0.0 && self.motors.right.speed_rad_per_s() == 0.0
    }
}

/// What the floor does to the robot.
#[derive(Clone, Debug)]
struct WheelSlip {
    errors: ErrorSettings,
    noise: RandomStream,
    events: RandomStream,
    /// Rotation of each wheel that is still to be lost, in radians.
    lost_rad: PerWheel<f64>,
    /// Turn of a kick that is still to come, in radians, and its speed.
    kick_rad: f64,
    kick_rad_per_step: f64,
}

impl WheelSlip {
    fn new(seed: u64, errors: ErrorSettings) -> Self {
        Self {
            errors,
            noise: RandomStream::new(seed, "slip"),
            events: RandomStream::new(seed, "slip events"),
            lost_rad: PerWheel::default(),
            kick_rad: 0.0,
            kick_rad_per_step: 0.0,
        }
    }

    /// The part of each wheel's rotation that grips the floor; also decides whether an event begins.
    fn grip(&mut self, rotation_rad: PerWheel<f64>) -> PerWheel<f64> {
        if rotation_rad == PerWheel::default() {
            return rotation_rad;
        }
        self.begin_events();
        rotation_rad.zip(self.lost_rad.as_mut()).map(|(angle, lost)| {
            let slipped = lost.min(angle.abs());
            *lost -= slipped;
            angle - slipped.copysign(angle)
        })
    }

    fn begin_events(&mut self) {
        if self.events.bernoulli(self.errors.slip_events_per_min / 60.0 * STEP_S) {
            let spin_rad = self.events.uniform(SLIP_DEG.0, SLIP_DEG.1).to_radians();
            if self.events.sign() > 0.0 {
                self.lost_rad.right += spin_rad;
            } else {
                self.lost_rad.left += spin_rad;
            }
        }
        if self.events.bernoulli(self.errors.kicks_per_min / 60.0 * STEP_S) {
            let size_rad = self.events.uniform(KICK_DEG.0, KICK_DEG.1).to_radians();
            self.kick_rad = self.events.sign() * size_rad;
            self.kick_rad_per_step = size_rad * STEP_S / KICK_S;
        }
    }

    fn travel(&mut self, rolled_m: f64) -> f64 {
        if rolled_m == 0.0 {
            return rolled_m;
        }
        rolled_m + self.errors.wheel_travel_m_per_sqrt_m * rolled_m.abs().sqrt() * self.noise.normal()
    }

    fn turn(&mut self, turn_rad: f64) -> f64 {
        let kicked = self.kick_rad.abs().min(self.kick_rad_per_step).copysign(self.kick_rad);
        self.kick_rad -= kicked;
        if turn_rad == 0.0 {
            return turn_rad + kicked;
        }
        let sigma = self.errors.turn_rad_per_sqrt_rad * turn_rad.abs().sqrt();
        turn_rad + sigma * self.noise.normal() + kicked
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn driven(scenario: &Scenario, duty: PerWheel<f64>, millis: u32) -> RobotBody {
        let mut body = RobotBody::new(scenario, Pose::default());
        for _ in 0..millis {
            body.step(duty);
        }
        body
    }

    fn exact() -> Scenario {
        let mut scenario = Scenario { errors: ErrorSettings::none(), ..Scenario::default() };
        scenario.robot.backlash_deg = 0.0;
        scenario
    }

    const AHEAD: PerWheel<f64> = PerWheel { left: 0.5, right: 0.5 };

    #[test]
    fn equal_wheels_drive_straight_by_radius_times_angle() {
        let body = driven(&exact(), AHEAD, 1_000);
        assert!((body.pose().x.0 - 0.028 * body.shaft_rad().left).abs() < 1e-9);
        assert!(body.pose().y.0.abs() < 1e-12);
    }

    #[test]
    fn a_larger_right_wheel_turns_the_robot_left_by_the_mismatch_over_the_track() {
        let mut scenario = exact();
        scenario.errors.radius_mismatch = 0.01;
        let body = driven(&scenario, AHEAD, 2_000);
        let travel_m = 0.028 * body.shaft_rad().left;
        let expected_rad = 0.01 * travel_m / 0.112;
        assert!((body.turned_rad() / expected_rad - 1.0).abs() < 0.02);
    }

    #[test]
    fn wheel_noise_grows_with_the_square_root_of_the_path() {
        let mut scenario = exact();
        scenario.errors.wheel_travel_m_per_sqrt_m = 0.004;
        let runs = 200_u64;
        let (mut sum_squares, mut path_m) = (0.0, 0.0);
        for seed in 0..runs {
            let body = driven(&scenario.clone().with_seed(seed), AHEAD, 1_000);
            path_m = 0.028 * body.shaft_rad().left;
            // Two independent wheels: the difference of their travel has twice the variance of one.
            sum_squares += (body.turned_rad() * 0.112).powi(2) / 2.0;
        }
        let sigma = (sum_squares / runs as f64).sqrt();
        let expected = 0.004 * path_m.sqrt();
        // The relative error of a sigma from 200 draws is 5 %.
        assert!((sigma / expected - 1.0).abs() < 0.15, "{sigma} against {expected}");
    }

    #[test]
    fn turn_noise_grows_with_the_square_root_of_the_turn() {
        let mut scenario = exact();
        scenario.errors.turn_rad_per_sqrt_rad = 0.01;
        let spin = PerWheel { left: -0.5, right: 0.5 };
        let runs = 200_u64;
        let (mut sum_squares, mut turn_rad) = (0.0, 0.0);
        for seed in 0..runs {
            let body = driven(&scenario.clone().with_seed(seed), spin, 1_000);
            turn_rad = 2.0 * 0.028 * body.shaft_rad().right / 0.112;
            sum_squares += (body.turned_rad() - turn_rad).powi(2);
        }
        let sigma = (sum_squares / runs as f64).sqrt();
        let expected = 0.01 * turn_rad.sqrt();
        assert!((sigma / expected - 1.0).abs() < 0.15, "{sigma} against {expected}");
    }

    #[test]
    fn a_battery_that_runs_down_slows_the_robot_and_stops_at_five_volts() {
        let mut scenario = exact();
        scenario.robot.battery_drop_v_per_min = 6.0;
        let full = PerWheel { left: 1.0, right: 1.0 };
        let speed_at = |millis| driven(&scenario, full, millis).forward_m_per_s();
        let at = |volts: f64| 0.028 * (volts - 0.330) / 0.487;
        // 8 V at the beginning, 0.1 V less each second; the speed lags by a tenth of a second.
        assert!((speed_at(10_000) - at(7.0)).abs() < 0.003);
        assert!((speed_at(60_000) - at(5.0)).abs() < 0.001);
    }

    #[test]
    fn geometry_is_drawn_with_its_sigmas() {
        let mut scenario = exact();
        scenario.errors.track_error_sigma = 0.02;
        scenario.errors.track_error = 0.01;
        let errors: Vec<f64> = (0..1_000)
            .map(|seed| RobotBody::new(&scenario.clone().with_seed(seed), Pose::default()).track_m / 0.112 - 1.0)
            .collect();
        let mean = errors.iter().sum::<f64>() / 1_000.0;
        let sigma = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / 1_000.0).sqrt();
        // Good to 0.02 / sqrt(1000) and to 2 %.
        assert!((mean - 0.01).abs() < 0.002, "{mean}");
        assert!((sigma - 0.02).abs() < 0.0015, "{sigma}");
    }

    /// Minutes of motion and rate per minute of the tests of events: 6000 are expected over all seeds.
    const SEEDS: u64 = 20;
    const MINUTES: u32 = 10;
    const PER_MIN: f64 = 30.0;

    /// Checks that events come as often, as large and as often to either side as they should, sizes in degrees, signed.
    fn check_events(sizes_deg: &[f64], low: f64, high: f64) {
        let count = sizes_deg.len() as f64;
        let expected = SEEDS as f64 * f64::from(MINUTES) * PER_MIN;
        // A rare event per step is binomial: sigma is the root of the count, here 1.3 %; four of them.
        let bound = 4.0 * expected.sqrt();
        assert!((count - expected).abs() < bound, "{count} of {expected}");
        let to_left = sizes_deg.iter().filter(|size| **size > 0.0).count() as f64;
        assert!((to_left - 0.5 * count).abs() < 0.5 * bound, "{to_left}");

        let mean = sizes_deg.iter().map(|size| size.abs()).sum::<f64>() / count;
        let smallest = sizes_deg.iter().fold(f64::MAX, |m, size| m.min(size.abs()));
        let largest = sizes_deg.iter().fold(0.0_f64, |m, size| m.max(size.abs()));
        // Uniform: sigma of the mean is the width over the root of 12 times the count; the extremes come within a hundredth.
        let width = high - low;
        let slack = 1e-9;
        let mean_bound = 4.0 * width / (12.0 * count).sqrt();
        assert!((mean - 0.5 * (low + high)).abs() < mean_bound, "{mean}");
        assert!((low - slack..low + 0.01 * width).contains(&smallest));
        assert!((high - 0.01 * width..high + slack).contains(&largest));
    }

    /// What both wheels turn in a step, in radians.
    const TURNING: PerWheel<f64> = PerWheel { left: 0.001, right: 0.001 };

    /// The sizes of all events; `step` makes one step and returns the size of what began in it, or zero.
    fn events_of(errors: ErrorSettings, mut step: impl FnMut(&mut WheelSlip) -> f64) -> Vec<f64> {
        let steps = (f64::from(MINUTES) * 60.0 / STEP_S).round() as u32;
        let mut sizes_deg = vec![];
        for seed in 0..SEEDS {
            let mut slip = WheelSlip::new(seed, errors);
            for _ in 0..steps {
                let size_deg = step(&mut slip);
                if size_deg != 0.0 {
                    sizes_deg.push(size_deg);
                }
            }
        }
        sizes_deg
    }

    #[test]
    fn slip_events_come_at_their_rate_and_size_on_either_wheel() {
        let errors = ErrorSettings { slip_events_per_min: PER_MIN, ..ErrorSettings::none() };
        let sizes_deg = events_of(errors, |slip| {
            slip.lost_rad = PerWheel::default();
            let gripped = slip.grip(TURNING);
            let lost = |left: f64, grip: f64| (left + TURNING.left - grip).to_degrees();
            lost(slip.lost_rad.left, gripped.left) - lost(slip.lost_rad.right, gripped.right)
        });
        check_events(&sizes_deg, 10.0, 40.0);
    }

    #[test]
    fn kicks_come_at_their_rate_and_size_to_either_side() {
        let errors = ErrorSettings { kicks_per_min: PER_MIN, ..ErrorSettings::none() };
        let sizes_deg = events_of(errors, |slip| {
            slip.kick_rad = 0.0;
            assert_eq!(slip.grip(TURNING), TURNING, "a kick costs no travel");
            slip.kick_rad.to_degrees()
        });
        check_events(&sizes_deg, 3.0, 8.0);
    }

    #[test]
    fn nothing_happens_to_a_robot_at_rest() {
        let mut scenario = exact();
        scenario.errors.kicks_per_min = 6_000.0;
        scenario.errors.slip_events_per_min = 6_000.0;
        let body = driven(&scenario, PerWheel::default(), 10_000);
        assert_eq!(body.slip.lost_rad, PerWheel::default());
        assert_eq!(body.turned_rad(), 0.0);
    }

    #[test]
    fn a_slip_event_takes_its_size_from_the_travel_of_one_wheel() {
        let mut body = driven(&exact(), AHEAD, 1_000);
        let before = (body.shaft_rad().left, body.turned_rad());
        body.slip.lost_rad.left = 25_f64.to_radians();
        for _ in 0..1_000 {
            body.step(AHEAD);
        }
        assert!(body.shaft_rad().left - before.0 > 2.0);
        let expected_rad = 25_f64.to_radians() * 0.028 / 0.112;
        assert!((body.turned_rad() - before.1 - expected_rad).abs() < 1e-9);
    }

    #[test]
    fn a_kick_turns_the_robot_by_its_size_within_a_fifth_of_a_second() {
        let mut scenario = exact();
        let mut body = driven(&scenario, AHEAD, 1_000);
        scenario.errors.kicks_per_min = 60_000.0;
        body.slip.errors = scenario.errors;
        body.step(AHEAD);
        body.slip.errors = ErrorSettings::none();
        let size_deg = (body.turned_rad() + body.slip.kick_rad).to_degrees();
        assert!((3.0..8.0).contains(&size_deg.abs()), "{size_deg}");
        for _ in 0..198 {
            body.step(AHEAD);
        }
        assert!(body.slip.kick_rad != 0.0, "not before its time");
        body.step(AHEAD);
        body.step(AHEAD);
        assert!((body.turned_rad().to_degrees() - size_deg).abs() < 1e-9);
    }

    #[test]
    fn the_wheels_pause_on_reversal_while_the_play_is_crossed() {
        let mut scenario = exact();
        scenario.robot.backlash_deg = 4.0;
        let mut body = driven(&scenario, AHEAD, 1_000);
        while !body.is_at_rest() {
            body.step(PerWheel::default());
        }
        let at_rest = (body.pose().x.0, body.shaft_rad().left);
        let back = PerWheel { left: -0.3, right: -0.3 };
        while body.shaft_rad().left > at_rest.1 - 3.9_f64.to_radians() {
            body.step(back);
        }
        assert_eq!(body.pose().x.0, at_rest.0);
        for _ in 0..500 {
            body.step(back);
        }
        assert!(body.pose().x.0 < at_rest.0 - 0.001);
    }
}
