//! The experiment on a recording: each run's step, and the predictions of its readings.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_lab::wall::{
    ForecastScore, GateStatistics, ManualStepFit, RangeForecast, StepFit, WallEntry, WallLog, WallReading,
    WallStepError, fit_by_hand, fit_steps, forecast, gate_statistics, score_forecasts,
};
use posebridge_recording::dataset::{DatasetRun, Descriptor};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_telemetry::{Observation, ObservationKind, SensorId};
use serde_json::{Value, json};

use super::pictures;
use super::steps::PIECE;
use crate::config::{Overlay, Setting};
use crate::flags::DataFlags;
use crate::lab::parallel::run_with_bar;
use crate::tools::dataset::{DataSet, report_bad_rows};
use crate::tools::own_recording;

const COMMAND_COLUMNS: [&str; 4] = ["pwm", "PWM", "motor_pwm", "Speed"];
/// Common names of a column with another filter's distance.
const KALMAN_COLUMNS: [&str; 4] = ["kf_mm", "kf", "kalman_mm", "kalman"];

pub(in crate::lab) struct RecordedRuns {
    pub(super) descriptor: String,
    pub(in crate::lab) runs: Vec<RunLog>,
}

pub(in crate::lab) struct RunLog {
    pub(in crate::lab) name: String,
    pub(in crate::lab) log: WallLog,
    /// Whether the files contain motor commands.
    pub(in crate::lab) knows_input: bool,
    /// Time and distance of another program's filter, in order.
    foreign_filter: Vec<(f64, f64)>,
    range_sigma_m: f64,
}

pub(super) const TASK: &str =
    "leave the robot standing before the wall for a second, then drive it straight at the wall, and stop it";

/// Flags that choose from a recording.
#[derive(clap::Args, Clone, Debug)]
pub struct RunSelection {
    /// Folder for the relative paths of the descriptor. Default: POSEBRIDGE_DATA, or else the descriptor's folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Read the runs of the descriptor whose names begin with this text. Default: all runs.
    #[arg(long = "run", value_name = "PREFIX", requires = "recording")]
    pub run: Option<String>,
    /// Set one key of the robot, e.g. noise.wall_range_m=0.02. For a posebridge recording or a live robot: a key of the
    /// configuration, e.g. robot.noise.wall_range_m=0.02. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real_robot")]
    pub settings: Vec<Setting>,
    /// Column of the motor's PWM in the files of the recording. Default: pwm, PWM, motor_pwm or Speed, if one exists.
    #[arg(long, value_name = "COLUMN", requires = "recording")]
    pub command_column: Option<String>,
}

/// Reads the selected runs of a descriptor, or a posebridge recording, which is one run. `kalman_column` is that of another program's
/// filter; `None` for a common name.
pub(in crate::lab) fn prepare(path: &Path, choice: &RunSelection, kalman_column: Option<&str>) -> Result<RecordedRuns> {
    if own_recording::is_own(path) {
        ensure!(
            choice.run.is_none() && choice.command_column.is_none() && kalman_column.is_none(),
            "--run, --command-column and --kalman-column choose from a descriptor's files; `{}` is a recording of ours",
            path.display()
        );
        return prepare_own(path, &choice.settings);
    }
    let flags = DataFlags {
        data: choice.data.clone(),
        run: Some(choice.run.clone().unwrap_or_default()),
        use_every: None,
        settings: choice.settings.clone(),
    };
    let mut set = DataSet::open(path, &flags)?;
    let text = std::fs::read_to_string(path).with_context(|| format!("reading the descriptor `{}`", path.display()))?;
    let mut runs = Vec::new();
    for name in set.runs.clone() {
        let mut reader = RunReader { set: &mut set, flags: &flags, text: &text, run: &name };
        runs.push(reader.read(choice.command_column.as_deref(), kalman_column)?);
    }
    Ok(RecordedRuns { descriptor: path.display().to_string(), runs })
}

