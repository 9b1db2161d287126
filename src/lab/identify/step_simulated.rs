//! Simulated sensors and a motor with known parameters, for `identify step` without a recording.

use anyhow::{Result, ensure};
use posebridge_lab::identification::Sampling;
use posebridge_lab::identification::channel::{wheel_speed, wheel_speed_sigma};
use posebridge_lab::identification::step_response::{SimulatedSensor, step_input};
use posebridge_sim::motor_bench::{ENCODER_TICK_RAD, MotorBench};

use super::step_dataset::{SimulatedSource, StepArgs, StepDataset, StepRun, StepTruth};

const IMMERSION_S: f64 = 10.0;
const PERIOD_S: f64 = 0.1;
/// From immersion to the sensor's response. The fraction puts the step into the middle of an integration step of the simulated sensor,
/// so that the dead time is exact.
const DEAD_TIME_S: f64 = 1.0 + PERIOD_S / 32.0;
const COLD_C: f64 = 20.0;
const WARM_C: f64 = 60.0;

struct ImmersionTest {
    what: &'static str,
    heating: &'static [(f64, f64)],
    cooling: &'static [(f64, f64)],
    sigma_k: f64,
    samples: usize,
}

const PLAIN: ImmersionTest =
    ImmersionTest { what: "thermometer", heating: &[(6.0, 1.0)], cooling: &[(7.5, 1.0)], sigma_k: 0.1, samples: 800 };
const SHEATHED: ImmersionTest = ImmersionTest {
    what: "thermometer in a sheath",
    heating: &[(3.0, 0.4), (15.0, 0.6)],
    cooling: &[(3.6, 0.4), (18.0, 0.6)],
    sigma_k: 0.05,
    samples: 1_600,
};
/// Resolution of the simulated thermometers: 12 bits of a DS18B20 (data sheet).
const RESOLUTION_K: f64 = 0.0625;

pub(super) fn material(args: &StepArgs) -> Result<StepDataset> {
    ensure!(
        args.onset.is_none() && args.input_step.is_none() && args.end.is_none(),
        "--onset, --input-step and --end are known of a simulated sensor; they belong to a --recording"
    );
    Ok(match args.sim {
        SimulatedSource::Thermometer => bath(args, &PLAIN),
        SimulatedSource::SheathedThermometer => bath(args, &SHEATHED),
        SimulatedSource::Motor => motor(args),
    })
}

fn bath(args: &StepArgs, bath: &ImmersionTest) -> StepDataset {
    let runs = [("heating", bath.heating, COLD_C, WARM_C), ("cooling", bath.cooling, WARM_C, COLD_C)];
    let runs = runs.into_iter().zip(0..);
    let runs = runs.map(|((name, lags, before, after), index)| {
        let sensor =
            SimulatedSensor { lags: lags.to_vec(), sigma: bath.sigma_k, resolution: RESOLUTION_K, period_s: PERIOD_S };
        let truth = step_input(before, after, IMMERSION_S + DEAD_TIME_S);
        let mut options = args.options(bath.sigma_k);
        options.onset_s = Some(IMMERSION_S);
        options.input_step = Some(after - before);
        StepRun {
            name: name.to_owned(),
            samples: sensor.run(seed(args, index), bath.samples, truth),
            options,
            sampling: Sampling::Readings,
            truth: Some(StepTruth { gain: 1.0, delay_s: DEAD_TIME_S, lags: lags.to_vec() }),
        }
    });
    StepDataset {
        source: format!("simulated, seed {}", args.seed),
        sensor: bath.what.to_owned(),
        unit: "°C",
        gain_unit: "1",
        runs: runs.collect(),
    }
}

fn motor(args: &StepArgs) -> StepDataset {
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
    StepDataset {
        source: format!("simulated, seed {}", args.seed),
        sensor: "motor".to_owned(),
        unit: "rad/s",
        gain_unit: "rad/s/V",
        runs: runs.collect(),
    }
}

const fn seed(args: &StepArgs, index: u64) -> u64 {
    args.seed.wrapping_mul(2).wrapping_add(index)
}
