//! The car, its range sensor, its controller and the step test.

use super::scene::{CarSettings, ControlSettings, Gains, RangerSettings, WallScene};
use crate::random::RandomStream;

#[derive(Clone, Debug)]
pub(super) struct Car {
    steady_m_per_s_per_pwm: f64,
    time_constant_s: f64,
    pub(super) distance_m: f64,
    pub(super) towards_m_per_s: f64,
}

impl Car {
    pub(super) fn new(settings: &CarSettings, distance_m: f64) -> Self {
        Self {
            steady_m_per_s_per_pwm: settings.steady_m_per_s / settings.reference_pwm,
            time_constant_s: settings.rise_90_s / std::f64::consts::LN_10,
            distance_m,
            towards_m_per_s: 0.0,
        }
    }

    /// Drives for `dt_s`. The wall stops the car.
    pub(super) fn drive(&mut self, pwm: f64, dt_s: f64) {
        let settled = self.steady_m_per_s_per_pwm * pwm;
        let left = (-dt_s / self.time_constant_s).exp();
        // What is missing to the settled speed decays; its integral is the way that is missing.
        let missing = self.towards_m_per_s - settled;
        self.distance_m -= settled * dt_s + missing * self.time_constant_s * (1.0 - left);
        self.towards_m_per_s = settled + missing * left;
        if self.distance_m <= 0.0 {
            self.distance_m = 0.0;
            self.towards_m_per_s = 0.0;
        }
    }
}

