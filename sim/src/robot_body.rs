//! The true motion of the robot: motors, backlash, true wheel sizes, slip. Only the sensors and the truth log read it.
//!
//! # Model
//! ```text
//! s_l, s_r   travel of the wheels = true radius times wheel rotation, less what slips away, plus k sqrt(|ds|) n
//! turn       (s_r - s_l) / true track + k sqrt(|dtheta|) n + kicks
//! pose       an exact arc of (s_l + s_r) / 2 and turn
//! carried    0.1 s along a straight line, turned evenly; the wheels spin in the air and count, the gyro feels the turn
//! no grip    of each step's rotation the share that is lost turns the shaft and moves nothing
//! ```
//! # Sources
//! docs/simulator.md, sections 1 and 2.

use posebridge_telemetry::{Arena, Body, Heading, Meters, Pose, SlippingWheel, TimeDelta, Transform2};

use crate::clock::{STEP, STEP_S};
use crate::hand::FloorContact;
use crate::motor::{Backlash, Motor};
use crate::random::RandomStream;
use crate::scenario::{ErrorSettings, Scenario};
use crate::wheels::PerWheel;

const KICK_S: f64 = 0.2;
const KICK_DEG: (f64, f64) = (3.0, 8.0);
const SLIP_DEG: (f64, f64) = (10.0, 40.0);
/// A brick switches off below this voltage.
const LOWEST_BATTERY_V: f64 = 5.0;

#[derive(Clone, Debug)]
pub(crate) struct RobotBody {
    motors: PerWheel<Motor>,
    backlash: PerWheel<Backlash>,
    /// The same play while the wheels turn the shafts.
    play_by_hand: PerWheel<Backlash>,
    wheels_by_hand_rad: PerWheel<f64>,
    pub(crate) radius_m: PerWheel<f64>,
    pub(crate) track_m: f64,
    pub(crate) battery_v: f64,
    battery_drop_v_per_step: f64,
    slip: WheelSlip,
    carried: Option<CarriedRobot>,
    lost_grip: PerWheel<GripLoss>,
    pub(crate) pose: Pose<Arena>,
    /// Rolling speed of both wheels without the noise of slip.
    pub(crate) wheel_speed_m_per_s: PerWheel<f64>,
    /// Total turn of the body, slip included.
    pub(crate) turned_rad: f64,
}

impl RobotBody {
    /// At rest at `start`, with the errors drawn.
    pub(crate) fn new(scenario: &Scenario, start: Pose<Arena>) -> Self {
        let robot = &scenario.robot;
        let errors = &scenario.errors;
        let (radius_m, track_m) = draw_geometry(scenario.seed, errors, robot.wheel_radius_m, robot.track_width_m);
        let backlash = Backlash::new(robot.backlash_deg.to_radians());
        Self {
            motors: radius_m.map(|r| Motor::new(&robot.motor, 0.5 * robot.mass_kg * r * r)),
            backlash: PerWheel { left: backlash, right: backlash },
            play_by_hand: PerWheel { left: backlash, right: backlash },
            wheels_by_hand_rad: PerWheel::default(),
            radius_m,
            track_m,
            battery_v: robot.battery_v,
            battery_drop_v_per_step: robot.battery_drop_v_per_min / 60.0 * STEP_S,
            slip: WheelSlip::new(scenario.seed, *errors),
            carried: None,
            lost_grip: PerWheel::default(),
            pose: start,
            wheel_speed_m_per_s: PerWheel::default(),
            turned_rad: 0.0,
        }
    }

    /// Runs the motors for one step at these duties, -1 to 1 of the battery's voltage.
    pub(crate) fn step(&mut self, duty: PerWheel<f64>) {
        self.battery_v = (self.battery_v - self.battery_drop_v_per_step).max(LOWEST_BATTERY_V.min(self.battery_v));
        let battery_v = self.battery_v;
        let rotation = self.motors.as_mut().zip(self.backlash.as_mut()).zip(duty).map(|((motor, play), duty)| {
            motor.step(battery_v * duty);
            play.follow(motor.angle_rad)
        });
        self.roll(rotation);
    }

    /// A hand turns the wheels by these angles, and with them the motors' shafts.
    pub(crate) fn step_by_hand(&mut self, rotation: PerWheel<f64>, contact: FloorContact) {
        self.wheels_by_hand_rad = self.wheels_by_hand_rad.zip(rotation).map(|(angle, step)| angle + step);
        let shafts = self.play_by_hand.as_mut().zip(self.wheels_by_hand_rad).map(|(play, angle)| play.follow(angle));
        self.motors.as_mut().zip(shafts).map(|(motor, step)| motor.angle_rad += step);
        match contact {
            FloorContact::Rolling => self.roll(rotation),
            FloorContact::Lifted => self.wheel_speed_m_per_s = PerWheel::default(),
        }
    }

