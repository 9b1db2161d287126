//! The experiment on a recording: each run's step, and its readings foretold.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use posebridge_lab::wall::{
    PlantSearch, RangeForecast, WallEntry, WallLog, WallReading, fit_by_hand, fit_steps, forecast, gate_statistics,
    score_forecasts,
};
use posebridge_recording::dataset::{DatasetRun, Descriptor};
use posebridge_report::report::Report;
use posebridge_telemetry::{Observation, ObservationKind, SensorId};

use super::columns::{ExtraColumn, FOREIGN_FILTER, with_extra};
use super::recorded_report::{self, RunResult};
use super::steps::PIECE;
use crate::config::{Overlay, Setting};
use crate::console::progress_bar;
use crate::flags::DataFlags;
use crate::lab::parallel::run_all;
use crate::tools::dataset::{DataSet, report_bad_rows};
use crate::tools::own_recording;

/// Names that people give to a column of PWM.
const COMMAND_COLUMNS: [&str; 4] = ["pwm", "PWM", "motor_pwm", "Speed"];
/// And to the distance that their filter gave.
const KALMAN_COLUMNS: [&str; 4] = ["kf_mm", "kf", "kalman_mm", "kalman"];

/// The runs of a recording, read.
pub(in crate::lab) struct RecordedRuns {
    pub(super) descriptor: String,
    pub(in crate::lab) runs: Vec<RunLog>,
}

/// One run, as far as this experiment is concerned.
pub(in crate::lab) struct RunLog {
    pub(in crate::lab) name: String,
    pub(in crate::lab) log: WallLog,
    /// Whether the files have the motors' commands.
    pub(in crate::lab) knows_input: bool,
    /// Time and distance of another program's filter, in order.
    foreign_filter: Vec<(f64, f64)>,
    range_sigma_m: f64,
}

/// The instructions for a person with a live robot.
pub(super) const TASK: &str =
    "leave the robot standing before the wall for a second, then drive it straight at the wall, and stop it";

/// What to read of a recording.
#[derive(Clone, Copy, Debug)]
pub(in crate::lab) struct RunSelection<'a> {
    /// Where a descriptor's relative paths start.
    pub(in crate::lab) data: Option<&'a Path>,
    /// The beginning of the names of a descriptor's runs; all without it.
    pub(in crate::lab) run: Option<&'a str>,
    /// Keys of the robot's table, or of the configuration of a recording of ours.
    pub(in crate::lab) settings: &'a [Setting],
    /// The column of the motor's PWM, instead of one with a usual name.
    pub(in crate::lab) command_column: Option<&'a str>,
    /// The column of another program's filter, instead of one with a usual name.
    pub(in crate::lab) kalman_column: Option<&'a str>,
}

/// Reads every run that was asked for: of a descriptor, or a recording of ours, which is one run.
pub(in crate::lab) fn prepare(path: &Path, choice: &RunSelection<'_>) -> Result<RecordedRuns> {
    if own_recording::is_own(path) {
        return prepare_own(path, choice);
    }
    let flags = DataFlags {
        data: choice.data.map(Path::to_owned),
        run: Some(choice.run.unwrap_or_default().to_owned()),
        use_every: None,
        settings: choice.settings.to_vec(),
    };
    let mut set = DataSet::open(path, &flags)?;
    let text = std::fs::read_to_string(path).with_context(|| format!("reading the descriptor `{}`", path.display()))?;
    let mut runs = Vec::new();
    for name in set.runs.clone() {
        let mut reader = RunReader { set: &mut set, flags: &flags, text: &text, run: &name };
        runs.push(reader.read(choice)?);
    }
    Ok(RecordedRuns { descriptor: path.display().to_string(), runs })
}

/// A recording of ours has ranges but no motor commands: full drive is assumed, as for others who wrote it down nowhere.
fn prepare_own(path: &Path, choice: &RunSelection<'_>) -> Result<RecordedRuns> {
    ensure!(
        choice.run.is_none() && choice.command_column.is_none() && choice.kalman_column.is_none(),
        "--run, --command-column and --kalman-column choose from a descriptor's files; `{}` is a recording of ours",
        path.display()
    );
    let overlay = Overlay { robot: None, settings: choice.settings };
    let run = own_recording::read(path, overlay)?;
    let ranges = readings_of(run.observations.iter(), |_, observed| range_m(observed).map(WallReading::Range));
    ensure!(
        !ranges.is_empty(),
        "`{}` holds no range to a wall: let the robot send DISTANCE_SENSOR and record it again",
        run.name
    );
    Ok(RecordedRuns {
        descriptor: run.name.clone(),
        runs: vec![RunLog {
            name: run.name,
            knows_input: false,
            log: WallLog::new(ranges).with_assumed_drive(),
            foreign_filter: Vec::new(),
            range_sigma_m: run.config.noise.wall_range_m,
        }],
    })
}

struct RunReader<'a> {
    set: &'a mut DataSet,
    flags: &'a DataFlags,
    text: &'a str,
    run: &'a str,
}

