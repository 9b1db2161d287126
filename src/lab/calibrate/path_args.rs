//! Flags of `calibrate path`.

use std::path::PathBuf;

use clap::Args;

use super::source::CalibrationReference;
use crate::flags::DataFlags;
use crate::lab::experiments::live::LiveArgs;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `calibrate path`.
#[derive(Args, Clone, Debug)]
pub struct PathArgs {
    /// A recording's descriptor (config/recordings/*.toml) or a recording (*.mcap).
    #[arg(required_unless_present_any = ["segments", "link", "listen"], group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of a descriptor's data; without --use-every all fixes are taken.
    #[command(flatten)]
    pub data: DataFlags,
    /// In place of a recording: a CSV table of wheel distances and places measured with a tape (docs/lab/calibration.md, section 3).
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["real_robot", "run", "use_every", "settings", "against", "unknown_start"])]
    pub segments: Option<PathBuf>,
    /// The robot of --segments: a profile with a [robot] table.
    #[arg(long, value_name = "FILE.toml", requires = "segments")]
    pub robot: Option<PathBuf>,
    /// What to compare with, instead of the fixes if there are any and else the truth.
    #[arg(long, value_enum)]
    pub against: Option<CalibrationReference>,
    /// How well the truth is known, in metres: one standard deviation [default: 0.005, with --segments 0.01].
    #[arg(long, value_name = "M")]
    pub truth_sigma_m: Option<f64>,
    /// Take this number as given; may be repeated.
    #[arg(long = "hold", value_enum, value_name = "NUMBER")]
    pub held: Vec<GeometryParameter>,
    /// Look for this number, which is held otherwise, up to about this far from its value: NUMBER=SIGMA, e.g. tag-forward=0.02.
    #[arg(long = "free", value_name = "NUMBER=SIGMA", value_parser = freed)]
    pub freed: Vec<(GeometryParameter, f64)>,
    /// The robot's start and the camera's axes are unknown.
    #[arg(long)]
    pub unknown_start: bool,
    /// Try the result on the runs whose names begin so, which take no part in it; may be repeated.
    #[arg(long = "try-on", value_name = "PREFIX", conflicts_with_all = ["segments", "link", "listen"])]
    pub try_on: Vec<String>,
    /// Take what the filter `pose` has learned while it drove instead, of one run.
    #[arg(long, conflicts_with_all = ["segments", "try_on", "unknown_start", "held", "freed", "against", "truth_sigma_m"])]
    pub online: bool,
    /// Write the robot as a profile for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// A number of a robot, as people say it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum GeometryParameter {
    /// Mean radius of the wheels.
    WheelRadius,
    /// Distance between the wheels.
    Track,
    /// Difference of the wheels' radii.
    WheelDifference,
    /// How late the camera is.
    Delay,
    /// Where the tag is, forward.
    TagForward,
    /// Where the tag is, to the left.
    TagLeft,
}

fn freed(text: &str) -> Result<(GeometryParameter, f64), String> {
    use clap::ValueEnum as _;
    let (name, sigma) = text.split_once('=').ok_or("must be NUMBER=SIGMA, e.g. tag-forward=0.02")?;
    let number = GeometryParameter::from_str(name, false).map_err(|_unknown| {
        let known = GeometryParameter::value_variants().iter();
        let known: Vec<String> =
            known.filter_map(|number| Some(number.to_possible_value()?.get_name().to_owned())).collect();
        format!("`{name}` is none of {}", known.join(", "))
    })?;
    match sigma.parse::<f64>() {
        Ok(sigma) if sigma > 0.0 && sigma.is_finite() => Ok((number, sigma)),
        _ => Err(format!("`{sigma}` is not a number of more than zero")),
    }
}
