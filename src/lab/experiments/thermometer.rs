//! `posebridge lab thermometer`: predicts the final value of a slow sensor during its transient (paper 2).
//!
//! Without `--recording` on a simulated sensor, section by section; with it on recorded steps. docs/lab/thermometer.md is the lesson.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use posebridge_estimator::FilterConfig;
use posebridge_lab::identification::lesson::{
    LessonSection, RecordedPrediction, RecordedRun, SECTIONS, bound_run, bounds_section, recorded_answer,
    recorded_sections, simulated_answer,
};
use posebridge_lab::identification::sensor_kind::RunSimilarity;
use posebridge_lab::identification::{SensorChannel, StepOptions, TimedSample, estimate_noise, identify_step};
use posebridge_report::report::{Report, Table};
use posebridge_telemetry::Observation;
use serde_json::{Map, Value, json};

use super::live::LiveArgs;
use crate::config::{Overlay, Setting};
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::parallel::run_all;
use crate::lab::sample_table::SampleColumns;
use crate::tools::dataset::{DataSet, report_bad_rows, report_skipped};
use crate::tools::experiment_output::OutputArgs;
use crate::tools::own_recording;

pub fn execute(args: &LabThermometerArgs) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    check_columns(args).before_start()?;
    let (answer, sections) = if args.is_real() { recorded(args)? } else { simulated(args)? };
    args.output.write_outcome(&folder, &report(args, answer, &sections))
}

fn simulated(args: &LabThermometerArgs) -> Result<(String, Vec<LessonSection>), Failure> {
    let runs: Vec<u64> = (0..u64::from(args.runs)).collect();
    let bar = progress_bar((SECTIONS.len() + runs.len()) as u64, "parts").before_start()?;
    let mut sections = run_all(&SECTIONS, |make| make(args.seed), || bar.inc(1));
    // Far from the seeds of the sections.
    let seed = |run: &u64| args.seed.wrapping_mul(1 << 32).wrapping_add(*run);
    let bound_runs = run_all(&runs, |run| bound_run(seed(run)), || bar.inc(1));
    bar.finish_and_clear();
    sections.push(bounds_section(&bound_runs));
    Ok((simulated_answer(&sections), sections))
}

fn report(args: &LabThermometerArgs, answer: String, sections: &[LessonSection]) -> Report {
    let source = if args.is_real() {
        let names = args.recordings.iter().map(|path| path.display().to_string());
        let live = args.live.is_requested().then(|| "a live robot".to_owned());
        let names: Vec<String> = names.chain(live).collect();
        format!("recording {}", names.join(", "))
    } else {
        format!("simulated sensor, seed {}", args.seed)
    };
    let mut report = Report::new("lab-thermometer", "The slow thermometer");
    report.answer(answer);
    report.background("What will a slow sensor show in the end? docs/lab/thermometer.md has the theory and exercises.");
    report.paragraph(format!("Source: {source}"));
    for section in sections {
        add_section(&mut report, section);
    }
    report.data("source", json!(source));
    report.data("sections", sections_json(sections));
    report
}

fn add_section(report: &mut Report, section: &LessonSection) {
    report.heading(section.title.as_str());
    for paragraph in &section.paragraphs {
        report.background(paragraph);
    }
    if !section.header.is_empty() {
        let mut table = Table::of(&section.rows);
        for (column, heading) in section.header.iter().enumerate() {
            table = table.text("", heading, move |row| row.get(column).cloned().unwrap_or_default());
        }
        report.table("", &table);
    }
    if let Some((plot, caption)) = &section.figure {
        report.chart(plot, caption);
    }
}

/// `{name: {number: value}}` of the sections with numbers; an unavailable number is null.
fn sections_json(sections: &[LessonSection]) -> Value {
    let of = |section: &LessonSection| {
        let numbers = section.values.iter();
        let numbers: Map<String, Value> = numbers.map(|(name, value)| (name.clone(), json!(value))).collect();
        (section.name.to_owned(), Value::Object(numbers))
    };
    let with_numbers = sections.iter().filter(|section| !section.values.is_empty());
    Value::Object(with_numbers.map(of).collect())
}