    fn roll(&mut self, rotation: PerWheel<f64>) {
        let rolled = self.radius_m.zip(rotation).map(|(r, angle)| r * angle);
        self.wheel_speed_m_per_s = rolled.map(|travel| travel / STEP_S);
        let grip = self.lost_grip.as_mut().map(GripLoss::next);
        if let Some(carried) = &mut self.carried {
            // In the air nothing that the wheels do moves anything.
            self.pose = carried.step();
            self.turned_rad += carried.by.turn_rad / f64::from(CARRIED_STEPS);
            self.carried = self.carried.filter(|carried| carried.steps < CARRIED_STEPS);
            return;
        }
        let gripped = self.slip.grip(rotation).zip(self.radius_m);
        let travel = gripped.zip(grip).map(|((angle, r), share)| r * angle * share);
        let travel = travel.map(|s| self.slip.travel(s));
        let turn = self.slip.turn((travel.right - travel.left) / self.track_m);
        self.advance(0.5 * (travel.left + travel.right), turn);
    }

    pub(crate) const fn lift(&mut self, by: Displacement) {
        self.carried = Some(CarriedRobot { from: self.pose, by, steps: 0 });
    }

    pub(crate) fn reduce_grip(&mut self, wheel: SlippingWheel, share: f64, duration: TimeDelta) {
        let lost = GripLoss { share, steps_left: duration.as_nanos() / STEP.as_nanos() };
        let wheels = &mut self.lost_grip;
        match wheel {
            SlippingWheel::Left => wheels.left = lost,
            SlippingWheel::Right => wheels.right = lost,
            SlippingWheel::Both => *wheels = PerWheel { left: lost, right: lost },
        }
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

    /// Total rotation of the shafts that carry the encoders.
    pub(crate) fn shaft_rad(&self) -> PerWheel<f64> {
        self.motors.map(|motor| motor.angle_rad)
    }

    /// Along the body's x axis, without slip.
    pub(crate) fn forward_m_per_s(&self) -> f64 {
        0.5 * (self.wheel_speed_m_per_s.left + self.wheel_speed_m_per_s.right)
    }

    /// About the vertical, without slip.
    pub(crate) fn turn_rad_per_s(&self) -> f64 {
        (self.wheel_speed_m_per_s.right - self.wheel_speed_m_per_s.left) / self.track_m
    }

    pub(crate) fn is_at_rest(&self) -> bool {
        self.motors.left.speed_rad_per_s == 0.0 && self.motors.right.speed_rad_per_s == 0.0
    }
}

pub(crate) fn draw_geometry(
    seed: u64,
    errors: &ErrorSettings,
    wheel_radius_m: f64,
    track_width_m: f64,
) -> (PerWheel<f64>, f64) {
    let mut stream = RandomStream::new(seed, "geometry");
    let mean = errors.radius_error + errors.radius_error_sigma * stream.normal();
    let mismatch = errors.radius_mismatch + errors.radius_mismatch_sigma * stream.normal();
    let track = errors.track_error + errors.track_error_sigma * stream.normal();
    let radius_m = PerWheel {
        left: wheel_radius_m * (1.0 + mean - 0.5 * mismatch),
        right: wheel_radius_m * (1.0 + mean + 0.5 * mismatch),
    };
    (radius_m, track_width_m * (1.0 + track))
}

#[derive(Clone, Debug)]
struct WheelSlip {
    errors: ErrorSettings,
    noise: RandomStream,
    events: RandomStream,
    lost_rad: PerWheel<f64>,
    /// Remaining turn of a kick, and its speed.
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

