//! The measured quantities of the sensors on a LEGO brick at this moment.
//!
//! Unlike the means of [`SensorBoard`](crate::sensors::SensorBoard) over a telemetry period, these are the instantaneous values of a
//! poll. Units and rest values of the individual parts are added where their bytes are encoded.
//!
//! # Model
//! ```text
//! gyro            mean true rate over 3 ms + bias + noise, cut at its range          300 new values per second
//! accelerometer   (dv/dt, v w, g) + tilt + noise in 1/200 g                          100 new values per second
//! compass         90 deg - heading + 1 deg noise + 5 deg times the motors' power     clockwise from north, arena y is north
//! ultrasonic      distance to the wall along the body's x axis + 0.3 cm noise, in whole centimetres; 255 without an echo
//! ```
//! # Sources
//! HiTechnic's pages on gyro, accelerometer and compass (rates, resolutions, ranges). The field distortion by the motors and the noise
//! of the echo: our choice.

use crate::clock::STEP_S;
use crate::random::RandomStream;
use crate::robot_body::RobotBody;
use crate::scenario::{AccelerometerSettings, GyroSettings, Scenario};
use crate::sensors::Gyro;

const GYRO_STEPS: u32 = 3;
const SLOW_STEPS: u32 = 10;
/// One g, in m/s² and in counts of the HiTechnic accelerometer.
const G_M_PER_S2: f64 = 9.806_65;
const COUNTS_PER_G: f64 = 200.0;
/// Range of the accelerometer: 10 bits with a sign.
const LARGEST_COUNT: f64 = 511.0;
/// Noise of the compass, and its deflection by the motors at full power.
const COMPASS_SIGMA_DEG: f64 = 1.0;
const COMPASS_MOTOR_ERROR_DEG: f64 = 5.0;
const ECHO_SIGMA_CM: f64 = 0.3;
/// The sensor's value for "no echo"; also its maximum range. A wall parallel to the beam gives no echo.
const NO_ECHO: u8 = 255;
const FARTHEST_CM: f64 = 250.0;
const STEEPEST_RAD: f64 = 0.8;

#[derive(Clone, Debug)]
pub(crate) struct PluggedSensors {
    pub(super) gyro: PluggedGyro,
    pub(super) accelerometer: PluggedAccelerometer,
    compass_noise: RandomStream,
    echo: RandomStream,
    wall_x_m: Option<f64>,
    steps: u32,
    /// Measured direction of the body, from north, clockwise, 0 to 359.
    pub(super) compass_deg: u16,
    /// Distance ahead, or 255.
    pub(super) range_cm: u8,
}

impl PluggedSensors {
    pub(crate) fn new(scenario: &Scenario) -> Self {
        let stream = |name| RandomStream::new(scenario.seed, name);
        Self {
            // What a reading is rounded to depends on the brick.
            gyro: PluggedGyro {
                gyro: Gyro::new(
                    GyroSettings { quantum_deg_per_s: 0.0, ..scenario.gyro },
                    scenario.seed,
                    "plugged gyro",
                ),
                turned_rad: 0.0,
                rate_deg_per_s: 0.0,
                angle_deg: 0.0,
            },
            accelerometer: PluggedAccelerometer::new(scenario.accelerometer, stream("plugged accelerometer")),
            compass_noise: stream("compass"),
            echo: stream("ultrasonic"),
            wall_x_m: scenario.brick.wall_x_m,
            steps: 0,
            compass_deg: 0,
            range_cm: NO_ECHO,
        }
    }

    /// Updates from the body for one step; `power` is the mean of both motors' duties, -1 to 1.
    pub(crate) fn step(&mut self, body: &RobotBody, power: f64) {
        if self.steps.is_multiple_of(GYRO_STEPS) {
            self.gyro.sample(body.turned_rad);
        }
        if self.steps.is_multiple_of(SLOW_STEPS) {
            self.accelerometer.sample(body);
            let north_deg = 90.0 - body.pose.heading.rad().to_degrees();
            let shown_deg =
                north_deg + COMPASS_SIGMA_DEG * self.compass_noise.normal() + COMPASS_MOTOR_ERROR_DEG * power;
            self.compass_deg = shown_deg.round().rem_euclid(360.0) as u16;
            self.range_cm = self.measure_range(body);
        }
        self.steps = self.steps.wrapping_add(1);
    }

    /// A power cycle: the gyro's integral is zero and its bias is drawn again.
    pub(crate) fn restart(&mut self) {
        self.gyro.gyro.power_up();
        self.gyro.angle_deg = 0.0;
    }

    fn measure_range(&mut self, body: &RobotBody) -> u8 {
        let noise_cm = ECHO_SIGMA_CM * self.echo.normal();
        let pose = body.pose;
        let Some(ahead_m) = self.wall_x_m.map(|wall| wall - pose.x.0) else {
            return NO_ECHO;
        };
        let distance_cm = ahead_m / pose.heading.rad().cos() * 100.0 + noise_cm;
        let is_square = pose.heading.rad().cos() * ahead_m.signum() > STEEPEST_RAD.cos();
        if is_square && (0.0..FARTHEST_CM).contains(&distance_cm) { distance_cm.round() as u8 } else { NO_ECHO }
    }
}