/// Flags of `lab thermometer`.
#[derive(Args, Clone, Debug)]
#[command(group = clap::ArgGroup::new("real").multiple(true).args(["recordings", "link", "listen"]))]
pub struct LabThermometerArgs {
    /// Descriptor (config/recordings/*.toml) with temperatures, recordings (*.mcap; each thermometer is one run), or tables (*.csv;
    /// each is one run). Default: the simulated sensor.
    #[arg(long = "recording", value_name = "FILE", num_args = 1..)]
    pub recordings: Vec<PathBuf>,
    /// Columns of the tables.
    #[command(flatten)]
    pub columns: SampleColumns,
    /// A live robot, whose step the recordings foretell.
    #[command(flatten)]
    pub live: LiveArgs,
    /// Folder for the relative paths of the descriptor. Default: POSEBRIDGE_DATA, or else the descriptor's folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Runs to identify the sensor on. Default: all.
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "real")]
    pub identify: Vec<String>,
    /// Runs to predict, each from the other identified runs, and from nothing. Default: all.
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "real")]
    pub predict: Vec<String>,
    /// All runs are of one sensor in the same surroundings, in either direction: its lags differ less.
    #[arg(long, requires = "real")]
    pub same_sensor: bool,
    /// Set one key of the descriptor's robot, or of the configuration of a recording or a live robot, e.g.
    /// robot.noise.temperature_k=0.05. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real")]
    pub settings: Vec<Setting>,
    /// Number of simulated runs for the coverage of the bounds.
    #[arg(long, value_name = "N", default_value_t = 1_000, conflicts_with = "real", value_parser = clap::value_parser!(u32).range(10..=100_000))]
    pub runs: u32,
    /// Seed of the simulated sensor.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real")]
    pub seed: u64,
    /// What it leaves behind.
    #[command(flatten)]
    pub output: OutputArgs,
}

impl LabThermometerArgs {
    fn is_real(&self) -> bool {
        !self.recordings.is_empty() || self.live.is_requested()
    }
}

/// Default noise: half the resolution of a thermometer with sixteen steps per kelvin, as the filter uses it.
const DEFAULT_SIGMA_K: f64 = 0.03;

const TASK: &str = "leave the thermometer as it is for a few seconds, bring it to something warm or cold at once, and leave it there until it has settled";

fn recorded(args: &LabThermometerArgs) -> Result<(String, Vec<LessonSection>), Failure> {
    let live = args.live.record(&args.output, None, &args.settings, TASK)?;
    let (chosen, loaded) = match args.recordings.as_slice() {
        [descriptor] if live.is_none() && !own_recording::is_own(descriptor) && !is_table(descriptor) => {
            of_descriptor(args, descriptor)
        }
        recordings => of_recordings(args, recordings, live.as_deref()),
    }
    .before_start()?;
    let bar = progress_bar((loaded.len() + 2 * chosen.predict.len()) as u64, "steps").before_start()?;
    let identified = run_all(&loaded, identify_run, || bar.inc(1));
    let runs: Vec<RecordedRun> = identified.into_iter().collect::<Result<_>>().while_running()?;
    let jobs = chosen.jobs(&runs);
    let likeness = if args.same_sensor { RunSimilarity::SameSensor } else { RunSimilarity::SameKind };
    let predict = |(run, others): &(&RecordedRun, Vec<&RecordedRun>)| {
        let found = RecordedPrediction::predict_run(run, others, likeness);
        let found = found.with_context(|| format!("run `{}`: the other runs show no lag", run.name))?;
        Ok(((*run).clone(), found))
    };
    let predicted: Vec<_> =
        run_all(&jobs, predict, || bar.inc(1)).into_iter().collect::<Result<_>>().while_running()?;
    bar.finish_and_clear();
    let used: Vec<RecordedRun> = runs.into_iter().filter(|run| chosen.identify.contains(&run.name)).collect();
    Ok((recorded_answer(&predicted), recorded_sections(&used, &predicted)))
}

