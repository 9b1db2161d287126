//! `posebridge lab nxt-square`: the three filters of paper 1 on its square, a test of their ranking, and its outlook.
//!
//! Input is simulated drives, a file of exported sensor data, recordings, or a live robot. docs/lab/square.md is the lesson.

mod drives;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::numerics::statistics::wilson_interval_95;
use posebridge_lab::square::{
    ChainMatrices, ErrorMetric, MeanAndVariance, Method, MethodGroup, MethodOrder, MethodRanking, NoiseRecord,
    OrderStep, PaperInterpretation, PathErrors, SensorTable, SquareExample, SquareReport, chains, compare_order,
    noise_at_stop, noise_on_straight, outlook, parse, prepare_config, table_of, write,
};
use posebridge_report::report::Report;
use posebridge_sim::montecarlo::Scenario;
use serde_json::{Map, Value, json};

use self::drives::{
    MethodSeries, VARIATIONS, all_errors, errors_of, filter_config, recoveries, scenario, table, unchanged_table,
};
use super::recorded::{RecordedArgs, RobotDrive, RobotDrives, rerun_command};
use crate::config::RobotProfile;
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_with_bar;
use crate::text_file::read_text;
use crate::tools::experiment_output::OutputArgs;

/// Drives whose innovations tune the matrices.
const TUNING_DRIVES: u32 = 4;
/// Distance of their seed from that of the drives that are compared: no user's next seed.
const TUNING_SEED: u64 = 1_000_003;

