//! `posebridge lab nxt-square`: the three filters of paper 1 on its square, what is left of their order, and its outlook.
//!
//! On simulated drives, on a file of exported sensor data, on recordings, or on a live robot. docs/lab/square.md is the page
//! for people.

mod drives;
mod json;
mod methods;
mod readings;
mod recorded;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_estimator::FilterConfig;
use posebridge_lab::square::{PaperInterpretation, SquareReport, compare_order, parse, write};
use posebridge_sim::montecarlo::Scenario;

use self::drives::{MethodSeries, all_errors, errors_of, filter_config, scenario, table};
use self::methods::{every_method, example, report};
use self::readings::{VARIATIONS, unchanged_table};
use super::again;
use super::recorded::RecordedArgs;
use crate::config::RobotProfile;
use crate::console::{print_line, progress_bar};
use crate::exit::{ExitStage, Failure};
use crate::tools::experiment_output::OutputArgs;

/// Flags of `lab nxt-square`.
#[derive(clap::Args, Clone, Debug)]
pub struct LabNxtSquareArgs {
    /// Drives to simulate.
    #[arg(long, value_name = "N", default_value_t = 100, conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Base seed; drive i draws from it and i.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real_robot")]
    pub seed: u64,
    /// Take exported sensor data (docs/lab/square.md has the columns) instead of simulated drives.
    #[arg(long, value_name = "FILE.csv", group = "real_robot", conflicts_with_all = ["judge", "settings"])]
    pub data: Option<PathBuf>,
    /// A real robot.
    #[command(flatten)]
    pub real: RecordedArgs,
    /// One of this number of camera images goes to the filters that use a camera; the others only score them.
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
    let mut report = of_data.transpose().before_start()?;
    let mut recordings: Vec<String> = Vec::new();
    if let Some(drives) = args.real.drives(&args.output, recorded::TASK)? {
        let found = recorded::report_of(&drives, args.camera_every as usize);
        report = Some(drives.with_exit_stage(found)?);
        recordings.extend(drives.names().into_iter().map(str::to_owned));
    }
    let folder = args.output.folder()?;
    let report = match report {
        Some(report) => report,
        None => simulated(args).while_running()?,
    };
    let mut tables = report.report();
    json::add(&mut tables, &report, &recordings);
    args.output.write_outcome(&folder, &tables)
}

fn simulated(args: &LabNxtSquareArgs) -> Result<SquareReport> {
    let scenario = scenario(args.seed)?;
    let camera_every = args.camera_every as usize;
    if let Some(path) = &args.export {
        export(path, &scenario, args.seed)?;
    }
    let mut series = vec![MethodSeries {
        base: filter_config(&scenario),
        scenario: scenario.clone(),
        methods: every_method(),
        adjust: unchanged_table,
    }];
    series.extend(VARIATIONS.iter().map(|variation| variation.series(&scenario)));
    let bar = progress_bar(u64::from(args.runs) * series.len() as u64, "drives")?;
    let mut errors = all_errors(&series, args.runs, camera_every, || bar.inc(1)).into_iter();
    bar.finish_and_clear();
    let runs = errors.next().unwrap_or_default();
    let readings = VARIATIONS.iter().zip(&series[1..]).zip(errors);
    let readings = readings.map(|((variation, series), runs)| {
        let names: Vec<&'static str> = series.methods.iter().map(|method| method.name).collect();
        PaperInterpretation {
            name: variation.name,
            note: variation.note,
            metric: variation.metric,
            order: compare_order(&names, &runs, variation.metric),
        }
    });
    let source = format!(
        "{} simulated drives of one lap, scenario paper-square, seed {}, 50 ms; all figures against the true pose",
        args.runs, args.seed
    );
    let command = again::rerun_command(None);
    let example = example(table(&scenario, 0), &filter_config(&scenario), camera_every);
    Ok(report(source, command, &runs, readings.collect(), example))
}

fn export(path: &Path, scenario: &Scenario, seed: u64) -> Result<()> {
    let remark = format!(
        "posebridge lab nxt-square, scenario paper-square, seed {seed}, first drive\nwheel radius 0.028 m, track width 0.112 m, one count is one degree"
    );
    std::fs::write(path, write(&table(scenario, 0), &remark))
        .with_context(|| format!("writing `{}`", path.display()))?;
    print_line(&format!("sensor data: {}", path.display()));
    Ok(())
}

fn of_data(args: &LabNxtSquareArgs, path: &Path) -> Result<SquareReport> {
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
    let command = again::rerun_command(None);
    let example = example(table, &base, camera_every);
    Ok(report(source, command, &runs, Vec::new(), example))
}

/// The configuration of the filters: the robot of a file, or the simulated one.
fn base_of(args: &LabNxtSquareArgs) -> Result<FilterConfig> {
    let config = filter_config(&scenario(args.seed)?);
    let Some(path) = &args.real.robot else {
        return Ok(config);
    };
    let robot = RobotProfile::read(path)?.robot;
    let of_file = || -> Result<FilterConfig> {
        Ok(FilterConfig {
            geometry: robot.geometry()?,
            noise: robot.noise()?,
            start: robot.start()?,
            calibration: robot.calibration()?,
            ..config
        })
    };
    of_file().with_context(|| format!("robot `{}`", path.display()))
}
