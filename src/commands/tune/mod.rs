//! `posebridge tune`: noise parameters from recordings or from simulated drives, by the likelihood of the innovations.
//!
//! docs/lab/tune.md has the equations, what is switched off meanwhile, how far the numbers may move, and how to read the result.

mod own;
mod profile;
mod report;
mod runs;
mod trial;

use std::path::PathBuf;

use anyhow::{Result, anyhow, ensure};
use posebridge_analysis::tuning::{Choice, Found, Loss, Reason, Search, TunedKey, Worth, usual_keys};
use posebridge_estimator::{Estimates, FilterEntry, filter_named};

use self::runs::{Material, RunScore, Set, TuneRun};
use self::trial::Trial;
use crate::commands::lab::outcome::{Outcome, OutputArgs};
use crate::commands::{Failure, Stage};
use crate::config::Setting;
use crate::parallel::run_all;
use crate::progress;
use crate::stderr::say;

/// Flags of `tune`.
#[derive(clap::Args, Clone, Debug)]
pub struct TuneArgs {
    /// A recording's descriptor (config/recordings/*.toml) or a recording (*.mcap), which is one run by the name of its file; may be
    /// repeated.
    #[arg(long = "recording", value_name = "FILE", required_unless_present = "sim")]
    pub recordings: Vec<PathBuf>,
    /// Runs to tune on: all whose names begin so; may be repeated. Without it the descriptor's usual ones.
    #[arg(long = "run", value_name = "PREFIX")]
    pub run: Vec<String>,
    /// Runs that are only scored, before and after; if the tuned numbers are worse on them, those to start from are kept. May be
    /// repeated.
    #[arg(long = "hold-out", value_name = "PREFIX")]
    pub hold_out: Vec<String>,
    /// Where a descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Use every n-th fix and score on the rest, instead of what the descriptor says.
    #[arg(long, value_name = "N")]
    pub use_every: Option<usize>,
    /// Set one key of the robot's table or a tunable of the filter before tuning, as for `replay`, or of the configuration of a
    /// recording of ours; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
    /// Show the filter a position out of the truth every so many seconds, with the noise of noise.fix_position_m: for recordings
    /// without fixes.
    #[arg(long, value_name = "SECONDS", group = "drawn")]
    pub fixes_from_truth: Option<f64>,
    /// Tune on simulated drives instead: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", group = "drawn", conflicts_with_all = ["recordings", "run", "hold_out", "use_every", "settings"])]
    pub sim: Option<String>,
    /// Simulated drives to tune on; as many more are held out.
    #[arg(long, value_name = "N", default_value_t = 4, conflicts_with = "recordings", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// A parameter to tune: a key of [robot.noise], or filter.KEY; may be repeated. Without it those of which the data tell.
    #[arg(long = "param", value_name = "KEY")]
    pub params: Vec<String>,
    /// The filter.
    #[arg(long, value_name = "NAME", default_value = "pose")]
    pub filter: String,
    /// Start with the tuned parameters so many times too large: an exercise.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub start_factor: f64,
    /// Seed of simulated drives and of the noise of fixes from the truth.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "drawn")]
    pub seed: u64,
    /// Write the robot with the tuned noise as a profile for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub out_profile: Option<PathBuf>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// What was tuned, and what it is worth.
pub(super) struct Tuned {
    keys: Vec<TunedKey>,
    found: Found,
    /// How far towards what was found, by data that the search did not see.
    choice: Choice,
    kept: Kept,
    start_factor: f64,
    /// Values of the keys in the first training run.
    values: Vec<Values>,
    before: Vec<RunScore>,
    /// With the numbers that the choice gives, kept or not.
    proposed: Vec<RunScore>,
    /// With the numbers of the file, where the search started from others.
    as_given: Option<Vec<RunScore>>,
}

/// A number on its way.
pub(super) struct Values {
    before: f64,
    /// Where the likelihood of all training runs is largest.
    at_maximum: f64,
    /// So far as other data agree.
    proposed: f64,
    /// What is written.
    after: f64,
}

/// Which numbers are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kept {
    /// The tuned ones.
    Tuned,
    /// Those to start from: on data that the search did not see no other ones were better.
    StartByFolds(Reason),
    /// Those to start from: on the runs that were held out the tuned ones are worse.
    StartByHeldOut(Loss),
}

impl Tuned {
    /// The scores with what is kept.
    fn after(&self) -> &[RunScore] {
        match self.kept {
            Kept::Tuned => &self.proposed,
            Kept::StartByFolds(_) | Kept::StartByHeldOut(_) => &self.before,
        }
    }
}

