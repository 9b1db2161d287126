//! `posebridge calibrate rest`: gyro and accelerometers from the times at which a robot stood.

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use clap::Args;
use posebridge_analysis::calibration::at_rest::{AtRest, Resting, RestingChannel};
use posebridge_analysis::figures::{Axes, Curve, Plot, Shape, plot};
use posebridge_analysis::report::Table;
use posebridge_analysis::report::page::{Page, Part};
use posebridge_link::HostTimer;
use posebridge_telemetry::Known;
use serde_json::{Value, json};

use super::profile::Calibrated;
use super::source::{self, Watch};
use crate::cli::DataFlags;
use crate::commands::lab::live::LiveArgs;
use crate::commands::lab::outcome::{Outcome, OutputArgs};
use crate::commands::{Failure, Stage};
use crate::config::{CalibrationEntry, RobotFile};

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
    rest: AtRest,
    readings: Vec<(f64, f64)>,
}

/// Calibrates.
///
/// # Errors
/// The recording makes no sense, the robot never stood, or an output cannot be written.
pub(super) fn execute(args: &RestArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let folder = args.output.folder()?;
    let watch = Watch {
        against: None,
        truth_sigma_m: 1.0,
    };
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
    let channels = channels(&all);
    if channels.is_empty() {
        return Err(anyhow!(
            "`{}` holds too few readings of a gyro or of accelerometers while its wheels stood: record a minute of rest",
            drives.recording
        ))
        .while_running();
    }
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
    args.output
        .deliver(&folder, &outcome(&drives.recording, &channels))
}

fn channels(all: &Resting) -> Vec<Channel> {
    let named: [(&'static str, &'static str, &RestingChannel); 3] = [
        ("gyro", "rad/s", &all.gyro),
        ("left accelerometer", "m/s²", &all.left_accelerometer),
        ("right accelerometer", "m/s²", &all.right_accelerometer),
    ];
    let found = named.into_iter().filter_map(|(name, unit, channel)| {
        Some(Channel {
            name,
            unit,
            // Too few readings: no such sensor.
            rest: channel.at_rest().ok()?,
            readings: channel.stretches.iter().flatten().copied().collect(),
        })
    });
    found.collect()
}

/// The robot with the noise of the channels that were measured.
fn with_noise(robot: &RobotFile, channels: &[Channel]) -> RobotFile {
    let mut robot = robot.clone();
    let find = |name: &str| channels.iter().find(|channel| channel.name == name);
    if let Some(Channel { rest, .. }) = find("gyro") {
        robot.noise.gyro_rad_per_s = rest.noise;
        robot.noise.gyro_resolution_rad_per_s = rest.step;
        if let Some(walk) = rest.walk_per_sqrt_s {
            robot.noise.gyro_bias_walk_rad_per_s_sqrt_s = walk;
        }
        let Known { value, sigma } = rest.bias;
        robot.calibration.gyro_bias_rad_per_s = Some(CalibrationEntry { value, sigma });
    }
    let accelerometers = [find("left accelerometer"), find("right accelerometer")];
    let noise = accelerometers
        .into_iter()
        .flatten()
        .map(|channel| channel.rest.noise);
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
        "step",
        "walk/sqrt(s)",
        "readings",
        "rest s",
    ]);
    for Channel {
        name, unit, rest, ..
    } in channels
    {
        table.push([
            (*name).to_owned(),
            (*unit).to_owned(),
            format!("{:+.5}", rest.bias.value),
            format!("{:.5}", rest.bias.sigma),
            format!("{:.5}", rest.noise),
            format!("{:.5}", rest.step),
            rest.walk_per_sqrt_s
                .map_or_else(|| "-".to_owned(), |walk| format!("{walk:.6}")),
            rest.readings.to_string(),
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
            Curve {
                name: "reading".to_owned(),
                shape: Shape::Line(channel.readings.clone()),
            },
            Curve {
                name: "bias".to_owned(),
                shape: Shape::Level(channel.rest.bias.value),
            },
        ],
    });
    let picture = plot(&Plot {
        title: format!("At rest: {recording}"),
        key_figures: String::new(),
        axes: axes.collect(),
    });
    let table = table(channels);
    let json: Vec<Value> = channels
        .iter()
        .map(|channel| {
            json!({
                "sensor": channel.name,
                "unit": channel.unit,
                "bias": channel.rest.bias.value,
                "bias_sigma": channel.rest.bias.sigma,
                "noise": channel.rest.noise,
                "step": channel.rest.step,
                "walk_per_sqrt_s": channel.rest.walk_per_sqrt_s,
                "readings": channel.rest.readings,
                "rest_s": channel.rest.rest_s,
            })
        })
        .collect();
    Outcome {
        name: "calibrate-rest",
        page: Page {
            title: format!("At rest: {recording}"),
            parts: vec![
                Part::Text(
                    "Readings while the wheels stood: what is left is bias and noise.".to_owned(),
                ),
                Part::Lines(table.clone()),
                Part::Figure {
                    svg: picture,
                    caption: "A bias that walks shows as a bend, a coarse sensor as steps."
                        .to_owned(),
                },
            ],
        },
        text: format!("{recording} at rest\n\n{table}"),
        json: json!({ "recording": recording, "channels": json }),
    }
}