/// A posebridge recording has ranges but no motor commands: full drive is assumed.
fn prepare_own(path: &Path, settings: &[Setting]) -> Result<RecordedRuns> {
    let overlay = Overlay { robot: None, settings };
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
    fn read(&mut self, command_column: Option<&str>, kalman_column: Option<&str>) -> Result<RunLog> {
        let plain = self.set.load(self.run, self.flags)?;
        report_bad_rows(&plain);
        let commanded = self.column(command_column, &COMMAND_COLUMNS, ExtraColumn::Command)?;
        let filtered = self.column(kalman_column, &KALMAN_COLUMNS, ExtraColumn::Filtered)?;
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

    /// The run with an additional column: the requested one, which must exist, or the first common name that exists.
    fn column<'c>(
        &mut self,
        requested: Option<&'c str>,
        usual: &[&'c str],
        extra: fn(&'c str) -> ExtraColumn<'c>,
    ) -> Result<Option<DatasetRun>> {
        let known = self.set.descriptor.clone();
        let mut found = None;
        for column in requested.map_or_else(|| usual.to_vec(), |requested| vec![requested]) {
            let Some(text) = with_extra(self.text, self.run, extra(column))? else {
                break;
            };
            self.set.descriptor =
                Descriptor::from_toml(&text).with_context(|| format!("the descriptor with the column `{column}`"))?;
            let loaded = self.set.load(self.run, self.flags);
            match loaded {
                Ok(loaded) => found = Some(loaded.run),
                Err(error) if requested.is_some() => {
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

pub(super) fn run(prepared: &RecordedRuns, command: String) -> Result<Report> {
    let runs: Vec<&RunLog> = prepared.runs.iter().collect();
    let found = run_with_bar(&runs, "runs", |run| evaluate(run))?;
    Ok(report(&prepared.descriptor, command, &found))
}

fn evaluate(run: &RunLog) -> RunResult<'_> {
    let forecasts = forecast(&run.log, run.range_sigma_m);
    // The last output of their filter before the reading came.
    let before = |foreseen: &RangeForecast| {
        let earlier = run.foreign_filter.partition_point(|(at_s, _)| *at_s < foreseen.at_s);
        let last = earlier.checked_sub(1).and_then(|last| run.foreign_filter.get(last));
        last.map(|(_, distance_m)| *distance_m)
    };
    RunResult {
        run,
        readings: run.log.readings().count(),
        by_hand: fit_by_hand(&run.log, PIECE),
        fit: fit_steps(std::slice::from_ref(&run.log)),
        gate: gate_statistics(&forecasts),
        score_against_line: score_forecasts(&forecasts, |foreseen| foreseen.line_m),
        score_against_foreign: score_forecasts(&forecasts, before),
        forecasts,
    }
}

struct RunResult<'a> {
    run: &'a RunLog,
    readings: usize,
    by_hand: Result<ManualStepFit, WallStepError>,
    fit: Result<StepFit, WallStepError>,
    forecasts: Vec<RangeForecast>,
    gate: Option<GateStatistics>,
    /// Compared with the line through the last two readings.
    score_against_line: Option<ForecastScore>,
    score_against_foreign: Option<ForecastScore>,
}

fn report(descriptor: &str, command: String, found: &[RunResult<'_>]) -> Report {
    let mut report = Report::new("lab-wall", "The distance to a wall: a recording");
    report.background(
        "Nobody measured these cars. Drive and noise are found anew at each reading, from the readings before it alone; then the \
         reading is foretold and compared.",
    );
    report.command(command);
    add_steps(&mut report, found);
    add_scores(&mut report, found);
    for run in found {
        pictures::add(&mut report, &pictures::foreseen(&run.run.name, &run.forecasts, &run.run.foreign_filter));
    }
    report.data("recording", json!(descriptor));
    report.data("runs", found.iter().map(object).collect());
    report
}

const fn input_name(run: &RunResult<'_>) -> &'static str {
    if run.run.knows_input { "recorded" } else { "assumed" }
}

fn add_steps(report: &mut Report, found: &[RunResult<'_>]) {
    report.heading("Step: m/s and s under the input 1");
    report.paragraph("The input is 1 at PWM 80, or for the whole drive where nobody wrote it down.");
    let two = Format::new(Unit::None, 2);
    let steady = |run: &RunResult<'_>| run.fit.as_ref().ok().map(|fit| fit.steady_m_per_s);
    let rise = |run: &RunResult<'_>| run.fit.as_ref().ok().map(|fit| fit.rise_90_s);
    let table = Table::of(found)
        .text("", "run", |run| run.run.name.clone())
        .count("", "readings", |run| run.readings)
        .text("", "input", |run| input_name(run).to_owned())
        .number("", "v_ss by lines", two, |run| run.by_hand.as_ref().ok().map(|hand| hand.steady_m_per_s))
        .uncertain("", "v_ss by fit", two, move |run| Some(steady(run)?.value), move |run| Some(steady(run)?.sigma))
        .uncertain("", "t90 by fit", two, move |run| Some(rise(run)?.value), move |run| Some(rise(run)?.sigma));
    report.table("", &table);
}

fn add_scores(report: &mut Report, found: &[RunResult<'_>]) {
    report.heading("Each reading foretold from those before it, rms");
    report.paragraph(
        "Against a line through two readings, and against their own filter. Gate: its mean half-width, and how many readings it refused.",
    );
    let mm = Format::new(Unit::Millimetres, 1);
    let table = Table::of(found)
        .text("", "run", |run| run.run.name.clone())
        .optional_count("", "readings", |run| Some(run.score_against_line?.readings))
        .number("", "filter", mm, |run| Some(run.score_against_line?.kalman_rms_m))
        .number("", "line", mm, |run| Some(run.score_against_line?.other_rms_m))
        .number("", "gate", Format::new(Unit::Millimetres, 0), |run| Some(run.gate?.mean_m))
        .optional_count("", "refused", |run| Some(run.gate?.gated))
        .optional_count("", "theirs: readings", |run| Some(run.score_against_foreign?.readings))
        .number("", "filter", mm, |run| Some(run.score_against_foreign?.kalman_rms_m))
        .number("", "theirs", mm, |run| Some(run.score_against_foreign?.other_rms_m));
    report.table("", &table);
}

fn object(run: &RunResult<'_>) -> Value {
    let scored = |score: Option<ForecastScore>| {
        score.map(|score| {
            json!({
                "readings": score.readings,
                "filter_rms_m": score.kalman_rms_m,
                "other_rms_m": score.other_rms_m,
            })
        })
    };
    json!({
        "name": run.run.name,
        "readings": run.readings,
        "input": input_name(run),
        "fit": run.fit.as_ref().ok().map(|fit| json!({
            "steady_m_per_s": fit.steady_m_per_s.value,
            "steady_sigma_m_per_s": fit.steady_m_per_s.sigma,
            "rise_90_s": fit.rise_90_s.value,
            "rise_90_sigma_s": fit.rise_90_s.sigma,
        })),
        "no_fit": run.fit.as_ref().err().map(ToString::to_string),
        "no_hand": run.by_hand.as_ref().err().map(ToString::to_string),
        "gate": run.gate.map(|gate| json!({
            "readings": gate.readings,
            "refused": gate.gated,
            "mean_m": gate.mean_m,
        })),
        "against_line": scored(run.score_against_line),
        "against_theirs": scored(run.score_against_foreign),
        "foreseen": run.forecasts.iter().map(|foreseen| json!({
            "at_s": foreseen.at_s,
            "range_m": foreseen.range_m,
            "filter_m": foreseen.kalman_m,
            "line_m": foreseen.line_m,
            "gate_m": foreseen.gate_m,
            "refused": foreseen.is_gated,
            "steady_m_per_s": foreseen.plant.steady_m_per_s,
            "time_constant_s": foreseen.plant.time_constant_s,
            "process_m": foreseen.plant.noise.process_m,
            "range_sigma_m": foreseen.plant.noise.range_m,
        })).collect::<Vec<_>>(),
    })
}

// Columns of a recording's files that its descriptor does not name: the motor's PWM, and another program's filter.
//
// The descriptor's text gets two streams more, bound to the file of the run's range readings; everything else (units, stamps, bad
// rows) stays with the reader of recordings.

/// Sensor id of another program's filtered distance, unused in the bundled descriptors.
pub(super) const FOREIGN_FILTER: SensorId = SensorId(250);
/// Motor input per PWM: 80 is full drive, as in the paper.
const PER_PWM: f64 = 1.0 / 80.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ExtraColumn<'a> {
    Command(&'a str),
    Filtered(&'a str),
}

/// Adds a stream for a run to the descriptor's text; `None` if the run has no stream of ranges.
pub(super) fn with_extra(text: &str, run: &str, extra: ExtraColumn<'_>) -> Result<Option<String>> {
    let table: toml::Table = text.parse().context("reading the descriptor again")?;
    let streams = table.get("wall_range").and_then(toml::Value::as_array);
    let of_run = streams.into_iter().flatten().filter_map(toml::Value::as_table).find(|stream| is_in(stream, run));
    let Some(stream) = of_run else {
        return Ok(None);
    };
    let mut added = toml::Table::new();
    for (key, value) in [("file", stream.get("file")), ("stamp_shift_s", stream.get("stamp_shift_s"))] {
        if let Some(value) = value {
            added.insert(key.to_owned(), value.clone());
        }
    }
    added.insert("runs".to_owned(), vec![run].into());
    let key = match extra {
        ExtraColumn::Command(column) => {
            let column_entry = column_of(column, &[("scale", PER_PWM.into())]);
            added.insert("left".to_owned(), column_entry.clone());
            added.insert("right".to_owned(), column_entry);
            "body_velocity"
        }
        ExtraColumn::Filtered(column) => {
            let range = stream.get("range").and_then(toml::Value::as_table);
            let keep = ["unit", "scale"].map(|key| {
                let value = range.and_then(|range| range.get(key));
                value.map(|value| (key, value.clone()))
            });
            let keep: Vec<(&str, toml::Value)> = keep.into_iter().flatten().collect();
            added.insert("range".to_owned(), column_of(column, &keep));
            added.insert("sensor".to_owned(), i64::from(FOREIGN_FILTER.0).into());
            "wall_range"
        }
    };
    let mut more = toml::Table::new();
    more.insert(key.to_owned(), vec![added].into());
    Ok(Some(format!("{text}\n{more}")))
}

fn column_of(column: &str, more: &[(&str, toml::Value)]) -> toml::Value {
    let mut entry = toml::Table::new();
    entry.insert("column".to_owned(), column.into());
    for (key, value) in more {
        entry.insert((*key).to_owned(), value.clone());
    }
    entry.into()
}

fn is_in(stream: &toml::Table, run: &str) -> bool {
    let runs = stream.get("runs").and_then(toml::Value::as_array);
    runs.is_none_or(|runs| {
        let prefixes = runs.iter().filter_map(toml::Value::as_str);
        prefixes.into_iter().any(|prefix| run.starts_with(prefix))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = include_str!("../../../../config/recordings/tof-wall.toml");

    #[test]
    fn the_descriptor_still_reads_with_more_columns() {
        for extra in [ExtraColumn::Command("pwm"), ExtraColumn::Filtered("kf \"mm\"")] {
            let more = with_extra(TEXT, "robotC-20250325", extra).unwrap().unwrap();
            assert!(Descriptor::from_toml(&more).is_ok(), "{more}");
        }
        let other = TEXT.replace("wall_range]]", "compass]]");
        assert_eq!(with_extra(&other, "x", ExtraColumn::Command("pwm")).unwrap(), None);
    }
}