/// Tunes.
///
/// # Errors
/// A recording, a run, a scenario, a filter or a key does not exist or makes no sense, or an output cannot be written.
pub fn execute(args: &TuneArgs) -> Result<(), Failure> {
    let filter = filter_of(args).at_start()?;
    let material = Material::gather(args).at_start()?;
    let keys = keys_of(args, &material).at_start()?;
    let folder = args.output.folder()?;
    let tuned = tune(args, filter, &material, keys).while_running()?;
    if let Some(path) = &args.out_profile {
        profile::write(path, &material, &tuned).while_running()?;
        say(&format!("profile: {}", path.display()));
    }
    let text = report::text(&tuned);
    let outcome = Outcome { name: "tune", page: report::page(&tuned, &text), json: report::json(&tuned), text };
    args.output.deliver(&folder, &outcome)
}

fn filter_of(args: &TuneArgs) -> Result<&'static FilterEntry> {
    let factor = args.start_factor;
    ensure!(
        factor.is_finite() && (1e-3..=1e3).contains(&factor),
        "--start-factor is {factor}, must be from 0.001 to 1000"
    );
    filter_named(&args.filter).filter(|entry| entry.estimates == Estimates::Pose).ok_or_else(|| {
        anyhow!("no filter of a pose is called `{}`; `posebridge config schema` lists the filters", args.filter)
    })
}

fn keys_of(args: &TuneArgs, material: &Material) -> Result<Vec<TunedKey>> {
    let mut keys: Vec<TunedKey> = Vec::new();
    if args.params.is_empty() {
        for run in material.training() {
            for key in usual_keys(&run.observations, &run.config.noise) {
                let is_drawn = args.fixes_from_truth.is_some() && key.name() == "noise.fix_position_m";
                if !is_drawn && keys.iter().all(|known| known.name() != key.name()) {
                    keys.push(key);
                }
            }
        }
    }
    for text in &args.params {
        keys.push(TunedKey::named(text)?);
    }
    ensure!(!keys.is_empty(), "the runs tell of no noise above zero: name one with --param");
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

fn tune(args: &TuneArgs, filter: &'static FilterEntry, material: &Material, keys: Vec<TunedKey>) -> Result<Tuned> {
    let training: Vec<&TuneRun> = material.training().collect();
    let start = args.start_factor.ln();
    let mut trial = Trial::new(filter, &keys, start, &training);
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
    let bar = progress::bar(trial.usual_work(), "filter runs")?;
    let ended = || bar.inc(1);
    let found = trial.maximum(&Search::default(), None, &ended);
    let choice = trial.validate(&Search::default(), &ended);
    bar.finish_and_clear();
    let scores = |at: &[f64]| {
        let score = |run: &TuneRun| run.score(filter, trial.config(run, at));
        run_all(&material.runs, score, || {})
    };
    let at: Vec<f64> = found.at.iter().map(|x| choice.share() * x).collect();
    let (before, proposed) = (scores(&unmoved), scores(&at));
    let as_given = (args.start_factor != 1.0).then(|| scores(&vec![-start; keys.len()]));
    let kept = kept(&choice, &before, &proposed);
    let value = |key: &TunedKey, x: f64| {
        training.first().map_or(f64::NAN, |run| {
            let mut config = run.config.clone();
            key.scale(&mut config, (start + x).exp());
            key.read(&config)
        })
    };
    let pairs = keys.iter().zip(&found.at).zip(&at);
    let values = pairs.map(|((key, peak), x)| Values {
        before: value(key, 0.0),
        at_maximum: value(key, *peak),
        proposed: value(key, *x),
        after: value(key, if kept == Kept::Tuned { *x } else { 0.0 }),
    });
    Ok(Tuned {
        values: values.collect(),
        keys,
        found,
        choice,
        kept,
        start_factor: args.start_factor,
        before,
        proposed,
        as_given,
    })
}

/// The tuned numbers are kept if they moved and are no worse where nobody tuned.
fn kept(choice: &Choice, before: &[RunScore], proposed: &[RunScore]) -> Kept {
    if choice.share() == 0.0 {
        return Kept::StartByFolds(choice.reason);
    }
    let lost = worth(proposed).loss_against(&worth(before));
    lost.map_or(Kept::Tuned, Kept::StartByHeldOut)
}

/// What the held-out runs are worth.
fn worth(scores: &[RunScore]) -> Worth {
    let held_out: Vec<&RunScore> = scores.iter().filter(|score| score.set == Set::HeldOut).collect();
    Worth { ln_p_each: report::each(&report::joined(&held_out)), position_rms_m: report::rms_m(&held_out) }
}
