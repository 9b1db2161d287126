//! `posebridge lab nxt-square`: the three filters of paper 1 on its square, a test of their ranking, and its outlook.
//!
//! Input is simulated drives, a file of exported sensor data, recordings, or a live robot. docs/lab/square.md is the lesson.

mod drives;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_lab::square::{
    ErrorMetric, MeanAndVariance, Method, MethodOrder, MethodRanking, NoiseRecord, OrderStep, PaperInterpretation,
    PathErrors, SensorTable, SquareExample, SquareReport, compare_order, corrected_methods, extended, noise_at_stop,
    noise_on_straight, parse, prepare_config, printed_methods, swapped_methods, table_of, write,
};
use posebridge_report::report::Report;
use posebridge_sim::montecarlo::Scenario;
use serde_json::{Map, Value, json};

use self::drives::{MethodSeries, VARIATIONS, all_errors, errors_of, filter_config, scenario, table, unchanged_table};
use super::recorded::{RecordedArgs, RobotDrive, RobotDrives, rerun_command};
use crate::config::RobotProfile;
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_with_bar;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `lab nxt-square`.
#[derive(clap::Args, Clone, Debug)]
pub struct LabNxtSquareArgs {
    /// Number of simulated drives.
    #[arg(long, value_name = "N", default_value_t = 100, conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Base seed. Each drive uses the base seed and its own number.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real_robot")]
    pub seed: u64,
    /// Use exported sensor data instead of simulated drives (docs/lab/square.md lists the columns).
    #[arg(long, value_name = "FILE.csv", group = "real_robot", conflicts_with_all = ["judge", "settings"])]
    pub data: Option<PathBuf>,
    /// A real robot.
    #[command(flatten)]
    pub real: RecordedArgs,
    /// Give the filters every n-th camera image and score them on the others.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    pub camera_every: u32,
    /// Write the sensor data of the first simulated drive to this file.
    #[arg(long, value_name = "FILE.csv", conflicts_with = "real_robot")]
    pub export: Option<PathBuf>,
    /// Where the results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

pub fn execute(args: &LabNxtSquareArgs) -> Result<(), Failure> {
    // Data that cannot be used leave no folder behind.
    let of_data = args.data.as_ref().map(|path| of_data(args, path));
    let mut report = of_data.transpose().before_start()?;
    let mut recordings: Vec<String> = Vec::new();
    if let Some(drives) = args.real.drives(&args.output, TASK)? {
        let found = recorded_report(&drives, args.camera_every as usize);
        report = Some(drives.with_exit_stage(found)?);
        recordings.extend(drives.names().into_iter().map(str::to_owned));
    }
    let folder = args.output.folder()?;
    let report = match report {
        Some(report) => report,
        None => simulated(args).while_running()?,
    };
    let mut tables = report.report();
    add_json(&mut tables, &report, &recordings);
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
    let mut errors = all_errors(&series, args.runs, camera_every)?.into_iter();
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
    let command = rerun_command(None);
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
    let reference = if table.has_truth() {
        "the true pose in the file"
    } else if table.rows.iter().any(|row| row.camera.is_some()) {
        "those camera images that no filter was given"
    } else {
        "nothing: the file has neither camera nor truth, so there are paths and no errors"
    };
    let source = format!("{name}: {} rows; judged by {reference}", table.rows.len());
    let command = rerun_command(None);
    let example = example(table, &base, camera_every);
    Ok(report(source, command, &runs, Vec::new(), example))
}

/// The filter's configuration: the robot of a file, or the simulated one.
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

/// Each method once: the paper's chain, the corrected one, the outlook.
fn groups() -> [(&'static str, Vec<Method>); 4] {
    [
        ("the paper's matrices", printed_methods()),
        ("matrices that follow from the sensors", corrected_methods()),
        ("the paper's matrices, Q of v and w swapped", swapped_methods()),
        ("outlook", extended()),
    ]
}

/// The errors of all methods, in the order of [`groups`], by group.
fn rankings(runs: &[Vec<PathErrors>]) -> [MethodRanking; 4] {
    let mut from = 0;
    groups().map(|(matrices, methods)| {
        let own = from..from + methods.len();
        from = own.end;
        MethodRanking {
            matrices,
            names: methods.iter().map(|method| method.name).collect(),
            runs: runs.iter().filter_map(|run| Some(run.get(own.clone())?.to_vec())).collect(),
        }
    })
}

fn every_method() -> Vec<Method> {
    groups().into_iter().flat_map(|(_, methods)| methods).collect()
}

fn example(table: SensorTable, base: &FilterConfig, camera_every: usize) -> SquareExample {
    let config = prepare_config(&table, base);
    let paths = every_method().into_iter().map(|method| {
        let path = method.run(&table, &config, camera_every);
        (method.name, path)
    });
    SquareExample { paths: paths.collect(), table, config, camera_every }
}

fn report(
    source: String,
    command: String,
    runs: &[Vec<PathErrors>],
    readings: Vec<PaperInterpretation>,
    example: SquareExample,
) -> SquareReport {
    let [printed, corrected, swapped, extended] = rankings(runs);
    SquareReport {
        source,
        command,
        rankings: vec![printed, corrected, swapped],
        extended,
        interpretations: readings,
        stop: noise_at_stop(&example.table, example.geometry()),
        straight: noise_on_straight(&example.table, example.geometry()),
        example,
    }
}

const TASK: &str = "leave the robot standing for two seconds, then drive the square, and let it stand again";

/// Runs every method over every drive; the first one is plotted.
fn recorded_report(drives: &RobotDrives, camera_every: usize) -> Result<SquareReport> {
    let tables: Vec<(&RobotDrive, SensorTable)> =
        drives.drives.iter().map(|one| (one, table_of(&one.drive, &one.config.geometry))).collect();
    for (one, table) in &tables {
        ensure!(
            table.references(camera_every).iter().any(Option::is_some),
            "`{}`: no image is left as a reference, every one comes before or after the wheels: record with the camera from the \
             start, or drive a closed path and say `--judge start`",
            one.name
        );
    }
    let methods = every_method();
    let errors = |(one, table): &(&RobotDrive, SensorTable)| errors_of(table, &one.config, &methods, camera_every);
    let runs = run_with_bar(&tables, "drives", errors)?;
    let rows: Vec<String> = tables.iter().map(describe_drive).collect();
    let source = format!("{}; judged by {}", rows.join("; "), drives.reference_name());
    let first = tables.into_iter().next();
    let (one, table) = first.ok_or_else(|| anyhow::anyhow!("there is no recording"))?;
    let example = example(table, &one.config, camera_every);
    Ok(report(source, drives.command(), &runs, Vec::new(), example))
}

fn describe_drive((one, table): &(&RobotDrive, SensorTable)) -> String {
    let count = |has: fn(&posebridge_lab::square::SensorRow) -> bool| table.rows.iter().filter(|row| has(row)).count();
    format!(
        "{}: {} rows, {} with gyro, {} with accelerometers, {} with an image",
        one.name,
        table.rows.len(),
        count(|row| row.gyro_deg_per_s.is_some()),
        count(|row| row.accelerations_m_per_s2.is_some()),
        count(|row| row.camera.is_some()),
    )
}

/// Adds the JSON data; `recordings` are the files of a real robot's drives.
fn add_json(report: &mut Report, found: &SquareReport, recordings: &[String]) {
    let readings = found.interpretations.iter().map(|reading| {
        json!({
            "name": reading.name,
            "metric": reading.metric.name(),
            "order": order(&reading.order),
        })
    });
    report.data("source", json!(found.source));
    report.data("recordings", json!(recordings));
    report.data("settings", found.rankings.iter().map(chain).collect());
    report.data("outlook", chain(&found.extended));
    report.data("readings", readings.collect());
    report.data("stop", json!(found.stop.as_ref().map(record)));
    report.data("straight", json!(found.straight.as_ref().map(record)));
}

fn chain(chain: &MethodRanking) -> Value {
    let methods = chain.names.iter().enumerate().map(|(index, name)| {
        let runs = chain.runs.iter().filter_map(|run| run.get(index));
        let runs: Value = runs.map(|errors| Value::Object(by_metric(|metric| errors.value(metric)))).collect();
        let mut method = by_metric(|metric| chain.rms(index, metric));
        method.extend([
            ("name".to_owned(), json!(name)),
            ("diverged".to_owned(), json!(chain.diverged(index))),
            ("runs".to_owned(), runs),
        ]);
        method
    });
    json!({
        "setting": chain.matrices,
        "methods": methods.collect::<Vec<_>>(),
        "order": order(&chain.order(ErrorMetric::Position)),
    })
}

fn by_metric(value: impl Fn(ErrorMetric) -> Option<f64>) -> Map<String, Value> {
    ErrorMetric::KEYS.map(|(key, metric)| (key.to_owned(), json!(value(metric)))).into_iter().collect()
}

fn order(order: &MethodOrder) -> Value {
    let step = |step: &OrderStep| {
        json!({
            "worse": step.worse,
            "better": step.better,
            "holds": step.holds,
            "drives": step.drives,
            "sign_test_p": step.sign_p,
            "ratio": step.ratio.map(|ratio| ratio[0]),
            "ratio_interval": step.ratio.map(|ratio| [ratio[1], ratio[2]]),
            "verdict": step.as_text(),
        })
    };
    json!({
        "steps": order.steps.iter().map(step).collect::<Vec<_>>(),
        "holds_on_average": order.holds_on_average(),
        "all_hold": order.all_hold,
        "drives": order.drives,
        "left_out": order.excluded,
    })
}

fn record(record: &NoiseRecord) -> Value {
    let variance = |spread: &Option<MeanAndVariance>| spread.map(|spread| spread.variance);
    let both = |spreads: &Option<[MeanAndVariance; 2]>| spreads.map(|both| both.map(|spread| spread.variance));
    json!({
        "from_row": record.from,
        "rows": record.rows,
        "counters_deg2": both(&record.counters),
        "forward_cm2_per_s2": variance(&record.forward),
        "turn_deg2_per_s2": variance(&record.turn),
        "wheel_heading_deg2": variance(&record.wheel_heading),
        "gyro_mean_deg_per_s": record.gyro.map(|spread| spread.mean),
        "gyro_deg2_per_s2": variance(&record.gyro),
        "gyro_heading_deg2": variance(&record.gyro_heading),
        "accelerometers_m2_per_s4": both(&record.accelerometers),
        "camera_cm2": both(&record.camera),
    })
}
