//! The experiment on a recording: each run's step, and the predictions of its readings.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_lab::wall::{
    ForecastScore, GateStatistics, RangeForecast, SingleStep, StepCommand, WallEntry, WallLog, WallReading,
    WallStepError, find_step, forecast, gate_statistics, score_against_best_line, score_forecasts,
};
use posebridge_recording::dataset::{DatasetRun, Descriptor};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_telemetry::{Observation, ObservationKind, SensorId};
use serde_json::{Value, json};

use super::extra_columns::{ExtraColumn, FOREIGN_FILTER, columns_of_run, with_extra};
use super::motor_column::{MotorColumn, find_motor_column};
use super::pictures;
use super::table::read_table;
use crate::config::{Overlay, Setting};
use crate::flags::DataFlags;
use crate::lab::parallel::run_with_bar;
use crate::text_file::read_text;
use crate::tools::dataset::{DataSet, report_bad_rows};
use crate::tools::own_recording;

/// Noise of a reading that a table does not tell: a small time-of-flight sensor, or an ultrasonic one that counts centimetres.
const TABLE_SIGMA_M: f64 = 0.01;
/// Common names of a column with another filter's distance.
const KALMAN_COLUMNS: [&str; 4] = ["kf_mm", "kf", "kalman_mm", "kalman"];

pub(in crate::lab) struct RecordedRuns {
    pub(super) descriptor: String,
    pub(in crate::lab) runs: Vec<RunLog>,
}

pub(in crate::lab) struct RunLog {
    pub(in crate::lab) name: String,
    pub(in crate::lab) log: WallLog,
    pub(in crate::lab) input: RunInput,
    /// Time and distance of another program's filter, in order.
    foreign_filter: Vec<(f64, f64)>,
    range_sigma_m: f64,
}

/// The motor input of a run.
pub(in crate::lab) struct RunInput {
    pub(in crate::lab) command: StepCommand,
    /// Where it comes from, or why it is unknown.
    pub(in crate::lab) note: String,
}

impl RunInput {
    fn unknown(why: &str) -> Self {
        let note = format!("{why}: the car is taken to be driven fully, from an instant that the readings show");
        Self { command: StepCommand::Unknown, note }
    }
}

/// The log of readings and of inputs as they were recorded. The input 1 is the largest one.
fn log_with_input(
    ranges: &[WallEntry],
    recorded: &[WallEntry],
    column: Option<&MotorColumn>,
    columns: &[String],
) -> (WallLog, RunInput) {
    let values = || {
        recorded.iter().filter_map(|entry| match entry.reading {
            WallReading::Input(input) => Some(input),
            WallReading::Range(_) => None,
        })
    };
    let most = values().map(f64::abs).fold(0.0, f64::max);
    let assumed = |why: &str| (WallLog::new(ranges.to_vec()).with_assumed_drive(), RunInput::unknown(why));
    let Some(column) = column else {
        if columns.is_empty() {
            return assumed("the recording holds no motor input");
        }
        return assumed(&format!(
            "no column has a usual name of a motor's input (--command-column names one); there are: {}",
            columns.join(", ")
        ));
    };
    if most <= 0.0 {
        return assumed(&format!("the motor column {} is 0 throughout", column.describe()));
    }
    let first = values().next();
    let scaled = recorded.iter().map(|entry| match entry.reading {
        WallReading::Input(input) => WallEntry { reading: WallReading::Input(input / most), ..*entry },
        WallReading::Range(_) => *entry,
    });
    let log = WallLog::new(ranges.iter().copied().chain(scaled).collect());
    let note = format!("motor input by {}; the input 1 is {most}", column.describe());
    if values().all(|value| Some(value) == first) {
        let note = format!("{note}; it never changes, so that the readings show when the car began to drive");
        return (log, RunInput { command: StepCommand::Unknown, note });
    }
    (log, RunInput { command: StepCommand::Recorded, note })
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
    /// Column of the motors' input in the files of the recording. Default: one with a usual name: pwm, motor, speed, u,
    /// command, throttle, duty, power, or one for each side such as left_pwm and right_pwm.
    #[arg(long, value_name = "COLUMN", requires = "recording")]
    pub command_column: Option<String>,
}

