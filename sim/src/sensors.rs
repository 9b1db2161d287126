//! The sensors on board, with all their errors.
//!
//! The firmware reads them through [`SensorBoard`]; the true quantities stay private.

use crate::clock::STEP_S;
use crate::random::RandomStream;
use crate::robot_body::RobotBody;
use crate::scenario::{AccelerometerSettings, GyroSettings, Scenario, TICK_RAD, ThermometerSettings};
use crate::wheels::PerWheel;

/// Means since the previous reading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct InertialReading {
    /// Bias included.
    pub(crate) turn_rate_rad_per_s: f64,
    /// Integral of the turn rate since power-up.
    pub(crate) turn_rad: f64,
    pub(crate) wheels_m_per_s2: PerWheel<f64>,
}

#[derive(Clone, Debug)]
pub(crate) struct SensorBoard {
    encoders: PerWheel<Encoder>,
    pub(crate) gyro: Gyro,
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
    pub(crate) fn new(scenario: &Scenario) -> Self {
        Self {
            encoders: PerWheel::default(),
            gyro: Gyro::new(scenario.gyro, scenario.seed, "gyro"),
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

    pub(crate) fn sample(&mut self, body: &RobotBody) {
        self.encoders.as_mut().zip(body.shaft_rad()).map(|(encoder, shaft_rad)| encoder.sample(shaft_rad));
        self.turned_rad = body.turned_rad;
        self.wheel_speed_m_per_s = body.wheel_speed_m_per_s;
        self.steps_since_last += 1;
        if let Some(thermometer) = &mut self.thermometer {
            thermometer.step();
        }
    }

    pub(crate) fn counts(&self) -> PerWheel<i64> {
        self.encoders.map(Encoder::count)
    }

    /// Means since the previous reading; repeats it if no time has passed.
    pub(crate) fn read_inertial(&mut self) -> InertialReading {
        if self.steps_since_last == 0 {
            return self.last;
        }
        let interval_s = f64::from(self.steps_since_last) * STEP_S;
        let mean_turn = (self.turned_rad - self.turned_at_last_rad) / interval_s;
        let turn_rate = self.gyro.read(mean_turn.to_degrees(), interval_s).to_radians();
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

    /// Degrees Celsius; `None` without a thermometer.
    pub(crate) fn read_temperature(&mut self) -> Option<f64> {
        self.thermometer.as_mut().map(Thermometer::read)
    }

    /// A power cycle: counters and the gyro's integral at zero, biases drawn again.
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

/// An encoder, on the motor's side of the backlash.
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

#[derive(Clone, Debug)]
pub(crate) struct Gyro {
    settings: GyroSettings,
    stream: RandomStream,
    /// Reading over rate.
    scale: f64,
    bias_deg_per_s: f64,
}

impl Gyro {
    /// Noise and bias are drawn from the stream `name`; all gyros of a seed have the same scale.
    pub(crate) fn new(settings: GyroSettings, seed: u64, name: &str) -> Self {
        let error = settings.scale_error + settings.scale_error_sigma * RandomStream::new(seed, "gyro scale").normal();
        let stream = RandomStream::new(seed, name);
        let mut gyro = Self { settings, stream, scale: 1.0 + error, bias_deg_per_s: 0.0 };
        gyro.power_up();
        gyro
    }

    pub(crate) fn power_up(&mut self) {
        self.bias_deg_per_s = self.settings.bias_sigma_deg_per_s * self.stream.normal();
    }

    /// Until a power cycle.
    pub(crate) fn step_bias(&mut self, rad_per_s: f64) {
        self.bias_deg_per_s += rad_per_s.to_degrees();
    }

    /// Reading for a mean turn rate over an interval, in degrees per second.
    pub(crate) fn read(&mut self, turn_deg_per_s: f64, interval_s: f64) -> f64 {
        let walk = self.settings.bias_walk_deg_per_s_sqrt_s * interval_s.sqrt();
        self.bias_deg_per_s += walk * self.stream.normal();
        let noise = self.settings.sigma_deg_per_s * self.stream.normal();
        let felt = self.scale * turn_deg_per_s + self.bias_deg_per_s + noise;
        let range = self.settings.range_deg_per_s;
        quantise(felt, self.settings.quantum_deg_per_s).clamp(-range, range)
    }
}

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

/// A slow thermometer on the brick: the bath's temperature through the sensor's lags.
///
/// ```text
/// dx_j/dt = (u - x_j) / tau_j        y = sum of s_j x_j, sum of s_j = 1        shown = round((y + noise) / step) step
/// u = before until the instant at which it is dipped in, after from then on; it has rested in `before` for ever
/// ```
/// Newton's law of cooling for each lag; two of them for a sensor in a sleeve.
#[derive(Clone, Debug)]
struct Thermometer {
    settings: ThermometerSettings,
    lags: Vec<FirstOrderLag>,
    noise: RandomStream,
    steps: u64,
}

#[derive(Clone, Copy, Debug)]
struct FirstOrderLag {
    share: f64,
    /// 1 - e^(-step / tau).
    approach: f64,
    state_c: f64,
}

impl Thermometer {
    /// In equilibrium with its first bath.
    fn new(settings: &ThermometerSettings, seed: u64) -> Self {
        let parts = settings.lags_s.iter().zip(&settings.shares);
        let lag = |(tau_s, share): (&f64, &f64)| FirstOrderLag {
            share: *share,
            approach: -(-STEP_S / tau_s).exp_m1(),
            state_c: settings.before_c,
        };
        Self {
            lags: parts.map(lag).collect(),
            settings: settings.clone(),
            noise: RandomStream::new(seed, "thermometer"),
            steps: 0,
        }
    }

    fn step(&mut self) {
        let elapsed_s = self.steps as f64 * STEP_S;
        self.steps += 1;
        let bath_c = if elapsed_s < self.settings.dipped_at_s { self.settings.before_c } else { self.settings.after_c };
        for lag in &mut self.lags {
            lag.state_c += lag.approach * (bath_c - lag.state_c);
        }
    }

    fn read(&mut self) -> f64 {
        let true_c: f64 = self.lags.iter().map(|lag| lag.share * lag.state_c).sum();
        let noisy_c = true_c + self.settings.sigma_k * self.noise.normal();
        quantise(noisy_c, self.settings.resolution_k)
    }
}

/// Rounds to a multiple of `quantum`; 0 does not round.
pub(crate) fn quantise(value: f64, quantum: f64) -> f64 {
    if quantum > 0.0 { (value / quantum).round() * quantum } else { value }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::Pose;

    use super::*;
    use crate::random::rms;

    fn gyro(bias_sigma_deg_per_s: f64, bias_walk_deg_per_s_sqrt_s: f64, seed: u64) -> Gyro {
        let settings = GyroSettings {
            bias_sigma_deg_per_s,
            bias_walk_deg_per_s_sqrt_s,
            scale_error_sigma: 0.0,
            ..GyroSettings::default()
        };
        Gyro::new(settings, seed, "gyro")
    }

    #[test]
    fn an_encoder_floors_to_whole_degrees_on_both_sides_of_zero() {
        let mut encoder = Encoder::default();
        for (shaft_deg, count) in [(1.99_f64, 1), (-0.01, -1)] {
            encoder.sample(shaft_deg.to_radians());
            assert_eq!(encoder.count(), count);
        }
        encoder.zero();
        assert_eq!(encoder.count(), 0);
    }

    #[test]
    fn a_gyro_has_whole_degrees_per_second_its_noise_and_its_range() {
        let mut gyro = gyro(0.0, 0.0, 11);
        let readings: Vec<f64> = (0..20_000).map(|_| gyro.read(0.0, 0.05)).collect();
        assert!(readings.iter().all(|reading| reading.fract() == 0.0));
        // 0.36 of noise and 1/12 of rounding; a mean square over 20000 draws is good to 1 %.
        let mean_square = rms(readings.into_iter()).powi(2);
        assert!((mean_square - 0.4433).abs() < 0.025, "{mean_square}");
        assert_eq!((gyro.read(510.0, 0.05), gyro.read(-510.0, 0.05)), (360.0, -360.0));
    }

    #[test]
    fn the_bias_at_power_up_has_its_sigma_and_walks() {
        let drawn = rms((0..2_000_u32).map(|seed| gyro(1.0, 0.01, seed.into()).bias_deg_per_s));
        assert!((drawn - 1.0).abs() < 0.07, "{drawn}");
        // 0.01 degrees per second after one second, so sqrt(5) times that after five.
        let walked = rms((0..1_000_u32).map(|seed| {
            let mut gyro = gyro(0.0, 0.01, seed.into());
            for _ in 0..100 {
                gyro.read(0.0, 0.05);
            }
            gyro.bias_deg_per_s
        }));
        assert!((walked - 0.022_36).abs() < 0.002, "{walked}");
    }

    #[test]
    fn a_scale_error_has_its_fixed_part_and_its_sigma_leaves_noise_and_bias_as_they_were_and_survives_a_power_cycle() {
        let settings = GyroSettings { quantum_deg_per_s: 0.0, ..GyroSettings::default() };
        let read = |scale_error, scale_error_sigma, seed| {
            let mut gyro = Gyro::new(GyroSettings { scale_error, scale_error_sigma, ..settings }, seed, "gyro");
            gyro.power_up();
            gyro.read(100.0, 0.05)
        };
        assert!((read(0.02, 0.0, 7) - read(0.0, 0.0, 7) - 2.0).abs() < 1e-9);
        // The relative error of a sigma from 2000 draws is 1.6 %.
        let drawn = rms((0..2_000_u32).map(|seed| read(0.0, 0.01, seed.into()) - read(0.0, 0.0, seed.into())));
        assert!((drawn - 1.0).abs() < 0.06, "{drawn}");
    }

    #[test]
    fn accelerometers_have_their_quantum_and_noise() {
        let settings = AccelerometerSettings { bias_sigma_m_per_s2: 0.0, ..AccelerometerSettings::default() };
        let mut both = Accelerometers::new(settings, RandomStream::new(5, "accelerometers"));
        let readings: Vec<f64> = (0..5_000).map(|_| both.read(PerWheel::default()).left).collect();
        assert!(readings.iter().all(|reading| (reading / 0.049 - (reading / 0.049).round()).abs() < 1e-9));
        // sqrt(0.075^2 + 0.049^2 / 12)
        let sigma = rms(readings.into_iter());
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
            scale_error_sigma: 0.0,
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
            let rate = (body.turned_rad - turned) / 0.05;
            let acceleration = (body.wheel_speed_m_per_s.right - speed) / 0.05;
            assert!((reading.turn_rate_rad_per_s - rate).abs() < 1e-9);
            assert!((reading.turn_rad - body.turned_rad).abs() < 1e-9);
            assert!((reading.wheels_m_per_s2.right - acceleration).abs() < 1e-9);
            assert_eq!(board.read_inertial(), reading, "no time has passed");
            (turned, speed) = (body.turned_rad, body.wheel_speed_m_per_s.right);
        }
        assert!(turned > 0.1 && speed > 0.1);
    }

    #[test]
    fn a_thermometer_goes_by_its_exponentials_once_it_is_dipped_in_and_shows_whole_steps_with_its_noise() {
        let settings = ThermometerSettings {
            lags_s: vec![5.0, 20.0],
            shares: vec![0.25, 0.75],
            sigma_k: 0.0,
            resolution_k: 0.0,
            dipped_at_s: 3.0,
            ..ThermometerSettings::default()
        };
        let mut thermometer = Thermometer::new(&settings, 1);
        for millis in 0..23_000 {
            let since_s = (f64::from(millis) * STEP_S - 3.0).max(0.0);
            let left = 0.25 * (-since_s / 5.0).exp() + 0.75 * (-since_s / 20.0).exp();
            let (found, expected) = (thermometer.read(), 60.0 - 40.0 * left);
            assert!((found - expected).abs() < 1e-9, "{millis}: {found} {expected}");
            thermometer.step();
        }
        let mut coarse = Thermometer::new(&ThermometerSettings { sigma_k: 0.3, resolution_k: 0.5, ..settings }, 1);
        let shown: Vec<f64> = (0..2_000).map(|_| coarse.read()).collect();
        assert!(shown.iter().all(|value| (value * 2.0).fract() == 0.0));
        // Noise and rounding: 0.09 + 0.25 / 12 = 0.111, give or take three sigma of 2000 draws.
        let variance = rms(shown.into_iter().map(|value| value - 20.0)).powi(2);
        assert!((variance - 0.111).abs() < 0.011, "{variance}");
    }
}
