//! Reference data of a recorded robot run: ground truth and the brick's odometry. A simulation's truth is a CSV file, written by
//! `posebridge sim --truth` and read by `posebridge replay --truth`, or in the recording.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use posebridge_recording::container::{self, TruthSample};
use posebridge_report::{PoseTrack, TimedPose};
use posebridge_telemetry::{Heading, Meters, Pose, RobotId, Timestamp};

use super::csv_table::CsvTable;
use crate::station::event_collector::MAX_INTERPOLATION_GAP;

/// True poses and the brick's odometry, as far as the recording or a file contains them.
#[derive(Debug, Default)]
pub struct GroundTruth {
    pub truth: Option<PoseTrack>,
    pub odometry: Option<PoseTrack>,
}

impl GroundTruth {
    pub fn from_file(truth: Option<&Path>) -> Result<Self> {
        Ok(Self { truth: truth.map(open_truth_file).transpose()?, odometry: None })
    }

    /// Loads the truth from a file, else from the recording with this name and these bytes; empty if there is none for the robot.
    ///
    /// `None` selects the samples without a robot id; if all samples have one, the robot with the lowest id. `Some` selects that robot;
    /// if no sample has an id, the samples belong to the only simulated robot, as written by programs that served one robot. Then they
    /// match any robot, and a caller with several must know which one was simulated.
    pub fn load(name: &str, recording: &[u8], truth: Option<&Path>, robot: Option<RobotId>) -> Result<Self> {
        if truth.is_some() {
            return Self::from_file(truth);
        }
        let samples = container::read_truth(recording)
            .with_context(|| format!("the truth in `{name}`; give another with --truth"))?;
        let samples = samples_of(robot, samples);
        if samples.is_empty() {
            return Ok(Self::default());
        }
        let of_truth = samples.iter().map(|sample| TimedPose { time: sample.time, pose: sample.pose });
        let odometry_samples =
            samples.iter().filter_map(|sample| Some(TimedPose { time: sample.time, pose: sample.odometry? }));
        let odometry = PoseTrack::new(odometry_samples, MAX_INTERPOLATION_GAP);
        Ok(Self {
            truth: Some(PoseTrack::new(of_truth, MAX_INTERPOLATION_GAP)),
            odometry: (!odometry.samples().is_empty()).then_some(odometry),
        })
    }
}

/// The samples of one robot; see [`GroundTruth::load`].
fn samples_of(robot: Option<RobotId>, mut samples: Vec<TruthSample>) -> Vec<TruthSample> {
    let is_named = |sample: &TruthSample| sample.robot.is_some();
    let selected = match robot {
        None if samples.iter().all(is_named) => samples.iter().filter_map(|sample| sample.robot).min(),
        Some(_) if !samples.iter().any(is_named) => None,
        None | Some(_) => robot,
    };
    samples.retain(|sample| sample.robot == selected);
    samples
}

const HEADER: &str = "brick_micros,x_m,y_m,heading_rad,odometry_x_m,odometry_y_m,odometry_heading_rad,cross_track_m";

pub fn write_truth_file(samples: &[posebridge_sim::TruthSample]) -> String {
    let mut text = String::from(HEADER);
    text.push('\n');
    for sample in samples {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{}",
            sample.brick_time.as_micros(),
            sample.pose.x.0,
            sample.pose.y.0,
            sample.pose.heading.rad(),
            sample.odometry.x.0,
            sample.odometry.y.0,
            sample.odometry.heading.rad(),
            sample.cross_track_m,
        );
    }
    text
}

fn open_truth_file(path: &Path) -> Result<PoseTrack> {
    let table = CsvTable::read(path).context("reading the truth")?;
    ensure!(
        table.columns().iter().eq(HEADER.split(',')),
        "`{}` is no truth file; its first line must be `{HEADER}`",
        path.display()
    );
    let samples = table.rows().map(|row| {
        Ok(TimedPose {
            time: Timestamp::from_micros(row.number("brick_micros")? as i64),
            pose: Pose::new(
                Meters(row.number("x_m")?),
                Meters(row.number("y_m")?),
                Heading::from_rad(row.number("heading_rad")?),
            ),
        })
    });
    Ok(PoseTrack::new(samples.collect::<Result<Vec<_>>>()?, MAX_INTERPOLATION_GAP))
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, LinkId};

    fn id(system: u8) -> RobotId {
        RobotId { link: LinkId(0), address: Address::new(system, 1) }
    }

    /// A second apart, each as far east as its place in the list.
    fn samples(robots: &[Option<RobotId>]) -> Vec<TruthSample> {
        let sample = |(index, robot): (i32, &Option<RobotId>)| TruthSample {
            robot: *robot,
            time: Timestamp::from_millis(1_000 * i64::from(index)),
            pose: Pose::new(Meters(f64::from(index)), Meters(0.0), Heading::default()),
            odometry: None,
        };
        (0..).zip(robots).map(sample).collect()
    }

    #[test]
    fn the_truth_is_that_of_one_robot_and_samples_that_name_none_answer_for_any() {
        let (two, unnamed, mixed) = ([Some(id(2)), Some(id(1)), Some(id(2))], [None, None], [Some(id(1)), None]);
        for (requested, robots, expected) in [
            (None, &two[..], &[1.0][..]),
            (Some(id(2)), &two, &[0.0, 2.0]),
            (Some(id(3)), &two, &[]),
            (Some(id(2)), &unnamed, &[0.0, 1.0]),
            (None, &mixed, &[1.0]),
            (Some(id(2)), &mixed, &[]),
        ] {
            let found = samples_of(requested, samples(robots));
            let positions: Vec<f64> = found.iter().map(|sample| sample.pose.x.0).collect();
            assert_eq!(positions, expected, "{requested:?} of {robots:?}");
        }
    }

    #[test]
    fn a_wrong_file_is_refused_with_line_and_column() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        for (text, expected) in [
            ("t_s,x_m\n".to_owned(), "truth.csv` is no truth file; its first line must be `brick_micros,x_m"),
            (format!("{HEADER}\n0,0,0,0,0,0,0,0\n1,0,far,0\n"), "truth.csv` line 3: `far` in column `y_m`"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = format!("{:#}", open_truth_file(&path).unwrap_err());
            assert!(error.contains(expected), "{error}");
        }
    }
}