/// The lengths of the control cycles of a run.
pub(super) fn control_periods(settings: ControlSettings, seed: u64, run: u32) -> impl FnMut() -> f64 {
    let mut stream = RandomStream::new(seed, &format!("wall control {run}"));
    move || stream.period(settings.period_s, settings.period_spread)
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeReading {
    pub at_s: f64,
    /// At least 0.
    pub range_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeEstimate {
    pub distance_m: f64,
    pub towards_m_per_s: f64,
}

#[derive(Clone, Debug)]
pub(super) struct Ranger {
    settings: RangerSettings,
    next_s: f64,
    pace: RandomStream,
    noise: RandomStream,
    misses: RandomStream,
}

impl Ranger {
    pub(super) fn new(settings: RangerSettings, seed: u64, run: u32) -> Self {
        let stream = |of: &str| RandomStream::new(seed, &format!("wall ranger {of} {run}"));
        let mut pace = stream("pace");
        Self {
            settings,
            next_s: pace.uniform(0.0, settings.period_s),
            pace,
            noise: stream("noise"),
            misses: stream("misses"),
        }
    }

    /// The reading at a control cycle, if it is due.
    pub(super) fn read(&mut self, at_s: f64, distance_m: f64) -> Option<RangeReading> {
        if at_s < self.next_s {
            return None;
        }
        self.next_s += self.pace.period(self.settings.period_s, self.settings.period_spread);
        let sigma_m = self.settings.sigma_m + self.settings.sigma_share * distance_m;
        let range_m = (distance_m + sigma_m * self.noise.normal()).max(0.0);
        let is_missed = self.misses.bernoulli(self.settings.miss_probability);
        (!is_missed).then_some(RangeReading { at_s, range_m })
    }
}

#[derive(Clone, Debug)]
pub(super) struct Pid {
    pub(super) gains: Gains,
    pub(super) target_m: f64,
    pub(super) max_pwm: f64,
    pub(super) integral_most_m_s: f64,
    pub(super) integral_m_s: f64,
}

impl Pid {
    /// The PWM for the estimate; `dt_s` is the time since the previous cycle.
    pub(super) fn steer(&mut self, estimate: RangeEstimate, dt_s: f64) -> f64 {
        let error_m = estimate.distance_m - self.target_m;
        let sum = self.integral_m_s + error_m * dt_s;
        self.integral_m_s = sum.clamp(-self.integral_most_m_s, self.integral_most_m_s);
        let pwm = self.gains.kp_pwm_per_m * error_m + self.gains.ki_pwm_per_m_s * self.integral_m_s
            - self.gains.kd_pwm_s_per_m * estimate.towards_m_per_s;
        pwm.clamp(-self.max_pwm, self.max_pwm)
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedCommand {
    /// Brick time from which it holds.
    pub at_s: f64,
    pub pwm: f64,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepRun {
    /// The PWM of each control cycle, in order.
    pub commands: Vec<TimedCommand>,
    /// In order; the last is the one below the cut-off.
    pub readings: Vec<RangeReading>,
    /// True speed at each control cycle.
    pub towards_m_per_s: Vec<f64>,
}

/// Time limit of a step after its rest, for a car that never arrives.
const LONGEST_S: f64 = 60.0;

/// Draws step `run`. The same scene and number give the same readings, bit for bit.
pub fn simulate_step(scene: &WallScene, run: u32) -> StepRun {
    let mut car = Car::new(&scene.car, scene.step.start_m);
    let mut next_period_s = control_periods(scene.control, scene.seed, run);
    let mut ranger = Ranger::new(scene.ranger, scene.seed, run);
    let mut run = StepRun::default();
    let mut at_s = 0.0;
    while at_s < scene.step.rest_s + LONGEST_S {
        let pwm = if at_s < scene.step.rest_s { 0.0 } else { scene.step.pwm };
        run.commands.push(TimedCommand { at_s, pwm });
        run.towards_m_per_s.push(car.towards_m_per_s);
        if let Some(reading) = ranger.read(at_s, car.distance_m) {
            run.readings.push(reading);
            if reading.range_m < scene.step.cutoff_m {
                break;
            }
        }
        let dt_s = next_period_s();
        car.drive(pwm, dt_s);
        at_s += dt_s;
    }
    run
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall::DEFAULT_SCENE;

    const PAPER: CarSettings = CarSettings { reference_pwm: 80.0, steady_m_per_s: 1.225, rise_90_s: 0.997 };

    #[test]
    fn ninety_per_cent_of_the_speed_are_there_at_the_stated_time_however_it_is_cut_and_the_wall_stops_it() {
        let (mut whole, mut cut) = (Car::new(&PAPER, 5.0), Car::new(&PAPER, 5.0));
        whole.drive(80.0, 0.997);
        (0..997).for_each(|_| cut.drive(80.0, 0.001));
        assert!((whole.towards_m_per_s - 0.9 * 1.225).abs() < 1e-12);
        assert!((whole.distance_m - cut.distance_m).abs() < 1e-9);
        // By hand: 5 - 1.225 (0.997 - 0.9 tau), tau = 0.997 / 2.302585 = 0.432992.
        assert!((whole.distance_m - 4.256_04).abs() < 1e-4, "{}", whole.distance_m);
        whole.drive(80.0, 100.0);
        assert_eq!((whole.distance_m, whole.towards_m_per_s), (0.0, 0.0));
    }

    #[test]
    fn pace_noise_and_misses_of_the_ranger_are_as_stated() {
        let settings = RangerSettings {
            period_s: 0.1,
            period_spread: 0.02,
            sigma_m: 0.005,
            sigma_share: 0.01,
            miss_probability: 0.25,
        };
        let mut ranger = Ranger::new(settings, 4, 0);
        let readings: Vec<RangeReading> =
            (0..100_000).filter_map(|turn| ranger.read(0.01 * f64::from(turn), 2.0)).collect();
        // 10 000 due; binomial with sigma 43.
        assert!((7_330..=7_670).contains(&readings.len()), "{}", readings.len());
        let squares = readings.iter().map(|reading| (reading.range_m - 2.0).powi(2));
        let sigma_m = (squares.sum::<f64>() / readings.len() as f64).sqrt();
        // 25 mm, known to 0.8 %.
        assert!((sigma_m / 0.025 - 1.0).abs() < 0.03, "{sigma_m}");
    }

    #[test]
    fn error_sum_and_rate_add_up_and_the_limits_hold() {
        let mut pid = Pid {
            gains: Gains { kp_pwm_per_m: 20.0, ki_pwm_per_m_s: 5.0, kd_pwm_s_per_m: 8.0 },
            target_m: 0.3,
            max_pwm: 80.0,
            integral_most_m_s: 0.5,
            integral_m_s: 0.0,
        };
        // 20 x 1 + 5 x 0.1 - 8 x 0.5, then the limits of both sides.
        for (distance_m, towards_m_per_s, dt_s, pwm) in
            [(1.3, 0.5, 0.1, 16.5), (9.0, 0.0, 1.0, 80.0), (0.3, 20.0, 0.1, -80.0)]
        {
            let found = pid.steer(RangeEstimate { distance_m, towards_m_per_s }, dt_s);
            assert!((found - pwm).abs() < 1e-12, "{found}");
        }
        assert_eq!(pid.integral_m_s, 0.5);
    }

    #[test]
    fn a_step_has_the_readings_of_the_paper_and_repeats_by_its_number() {
        let scene = WallScene::from_toml(DEFAULT_SCENE).unwrap();
        let first = simulate_step(&scene, 0);
        let moving_count = first.readings.iter().filter(|reading| reading.at_s >= 0.241).count();
        assert!((17..=22).contains(&moving_count), "{moving_count}");
        let (last, others) = first.readings.split_last().unwrap();
        assert!(last.range_m < 0.5 && others.iter().all(|reading| reading.range_m >= 0.5));
        let first_drive = first.commands.iter().find(|command| command.pwm > 0.0).unwrap();
        assert!((0.241..0.252).contains(&first_drive.at_s));
        assert_eq!(first, simulate_step(&scene, 0));
        assert_ne!(first.readings, simulate_step(&scene, 1).readings);
    }
}
