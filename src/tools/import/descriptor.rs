//! One run of a descriptor: its observations, at the instants at which they arrived.

use std::path::Path;

use anyhow::{Result, bail};
use posebridge_telemetry::{Arena, Input, Point2};

use super::InputSink;
use crate::config::{Config, NumberedPlace, RobotFile, RobotStart, WorldConfig};
use crate::flags::DataFlags;
use crate::tools::dataset::{DataSet, RobotRun};

/// An opened run.
pub(super) struct DescriptorSource {
    /// The robot, its tunables, and what stands in its arena.
    pub(super) config: Config,
    robot_run: RobotRun,
}

impl DescriptorSource {
    /// Loads the one run that the flags choose.
    ///
    /// # Errors
    /// As loading it, or the flags choose several.
    pub(super) fn open(path: &Path, flags: &DataFlags) -> Result<Self> {
        let data = DataSet::open(path, flags)?;
        let [name] = data.runs.as_slice() else {
            bail!(
                "a recording holds one run, but {} are selected: choose one with --run: {}",
                data.runs.len(),
                data.runs.join(", ")
            );
        };
        let robot_run = data.load(name, flags)?;
        let start = robot_run.filter_config.start.map(|start| RobotStart {
            x_m: start.pose.x.0,
            y_m: start.pose.y.0,
            heading_deg: start.pose.heading.rad().to_degrees(),
            position_sigma_m: start.position_sigma_m,
            heading_sigma_deg: start.heading_sigma_rad.to_degrees(),
        });
        let config = Config {
            robot: RobotFile { start, ..robot_run.robot.clone() },
            filter: robot_run.filter.clone(),
            world: WorldConfig {
                landmarks: places(robot_run.run.landmarks.iter().map(|(id, at)| (id.0, *at))),
                beacons: places(robot_run.run.beacons.iter().map(|(id, at)| (id.0, *at))),
                walls: Vec::new(),
            },
            links: Vec::new(),
            ..Config::default()
        };
        Ok(Self { config, robot_run })
    }

    /// Gives the observations in the order of their arrival.
    ///
    /// # Errors
    /// As `sink` says.
    pub(super) fn inputs(&self, sink: &mut InputSink<'_>) -> Result<Vec<String>> {
        let run = &self.robot_run.run;
        for timed in &run.observations {
            sink(timed.arrival, &Input::Observation(timed.observation))?;
        }
        let left_out = [
            (run.bad_rows.total(), "rows that could not be used"),
            (run.truth.len(), "true poses: they belong to the descriptor"),
            (run.withheld.len(), "fixes that the descriptor withholds"),
        ];
        let left_out = left_out.into_iter().filter(|(count, _)| *count > 0);
        Ok(left_out.map(|(count, what)| format!("left out: {count} {what}")).collect())
    }
}

fn places(places: impl Iterator<Item = (u32, Point2<Arena>)>) -> Vec<NumberedPlace> {
    let place = |(id, at): (u32, Point2<Arena>)| NumberedPlace { id, x_m: at.x.0, y_m: at.y.0 };
    places.map(place).collect()
}
