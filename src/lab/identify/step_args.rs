//! Flags of `identify step`.

use std::path::PathBuf;

use posebridge_lab::identification::{ModelOrder, SensorChannel, StepOptions};

use crate::config::Setting;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `identify step`.
#[derive(clap::Args, Clone, Debug)]
pub struct StepArgs {
    /// A recording's descriptor (*.toml), a recording of ours (*.mcap) or a table of numbers (*.csv); without it a simulated sensor.
    #[arg(long, value_name = "FILE")]
    pub recording: Option<PathBuf>,
    /// Which runs of a descriptor: all whose names begin so; without it all.
    #[arg(long, value_name = "PREFIX", requires = "recording")]
    pub run: Option<String>,
    /// Where a descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Set one key of a descriptor's robot, or of the configuration of a recording of ours; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "recording")]
    pub settings: Vec<Setting>,
    /// Which sensor of a descriptor or of a recording of ours [default: the temperature].
    #[arg(long, value_enum, requires = "recording")]
    pub channel: Option<ChannelName>,
    /// The column of a table with the time [default: the first].
    #[arg(long, value_name = "NAME", requires = "recording")]
    pub time_column: Option<String>,
    /// The unit of that column [default: s].
    #[arg(long, value_enum, requires = "recording")]
    pub time_unit: Option<TimeUnit>,
    /// The column of a table with the value [default: the second].
    #[arg(long, value_name = "NAME", requires = "recording")]
    pub value_column: Option<String>,
    /// The simulated sensor.
    #[arg(long, value_enum, default_value = "thermometer", conflicts_with = "recording")]
    pub sim: SimulatedSource,
    /// Seed of the simulated sensor.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "recording")]
    pub seed: u64,
    /// Use data from this number of seconds after the first sample on.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub from: f64,
    /// Use data up to this number of seconds after the first sample.
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,
    /// Fit this number of lags, instead of choosing the number from the data.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=3))]
    pub order: Option<u8>,
    /// Noise of a sample, one standard deviation in the sensor's unit, instead of what the description or the samples say.
    #[arg(long, value_name = "SIGMA")]
    pub noise: Option<f64>,
    /// When the quantity stepped or the command was given, in seconds after the first sample: the dead time is counted from there.
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    pub onset: Option<f64>,
    /// How far the quantity stepped, in its own unit: the gain is the step of the sensor over this.
    #[arg(long, value_name = "AMOUNT", allow_hyphen_values = true)]
    pub input_step: Option<f64>,
    /// What the sensor shows in the end, where the samples do not go so far.
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
    /// The motor of the simulated robot, from a voltage to the speed by its encoder, forward and backward.
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
    /// All of them.
    pub(super) const ALL: [Self; 5] =
        [Self::Temperature, Self::LeftWheel, Self::RightWheel, Self::TurnRate, Self::Range];

    /// As the analysis calls it.
    pub(super) const fn channel(self) -> SensorChannel {
        match self {
            Self::Temperature => SensorChannel::Temperature,
            Self::LeftWheel => SensorChannel::LeftWheel,
            Self::RightWheel => SensorChannel::RightWheel,
            Self::TurnRate => SensorChannel::TurnRate,
            Self::Range => SensorChannel::WallRange,
        }
    }

    /// As the flag has it.
    pub(super) const fn flag(self) -> &'static str {
        match self {
            Self::Temperature => "temperature",
            Self::LeftWheel => "left-wheel",
            Self::RightWheel => "right-wheel",
            Self::TurnRate => "turn-rate",
            Self::Range => "range",
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
    /// One of it, in seconds.
    pub(super) const fn seconds(self) -> f64 {
        match self {
            Self::S => 1.0,
            Self::Ms => 1e-3,
            Self::Us => 1e-6,
        }
    }
}

impl StepArgs {
    /// What is known of a step beforehand: what the flags say, and the noise that the source knows.
    pub(super) fn options(&self, sigma: f64) -> StepOptions {
        StepOptions {
            sigma: self.noise.unwrap_or(sigma),
            order: self.order(),
            onset_s: self.onset,
            input_step: self.input_step,
            end: self.end,
        }
    }

    /// How many lags.
    pub(super) fn order(&self) -> ModelOrder {
        self.order.map_or(ModelOrder::Automatic, |order| ModelOrder::Fixed(usize::from(order)))
    }
}
