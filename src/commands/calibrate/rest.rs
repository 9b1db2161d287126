//! `posebridge calibrate rest`: gyro and accelerometers from the times at which a robot stood.

use std::path::PathBuf;

use anyhow::{Result, anyhow, bail};
use clap::Args;
use posebridge_analysis::calibration::at_rest::{Resting, RestingChannel};
use posebridge_analysis::figures::{Axes, Curve, Plot, Shape, plot};
use posebridge_analysis::noise_identification::RestNoise;
use posebridge_analysis::report::Table;
use posebridge_analysis::report::page::{Page, Part};
use posebridge_link::HostTimer;
use serde_json::{Value, json};

use super::profile::Calibrated;
use super::source::{self, Watch};
use crate::cli::DataFlags;
use crate::commands::lab::live::LiveArgs;
use crate::commands::lab::outcome::{Outcome, OutputArgs};
use crate::commands::{Failure, Stage};
use crate::config::{CalibrationEntry, RobotFile};
use crate::stderr::say;

/// What a person with a live robot is told to do.
const TASK: &str = "leave the robot standing for a minute, its motors off";

/// Flags of `calibrate rest`.
#[derive(Args, Clone, Debug)]
pub struct RestArgs {
    /// A recording's descriptor (config/recordings/*.toml) or a recording (*.mcap); a minute of rest is good.
    #[arg(required_unless_present_any = ["link", "listen"], group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Write the robot with its noise as a profile for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save: Option<PathBuf>,
    /// Where results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// A channel with its name and unit.
struct Channel {
    name: &'static str,
    unit: &'static str,
    rest: RestNoise,
    readings: Vec<(f64, f64)>,
}

/// Calibrates.
///
/// # Errors
/// The recording makes no sense, the robot never stood, or an output cannot be written.
pub(super) fn execute(args: &RestArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let folder = args.output.folder()?;
    let watch = Watch { against: None, truth_sigma_m: 1.0 };
    let named = args.recording.as_deref();
    let recording = args.live.or_named(named, &args.output, &args.data, TASK)?;
    let drives = source::load(&recording, &args.data, watch)?;
    let Some(first) = drives.drives.first() else {
        return Err(anyhow!("`{}` holds no run", drives.recording)).at_start();
    };
    let mut all = Resting::default();
    for drive in &drives.drives {
        let mut observations = drive.observations.clone();
        observations.sort_by_key(|observation| observation.stamp);
        let found = Resting::of(&observations);
        all.gyro.stretches.extend(found.gyro.stretches);
        let (left, right) = (found.left_accelerometer, found.right_accelerometer);
        all.left_accelerometer.stretches.extend(left.stretches);
        all.right_accelerometer.stretches.extend(right.stretches);
    }
    let channels = channels(&all, &drives.recording).while_running()?;
    if let Some(path) = &args.save {
        let robot = with_noise(&first.robot, &channels);
        let calibrated = Calibrated {
            calibration: robot.calibration().while_running()?,
            robot,
            source: drives.recording.clone(),
            by: "calibrate rest",
            remarks: vec![table(&channels)],
        };
        calibrated.save(path, timer.utc_start()).while_running()?;
    }
    args.output.deliver(&folder, &outcome(&drives.recording, &channels))
}

/// The channels that tell something; what the others lack is said.
///
/// # Errors
/// None does.
fn channels(all: &Resting, recording: &str) -> Result<Vec<Channel>> {
    let named: [(&'static str, &'static str, &RestingChannel); 3] = [
        ("gyro", "rad/s", &all.gyro),
        ("left accelerometer", "m/s²", &all.left_accelerometer),
        ("right accelerometer", "m/s²", &all.right_accelerometer),
    ];
    let mut found = Vec::new();
    let mut reasons = Vec::new();
    for (name, unit, channel) in named {
        match channel.noise() {
            Ok(rest) => found.push(Channel {
                name,
                unit,
                rest,
                readings: channel.stretches.iter().flatten().copied().collect(),
            }),
            // No such sensor, or no rest.
            Err(_) if channel.stretches.is_empty() => {}
            Err(reason) => reasons.push(format!("{name}: {reason}")),
        }
    }
    if found.is_empty() {
        bail!(
            "`{recording}` does not tell the noise of a gyro or of accelerometers while its wheels stood{}{}; record a minute of rest, ten \
             where a coarse sensor hardly ever changes",
            if reasons.is_empty() { "" } else { ": " },
            reasons.join("; ")
        );
    }
    for reason in reasons {
        say(&format!("{recording}: {reason}; it is left as it was"));
    }
    Ok(found)
}

/// The robot with the noise of the channels that were measured.
fn with_noise(robot: &RobotFile, channels: &[Channel]) -> RobotFile {
    let mut robot = robot.clone();
    let find = |name: &str| channels.iter().find(|channel| channel.name == name);
    if let Some(Channel { rest, .. }) = find("gyro") {
        // The filters add the rounding to the resolution themselves.
        robot.noise.gyro_rad_per_s = rest.beside_rounding();
        robot.noise.gyro_resolution_rad_per_s = rest.quantum.unwrap_or(0.0);
        if let Some((walk, _)) = rest.walk {
            robot.noise.gyro_bias_walk_rad_per_s_sqrt_s = walk;
        }
        robot.calibration.gyro_bias_rad_per_s = Some(CalibrationEntry { value: rest.bias, sigma: rest.bias_sigma });
    }
    let accelerometers = [find("left accelerometer"), find("right accelerometer")];
    // A profile has no resolution of an accelerometer: its noise is told with the rounding.
    let noise = accelerometers.into_iter().flatten().map(|channel| channel.rest.total);
    let largest = noise.fold(0.0, f64::max);
    if largest > 0.0 {
        robot.noise.accelerometer_m_per_s2 = largest;
    }
    robot
}

fn table(channels: &[Channel]) -> String {
    let mut table = Table::new([
        "sensor",
        "unit",
        "bias",
        "sigma",
        "noise",
        "with rounding",
        "step",
        "walk/sqrt(s)",
        "readings",
        "rest s",
    ]);
    for Channel { name, unit, rest, .. } in channels {
        table.push([
            (*name).to_owned(),
            (*unit).to_owned(),
            format!("{:+.5}", rest.bias),
            format!("{:.5}", rest.bias_sigma),
            format!("{:.5}", rest.beside_rounding()),
            format!("{:.5}", rest.total),
            format!("{:.5}", rest.quantum.unwrap_or(0.0)),
            rest.walk.map_or_else(|| "-".to_owned(), |(walk, _)| format!("{walk:.6}")),
            rest.samples.to_string(),
            format!("{:.1}", rest.rest_s),
        ]);
    }
    table.render()
}

fn outcome(recording: &str, channels: &[Channel]) -> Outcome {
    let axes = channels.iter().map(|channel| Axes {
        x_name: "time [s]".to_owned(),
        y_name: format!("{} [{}]", channel.name, channel.unit),
        height_px: 200.0,
        is_map: false,
        curves: vec![
            Curve { name: "reading".to_owned(), shape: Shape::Line(channel.readings.clone()) },
            Curve { name: "bias".to_owned(), shape: Shape::Level(channel.rest.bias) },
        ],
    });
    let picture =
        plot(&Plot { title: format!("At rest: {recording}"), key_figures: String::new(), axes: axes.collect() });
    let table = table(channels);
    let json: Vec<Value> = channels
        .iter()
        .map(|channel| {
            json!({
                "sensor": channel.name,
                "unit": channel.unit,
                "bias": channel.rest.bias,
                "bias_sigma": channel.rest.bias_sigma,
                "noise": channel.rest.beside_rounding(),
                "noise_with_rounding": channel.rest.total,
                "step": channel.rest.quantum.unwrap_or(0.0),
                "walk_per_sqrt_s": channel.rest.walk.map(|(walk, _)| walk),
                "readings": channel.rest.samples,
                "rest_s": channel.rest.rest_s,
            })
        })
        .collect();
    Outcome {
        name: "calibrate-rest",
        page: Page {
            title: format!("At rest: {recording}"),
            parts: vec![
                Part::Text("Readings while the wheels stood: what is left is bias and noise.".to_owned()),
                Part::Lines(table.clone()),
                Part::Figure {
                    svg: picture,
                    caption: "A bias that walks shows as a bend, a coarse sensor as steps.".to_owned(),
                },
            ],
        },
        text: format!("{recording} at rest\n\n{table}"),
        json: json!({ "recording": recording, "channels": json }),
    }
}
