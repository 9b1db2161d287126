//! `posebridge calibrate rest`: gyro and accelerometers from the intervals at rest.

use std::path::PathBuf;

use anyhow::{Result, anyhow, bail};
use clap::Args;
use posebridge_lab::noise_identification::{RestIntervals, RestNoise, readings_at_rest, rest_noise};
use posebridge_link::HostTimer;
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use serde_json::json;

use super::profile::save_profile;
use crate::config::{CalibrationEntry, RobotFile};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::experiments::live::LiveArgs;
use crate::lab::source;
use crate::tools::experiment_output::OutputArgs;

const TASK: &str = "leave the robot standing for a minute, its motors off";

/// Flags of `calibrate rest`.
#[derive(Args, Clone, Debug)]
pub struct RestArgs {
    /// Descriptor (config/recordings/*.toml) or recording (*.mcap). One minute of rest is enough.
    #[arg(required_unless_present_any = ["link", "listen"], group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Write a robot profile with the measured noise, for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

struct ChannelNoise {
    name: &'static str,
    unit: &'static str,
    noise: RestNoise,
    readings: Vec<(f64, f64)>,
}

pub(super) fn execute(args: &RestArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let folder = args.output.folder()?;
    let named = args.recording.as_deref();
    let recording = args.live.or_named(named, &args.output, &args.data, TASK)?;
    let drives = source::load(&recording, &args.data).before_start()?;
    let Some(first) = drives.runs.first() else {
        return Err(anyhow!("`{}` holds no run", drives.recording)).before_start();
    };
    let mut all = <[RestIntervals; 3]>::default();
    for drive in &drives.runs {
        let mut observations = drive.observations.clone();
        observations.sort_by_key(|observation| observation.stamp);
        for (channel, found) in all.iter_mut().zip(readings_at_rest(&observations)) {
            channel.extend(found);
        }
    }
    let channels = channels(&all, &drives.recording).while_running()?;
    let report = report(&drives.recording, &channels);
    if let Some(path) = &args.save {
        let robot = with_noise(&first.robot, &channels);
        let calibration = robot.calibration().while_running()?;
        let source = drives.recording.clone();
        save_profile(path, &timer, &report, "calibrate rest", source, (robot, calibration)).while_running()?;
    }
    args.output.write_outcome(&folder, &report)
}

fn channels(all: &[RestIntervals; 3], recording: &str) -> Result<Vec<ChannelNoise>> {
    let named = [("gyro", "rad/s"), ("left accelerometer", "m/s²"), ("right accelerometer", "m/s²")];
    let mut found = Vec::new();
    let mut reasons = Vec::new();
    for ((name, unit), intervals) in named.into_iter().zip(all) {
        match rest_noise(intervals) {
            Ok(rest) => found.push(ChannelNoise { name, unit, noise: rest, readings: intervals.concat() }),
            // No such sensor, or no rest.
            Err(_) if intervals.is_empty() => {}
            Err(reason) => reasons.push(format!("{name}: {reason}")),
        }
    }
    if found.is_empty() {
        bail!(
            "`{recording}` does not determine the noise of a gyro or of accelerometers while its wheels stood{}{}; record a minute of rest, ten \
             where a coarse sensor hardly ever changes",
            if reasons.is_empty() { "" } else { ": " },
            reasons.join("; ")
        );
    }
    for reason in reasons {
        print_line(&format!("{recording}: {reason}; it is left as it was"));
    }
    Ok(found)
}

fn with_noise(robot: &RobotFile, channels: &[ChannelNoise]) -> RobotFile {
    let mut robot = robot.clone();
    let find = |name: &str| channels.iter().find(|channel| channel.name == name);
    if let Some(ChannelNoise { noise: rest, .. }) = find("gyro") {
        // The filters add the rounding to the resolution themselves.
        robot.noise.gyro_rad_per_s = rest.without_rounding();
        robot.noise.gyro_resolution_rad_per_s = rest.quantum.unwrap_or(0.0);
        if let Some((walk, _)) = rest.walk {
            robot.noise.gyro_bias_walk_rad_per_s_sqrt_s = walk;
        }
        robot.calibration.gyro_bias_rad_per_s = Some(CalibrationEntry { value: rest.bias, sigma: rest.bias_sigma });
    }
    let accelerometers = [find("left accelerometer"), find("right accelerometer")];
    // A profile has no resolution of an accelerometer: its noise includes the rounding.
    let noise = accelerometers.into_iter().flatten().map(|channel| channel.noise.total);
    let largest = noise.fold(0.0, f64::max);
    if largest > 0.0 {
        robot.noise.accelerometer_m_per_s2 = largest;
    }
    robot
}

fn report(recording: &str, channels: &[ChannelNoise]) -> Report {
    let five = Format::new(Unit::None, 5);
    let table = Table::of(channels)
        .text("sensor", "sensor", |channel| channel.name.to_owned())
        .text("unit", "unit", |channel| channel.unit.to_owned())
        .labels(2)
        .number("bias", "bias", five.signed(), |channel| Some(channel.noise.bias))
        .number("bias_sigma", "sigma", five, |channel| Some(channel.noise.bias_sigma))
        .number("noise", "noise", five, |channel| Some(channel.noise.without_rounding()))
        .number("noise_with_rounding", "with rounding", five, |channel| Some(channel.noise.total))
        .number("step", "step", five, |channel| Some(channel.noise.quantum.unwrap_or(0.0)))
        .number("walk_per_sqrt_s", "walk/sqrt(s)", Format::new(Unit::None, 6), |channel| Some(channel.noise.walk?.0))
        .count("readings", "readings", |channel| channel.noise.samples)
        .number("rest_s", "rest", Format::new(Unit::Named("s"), 1), |channel| Some(channel.noise.rest_s));
    let title = format!("At rest: {recording}");
    let mut report = Report::new("calibrate-rest", title.as_str());
    report.background("Readings while the wheels stood: what is left is bias and noise.");
    report.table("channels", &table);
    let axes = channels.iter().map(|channel| {
        Axes::new(
            "time [s]",
            format!("{} [{}]", channel.name, channel.unit),
            200.0,
            [
                Curve::line("reading", channel.readings.clone()),
                Curve::new("bias", CurveShape::Level(channel.noise.bias)),
            ],
        )
    });
    let plot = Plot::new(title, "", axes.collect());
    report.chart(&plot, "A bias that walks shows as a bend, a coarse sensor as steps.");
    report.data("recording", json!(recording));
    report
}
