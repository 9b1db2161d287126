//! `posebridge lab nxt-square`: the three filters of paper 1 on its square, what is left of their order, and its outlook.
//!
//! On simulated drives, on a file of exported sensor data, on recordings, or on a live robot. docs/lab/nxt-square.md is the page
//! for people.

mod drives;
mod json;
mod readings;
mod recorded;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_analysis::square::{
    Chain, Errors, Example, Method, Reading, Report, SensorTable, corrected, order, outlook, parse, prepared, printed,
    stop, straight, swapped, write,
};
use posebridge_estimator::FilterConfig;
use posebridge_sim::montecarlo::Scenario;

use self::drives::{Series, all_errors, errors_of, scenario, table, told};
use self::readings::{VARIATIONS, untouched};
use super::again;
use super::outcome::{Outcome, OutputArgs};
use super::recorded::RecordedArgs;
use crate::commands::{Failure, Stage};
use crate::config::RobotProfile;
use crate::progress;
use crate::stderr::say;

/// Flags of `lab nxt-square`.
#[derive(clap::Args, Clone, Debug)]
pub struct LabNxtSquareArgs {
    /// Drives to simulate.
    #[arg(long, value_name = "N", default_value_t = 100, conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Base seed; drive i draws from it and i.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real_robot")]
    pub seed: u64,
    /// Take exported sensor data (docs/lab/nxt-square.md has the columns) instead of simulated drives.
    #[arg(long, value_name = "FILE.csv", group = "real_robot", conflicts_with_all = ["judge", "settings"])]
    pub data: Option<PathBuf>,
    /// A real robot.
    #[command(flatten)]
    pub real: RecordedArgs,
    /// Of so many camera images one is given to the filters that use a camera; the others only judge.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    pub camera_every: u32,
    /// Write the sensor data of the first simulated drive to this file.
    #[arg(long, value_name = "FILE.csv", conflicts_with = "real_robot")]
    pub export: Option<PathBuf>,
    /// Where the results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Runs the experiment.
///
/// # Errors
/// The data, the robot, a recording or the folder cannot be read or made; or the results cannot be written.
pub fn execute(args: &LabNxtSquareArgs) -> Result<(), Failure> {
    // Data that cannot be used leave no folder behind.
    let of_data = args.data.as_ref().map(|path| of_data(args, path));
    let mut report = of_data.transpose().at_start()?;
    let mut recordings: Vec<String> = Vec::new();
    if let Some(drives) = args.real.drives(&args.output, recorded::TASK)? {
        let found = recorded::report_of(&drives, args.camera_every as usize);
        report = Some(drives.staged(found)?);
        recordings.extend(drives.names().into_iter().map(str::to_owned));
    }
    let folder = args.output.folder()?;
    let report = match report {
        Some(report) => report,
        None => simulated(args).while_running()?,
    };
    let outcome = Outcome {
        name: "lab-nxt-square",
        page: report.page(),
        text: report.text(),
        json: json::object(&report, &recordings),
    };
    args.output.deliver(&folder, &outcome)
}

/// Every method once: the paper's chain, the corrected one, the outlook.
fn groups() -> [(&'static str, Vec<Method>); 4] {
    [
        ("the paper's matrices", printed()),
        ("matrices that follow from the sensors", corrected()),
        ("the paper's matrices, Q of v and w swapped", swapped()),
        ("outlook", outlook()),
    ]
}

/// Cuts the errors of all methods, in the order of [`groups`], into chains.
fn chains(runs: &[Vec<Errors>]) -> (Vec<Chain>, Chain) {
    let mut from = 0;
    let mut all: Vec<Chain> = Vec::new();
    for (setting, methods) in groups() {
        let to = from + methods.len();
        let runs = runs.iter().filter_map(|run| Some(run.get(from..to)?.to_vec()));
        all.push(Chain { setting, names: methods.iter().map(|method| method.name).collect(), runs: runs.collect() });
        from = to;
    }
    let outlook = all.pop().unwrap_or(Chain { setting: "outlook", names: Vec::new(), runs: Vec::new() });
    (all, outlook)
}

fn every_method() -> Vec<Method> {
    groups().into_iter().flat_map(|(_, methods)| methods).collect()
}

fn example(table: SensorTable, base: &FilterConfig, camera_every: usize) -> Example {
    let config = prepared(&table, base);
    let paths = every_method().into_iter().map(|method| {
        let path = method.follow(&table, &config, camera_every);
        (method.name, path)
    });
    Example { paths: paths.collect(), table, config, camera_every }
}

fn report(source: String, command: String, runs: &[Vec<Errors>], readings: Vec<Reading>, example: Example) -> Report {
    let (chains, outlook) = chains(runs);
    Report {
        source,
        command,
        chains,
        outlook,
        readings,
        stop: stop(&example.table, example.geometry()),
        straight: straight(&example.table, example.geometry()),
        example,
    }
}

fn simulated(args: &LabNxtSquareArgs) -> Result<Report> {
    let scenario = scenario(args.seed)?;
    let camera_every = args.camera_every as usize;
    if let Some(path) = &args.export {
        export(path, &scenario, args.seed)?;
    }
    let mut series =
        vec![Series { base: told(&scenario), scenario: scenario.clone(), methods: every_method(), adjust: untouched }];
    series.extend(VARIATIONS.iter().map(|variation| variation.series(&scenario)));
    let bar = progress::bar(u64::from(args.runs) * series.len() as u64, "drives")?;
    let mut errors = all_errors(&series, args.runs, camera_every, || bar.inc(1)).into_iter();
    bar.finish_and_clear();
    let runs = errors.next().unwrap_or_default();
    let readings = VARIATIONS.iter().zip(&series[1..]).zip(errors);
    let readings = readings.map(|((variation, series), runs)| {
        let names: Vec<&'static str> = series.methods.iter().map(|method| method.name).collect();
        Reading {
            name: variation.name,
            note: variation.note,
            metric: variation.metric,
            order: order(&names, &runs, variation.metric),
        }
    });
    let source = format!(
        "{} simulated drives of one lap, scenario paper-square, seed {}, 50 ms; all figures against the true pose",
        args.runs, args.seed
    );
    let command = again::command(None);
    let example = example(table(&scenario, 0), &told(&scenario), camera_every);
    Ok(report(source, command, &runs, readings.collect(), example))
}

fn export(path: &Path, scenario: &Scenario, seed: u64) -> Result<()> {
    let remark = format!(
        "posebridge lab nxt-square, scenario paper-square, seed {seed}, first drive\nwheel radius 0.028 m, track width 0.112 m, one count is one degree"
    );
    std::fs::write(path, write(&table(scenario, 0), &remark))
        .with_context(|| format!("writing `{}`", path.display()))?;
    say(&format!("sensor data: {}", path.display()));
    Ok(())
}

fn of_data(args: &LabNxtSquareArgs, path: &Path) -> Result<Report> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(|| format!("reading the sensor data `{name}`"))?;
    let table = parse(&text).with_context(|| format!("sensor data `{name}`"))?;
    let base = base_of(args)?;
    let camera_every = args.camera_every as usize;
    let runs = [errors_of(&table, &base, &every_method(), camera_every)];
    let judge = if table.has_truth() {
        "the true pose in the file"
    } else if table.rows.iter().any(|row| row.camera.is_some()) {
        "those camera images that no filter was given"
    } else {
        "nothing: the file has neither camera nor truth, so there are paths and no errors"
    };
    let source = format!("{name}: {} rows; judged by {judge}", table.rows.len());
    let command = again::command(None);
    let example = example(table, &base, camera_every);
    Ok(report(source, command, &runs, Vec::new(), example))
}

/// What the filters are told: the robot of a file, or the simulated one.
fn base_of(args: &LabNxtSquareArgs) -> Result<FilterConfig> {
    let told = told(&scenario(args.seed)?);
    let Some(path) = &args.real.robot else {
        return Ok(told);
    };
    let robot = RobotProfile::read(path)?.robot;
    let of_file = || -> Result<FilterConfig> {
        Ok(FilterConfig {
            geometry: robot.geometry()?,
            noise: robot.noise()?,
            start: robot.start()?,
            calibration: robot.calibration()?,
            ..told
        })
    };
    of_file().with_context(|| format!("robot `{}`", path.display()))
}