/// Reads the selected runs of a descriptor, or a posebridge recording, which is one run. `kalman_column` is that of another program's
/// filter; `None` for a common name.
pub(in crate::lab) fn prepare(path: &Path, choice: &RunSelection, kalman_column: Option<&str>) -> Result<RecordedRuns> {
    if path.extension().is_some_and(|extension| extension == "csv" || extension == "txt") {
        ensure!(
            choice.run.is_none() && kalman_column.is_none() && choice.settings.is_empty(),
            "--run, --set and --kalman-column belong to a descriptor; `{}` is a table",
            path.display()
        );
        let table = read_table(path, choice.command_column.as_deref())?;
        let (log, input) = log_with_input(&table.ranges, &table.inputs, table.motor.as_ref(), &table.columns);
        let name = path.display().to_string();
        let run = RunLog { name: name.clone(), input, log, foreign_filter: Vec::new(), range_sigma_m: TABLE_SIGMA_M };
        return Ok(RecordedRuns { descriptor: name, runs: vec![run] });
    }
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
    let text = read_text(path).with_context(|| format!("reading the descriptor `{}`", path.display()))?;
    let root = choice.data.clone().unwrap_or_else(|| path.parent().unwrap_or(Path::new("")).to_owned());
    let mut runs = Vec::new();
    for name in set.runs.clone() {
        let mut reader = RunReader { set: &mut set, flags: &flags, text: &text, root: &root, run: &name };
        runs.push(reader.read(choice.command_column.as_deref(), kalman_column)?);
    }
    Ok(RecordedRuns { descriptor: path.display().to_string(), runs })
}

/// A posebridge recording has ranges but no motor commands: full drive is assumed.
fn prepare_own(path: &Path, settings: &[Setting]) -> Result<RecordedRuns> {
    let overlay = Overlay { robot: None, settings };
    let run = own_recording::read(path, overlay)?;
    let ranges = readings_of(run.observations.iter().copied(), |_, observed| range_m(observed).map(WallReading::Range));
    ensure!(
        !ranges.is_empty(),
        "`{}` holds no range to a wall: let the robot send DISTANCE_SENSOR and record it again",
        run.name
    );
    let (log, input) = log_with_input(&ranges, &[], None, &[]);
    Ok(RecordedRuns {
        descriptor: run.name.clone(),
        runs: vec![RunLog {
            name: run.name,
            input,
            log,
            foreign_filter: Vec::new(),
            range_sigma_m: run.config.noise.wall_range_m,
        }],
    })
}

struct RunReader<'a> {
    set: &'a mut DataSet,
    flags: &'a DataFlags,
    text: &'a str,
    root: &'a Path,
    run: &'a str,
}

impl RunReader<'_> {
    fn read(&mut self, command_column: Option<&str>, kalman_column: Option<&str>) -> Result<RunLog> {
        let plain = self.set.load(self.run, self.flags)?;
        report_bad_rows(&plain);
        let columns = columns_of_run(self.text, self.run, self.root).unwrap_or_default();
        let motor = match command_column {
            Some(column) => Some(MotorColumn::one(column)),
            None => find_motor_column(&columns.names, &columns.used_names()),
        };
        let commanded = match &motor {
            Some(motor) if command_column.is_some() => self.with_column(ExtraColumn::Command(motor))?,
            Some(motor) => self.with_column(ExtraColumn::Command(motor)).unwrap_or_default(),
            None => None,
        };
        let motor = motor.filter(|_| commanded.is_some());
        let filtered = self.filtered_column(kalman_column)?;
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
        let (log, input) = log_with_input(&ranges, &inputs, motor.as_ref(), &columns.names);
        Ok(RunLog {
            name: self.run.to_owned(),
            input,
            log,
            foreign_filter: theirs,
            range_sigma_m: plain.filter_config.noise.wall_range_m,
        })
    }

    /// The run with another program's distance: the requested column, which must exist, or the first common name that exists.
    fn filtered_column(&mut self, requested: Option<&str>) -> Result<Option<DatasetRun>> {
        if let Some(column) = requested {
            return self.with_column(ExtraColumn::Filtered(column));
        }
        let found =
            KALMAN_COLUMNS.iter().find_map(|column| self.with_column(ExtraColumn::Filtered(column)).ok().flatten());
        Ok(found)
    }

    /// The run with an additional column; `None` if it has no stream of ranges.
    fn with_column(&mut self, extra: ExtraColumn<'_>) -> Result<Option<DatasetRun>> {
        let Some(text) = with_extra(self.text, self.run, extra)? else {
            return Ok(None);
        };
        let with_column = Descriptor::from_toml(&text).context("the descriptor with one column more")?;
        let known = std::mem::replace(&mut self.set.descriptor, with_column);
        let loaded = self.set.load(self.run, self.flags);
        self.set.descriptor = known;
        Ok(Some(loaded?.run))
    }
}

