//! Flags and input of `identify step`: the samples of its runs.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use posebridge_lab::identification::channel::{wheel_speed, wheel_speed_sigma};
use posebridge_lab::identification::step_response::{SimulatedSensor, step_input};
use posebridge_lab::identification::{Sampling, SensorChannel, StepOptions, TimedSample};
use posebridge_sim::motor_bench::{ENCODER_TICK_RAD, MotorBench};

use crate::config::Setting;
use crate::lab::sample_table::SampleColumns;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `identify step`.
#[derive(clap::Args, Clone, Debug)]
pub struct StepArgs {
    /// Descriptor (*.toml), recording (*.mcap) or table (*.csv). Default: a simulated sensor.
    #[arg(long, value_name = "FILE")]
    pub recording: Option<PathBuf>,
    /// Read the runs of a descriptor whose names begin with this text. Default: all runs.
    #[arg(long, value_name = "PREFIX", requires = "recording")]
    pub run: Option<String>,
    /// Folder for the relative paths of a descriptor. Default: POSEBRIDGE_DATA, or else the descriptor's folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Set one key of the descriptor's robot, or of the configuration of a posebridge recording. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "recording")]
    pub settings: Vec<Setting>,
    /// Sensor of the descriptor or recording [default: the temperature].
    #[arg(long, value_enum, requires = "recording")]
    pub channel: Option<ChannelName>,
    /// Columns of a table.
    #[command(flatten)]
    pub columns: SampleColumns,
    /// The simulated sensor.
    #[arg(long, value_enum, default_value = "thermometer", conflicts_with = "recording")]
    pub sim: SimulatedSource,
    /// Seed of the simulated sensor.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "recording")]
    pub seed: u64,
    /// Use data from this time on, in seconds after the first sample.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub from: f64,
    /// Use data up to this time, in seconds after the first sample.
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,
    /// Number of lags to fit. Default: chosen from the data.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=3))]
    pub order: Option<u8>,
    /// Noise of a sample: one standard deviation in the unit of the sensor. Default: from the descriptor or from the samples.
    #[arg(long, value_name = "SIGMA")]
    pub noise: Option<f64>,
    /// Time of the step or of the command, in seconds after the first sample. The dead time counts from there.
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    pub onset: Option<f64>,
    /// Size of the step in the unit of the quantity. The gain is the step of the sensor divided by this.
    #[arg(long, value_name = "AMOUNT", allow_hyphen_values = true)]
    pub input_step: Option<f64>,
    /// Final value of the sensor, if the samples end before it is reached.
    #[arg(long, value_name = "VALUE", allow_hyphen_values = true)]
    pub end: Option<f64>,
    /// Write what the steps tell of the next sensor of this type to this file, for --sensor of `run` and `replay`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// The next step will be of the same sensor in the same surroundings: write narrower uncertainties.
    #[arg(long, requires = "save")]
    pub same_sensor: bool,
    /// Step between two values that the sensor can show, for --save.
    #[arg(long, value_name = "STEP", requires = "save")]
    pub resolution: Option<f64>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// A sensor that is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SimulatedSource {
    /// One lag, a shorter one for heating than for cooling, and a dead time.
    Thermometer,
    /// The same in a sheath: two lags.
    SheathedThermometer,
    /// The motor of the simulated robot: voltage to encoder speed, forward and backward.
    Motor,
}

/// A sensor, as people say it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ChannelName {
    /// The first thermometer.
    Temperature,
    /// Speed of the left wheel.
    LeftWheel,
    /// Speed of the right wheel.
    RightWheel,
    /// The gyro.
    TurnRate,
    /// The range to what is ahead.
    Range,
}

impl ChannelName {
    pub(super) const fn channel(self) -> SensorChannel {
        match self {
            Self::Temperature => SensorChannel::Temperature,
            Self::LeftWheel => SensorChannel::LeftWheel,
            Self::RightWheel => SensorChannel::RightWheel,
            Self::TurnRate => SensorChannel::TurnRate,
            Self::Range => SensorChannel::WallRange,
        }
    }
}

impl StepArgs {
    /// The known data of a step: the flags, and the noise of the source.
    pub(super) fn options(&self, sigma: f64) -> StepOptions {
        StepOptions {
            sigma: self.noise.unwrap_or(sigma),
            order: self.order.map(usize::from),
            onset_s: self.onset,
            input_step: self.input_step,
            end: self.end,
        }
    }
}

pub(super) struct StepDataset {
    /// In words.
    pub(super) source: String,
    pub(super) sensor: String,
    /// Empty if unknown.
    pub(super) unit: &'static str,
    /// Empty if unknown.
    pub(super) gain_unit: &'static str,
    pub(super) runs: Vec<StepRun>,
}

pub(super) struct StepRun {
    pub(super) name: String,
    /// Times are relative to the first sample.
    pub(super) samples: Vec<TimedSample>,
    pub(super) options: StepOptions,
    pub(super) sampling: Sampling,
    pub(super) truth: Option<StepTruth>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct StepTruth {
    pub(super) gain: f64,
    pub(super) delay_s: f64,
    /// Time constants in seconds with their shares, the fastest first.
    pub(super) lags: Vec<(f64, f64)>,
}

// Simulated sensors and a motor with known parameters, for `identify step` without a recording.

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

pub(super) fn simulated(args: &StepArgs) -> Result<StepDataset> {
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
