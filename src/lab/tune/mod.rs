//! `posebridge tune`: noise parameters from recordings or simulated drives, by the likelihood of the innovations.
//!
//! docs/lab/calibration.md, section 8, has the equations, the disabled parts of the filter, the limits of the parameters, and how to
//! read the result.

mod report;
mod runs;
mod trial;

use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use posebridge_estimator::{EstimatedQuantity, FilterEntry, find_filter};
use posebridge_lab::tuning::{FitQuality, NOISE_KEYS, SearchOptions, ShareChoice, TunedKey, default_keys};

pub use self::runs::TuneArgs;

use self::report::{KeptValues, ParameterValues, TuneResult};
use self::runs::{RunScore, RunSet, TuneDataset, TuneRun};
use self::trial::TuneSearch;
use super::parallel::run_all;
use crate::console::{print_line, progress_bar};
use crate::exit::{ExitStage, Failure};

pub fn execute(args: &TuneArgs) -> Result<(), Failure> {
    let filter = filter_of(args).before_start()?;
    let material = TuneDataset::load(args).before_start()?;
    let keys = keys_of(args, &material).before_start()?;
    let folder = args.output.folder()?;
    let tuned = tune(args, filter, &material, keys).while_running()?;
    if let Some(path) = &args.out_profile {
        write_profile(path, &material, &tuned).while_running()?;
        print_line(&format!("profile: {}", path.display()));
    }
    args.output.write_outcome(&folder, &report::report(&tuned))
}

fn filter_of(args: &TuneArgs) -> Result<&'static FilterEntry> {
    let factor = args.start_factor;
    ensure!(
        factor.is_finite() && (1e-3..=1e3).contains(&factor),
        "--start-factor is {factor}, must be from 0.001 to 1000"
    );
    find_filter(&args.filter).filter(|entry| entry.quantity == EstimatedQuantity::Pose).ok_or_else(|| {
        anyhow!("no filter of a pose is called `{}`; `posebridge config schema` lists the filters", args.filter)
    })
}

fn keys_of(args: &TuneArgs, material: &TuneDataset) -> Result<Vec<TunedKey>> {
    let mut keys: Vec<TunedKey> = Vec::new();
    if args.params.is_empty() {
        for run in material.training() {
            for key in default_keys(&run.observations, &run.config.noise) {
                let is_drawn = args.fixes_from_truth.is_some() && key.name() == "noise.fix_position_m";
                if !is_drawn && keys.iter().all(|known| known.name() != key.name()) {
                    keys.push(key);
                }
            }
        }
    }
    for text in &args.params {
        keys.push(TunedKey::from_name(text)?);
    }
    ensure!(!keys.is_empty(), "the runs determine no noise above zero: name one with --param");
    for (key, run) in keys.iter().flat_map(|key| material.training().map(move |run| (key, run))) {
        ensure!(
            key.read(&run.config) > 0.0 || args.params.is_empty(),
            "`{}` is 0 in run `{}`: a factor leaves it there; give it a value with --set",
            key.name(),
            run.name
        );
    }
    Ok(keys)
}

