//! The sensors on board, with all their errors.
//!
//! The firmware reads them through [`SensorBoard`]; the true quantities stay private.

use crate::random::RandomStream;
use crate::robot_body::RobotBody;
use crate::scenario::{AccelerometerSettings, GyroSettings, Scenario, TICK_RAD};
use crate::thermometer::Thermometer;
use crate::time_step::STEP_S;
use crate::wheels::PerWheel;

/// One reading of the inertial sensors: means since the reading before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct InertialReading {
    /// Turn rate, bias included, in radians per second.
    pub(crate) turn_rate_rad_per_s: f64,
    /// Sum of the turn rates times their intervals since power-up, in radians.
    pub(crate) turn_rad: f64,
    /// Forward acceleration at each wheel, in metres per second squared.
    pub(crate) wheels_m_per_s2: PerWheel<f64>,
}

/// All sensors of the brick.
#[derive(Clone, Debug)]
pub(crate) struct SensorBoard {
    encoders: PerWheel<Encoder>,
    gyro: Gyro,
    accelerometers: Accelerometers,
    thermometer: Option<Thermometer>,
    turned_rad: f64,
    wheel_speed_m_per_s: PerWheel<f64>,
    last: InertialReading,
    turned_at_last_rad: f64,
    speed_at_last_m_per_s: PerWheel<f64>,
    steps_since_last: u32,
}

impl SensorBoard {
    /// The sensors of a scenario, just powered up.
    pub(crate) fn new(scenario: &Scenario) -> Self {
        Self {
            encoders: PerWheel::default(),
            gyro: Gyro::new(scenario.gyro, RandomStream::new(scenario.seed, "gyro")),
            accelerometers: Accelerometers::new(
                scenario.accelerometer,
                RandomStream::new(scenario.seed, "accelerometers"),
            ),
            thermometer: scenario.thermometer.as_ref().map(|settings| Thermometer::new(settings, scenario.seed)),
            turned_rad: 0.0,
            wheel_speed_m_per_s: PerWheel::default(),
            last: InertialReading::default(),
            turned_at_last_rad: 0.0,
            speed_at_last_m_per_s: PerWheel::default(),
            steps_since_last: 0,
        }
    }

    /// Follows the body by one step of the world.
    pub(crate) fn sample(&mut self, body: &RobotBody) {
        self.encoders.as_mut().zip(body.shaft_rad()).map(|(encoder, shaft_rad)| encoder.sample(shaft_rad));
        self.turned_rad = body.turned_rad();
        self.wheel_speed_m_per_s = body.wheel_speed_m_per_s();
        self.steps_since_last += 1;
        if let Some(thermometer) = &mut self.thermometer {
            thermometer.step();
        }
    }

    /// Counts of both encoders since power-up.
    pub(crate) fn counts(&self) -> PerWheel<i64> {
        self.encoders.map(Encoder::count)
    }

    /// Means of gyro and accelerometers since the reading before; the same again if no time has passed.
    pub(crate) fn read_inertial(&mut self) -> InertialReading {
        if self.steps_since_last == 0 {
            return self.last;
        }
        let interval_s = f64::from(self.steps_since_last) * STEP_S;
        let mean_turn = (self.turned_rad - self.turned_at_last_rad) / interval_s;
        let turn_rate = self.gyro.read(mean_turn, interval_s);
        let accelerations = self
            .wheel_speed_m_per_s
            .zip(self.speed_at_last_m_per_s)
            .map(|(after, before)| (after - before) / interval_s);
        self.last = InertialReading {
            turn_rate_rad_per_s: turn_rate,
            turn_rad: self.last.turn_rad + turn_rate * interval_s,
            wheels_m_per_s2: self.accelerometers.read(accelerations),
        };
        self.begin_interval();
        self.last
    }

    /// What the thermometer shows, in degrees Celsius, if there is one.
    pub(crate) fn read_temperature(&mut self) -> Option<f64> {
        self.thermometer.as_mut().map(Thermometer::read)
    }

    /// The gyro shows so much more from here on, until a power cycle.
    pub(crate) fn step_gyro_bias(&mut self, rad_per_s: f64) {
        self.gyro.bias_deg_per_s += rad_per_s.to_degrees();
    }

    /// A power cycle: counters and the gyro's integral at zero, biases drawn anew.
    pub(crate) fn restart(&mut self) {
        self.encoders.as_mut().map(Encoder::zero);
        self.gyro.power_up();
        self.accelerometers.power_up();
        self.last = InertialReading::default();
        self.begin_interval();
    }

