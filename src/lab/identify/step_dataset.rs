//! Flags and input of `identify step`: the samples of its runs.

use std::path::PathBuf;

use posebridge_lab::identification::{Sampling, SensorChannel, StepOptions, TimedSample};

use crate::config::Setting;
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
    /// Column of the table with the time [default: the first].
    #[arg(long, value_name = "NAME", requires = "recording")]
    pub time_column: Option<String>,
    /// Unit of that column [default: s].
    #[arg(long, value_enum, requires = "recording")]
    pub time_unit: Option<TimeUnit>,
    /// Column of the table with the value [default: the second].
    #[arg(long, value_name = "NAME", requires = "recording")]
    pub value_column: Option<String>,
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

/// The unit of a column of times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
}

impl TimeUnit {
    pub(super) const fn seconds(self) -> f64 {
        match self {
            Self::S => 1.0,
            Self::Ms => 1e-3,
            Self::Us => 1e-6,
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