/// Flags of `lab nxt-square`.
#[derive(clap::Args, Clone, Debug)]
#[command(group = clap::ArgGroup::new("real_robot").multiple(true))]
pub struct LabNxtSquareArgs {
    /// Number of simulated drives.
    #[arg(long, value_name = "N", default_value_t = 100, conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Base seed. Each drive uses the base seed and its own number.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real_robot")]
    pub seed: u64,
    /// Use the text file of a brick, or an exported one, instead of simulated drives (docs/lab/square.md lists the columns). With the
    /// descriptor of a foreign recording (--recording FILE.toml): the folder of its files. Default of that: POSEBRIDGE_DATA, or else
    /// the descriptor's folder.
    #[arg(long, value_name = "FILE.csv", group = "real_robot", conflicts_with = "live_robot")]
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
    let is_text = args.real.recordings.is_empty();
    let of_data = args.data.as_ref().filter(|_| is_text).map(|path| of_data(args, path));
    let mut report = of_data.transpose().before_start()?;
    let mut recordings: Vec<String> = Vec::new();
    if let Some(drives) = args.real.drives(&args.output, TASK, args.data.as_deref())? {
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
    // The drives that are compared have the seed of the command, those that tune have others.
    let others = scenario.clone().with_seed(args.seed.wrapping_add(TUNING_SEED));
    let tuning: Vec<SensorTable> = (0..TUNING_DRIVES).map(|run| table(&others, run)).collect();
    let found = Comparisons::tuned_on(
        &tuning,
        &filter_config(&others),
        &format!("{TUNING_DRIVES} other drives, without their truth"),
    );
    let mut series = vec![MethodSeries {
        base: filter_config(&scenario),
        scenario: scenario.clone(),
        methods: found.methods.clone(),
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
    let example = found.example(table(&scenario, 0), &filter_config(&scenario), camera_every);
    let recoveries = recoveries(&scenario, args.runs, camera_every)?;
    Ok(SquareReport { recoveries, ..found.report(source, command, &runs, readings.collect(), example) })
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
    ensure!(
        args.real.judge.is_none() && args.real.settings.is_empty(),
        "--judge and --set belong to recordings; `{name}` is a text file: --robot says its robot, and its first row its start"
    );
    let text = read_text(path).with_context(|| format!("reading the sensor data `{name}`"))?;
    let table = parse(&text).with_context(|| format!("sensor data `{name}`"))?;
    let base = base_of(args)?;
    let camera_every = args.camera_every as usize;
    let found = Comparisons::tuned_on(std::slice::from_ref(&table), &base, "this drive itself, without its truth");
    let runs = [errors_of(&table, &base, &found.methods, camera_every)];
    let reference = if table.has_truth() {
        "the true pose in the file"
    } else if table.rows.iter().any(|row| row.camera.is_some()) {
        "those camera images that no filter was given"
    } else {
        "nothing: the file has neither camera nor truth, so there are paths and no errors"
    };
    let source = format!("{name}: {} rows; judged by {reference}", table.rows.len());
    let command = rerun_command(None);
    let example = found.example(table, &base, camera_every);
    Ok(found.report(source, command, &runs, Vec::new(), example))
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

/// Every comparison, and each of its methods once.
struct Comparisons {
    tuned: ChainMatrices,
    tuned_from: String,
    chains: Vec<MethodGroup>,
    outlook: MethodGroup,
    methods: Vec<Method>,
}

impl Comparisons {
    /// With the matrices that are most likely on these drives, which `source` names.
    fn tuned_on(tables: &[SensorTable], base: &FilterConfig, source: &str) -> Self {
        let tuned = ChainMatrices::most_likely(tables, base);
        let (chains, outlook) = (chains(&tuned), outlook());
        let mut methods: Vec<Method> = Vec::new();
        for method in chains.iter().chain([&outlook]).flat_map(|group| &group.methods) {
            if methods.iter().all(|known| known.name != method.name) {
                methods.push(*method);
            }
        }
        let tuned_from =
            format!("Tuned: the matrices that are most likely by the innovations of the filters on {source}.");
        Self { tuned, tuned_from, chains, outlook, methods }
    }

    /// The errors of a group's methods, of those of all.
    fn ranking(&self, group: &MethodGroup, runs: &[Vec<PathErrors>]) -> MethodRanking {
        let names: Vec<&'static str> = group.methods.iter().map(|method| method.name).collect();
        let indices: Vec<usize> =
            names.iter().filter_map(|name| self.methods.iter().position(|method| method.name == *name)).collect();
        let of_group = |run: &Vec<PathErrors>| indices.iter().map(|index| run.get(*index).copied()).collect();
        MethodRanking { matrices: group.name, names, runs: runs.iter().filter_map(of_group).collect() }
    }

    fn example(&self, table: SensorTable, base: &FilterConfig, camera_every: usize) -> SquareExample {
        let config = prepare_config(&table, base);
        let paths = self.methods.iter().map(|method| (method.name, method.run(&table, &config, camera_every)));
        SquareExample { paths: paths.collect(), table, config, camera_every }
    }

    fn report(
        self,
        source: String,
        command: String,
        runs: &[Vec<PathErrors>],
        interpretations: Vec<PaperInterpretation>,
        example: SquareExample,
    ) -> SquareReport {
        SquareReport {
            source,
            command,
            rankings: self.chains.iter().map(|group| self.ranking(group, runs)).collect(),
            extended: self.ranking(&self.outlook, runs),
            interpretations,
            recoveries: Vec::new(),
            tuned_from: self.tuned_from,
            tuned: self.tuned,
            stop: noise_at_stop(&example.table, example.geometry()),
            straight: noise_on_straight(&example.table, example.geometry()),
            example,
        }
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
    let (first, table) = tables.first().context("there is no recording")?;
    let found = Comparisons::tuned_on(
        std::slice::from_ref(table),
        &first.config,
        &format!("{} itself, without its reference", first.name),
    );
    let errors =
        |(one, table): &(&RobotDrive, SensorTable)| errors_of(table, &one.config, &found.methods, camera_every);
    let runs = run_with_bar(&tables, "drives", errors)?;
    let rows: Vec<String> = tables.iter().map(describe_drive).collect();
    let source = format!("{}; judged by {}", rows.join("; "), drives.reference_name());
    let (one, table) = tables.into_iter().next().context("there is no recording")?;
    let example = found.example(table, &one.config, camera_every);
    Ok(found.report(source, drives.command(), &runs, Vec::new(), example))
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
    let recoveries = found.recoveries.iter().map(|trial| {
        json!({
            "method": trial.method,
            "start_error_deg": trial.start_error_deg,
            "recovered": trial.recovered,
            "drives": trial.drives,
            "interval": wilson_interval_95(trial.recovered, trial.drives),
            "median_end_m": trial.median_end_m,
        })
    });
    report.data("recoveries", recoveries.collect());
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
            "share_interval": wilson_interval_95(step.holds, step.drives),
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
        "all_hold_interval": wilson_interval_95(order.all_hold, order.drives),
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