impl RunReader<'_> {
    fn read(&mut self, choice: &RunSelection<'_>) -> Result<RunLog> {
        let plain = self.set.load(self.run, self.flags)?;
        report_bad_rows(&plain);
        let commanded = self.column(choice.command_column, &COMMAND_COLUMNS, ExtraColumn::Command)?;
        let filtered = self.column(choice.kalman_column, &KALMAN_COLUMNS, ExtraColumn::Filtered)?;
        let ranges = readings_of(of_run(&plain.run), |sensor, observed| {
            range_m(observed).filter(|_| sensor != FOREIGN_FILTER).map(WallReading::Range)
        });
        ensure!(!ranges.is_empty(), "run `{}` holds no range to a wall; choose another with --run", self.run);
        let inputs = commanded.map_or_else(Vec::new, |run| {
            readings_of(of_run(&run), |_, observed| {
                let ObservationKind::BodyVelocity { forward, .. } = observed else {
                    return None;
                };
                Some(WallReading::Input(forward.0))
            })
        });
        let theirs = filtered.map_or_else(Vec::new, |run| {
            let entries = readings_of(of_run(&run), |sensor, observed| {
                range_m(observed).filter(|_| sensor == FOREIGN_FILTER).map(WallReading::Range)
            });
            WallLog::new(entries).readings().collect()
        });
        let log = WallLog::new(ranges.into_iter().chain(inputs).collect());
        Ok(RunLog {
            name: self.run.to_owned(),
            knows_input: log.drives_from_s().is_some(),
            log: log.with_assumed_drive(),
            foreign_filter: theirs,
            range_sigma_m: plain.filter_config.noise.wall_range_m,
        })
    }

    /// The run with a column more: the one that was asked for, which must be there, or the first usual name that is.
    fn column<'c>(
        &mut self,
        asked: Option<&'c str>,
        usual: &[&'c str],
        extra: fn(&'c str) -> ExtraColumn<'c>,
    ) -> Result<Option<DatasetRun>> {
        let known = self.set.descriptor.clone();
        let mut found = None;
        for column in asked.map_or_else(|| usual.to_vec(), |asked| vec![asked]) {
            let Some(text) = with_extra(self.text, self.run, extra(column))? else {
                break;
            };
            self.set.descriptor =
                Descriptor::from_toml(&text).with_context(|| format!("the descriptor with the column `{column}`"))?;
            let loaded = self.set.load(self.run, self.flags);
            match loaded {
                Ok(loaded) => found = Some(loaded.run),
                Err(error) if asked.is_some() => {
                    self.set.descriptor = known;
                    return Err(error);
                }
                Err(_) => continue,
            }
            break;
        }
        self.set.descriptor = known;
        Ok(found)
    }
}

fn range_m(observed: &ObservationKind) -> Option<f64> {
    let ObservationKind::WallRange(range) = observed else {
        return None;
    };
    Some(range.0)
}

fn of_run(run: &DatasetRun) -> impl Iterator<Item = &Observation> {
    run.observations.iter().map(|timed| &timed.observation)
}

fn readings_of<'a>(
    observations: impl Iterator<Item = &'a Observation>,
    of: impl Fn(SensorId, &ObservationKind) -> Option<WallReading>,
) -> Vec<WallEntry> {
    observations
        .filter_map(|observation| {
            Some(WallEntry {
                at_s: observation.stamp.as_secs_f64(),
                reading: of(observation.sensor, &observation.measurement)?,
            })
        })
        .collect()
}

/// Evaluates every run, on all cores; `command` is the one that gives the page again.
pub(super) fn run(prepared: &RecordedRuns, command: String) -> Result<Report> {
    let bar = progress_bar(prepared.runs.len() as u64, "runs")?;
    let found = run_all(&prepared.runs, evaluate, || bar.inc(1));
    bar.finish_and_clear();
    Ok(recorded_report::report(&prepared.descriptor, command, &found))
}

fn evaluate(run: &RunLog) -> RunResult {
    let search = PlantSearch { range_sigma_m: run.range_sigma_m };
    let foreseen = forecast(&run.log, search);
    // The last output of their filter before the reading came.
    let before = |foreseen: &RangeForecast| {
        let earlier = run.foreign_filter.partition_point(|(at_s, _)| *at_s < foreseen.at_s);
        let last = earlier.checked_sub(1).and_then(|last| run.foreign_filter.get(last));
        last.map(|(_, distance_m)| *distance_m)
    };
    RunResult {
        name: run.name.clone(),
        readings: run.log.readings().count(),
        knows_input: run.knows_input,
        by_hand: fit_by_hand(&run.log, PIECE),
        fit: fit_steps(std::slice::from_ref(&run.log)),
        gate: gate_statistics(&foreseen),
        score_against_line: score_forecasts(&foreseen, |foreseen| foreseen.line_m),
        score_against_foreign: score_forecasts(&foreseen, before),
        foreign_filter: run.foreign_filter.clone(),
        forecasts: foreseen,
    }
}