    const fn begin_interval(&mut self) {
        self.turned_at_last_rad = self.turned_rad;
        self.speed_at_last_m_per_s = self.wheel_speed_m_per_s;
        self.steps_since_last = 0;
    }
}

/// An encoder on the motor's side of the play.
#[derive(Clone, Copy, Debug, Default)]
struct Encoder {
    position_ticks: i64,
    zero_ticks: i64,
}

impl Encoder {
    fn sample(&mut self, shaft_rad: f64) {
        self.position_ticks = (shaft_rad / TICK_RAD).floor() as i64;
    }

    const fn count(self) -> i64 {
        self.position_ticks - self.zero_ticks
    }

    const fn zero(&mut self) {
        self.zero_ticks = self.position_ticks;
    }
}

/// A single-axis gyro.
#[derive(Clone, Debug)]
struct Gyro {
    settings: GyroSettings,
    stream: RandomStream,
    bias_deg_per_s: f64,
}

impl Gyro {
    fn new(settings: GyroSettings, stream: RandomStream) -> Self {
        let mut gyro = Self { settings, stream, bias_deg_per_s: 0.0 };
        gyro.power_up();
        gyro
    }

    fn power_up(&mut self) {
        self.bias_deg_per_s = self.settings.bias_sigma_deg_per_s * self.stream.normal();
    }

    /// Its reading for a mean turn rate in radians per second.
    fn read(&mut self, turn_rad_per_s: f64, interval_s: f64) -> f64 {
        let walk = self.settings.bias_walk_deg_per_s_sqrt_s * interval_s.sqrt();
        self.bias_deg_per_s += walk * self.stream.normal();
        let noise = self.settings.sigma_deg_per_s * self.stream.normal();
        let felt = turn_rad_per_s.to_degrees() + self.bias_deg_per_s + noise;
        let range = self.settings.range_deg_per_s;
        quantise(felt, self.settings.quantum_deg_per_s).max(-range).min(range).to_radians()
    }
}

/// Two accelerometers, one at each wheel.
#[derive(Clone, Debug)]
struct Accelerometers {
    settings: AccelerometerSettings,
    stream: RandomStream,
    bias_m_per_s2: PerWheel<f64>,
}

impl Accelerometers {
    fn new(settings: AccelerometerSettings, stream: RandomStream) -> Self {
        let mut accelerometers = Self { settings, stream, bias_m_per_s2: PerWheel::default() };
        accelerometers.power_up();
        accelerometers
    }

    fn power_up(&mut self) {
        let sigma = self.settings.bias_sigma_m_per_s2;
        self.bias_m_per_s2 = PerWheel { left: sigma * self.stream.normal(), right: sigma * self.stream.normal() };
    }

    fn read(&mut self, truth_m_per_s2: PerWheel<f64>) -> PerWheel<f64> {
        truth_m_per_s2.zip(self.bias_m_per_s2).map(|(truth, bias)| {
            let noise = self.settings.sigma_m_per_s2 * self.stream.normal();
            quantise(truth + bias + noise, self.settings.quantum_m_per_s2)
        })
    }
}