    /// Grip of each wheel, 0 to 1; also draws whether a slip event begins.
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

/// So short that a camera of 10 images per second sees the robot in the air at most once. A turn of more than 36 degrees is then faster
/// than the gyros of the bundled scenarios can measure (360 degrees per second), as it would be in a hand.
const CARRIED_STEPS: u32 = 100;

/// Displacement of a carried robot, relative to its pose before. A plain angle, because a half turn may go either way round.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Displacement {
    pub(crate) forward_m: f64,
    pub(crate) left_m: f64,
    pub(crate) turn_rad: f64,
}

#[derive(Clone, Copy, Debug)]
struct CarriedRobot {
    from: Pose<Arena>,
    by: Displacement,
    steps: u32,
}

impl CarriedRobot {
    fn step(&mut self) -> Pose<Arena> {
        self.steps += 1;
        let share = f64::from(self.steps) / f64::from(CARRIED_STEPS);
        let advance = Transform2::<Body, Body>::new(
            Meters(self.by.forward_m * share),
            Meters(self.by.left_m * share),
            Heading::from_rad(self.by.turn_rad * share),
        );
        self.from * advance
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct GripLoss {
    share: f64,
    steps_left: i64,
}

impl GripLoss {
    /// Share of the rotation that reaches the floor in the next step.
    const fn next(&mut self) -> f64 {
        if self.steps_left <= 0 {
            return 1.0;
        }
        self.steps_left -= 1;
        1.0 - self.share
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::rms;
    use crate::scenario::MotorSettings;

    const AHEAD: PerWheel<f64> = PerWheel { left: 0.5, right: 0.5 };

    fn drive(body: &mut RobotBody, duty: PerWheel<f64>, millis: u32) {
        (0..millis).for_each(|_| body.step(duty));
    }

    fn driven(scenario: &Scenario, duty: PerWheel<f64>, millis: u32) -> RobotBody {
        let mut body = RobotBody::new(scenario, Pose::default());
        drive(&mut body, duty, millis);
        body
    }

    fn exact() -> Scenario {
        let mut scenario = Scenario { errors: ErrorSettings::none(), ..Scenario::default() };
        scenario.robot.backlash_deg = 0.0;
        scenario
    }

    #[test]
    fn equal_wheels_drive_straight_and_a_larger_right_wheel_turns_left_by_the_mismatch_over_the_track() {
        let mut scenario = exact();
        let straight = driven(&scenario, AHEAD, 1_000);
        assert!((straight.pose.x.0 - 0.028 * straight.shaft_rad().left).abs() < 1e-9);
        assert!(straight.pose.y.0.abs() < 1e-12);
        (scenario.errors.radius_mismatch, scenario.errors.track_error) = (0.01, -0.001);
        let body = driven(&scenario, AHEAD, 2_000);
        assert!((body.track_m - 0.999 * 0.112).abs() < 1e-12);
        let expected_rad = 0.01 * 0.028 * body.shaft_rad().left / 0.112;
        assert!((body.turned_rad / expected_rad - 1.0).abs() < 0.02);
    }

    /// The relative error of a sigma from 200 draws is 5 %.
    #[test]
    fn the_noise_of_wheels_and_turns_grows_with_the_square_root_of_the_way() {
        let mut of_wheels = exact();
        of_wheels.errors.wheel_travel_m_per_sqrt_m = 0.004;
        let distance_m = 0.028 * driven(&exact(), AHEAD, 1_000).shaft_rad().left;
        // Two independent wheels: the difference of their travel has twice the variance of one.
        let wheels_rad = 0.004 * (2.0 * distance_m).sqrt() / 0.112;
        let mut of_turns = exact();
        of_turns.errors.turn_rad_per_sqrt_rad = 0.01;
        let spin = PerWheel { left: -0.5, right: 0.5 };
        let turn_rad = driven(&exact(), spin, 1_000).turned_rad;
        let cases = [
            ("wheels", of_wheels, AHEAD, 0.0, wheels_rad),
            ("turns", of_turns, spin, turn_rad, 0.01 * turn_rad.sqrt()),
        ];
        for (name, scenario, duty, mean_rad, expected_rad) in cases {
            let turned =
                (0..200_u32).map(|seed| driven(&scenario.clone().with_seed(seed.into()), duty, 1_000).turned_rad);
            let sigma_rad = rms(turned.map(|turned| turned - mean_rad));
            assert!((sigma_rad / expected_rad - 1.0).abs() < 0.15, "{name}: {sigma_rad} against {expected_rad}");
        }
    }

    #[test]
    fn a_battery_that_runs_down_slows_the_robot_and_stops_at_five_volts() {
        let mut scenario = exact();
        scenario.robot.battery_drop_v_per_min = 6.0;
        let motor = MotorSettings::default();
        for (millis, volts, bound) in [(10_000, 7.0, 0.003), (60_000, 5.0, 0.001)] {
            // 8 V at the beginning, 0.1 V less each second; the speed lags by a tenth of a second.
            let expected = 0.028 * (volts - motor.friction_n_m / motor.torque_n_m_per_v) / motor.back_emf_v_s_per_rad;
            let speed = driven(&scenario, PerWheel { left: 1.0, right: 1.0 }, millis).forward_m_per_s();
            assert!((speed - expected).abs() < bound, "{volts} V: {speed} {expected}");
        }
    }

    /// What both wheels turn in a step, in radians.
    const TURNING: PerWheel<f64> = PerWheel { left: 0.001, right: 0.001 };

    /// Checks that events come 30 times per minute of motion, with uniform sizes in degrees to either side alike. `step` makes one
    /// step and returns the signed size of what began in it, or zero.
    fn check_events(errors: ErrorSettings, low: f64, high: f64, mut step: impl FnMut(&mut WheelSlip) -> f64) {
        let mut sizes_deg = Vec::new();
        for seed in 0..20 {
            let mut slip = WheelSlip::new(seed, errors);
            sizes_deg.extend((0..600_000).map(|_| step(&mut slip)).filter(|size| *size != 0.0));
        }
        // A rare event per step is binomial: sigma is the root of the count, here 1.3 %; four of them.
        let (count, expected) = (sizes_deg.len() as f64, 6_000.0_f64);
        let bound = 4.0 * expected.sqrt();
        assert!((count - expected).abs() < bound, "{count} of {expected}");
        let to_left = sizes_deg.iter().filter(|size| **size > 0.0).count() as f64;
        assert!((to_left - 0.5 * count).abs() < 0.5 * bound, "{to_left}");
        // Uniform: sigma of the mean is the width over the root of 12 times the count; the extremes come within a hundredth.
        let width = high - low;
        let mut sizes: Vec<f64> = sizes_deg.iter().map(|size| size.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let mean = sizes.iter().sum::<f64>() / count;
        assert!((mean - 0.5 * (low + high)).abs() < 4.0 * width / (12.0 * count).sqrt(), "{mean}");
        assert!((low - 1e-9..low + 0.01 * width).contains(&sizes[0]));
        assert!((high - 0.01 * width..high + 1e-9).contains(sizes.last().unwrap()));
    }

    #[test]
    fn slip_events_come_at_their_rate_and_size_on_either_wheel() {
        let errors = ErrorSettings { slip_events_per_min: 30.0, ..ErrorSettings::none() };
        check_events(errors, 10.0, 40.0, |slip| {
            slip.lost_rad = PerWheel::default();
            let gripped = slip.grip(TURNING);
            let lost = |left: f64, grip: f64| (left + TURNING.left - grip).to_degrees();
            lost(slip.lost_rad.left, gripped.left) - lost(slip.lost_rad.right, gripped.right)
        });
    }

    #[test]
    fn kicks_come_at_their_rate_and_size_to_either_side() {
        let errors = ErrorSettings { kicks_per_min: 30.0, ..ErrorSettings::none() };
        check_events(errors, 3.0, 8.0, |slip| {
            slip.kick_rad = 0.0;
            assert_eq!(slip.grip(TURNING), TURNING, "a kick costs no travel");
            slip.kick_rad.to_degrees()
        });
    }

    #[test]
    fn nothing_happens_to_a_robot_at_rest() {
        let mut scenario = exact();
        (scenario.errors.kicks_per_min, scenario.errors.slip_events_per_min) = (6_000.0, 6_000.0);
        let body = driven(&scenario, PerWheel::default(), 10_000);
        assert_eq!((body.slip.lost_rad, body.turned_rad), (PerWheel::default(), 0.0));
    }

    #[test]
    fn a_slip_event_takes_its_size_from_the_travel_of_one_wheel() {
        let mut body = driven(&exact(), AHEAD, 1_000);
        let before_rad = body.turned_rad;
        body.slip.lost_rad.left = 25_f64.to_radians();
        drive(&mut body, AHEAD, 1_000);
        assert!((body.turned_rad - before_rad - 25_f64.to_radians() * 0.028 / 0.112).abs() < 1e-9);
    }

    #[test]
    fn a_kick_turns_the_robot_by_its_size_within_a_fifth_of_a_second() {
        let mut body = driven(&exact(), AHEAD, 1_000);
        body.slip.errors.kicks_per_min = 60_000.0;
        body.step(AHEAD);
        body.slip.errors = ErrorSettings::none();
        let size_deg = (body.turned_rad + body.slip.kick_rad).to_degrees();
        assert!((3.0..8.0).contains(&size_deg.abs()), "{size_deg}");
        drive(&mut body, AHEAD, 198);
        assert!(body.slip.kick_rad != 0.0, "not before its time");
        drive(&mut body, AHEAD, 2);
        assert!((body.turned_rad.to_degrees() - size_deg).abs() < 1e-9);
    }

    #[test]
    fn the_wheels_pause_on_reversal_while_the_play_is_crossed() {
        let mut scenario = exact();
        scenario.robot.backlash_deg = 4.0;
        let mut body = driven(&scenario, AHEAD, 1_000);
        drive(&mut body, PerWheel::default(), 1_000);
        assert!(body.is_at_rest());
        let (x_m, shaft_rad) = (body.pose.x.0, body.shaft_rad().left);
        let back = PerWheel { left: -0.3, right: -0.3 };
        while body.shaft_rad().left > shaft_rad - 3.9_f64.to_radians() {
            body.step(back);
        }
        assert_eq!(body.pose.x.0, x_m);
        drive(&mut body, back, 500);
        assert!(body.pose.x.0 < x_m - 0.001);
    }
}