fn range_m(observed: &ObservationKind) -> Option<f64> {
    let ObservationKind::WallRange(range) = observed else {
        return None;
    };
    Some(range.0)
}

fn of_run(run: &DatasetRun) -> impl Iterator<Item = Observation> {
    run.observations.iter().map(|timed| timed.observation)
}

fn readings_of(
    observations: impl Iterator<Item = Observation>,
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
        step: find_step(&run.log, run.input.command),
        gate: gate_statistics(&forecasts),
        predicted_share: predicted_share(&run.log),
        score_against_line: score_forecasts(&forecasts, |foreseen| foreseen.lines_m[0]),
        score_against_best_line: score_against_best_line(&forecasts),
        score_against_foreign: score_forecasts(&forecasts, before),
        forecasts,
    }
}

/// `None` without a recorded loop that is faster than the sensor.
fn predicted_share(log: &WallLog) -> Option<f64> {
    let (steps, readings) = (log.inputs().count(), log.readings().count());
    (steps > readings).then(|| 1.0 - readings as f64 / steps as f64)
}

struct RunResult<'a> {
    run: &'a RunLog,
    readings: usize,
    step: Result<SingleStep, WallStepError>,
    forecasts: Vec<RangeForecast>,
    gate: Option<GateStatistics>,
    /// Of the steps of a recorded control loop.
    predicted_share: Option<f64>,
    /// Compared with the line through the last two readings.
    score_against_line: Option<ForecastScore>,
    /// The line of most use in hindsight: its number of readings.
    score_against_best_line: Option<(usize, ForecastScore)>,
    score_against_foreign: Option<ForecastScore>,
}