fn tune(
    args: &TuneArgs,
    filter: &'static FilterEntry,
    material: &TuneDataset,
    keys: Vec<TunedKey>,
) -> Result<TuneResult> {
    let training: Vec<&TuneRun> = material.training().collect();
    let start = args.start_factor.ln();
    let mut trial = TuneSearch::new(filter, &keys, start, &training);
    // The search takes minutes.
    let unmoved = vec![0.0; keys.len()];
    let predicts = |run: &&TuneRun| {
        let fit = run.fit(filter, trial.config(run, &unmoved));
        fit.components() > 0
    };
    ensure!(
        training.iter().any(predicts),
        "the filter `{}` held no observation of these runs against a prediction; a recording of wheels alone needs --fixes-from-truth",
        filter.name
    );
    let bar = progress_bar(trial.expected_passes(), "filter runs")?;
    let ended = || bar.inc(1);
    let found = trial.maximum(&SearchOptions::default(), None, &ended);
    let choice = trial.validate(&SearchOptions::default(), &ended);
    bar.finish_and_clear();
    let scores = |at: &[f64]| {
        let score = |run: &TuneRun| run.score(filter, trial.config(run, at));
        run_all(&material.runs, score, || {})
    };
    let at: Vec<f64> = found.at.iter().map(|x| choice.share() * x).collect();
    let (before, proposed) = (scores(&unmoved), scores(&at));
    let as_given = (args.start_factor != 1.0).then(|| scores(&vec![-start; keys.len()]));
    let kept = decide_kept(&choice, &before, &proposed);
    let value = |key: &TunedKey, x: f64| {
        training.first().map_or(f64::NAN, |run| {
            let mut config = run.config.clone();
            key.scale(&mut config, (start + x).exp());
            key.read(&config)
        })
    };
    let pairs = keys.iter().zip(&found.at).zip(&at);
    let values = pairs.map(|((key, peak), x)| ParameterValues {
        before: value(key, 0.0),
        at_maximum: value(key, *peak),
        proposed: value(key, *x),
        after: value(key, if kept == KeptValues::Tuned { *x } else { 0.0 }),
    });
    Ok(TuneResult {
        values: values.collect(),
        keys,
        optimum: found,
        choice,
        kept,
        start_factor: args.start_factor,
        before,
        proposed,
        as_given,
    })
}

/// Keeps the tuned parameters if they moved and are no worse on data that was not used for tuning.
fn decide_kept(choice: &ShareChoice, before: &[RunScore], proposed: &[RunScore]) -> KeptValues {
    if choice.share() == 0.0 {
        return KeptValues::StartByFolds(choice.reason);
    }
    let lost = worth(proposed).loss_against(&worth(before));
    lost.map_or(KeptValues::Tuned, KeptValues::StartByHeldOut)
}

fn worth(scores: &[RunScore]) -> FitQuality {
    let held_out: Vec<&RunScore> = scores.iter().filter(|score| score.set == RunSet::HeldOut).collect();
    FitQuality { ln_p_each: report::each(&report::merged_fit(&held_out)), position_rms_m: report::rms_m(&held_out) }
}

fn write_profile(path: &Path, material: &TuneDataset, tuned: &TuneResult) -> Result<()> {
    let text = profile_text(material, tuned)?;
    std::fs::write(path, text).with_context(|| format!("writing the profile to `{}`", path.display()))
}

fn profile_text(material: &TuneDataset, tuned: &TuneResult) -> Result<String> {
    let mut robot = toml::Table::try_from(&material.robot)?;
    // Where it started belongs to the run.
    robot.remove("start");
    let mut noise = toml::Table::new();
    if let Some(first) = material.training().next() {
        for row in NOISE_KEYS {
            noise.insert(row.key.to_owned(), (row.read)(&first.config.noise).into());
        }
    }
    let mut filter = toml::Table::new();
    for (key, values) in tuned.keys.iter().zip(&tuned.values) {
        match key {
            TunedKey::Noise(row) => noise.insert(row.key.to_owned(), values.after.into()),
            TunedKey::Param(row) => filter.insert(row.key.to_owned(), values.after.into()),
        };
    }
    robot.insert("noise".to_owned(), noise.into());
    let keys: Vec<toml::Value> = tuned.keys.iter().map(|key| key.name().into()).collect();
    let origin: [(&str, toml::Value); 3] =
        [("source", material.source.clone().into()), ("keys", keys.into()), ("kept", report::kept(tuned).into())];
    let origin: toml::Table = origin.map(|(key, value)| (key.to_owned(), value)).into_iter().collect();
    let mut page = toml::Table::new();
    page.insert("tuned".to_owned(), origin.into());
    page.insert("robot".to_owned(), robot.into());
    if !filter.is_empty() {
        page.insert("filter".to_owned(), filter.into());
    }
    Ok(format!(
        "# A robot with tuned noise; give it with `posebridge run --robot FILE` or `posebridge replay --robot FILE`.\n\n{}",
        toml::to_string(&page)?
    ))
}
