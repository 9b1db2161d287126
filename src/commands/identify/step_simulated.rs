//! Sensors and a motor whose numbers are known, for `identify step` without a recording.

use anyhow::{Result, ensure};
use posebridge_analysis::identification::Sampling;
use posebridge_analysis::identification::channel::{wheel_speed, wheel_speed_sigma};
use posebridge_analysis::identification::simulated::{SimulatedSensor, step};
use posebridge_sim::bench::{ENCODER_TICK_RAD, MotorBench};

use super::step::StepArgs;
use super::step_source::{Material, StepRun, StepTruth};

/// A sensor that is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Simulated {
    /// One lag, a shorter one for heating than for cooling, and a dead time.
    Thermometer,
    /// The same in a sheath: two lags.
    SheathedThermometer,
    /// The motor of the simulated robot, from a voltage to the speed by its encoder, forward and backward.
    Motor,
}

/// When the water is poured, in seconds.
const POURED_S: f64 = 10.0;
/// Time between two samples of a thermometer, in seconds.
const PERIOD_S: f64 = 0.1;
/// Until the warmth has reached the sensor, in seconds. The odd part puts the step into the middle of one of the pieces in which the simulated
/// sensor sees the world, so that the dead time is just this.
const DEAD_TIME_S: f64 = 1.0 + PERIOD_S / 32.0;
/// Cold and warm water, in °C.
const COLD_C: f64 = 20.0;
const WARM_C: f64 = 60.0;

/// A thermometer in warm water and back in cold water.
struct Bath {
    what: &'static str,
    heating: &'static [(f64, f64)],
    cooling: &'static [(f64, f64)],
    sigma_k: f64,
    samples: usize,
}

const PLAIN: Bath =
    Bath { what: "thermometer", heating: &[(6.0, 1.0)], cooling: &[(7.5, 1.0)], sigma_k: 0.1, samples: 800 };
const SHEATHED: Bath = Bath {
    what: "thermometer in a sheath",
    heating: &[(3.0, 0.4), (15.0, 0.6)],
    cooling: &[(3.6, 0.4), (18.0, 0.6)],
    sigma_k: 0.05,
    samples: 1_600,
};
/// Last digit of the simulated thermometers, in K: 12 bits of a DS18B20 (data sheet).
const LAST_DIGIT_K: f64 = 0.0625;

/// Simulates.
///
/// # Errors
/// A flag that belongs to a recording was given.
pub(super) fn material(args: &StepArgs) -> Result<Material> {
    ensure!(
        args.onset.is_none() && args.input_step.is_none() && args.end.is_none(),
        "--onset, --input-step and --end are known of a simulated sensor; they belong to a --recording"
    );
    Ok(match args.sim {
        Simulated::Thermometer => bath(args, &PLAIN),
        Simulated::SheathedThermometer => bath(args, &SHEATHED),
        Simulated::Motor => motor(args),
    })
}

fn bath(args: &StepArgs, bath: &Bath) -> Material {
    let runs = [("heating", bath.heating, COLD_C, WARM_C), ("cooling", bath.cooling, WARM_C, COLD_C)];
    let runs = runs.into_iter().zip(0..);
    let runs = runs.map(|((name, lags, before, after), index)| {
        let sensor =
            SimulatedSensor { lags: lags.to_vec(), sigma: bath.sigma_k, last_digit: LAST_DIGIT_K, period_s: PERIOD_S };
        let truth = step(before, after, POURED_S + DEAD_TIME_S);
        let mut options = args.options(bath.sigma_k);
        options.onset_s = Some(POURED_S);
        options.input_step = Some(after - before);
        StepRun {
            name: name.to_owned(),
            samples: sensor.run(seed(args, index), bath.samples, truth),
            options,
            sampling: Sampling::Readings,
            truth: Some(StepTruth { gain: 1.0, delay_s: DEAD_TIME_S, lags: lags.to_vec() }),
        }
    });
    Material {
        source: format!("simulated, seed {}", args.seed),
        what: bath.what.to_owned(),
        unit: "°C",
        gain_unit: "1",
        runs: runs.collect(),
    }
}

fn motor(args: &StepArgs) -> Material {
    let runs = [("forward", 1.0), ("backward", -1.0)].into_iter().zip(0..);
    let runs = runs.map(|((name, sign), index)| {
        let bench = MotorBench::default();
        let bench = MotorBench { volts: sign * bench.volts, ..bench };
        let readings = bench.run(seed(args, index));
        let angles: Vec<(f64, f64)> = readings.iter().map(|reading| (reading.at_s, reading.angle_rad)).collect();
        let samples = wheel_speed(&angles);
        let sigma = wheel_speed_sigma(ENCODER_TICK_RAD, &samples).unwrap_or(f64::NAN);
        let mut options = args.options(sigma);
        options.onset_s = Some(bench.rest_s);
        options.input_step = Some(bench.volts);
        StepRun {
            name: name.to_owned(),
            samples,
            options,
            sampling: Sampling::Differences,
            truth: Some(StepTruth {
                gain: bench.gain_rad_per_s_per_v(),
                delay_s: bench.dead_time_s,
                lags: vec![(bench.time_constant_s(), 1.0)],
            }),
        }
    });
    Material {
        source: format!("simulated, seed {}", args.seed),
        what: "motor".to_owned(),
        unit: "rad/s",
        gain_unit: "rad/s/V",
        runs: runs.collect(),
    }
}

/// Each run draws its own.
const fn seed(args: &StepArgs, index: u64) -> u64 {
    args.seed.wrapping_mul(2).wrapping_add(index)
}
