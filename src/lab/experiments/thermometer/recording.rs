//! Recorded steps: which runs to identify on, which to predict, and by which others.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_lab::identification::lesson::{LessonSection, RecordedPrediction, RecordedRun, recorded_sections};
use posebridge_lab::identification::sensor_kind::RunSimilarity;
use posebridge_lab::identification::{SensorChannel, StepOptions, TimedSample, identify_step};
use posebridge_telemetry::Observation;

use super::args::LabThermometerArgs;
use crate::config::{Overlay, Setting};
use crate::console::{print_line, progress_bar};
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::experiments::live::LiveRobot;
use crate::lab::parallel::run_all;
use crate::tools::dataset::{DataSet, report_bad_rows, report_skipped};
use crate::tools::own_recording;

/// Half a last digit of a thermometer with sixteen steps per kelvin, where the descriptor gives no noise; as the filter takes it.
const DEFAULT_SIGMA_K: f64 = 0.03;

/// The instructions for a person with a live robot.
const TASK: &str = "leave the thermometer as it is for a few seconds, bring it to something warm or cold at once, and leave it there until it has settled";

/// The report about the runs of a descriptor, or of recordings of ours.
pub(super) fn sections(args: &LabThermometerArgs) -> Result<Vec<LessonSection>, Failure> {
    let robot = LiveRobot { file: None, settings: &args.settings };
    let live = args.live.record(&args.output, robot, TASK)?;
    let (chosen, loaded) = match args.recordings.as_slice() {
        [descriptor] if live.is_none() && !own_recording::is_own(descriptor) => of_descriptor(args, descriptor),
        recordings => of_recordings(args, recordings, live.as_deref()),
    }
    .before_start()?;
    let bar = progress_bar((loaded.len() + chosen.predict.len()) as u64, "steps").before_start()?;
    let identified = run_all(&loaded, identify_run, || bar.inc(1));
    let runs: Vec<RecordedRun> = identified.into_iter().collect::<Result<_>>().while_running()?;
    let jobs = chosen.jobs(&runs);
    let likeness = if args.same_sensor { RunSimilarity::SameDynamics } else { RunSimilarity::SameKind };
    let predict = |(run, others): &(&RecordedRun, Vec<&RecordedRun>)| {
        let found = RecordedPrediction::predict_run(run, others, likeness);
        let found =
            found.with_context(|| format!("run `{}`: the other runs have no description in common", run.name))?;
        Ok(((*run).clone(), found))
    };
    let predicted: Vec<_> =
        run_all(&jobs, predict, || bar.inc(1)).into_iter().collect::<Result<_>>().while_running()?;
    bar.finish_and_clear();
    let used: Vec<RecordedRun> = runs.into_iter().filter(|run| chosen.identify.contains(&run.name)).collect();
    Ok(recorded_sections(&used, &predicted))
}

/// What a thermometer showed in one run.
struct ThermometerRun {
    run: String,
    samples: Vec<TimedSample>,
    sigma_k: f64,
}

impl ThermometerRun {
    /// The readings of the first thermometer: a descriptor may hold further ones, and the experiment is about the first.
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

/// The runs of a descriptor that were asked for, each loaded once.
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

/// Each thermometer of each recording is a run; without other flags the earlier recordings foretell a live one.
fn of_recordings(
    args: &LabThermometerArgs,
    recordings: &[PathBuf],
    live: Option<&Path>,
) -> Result<(RunRoles, Vec<ThermometerRun>)> {
    let mut shown = Vec::new();
    for path in recordings {
        ensure!(
            own_recording::is_own(path),
            "`{}` is a descriptor: give one alone, or recordings (*.mcap) and a live robot",
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

/// The runs that were asked for.
struct RunRoles {
    identify: Vec<String>,
    predict: Vec<String>,
}

impl RunRoles {
    /// From `all` runs. The `usual` ones are identified and predicted unless others are named.
    fn resolve(args: &LabThermometerArgs, all: &[String], usual: [&[String]; 2]) -> Result<Self> {
        let named = |asked: &[String], flag: &str, usual: &[String]| -> Result<Vec<String>> {
            for name in asked {
                ensure!(all.contains(name), "`{flag} {name}`: there is no such run; there are: {}", all.join(", "));
            }
            Ok(if asked.is_empty() { usual.to_vec() } else { asked.to_vec() })
        };
        let [identify, predict] = usual;
        let identify = named(&args.identify, "--identify", identify)?;
        let predict = named(&args.predict, "--predict", predict)?;
        if let ([only], true) = (all, args.predict.is_empty()) {
            print_line(&format!(
                "`{only}` is the only run: it is identified, and nothing is foretold. Give a second run of this sensor to see it \
                 foretold by this one"
            ));
            return Ok(Self { identify, predict: Vec::new() });
        }
        for name in &predict {
            ensure!(
                identify.iter().any(|other| other != name),
                "run `{name}` cannot be predicted by itself: name another run with --identify"
            );
        }
        Ok(Self { identify, predict })
    }

    fn needs(&self, run: &String) -> bool {
        self.identify.contains(run) || self.predict.contains(run)
    }

    /// Each run that shall be predicted, with those by which: the identified ones without itself.
    fn jobs<'a>(&self, runs: &'a [RecordedRun]) -> Vec<(&'a RecordedRun, Vec<&'a RecordedRun>)> {
        let by_name = |name: &String| runs.iter().find(|run| run.name == *name);
        let predicted = self.predict.iter().filter_map(by_name);
        predicted
            .map(|run| {
                let others = self.identify.iter().filter(|name| **name != run.name);
                (run, others.filter_map(by_name).collect())
            })
            .collect()
    }
}

fn identify_run(shown: &ThermometerRun) -> Result<RecordedRun> {
    let found = identify_step(&shown.samples, &StepOptions::with_sigma(shown.sigma_k));
    let identified = found.with_context(|| format!("run `{}` (noise.temperature_k = {})", shown.run, shown.sigma_k))?;
    Ok(RecordedRun { name: shown.run.clone(), identified })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{FilterSection, RobotFile, filter_config};
    use posebridge_telemetry::{ArenaMap, Celsius, ObservationKind, SensorId, TimeDelta, Timestamp};

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