fn report(descriptor: &str, command: String, found: &[RunResult<'_>]) -> Report {
    let mut report = Report::new("lab-wall", "The distance to a wall: a recording");
    report.background(
        "Nobody measured these cars. A bank of filters learns drive and noise from the readings so far; it predicts the next one, \
         which is then compared.",
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
    match run.run.input.command {
        StepCommand::Recorded => "recorded",
        StepCommand::Unknown => "assumed",
    }
}

fn add_steps(report: &mut Report, found: &[RunResult<'_>]) {
    report.heading("The step of each run");
    let two = Format::new(Unit::None, 2);
    let step = |run: &RunResult<'_>| run.step.as_ref().ok().cloned();
    let by_hand = move |run: &RunResult<'_>| step(run)?.by_hand.ok();
    let table = Table::of(found)
        .text("", "run", |run| run.run.name.clone())
        .count("", "readings", |run| run.readings)
        .text("", "input", |run| input_name(run).to_owned())
        .number("", "v differences", two, move |run| Some(by_hand(run)?.steady_by_difference_m_per_s))
        .number("", "lines", two, move |run| Some(by_hand(run)?.steady_m_per_s))
        .uncertain(
            "",
            "v_ss by fit",
            two,
            move |run| Some(step(run)?.steady_m_per_s?.value),
            move |run| Some(step(run)?.steady_m_per_s?.sigma),
        )
        .uncertain(
            "",
            "t90",
            two,
            move |run| Some(step(run)?.rise_90_s?.value),
            move |run| Some(step(run)?.rise_90_s?.sigma),
        );
    report.table("", &table);
    report.list(found.iter().map(|run| format!("{}: {}", run.run.name, run.run.input.note)));
    report.list(found.iter().filter_map(|run| {
        let reason = match &run.step {
            Ok(step) => step.undetermined?.to_string(),
            Err(error) => error.to_string(),
        };
        Some(format!("{}: {reason}", run.run.name))
    }));
}

fn add_scores(report: &mut Report, found: &[RunResult<'_>]) {
    report.heading("Each reading predicted from those before it, rms");
    report.paragraph(
        "By the filter, which learns drive and noise on the way, and by the line through the last two readings. Best line: the one \
         through 2, 3 or 5 readings that was best on this run, which nobody knows before. As good: the squared errors differ by less \
         than two sigmas. Gate: its mean half-width.",
    );
    let mm = Format::new(Unit::Millimetres, 1);
    let table = Table::of(found)
        .text("", "run", |run| run.run.name.clone())
        .optional_count("", "n", |run| Some(run.score_against_line?.readings))
        .number("", "filter", mm, |run| Some(run.score_against_line?.kalman_rms_m))
        .number("", "line", mm, |run| Some(run.score_against_line?.other_rms_m))
        .text("", "best line", |run| {
            run.score_against_best_line
                .map_or_else(String::new, |(count, score)| format!("{:.1} ({count})", 1e3 * score.other_rms_m))
        })
        .text("", "it is", |run| {
            run.score_against_best_line.map_or_else(String::new, |(_, score)| score.verdict.name().to_owned())
        })
        .number("", "gate", Format::new(Unit::Millimetres, 0), |run| Some(run.gate?.mean_m))
        .optional_count("", "refused", |run| Some(run.gate?.gated));
    report.table("", &table);
    let theirs: Vec<&RunResult<'_>> = found.iter().filter(|run| run.score_against_foreign.is_some()).collect();
    if !theirs.is_empty() {
        report.paragraph("Against the filter that the car's owner recorded:");
        let table = Table::of(&theirs)
            .text("", "run", |run| run.run.name.clone())
            .optional_count("", "n", |run| Some(run.score_against_foreign?.readings))
            .number("", "filter", mm, |run| Some(run.score_against_foreign?.kalman_rms_m))
            .number("", "theirs", mm, |run| Some(run.score_against_foreign?.other_rms_m));
        report.table("", &table);
    }
    report.heading("Prediction alone");
    report.paragraph(
        "Share of the steps of the control loop that have no reading: there the filter predicts. The paper has 77 %.",
    );
    let shares: Vec<&RunResult<'_>> = found.iter().filter(|run| run.predicted_share.is_some()).collect();
    let table = Table::of(&shares).text("", "run", |run| run.run.name.clone()).number(
        "",
        "predicted",
        Format::new(Unit::Percent, 0),
        |run| run.predicted_share,
    );
    report.table("", &table);
}

fn object(run: &RunResult<'_>) -> Value {
    let scored = |score: Option<ForecastScore>| {
        score.map(|score| {
            json!({
                "readings": score.readings,
                "filter_rms_m": score.kalman_rms_m,
                "other_rms_m": score.other_rms_m,
                "verdict": score.verdict.name(),
            })
        })
    };
    json!({
        "name": run.run.name,
        "readings": run.readings,
        "input": input_name(run),
        "input_note": run.run.input.note,
        "fit": run.step.as_ref().ok().map(|step| json!({
            "steady_m_per_s": step.steady_m_per_s.map(|known| known.value),
            "steady_sigma_m_per_s": step.steady_m_per_s.map(|known| known.sigma),
            "rise_90_s": step.rise_90_s.map(|known| known.value),
            "rise_90_sigma_s": step.rise_90_s.map(|known| known.sigma),
            "undetermined": step.undetermined.map(|reason| reason.to_string()),
        })),
        "no_fit": run.step.as_ref().err().map(ToString::to_string),
        "predicted_share": run.predicted_share,
        "gate": run.gate.map(|gate| json!({
            "readings": gate.readings,
            "refused": gate.gated,
            "mean_m": gate.mean_m,
        })),
        "against_line": scored(run.score_against_line),
        "against_best_line": scored(run.score_against_best_line.map(|(_, score)| score)),
        "best_line_readings": run.score_against_best_line.map(|(count, _)| count),
        "against_theirs": scored(run.score_against_foreign),
        "foreseen": run.forecasts.iter().map(|foreseen| json!({
            "at_s": foreseen.at_s,
            "range_m": foreseen.range_m,
            "filter_m": foreseen.kalman_m,
            "towards_m_per_s": foreseen.towards_m_per_s,
            "input": foreseen.input,
            "line_m": foreseen.lines_m[0],
            "gate_m": foreseen.gate_m,
            "refused": foreseen.is_gated,
            "steady_m_per_s": foreseen.drive.map(|(steady, _)| steady),
            "time_constant_s": foreseen.drive.map(|(_, time_constant_s)| time_constant_s),
        })).collect::<Vec<_>>(),
    })
}