struct ThermometerRun {
    run: String,
    samples: Vec<TimedSample>,
    sigma_k: f64,
}

impl ThermometerRun {
    fn from_table(args: &LabThermometerArgs, path: &Path) -> Result<Self> {
        let samples = args.columns.read(path)?.samples;
        let sigma = estimate_noise(&samples);
        let sigma_k = sigma.with_context(|| format!("`{}` does not say how noisy it is", path.display()))?;
        Ok(Self { run: path.display().to_string(), samples, sigma_k })
    }

    /// Uses only the first thermometer.
    fn from_readings(run: &str, readings: &[Observation], config: &FilterConfig) -> Self {
        report_skipped(run, SensorChannel::Temperature.excluded_count(readings));
        let noise = config.noise.temperature_k;
        Self {
            run: run.to_owned(),
            samples: SensorChannel::Temperature.samples(readings),
            sigma_k: if noise > 0.0 { noise } else { DEFAULT_SIGMA_K },
        }
    }
}

fn check_columns(args: &LabThermometerArgs) -> Result<()> {
    ensure!(
        args.columns.is_default() || args.recordings.iter().any(|path| is_table(path)),
        "--time-column, --time-unit and --value-column belong to a table (*.csv)"
    );
    ensure!(
        args.settings.is_empty() || args.live.is_requested() || args.recordings.iter().any(|path| !is_table(path)),
        "--set changes what a recording says of its robot; a table says nothing of one"
    );
    Ok(())
}

fn is_table(path: &Path) -> bool {
    path.extension().is_some_and(|end| end.eq_ignore_ascii_case("csv") || end.eq_ignore_ascii_case("txt"))
}

/// The selected runs of a descriptor, each loaded once.
fn of_descriptor(args: &LabThermometerArgs, descriptor: &Path) -> Result<(RunRoles, Vec<ThermometerRun>)> {
    let flags = DataFlags {
        data: args.data.clone(),
        // Every name begins with nothing: all runs.
        run: Some(String::new()),
        use_every: None,
        settings: args.settings.clone(),
    };
    let data = DataSet::open(descriptor, &flags)?;
    let chosen = RunRoles::resolve(args, &data.runs, [&data.runs, &data.runs])?;
    let load = |name: &String| -> Result<ThermometerRun> {
        let run = data.load(name, &flags)?;
        report_bad_rows(&run);
        let readings = run.run.observations.iter();
        let readings: Vec<Observation> = readings.map(|timed| timed.observation).collect();
        let shown = ThermometerRun::from_readings(name, &readings, &run.filter_config);
        ensure!(
            !shown.samples.is_empty(),
            "run `{name}` of `{}` holds no temperature: it needs a [[temperature]] stream",
            descriptor.display()
        );
        Ok(shown)
    };
    let needed = data.runs.iter().filter(|name| chosen.needs(name));
    let shown = needed.map(load).collect::<Result<_>>()?;
    Ok((chosen, shown))
}

/// Each thermometer of each recording is a run; by default earlier recordings predict a live one.
fn of_recordings(
    args: &LabThermometerArgs,
    recordings: &[PathBuf],
    live: Option<&Path>,
) -> Result<(RunRoles, Vec<ThermometerRun>)> {
    let mut shown = Vec::new();
    for path in recordings {
        if is_table(path) {
            shown.push(ThermometerRun::from_table(args, path)?);
            continue;
        }
        ensure!(
            own_recording::is_own(path),
            "`{}` is a descriptor: give one alone, or recordings (*.mcap), tables (*.csv) and a live robot",
            path.display()
        );
        shown.extend(thermometers(path, &args.settings)?);
    }
    let earlier: Vec<String> = shown.iter().map(|one| one.run.clone()).collect();
    if let Some(live) = live {
        // The keys that are set stand in the recording.
        shown.extend(thermometers(live, &[])?);
    }
    let all: Vec<String> = shown.iter().map(|one| one.run.clone()).collect();
    let new = all.get(earlier.len()..).unwrap_or_default();
    let chosen = if new.is_empty() || earlier.is_empty() {
        RunRoles::resolve(args, &all, [&all, &all])?
    } else {
        RunRoles::resolve(args, &all, [&earlier, new])?
    };
    shown.retain(|one| chosen.needs(&one.run));
    Ok((chosen, shown))
}