#[derive(Clone, Debug)]
pub(super) struct PluggedGyro {
    pub(super) gyro: Gyro,
    turned_rad: f64,
    /// Counter-clockwise positive, with bias and noise.
    pub(super) rate_deg_per_s: f64,
    pub(super) angle_deg: f64,
}

impl PluggedGyro {
    fn sample(&mut self, turned_rad: f64) {
        let interval_s = f64::from(GYRO_STEPS) * STEP_S;
        let turn_deg_per_s = (turned_rad - self.turned_rad).to_degrees() / interval_s;
        self.turned_rad = turned_rad;
        self.rate_deg_per_s = self.gyro.read(turn_deg_per_s, interval_s);
        self.angle_deg += self.rate_deg_per_s * interval_s;
    }
}

#[derive(Clone, Debug)]
pub(super) struct PluggedAccelerometer {
    settings: AccelerometerSettings,
    stream: RandomStream,
    tilt_m_per_s2: [f64; 2],
    speed_m_per_s: f64,
    /// Along the body's x, y and z, in counts of 1/200 g.
    pub(super) counts: [i16; 3],
}

impl PluggedAccelerometer {
    fn new(settings: AccelerometerSettings, mut stream: RandomStream) -> Self {
        let tilt_m_per_s2 = [(); 2].map(|()| settings.bias_sigma_m_per_s2 * stream.normal());
        Self { settings, stream, tilt_m_per_s2, speed_m_per_s: 0.0, counts: [0, 0, COUNTS_PER_G as i16] }
    }

    fn sample(&mut self, body: &RobotBody) {
        let before = std::mem::replace(&mut self.speed_m_per_s, body.forward_m_per_s());
        let interval_s = f64::from(SLOW_STEPS) * STEP_S;
        let forward = (self.speed_m_per_s - before) / interval_s;
        let left = self.speed_m_per_s * body.turn_rad_per_s();
        let [tilt_x, tilt_y] = self.tilt_m_per_s2;
        let sigma = self.settings.sigma_m_per_s2;
        self.counts = [forward + tilt_x, left + tilt_y, G_M_PER_S2].map(|felt| {
            let noisy = felt + sigma * self.stream.normal();
            let counts = (noisy / G_M_PER_S2 * COUNTS_PER_G).round();
            counts.clamp(-LARGEST_COUNT - 1.0, LARGEST_COUNT) as i16
        });
    }
}

#[cfg(test)]
mod tests {
    use crate::scenario::ErrorSettings;
    use crate::wheels::PerWheel;
    use posebridge_telemetry::{Arena, Heading, Meters, Pose};

    use super::*;

    fn felt(start: Pose<Arena>, duty: PerWheel<f64>) -> PluggedSensors {
        let mut scenario = Scenario { errors: ErrorSettings::none(), ..Scenario::default() };
        scenario.gyro.sigma_deg_per_s = 0.0;
        scenario.gyro.bias_sigma_deg_per_s = 0.0;
        scenario.gyro.bias_walk_deg_per_s_sqrt_s = 0.0;
        scenario.gyro.scale_error_sigma = 0.0;
        scenario.accelerometer.sigma_m_per_s2 = 0.0;
        scenario.accelerometer.bias_sigma_m_per_s2 = 0.0;
        scenario.robot.backlash_deg = 0.0;
        scenario.brick.wall_x_m = Some(1.0);
        let mut body = RobotBody::new(&scenario, start);
        let mut senses = PluggedSensors::new(&scenario);
        for _ in 0..1_000 {
            body.step(duty);
            senses.step(&body, 0.0);
        }
        senses
    }

    #[test]
    fn a_left_turn_is_positive_for_gyro_and_accelerometer_and_negative_for_the_compass() {
        let senses = felt(Pose::default(), PerWheel { left: 0.2, right: 0.4 });
        // 1.6 V between the wheels is 3.3 rad/s of rotation: 28 mm / 112 mm of that turns the body.
        assert!((senses.gyro.rate_deg_per_s - 47.0).abs() < 1.5, "{senses:?}");
        assert!((senses.gyro.angle_deg - 42.0).abs() < 3.0, "{senses:?}");
        // v w = 0.12 m/s times 0.82 rad/s is 2 counts.
        assert_eq!(senses.accelerometer.counts, [0, 2, 200]);
        assert!((30..60).contains(&senses.compass_deg), "{senses:?}");
    }

    #[test]
    fn the_wall_ahead_is_seen_and_the_one_behind_or_beside_is_not() {
        for (heading_deg, expected) in [
            (0.0_f64, 59..=61),
            (45.0, 83..=87),
            (60.0, NO_ECHO..=NO_ECHO),
            (90.0, NO_ECHO..=NO_ECHO),
            (180.0, NO_ECHO..=NO_ECHO),
        ] {
            let start = Pose::new(Meters(0.4), Meters(0.0), Heading::from_rad(heading_deg.to_radians()));
            let range_cm = felt(start, PerWheel::default()).range_cm;
            assert!(expected.contains(&range_cm), "{heading_deg} degrees: {range_cm}");
        }
    }
}