/// The nearest whole multiple of `quantum`; the value itself when the quantum is zero.
fn quantise(value: f64, quantum: f64) -> f64 {
    if quantum > 0.0 { (value / quantum).round() * quantum } else { value }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::Pose;

    use super::*;

    fn gyro(change: impl FnOnce(&mut GyroSettings)) -> Gyro {
        let mut settings =
            GyroSettings { bias_sigma_deg_per_s: 0.0, bias_walk_deg_per_s_sqrt_s: 0.0, ..GyroSettings::default() };
        change(&mut settings);
        Gyro::new(settings, RandomStream::new(11, "gyro"))
    }

    #[test]
    fn an_encoder_floors_to_whole_degrees_on_both_sides_of_zero() {
        let mut encoder = Encoder::default();
        encoder.sample(1.99_f64.to_radians());
        assert_eq!(encoder.count(), 1);
        encoder.sample(-0.01_f64.to_radians());
        assert_eq!(encoder.count(), -1);
        encoder.zero();
        assert_eq!(encoder.count(), 0);
    }

    #[test]
    fn a_gyro_speaks_in_whole_degrees_per_second_and_saturates() {
        let mut gyro = gyro(|_| ());
        for _ in 0..100 {
            let said = gyro.read(0.7, 0.05).to_degrees();
            assert!((said - said.round()).abs() < 1e-9, "{said}");
        }
        assert!((gyro.read(510.0_f64.to_radians(), 0.05).to_degrees() - 360.0).abs() < 1e-9);
        assert!((gyro.read(-510.0_f64.to_radians(), 0.05).to_degrees() + 360.0).abs() < 1e-9);
    }

    #[test]
    fn gyro_noise_has_its_sigma_plus_that_of_the_quantum() {
        let mut gyro = gyro(|_| ());
        let draws = 20_000_u32;
        let mean_square = (0..draws).map(|_| gyro.read(0.0, 0.05).to_degrees().powi(2)).sum::<f64>() / f64::from(draws);
        // 0.36 of noise and 1/12 of rounding; a mean square over 20000 draws is good to 1 %.
        assert!((mean_square - 0.4433).abs() < 0.025, "{mean_square}");
    }

    #[test]
    fn the_bias_at_power_up_has_its_sigma_and_walks() {
        let bias = |seed| Gyro::new(GyroSettings::default(), RandomStream::new(seed, "gyro")).bias_deg_per_s;
        let sigma = ((0..2_000).map(|seed| bias(seed).powi(2)).sum::<f64>() / 2_000.0).sqrt();
        assert!((sigma - 1.0).abs() < 0.07, "{sigma}");

        let walked = |seed| {
            let mut gyro = Gyro::new(GyroSettings::default(), RandomStream::new(seed, "gyro"));
            let start = gyro.bias_deg_per_s;
            for _ in 0..100 {
                gyro.read(0.0, 0.05);
            }
            gyro.bias_deg_per_s - start
        };
        let sigma = ((0..1_000).map(|seed| walked(seed).powi(2)).sum::<f64>() / 1_000.0).sqrt();
        // 0.01 degrees per second after one second, so sqrt(5) times that after five.
        assert!((sigma - 0.022_36).abs() < 0.002, "{sigma}");
    }

    #[test]
    fn accelerometers_have_their_quantum_and_noise() {
        let settings = AccelerometerSettings { bias_sigma_m_per_s2: 0.0, ..AccelerometerSettings::default() };
        let mut both = Accelerometers::new(settings, RandomStream::new(5, "accelerometers"));
        let mut sum_squares = 0.0;
        for _ in 0..5_000 {
            let said = both.read(PerWheel::default()).left;
            let counts = said / 0.049;
            assert!((counts - counts.round()).abs() < 1e-9, "{said}");
            sum_squares += said * said;
        }
        let sigma = (sum_squares / 5_000.0_f64).sqrt();
        // sqrt(0.075^2 + 0.049^2 / 12)
        assert!((sigma - 0.0763).abs() < 0.004, "{sigma}");
    }

    #[test]
    fn readings_are_means_of_what_happened_since_the_last() {
        let mut scenario = Scenario::default();
        scenario.gyro = GyroSettings {
            sigma_deg_per_s: 0.0,
            quantum_deg_per_s: 0.0,
            bias_sigma_deg_per_s: 0.0,
            bias_walk_deg_per_s_sqrt_s: 0.0,
            ..scenario.gyro
        };
        scenario.accelerometer =
            AccelerometerSettings { sigma_m_per_s2: 0.0, quantum_m_per_s2: 0.0, bias_sigma_m_per_s2: 0.0 };
        let mut body = RobotBody::new(&scenario, Pose::default());
        let mut board = SensorBoard::new(&scenario);
        let (mut turned, mut speed) = (0.0, 0.0);
        for _ in 0..4 {
            for _ in 0..50 {
                body.step(PerWheel { left: 0.1, right: 0.5 });
                board.sample(&body);
            }
            let reading = board.read_inertial();
            let rate = (body.turned_rad() - turned) / 0.05;
            let acceleration = (body.wheel_speed_m_per_s().right - speed) / 0.05;
            assert!((reading.turn_rate_rad_per_s - rate).abs() < 1e-9);
            assert!((reading.turn_rad - body.turned_rad()).abs() < 1e-9);
            assert!((reading.wheels_m_per_s2.right - acceleration).abs() < 1e-9);
            (turned, speed) = (body.turned_rad(), body.wheel_speed_m_per_s().right);
        }
        assert!(turned > 0.1 && speed > 0.1);
    }

    #[test]
    fn two_readings_at_one_instant_are_the_same() {
        let scenario = Scenario::default();
        let mut board = SensorBoard::new(&scenario);
        board.sample(&RobotBody::new(&scenario, Pose::default()));
        let first = board.read_inertial();
        assert_eq!(board.read_inertial(), first);
    }
}