fn thermometers(path: &Path, settings: &[Setting]) -> Result<Vec<ThermometerRun>> {
    let overlay = Overlay { robot: None, settings };
    let own = own_recording::read(path, overlay)?;
    ensure!(
        !own.thermometers.is_empty(),
        "`{}` holds no temperature: let the brick send a named value whose name begins with `temp` (docs/lab/thermometer.md)",
        own.name
    );
    let shown = own.thermometers.iter().map(|one| {
        let run = format!("{}:{}", own.name, one.name_among(&own.thermometers));
        let readings = one.readings();
        let readings = readings.with_context(|| format!("recording `{}`", own.name))?;
        Ok(ThermometerRun::from_readings(&run, readings, &own.config))
    });
    shown.collect()
}

struct RunRoles {
    identify: Vec<String>,
    predict: Vec<String>,
}

impl RunRoles {
    /// Selects roles from `all` runs; `usual` are the default runs to identify and to predict.
    fn resolve(args: &LabThermometerArgs, all: &[String], usual: [&[String]; 2]) -> Result<Self> {
        let named = |requested: &[String], flag: &str, usual: &[String]| -> Result<Vec<String>> {
            for name in requested {
                ensure!(all.contains(name), "`{flag} {name}`: there is no such run; there are: {}", all.join(", "));
            }
            Ok(if requested.is_empty() { usual.to_vec() } else { requested.to_vec() })
        };
        let [identify, predict] = usual;
        let identify = named(&args.identify, "--identify", identify)?;
        let predict = named(&args.predict, "--predict", predict)?;
        Ok(Self { identify, predict })
    }

    fn needs(&self, run: &String) -> bool {
        self.identify.contains(run) || self.predict.contains(run)
    }

    /// Each run to predict, with the identified runs other than itself, and with none.
    fn jobs<'a>(&self, runs: &'a [RecordedRun]) -> Vec<(&'a RecordedRun, Vec<&'a RecordedRun>)> {
        let by_name = |name: &String| runs.iter().find(|run| run.name == *name);
        let mut jobs = Vec::new();
        for run in self.predict.iter().filter_map(by_name) {
            let others = self.identify.iter().filter(|name| **name != run.name);
            let others: Vec<&RecordedRun> = others.filter_map(by_name).collect();
            if !others.is_empty() {
                jobs.push((run, others));
            }
            jobs.push((run, Vec::new()));
        }
        jobs
    }
}

fn identify_run(shown: &ThermometerRun) -> Result<RecordedRun> {
    let found = identify_step(&shown.samples, &StepOptions::with_sigma(shown.sigma_k));
    let identified = found.with_context(|| format!("run `{}` (noise.temperature_k = {})", shown.run, shown.sigma_k))?;
    Ok(RecordedRun { name: shown.run.clone(), identified })
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{ArenaMap, Celsius, ObservationKind, SensorId, TimeDelta, Timestamp};

    use super::*;
    use crate::config::{FilterSection, RobotFile, filter_config};

    #[test]
    fn a_stamp_that_is_too_late_takes_no_other_reading_along() {
        let readings = [0, 1_000, 9_000, 2_000, 3_000, 3_000].map(|millis| Observation {
            sensor: SensorId::THERMOMETER,
            stamp: Timestamp::from_millis(millis),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Temperature(Celsius(20.0)),
        });
        let robot = RobotFile::default();
        let config = filter_config(&robot, &FilterSection::default(), ArenaMap::default()).unwrap();
        let shown = ThermometerRun::from_readings("bath", &readings, &config);
        let at_s: Vec<f64> = shown.samples.iter().map(|sample| sample.at_s).collect();
        assert_eq!(at_s, [0.0, 1.0, 2.0, 3.0, 9.0]);
        assert_eq!(SensorChannel::Temperature.excluded_count(&readings), 1);
    }
}
