//! Recorded steps: which runs to identify on, which to predict, and by which others.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use posebridge_analysis::identification::kind::Likeness;
use posebridge_analysis::identification::lesson::{Recorded, RecordedRun, Section, recorded};
use posebridge_analysis::identification::{Sample, StepOptions, identify_step};
use posebridge_telemetry::{Observed, SensorId};

use super::LabThermometerArgs;
use crate::cli::DataFlags;
use crate::commands::{Failure, Stage};
use crate::data::{DataSet, RobotRun, tell_bad_rows};
use crate::parallel::run_all;
use crate::progress;

/// Half a last digit of a thermometer with sixteen steps per kelvin, where the descriptor gives no noise; as the filter takes it.
const DEFAULT_SIGMA_K: f64 = 0.03;

/// Everything that is said about the runs of a descriptor.
pub(super) fn sections(
    args: &LabThermometerArgs,
    descriptor: &Path,
) -> Result<Vec<Section>, Failure> {
    let chosen = Chosen::of(args, descriptor).at_start()?;
    let loaded = chosen.load().at_start()?;
    let bar = progress::bar((loaded.len() + chosen.predict.len()) as u64, "steps").at_start()?;
    let identified = run_all(&loaded, |run| identified(run, descriptor), || bar.inc(1));
    let runs: Vec<RecordedRun> = identified
        .into_iter()
        .collect::<Result<_>>()
        .while_running()?;
    let jobs = chosen.jobs(&runs);
    let likeness = if args.same_sensor {
        Likeness::SameDynamics
    } else {
        Likeness::SameKind
    };
    let predict = |(run, others): &(&RecordedRun, Vec<&RecordedRun>)| {
        let found = Recorded::of(run, others, likeness);
        let found = found.with_context(|| {
            format!(
                "run `{}`: the other runs have no description in common",
                run.name
            )
        })?;
        Ok(((*run).clone(), found))
    };
    let predicted: Vec<_> = run_all(&jobs, predict, || bar.inc(1))
        .into_iter()
        .collect::<Result<_>>()
        .while_running()?;
    bar.finish_and_clear();
    let used: Vec<RecordedRun> = runs
        .into_iter()
        .filter(|run| chosen.identify.contains(&run.name))
        .collect();
    Ok(recorded(&used, &predicted))
}

/// The runs that were asked for.
struct Chosen {
    data: DataSet,
    flags: DataFlags,
    identify: Vec<String>,
    predict: Vec<String>,
}

impl Chosen {
    fn of(args: &LabThermometerArgs, descriptor: &Path) -> Result<Self> {
        let flags = DataFlags {
            data: args.data.clone(),
            // Every name begins with nothing: all runs.
            run: Some(String::new()),
            use_every: None,
            settings: Vec::new(),
        };
        let data = DataSet::open(descriptor, &flags)?;
        let named = |asked: &[String], flag: &str| -> Result<Vec<String>> {
            for name in asked {
                ensure!(
                    data.runs.contains(name),
                    "`{flag} {name}`: `{}` has no such run; there are: {}",
                    descriptor.display(),
                    data.runs.join(", ")
                );
            }
            Ok(if asked.is_empty() {
                data.runs.clone()
            } else {
                asked.to_vec()
            })
        };
        let chosen = Self {
            identify: named(&args.identify, "--identify")?,
            predict: named(&args.predict, "--predict")?,
            flags,
            data,
        };
        for name in &chosen.predict {
            ensure!(
                chosen.identify.iter().any(|other| other != name),
                "run `{name}` cannot be predicted by itself: name another run with --identify"
            );
        }
        Ok(chosen)
    }

    /// Loads every run that is needed, once.
    fn load(&self) -> Result<Vec<RobotRun>> {
        let needed = self.data.runs.iter();
        let needed =
            needed.filter(|name| self.identify.contains(name) || self.predict.contains(name));
        needed
            .map(|name| {
                let run = self.data.load(name, &self.flags)?;
                tell_bad_rows(&run);
                Ok(run)
            })
            .collect()
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

fn identified(robot_run: &RobotRun, descriptor: &Path) -> Result<RecordedRun> {
    let run = &robot_run.run;
    let samples = run.observations.iter().filter_map(|timed| {
        let observation = &timed.observation;
        let Observed::Temperature(temperature) = observation.observed else {
            return None;
        };
        // A recording may hold further thermometers; the experiment is about the first.
        (observation.sensor == SensorId::THERMOMETER).then_some(Sample {
            at_s: observation.stamp.as_secs_f64(),
            value: temperature.0,
        })
    });
    let samples: Vec<Sample> = samples.collect();
    ensure!(
        !samples.is_empty(),
        "run `{}` of `{}` holds no temperature: it needs a [[temperature]] stream",
        run.name,
        descriptor.display()
    );
    let noise = robot_run.filter_config.noise.temperature_k;
    let sigma = if noise > 0.0 { noise } else { DEFAULT_SIGMA_K };
    let found = identify_step(&samples, &StepOptions::with_sigma(sigma));
    let identified = found.with_context(|| {
        format!(
            "run `{}` of `{}` (noise.temperature_k = {sigma})",
            run.name,
            descriptor.display()
        )
    })?;
    Ok(RecordedRun {
        name: run.name.clone(),
        identified,
    })
}
