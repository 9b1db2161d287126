//! `posebridge tune`: noise parameters from recordings or from simulated drives, by the likelihood of the innovations.
//!
//! docs/lab/tune.md has the equations, what is switched off meanwhile, and how to read the result.

mod profile;
mod report;
mod runs;

use std::path::PathBuf;

use anyhow::{Result, anyhow, ensure};
use posebridge_analysis::tuning::{Found, Search, TunedKey, ln_prior, maximise, usual_keys};
use posebridge_estimator::{Estimates, FilterConfig, FilterEntry, filter_named};

use self::runs::{Material, RunScore, Set, TuneRun};
use crate::commands::lab::outcome::{Outcome, OutputArgs};
use crate::commands::{Failure, Stage};
use crate::config::Setting;
use crate::parallel::run_all;
use crate::progress;
use crate::stderr::say;

/// Flags of `tune`.
#[derive(clap::Args, Clone, Debug)]
pub struct TuneArgs {
    /// A recording's descriptor (config/recordings/*.toml); may be repeated.
    #[arg(
        long = "recording",
        value_name = "FILE.toml",
        required_unless_present = "sim"
    )]
    pub recordings: Vec<PathBuf>,
    /// Runs to tune on: all whose names begin so; may be repeated. Without it the descriptor's usual ones.
    #[arg(long = "run", value_name = "PREFIX")]
    pub run: Vec<String>,
    /// Runs that are only scored, before and after; may be repeated.
    #[arg(long = "hold-out", value_name = "PREFIX")]
    pub hold_out: Vec<String>,
    /// Where a descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Use every n-th fix and score on the rest, instead of what the descriptor says.
    #[arg(long, value_name = "N")]
    pub use_every: Option<usize>,
    /// Set one key of the robot's table or a tunable of the filter before tuning, as for `replay`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
    /// Show the filter a position out of the truth every so many seconds, with the noise of noise.fix_position_m: for recordings
    /// without fixes.
    #[arg(long, value_name = "SECONDS")]
    pub fixes_from_truth: Option<f64>,
    /// Tune on simulated drives instead: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with = "recordings")]
    pub sim: Option<String>,
    /// Simulated drives to tune on; as many more are held out.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
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
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Write the robot with the tuned noise as a profile for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub out_profile: Option<PathBuf>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Rounds that a search mostly takes, for the bar.
const USUAL_ROUNDS: u64 = 15;

/// What was tuned, and what it is worth.
pub(super) struct Tuned {
    keys: Vec<TunedKey>,
    found: Found,
    start_factor: f64,
    /// Values of the keys in the first training run: before, after.
    values: Vec<(f64, f64)>,
    before: Vec<RunScore>,
    after: Vec<RunScore>,
    /// With the numbers of the file, where the search started from others.
    as_given: Option<Vec<RunScore>>,
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
    let outcome = Outcome {
        name: "tune",
        page: report::page(&tuned, &text),
        json: report::json(&tuned),
        text,
    };
    args.output.deliver(&folder, &outcome)
}

fn filter_of(args: &TuneArgs) -> Result<&'static FilterEntry> {
    let factor = args.start_factor;
    ensure!(
        factor.is_finite() && (1e-3..=1e3).contains(&factor),
        "--start-factor is {factor}, must be from 0.001 to 1000"
    );
    filter_named(&args.filter)
        .filter(|entry| entry.estimates == Estimates::Pose)
        .ok_or_else(|| {
            anyhow!(
                "no filter of a pose is called `{}`; `posebridge config schema` lists the filters",
                args.filter
            )
        })
}

fn keys_of(args: &TuneArgs, material: &Material) -> Result<Vec<TunedKey>> {
    let mut keys: Vec<TunedKey> = Vec::new();
    if args.params.is_empty() {
        for run in material.training() {
            for key in usual_keys(&run.observations, &run.config.noise) {
                let is_drawn =
                    args.fixes_from_truth.is_some() && key.name() == "noise.fix_position_m";
                if !is_drawn && keys.iter().all(|known| known.name() != key.name()) {
                    keys.push(key);
                }
            }
        }
    }
    for text in &args.params {
        keys.push(TunedKey::named(text)?);
    }
    ensure!(
        !keys.is_empty(),
        "the runs tell of no noise above zero: name one with --param"
    );
    for (key, run) in keys
        .iter()
        .flat_map(|key| material.training().map(move |run| (key, run)))
    {
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
    material: &Material,
    keys: Vec<TunedKey>,
) -> Result<Tuned> {
    let training: Vec<&TuneRun> = material.training().collect();
    let polled = 2 * keys.len() as u64 + 3;
    let bar = progress::bar(USUAL_ROUNDS * polled * training.len() as u64, "filter runs")?;
    let start = args.start_factor.ln();
    let scaled = |run: &TuneRun, at: &[f64]| -> FilterConfig {
        let mut config = run.config.clone();
        for (key, x) in keys.iter().zip(at) {
            key.scale(&mut config, (start + x).exp());
        }
        config
    };
    let evaluate = |points: &[Vec<f64>]| -> Vec<f64> {
        let jobs: Vec<(&Vec<f64>, &TuneRun)> = points
            .iter()
            .flat_map(|point| training.iter().map(move |run| (point, *run)))
            .collect();
        let fit = |(point, run): &(&Vec<f64>, &TuneRun)| {
            run.fit(filter, scaled(run, point)).log_likelihood()
        };
        let values = run_all(&jobs, fit, || bar.inc(1));
        let sums = values.chunks(training.len()).zip(points);
        sums.map(|(values, point)| values.iter().sum::<f64>() + ln_prior(point))
            .collect()
    };
    let found = maximise(keys.len(), &Search::default(), evaluate);
    let scores = |at: &[f64]| {
        run_all(
            &material.runs,
            |run| run.score(filter, scaled(run, at)),
            || {},
        )
    };
    let (before, after) = (scores(&vec![0.0; keys.len()]), scores(&found.at));
    let as_given = (args.start_factor != 1.0).then(|| scores(&vec![-start; keys.len()]));
    bar.finish_and_clear();
    ensure!(
        before
            .iter()
            .any(|score| score.set == Set::Training && score.fit.components() > 0),
        "the filter `{}` held no observation of these runs against a prediction; a recording of wheels alone needs --fixes-from-truth",
        filter.name
    );
    let values = values_of(&keys, &training, start, &found);
    Ok(Tuned {
        keys,
        found,
        start_factor: args.start_factor,
        values,
        before,
        after,
        as_given,
    })
}

fn values_of(
    keys: &[TunedKey],
    training: &[&TuneRun],
    start: f64,
    found: &Found,
) -> Vec<(f64, f64)> {
    let Some(first) = training.first() else {
        return Vec::new();
    };
    let value = |key: &TunedKey, ln_factor: f64| {
        let mut config = first.config.clone();
        key.scale(&mut config, ln_factor.exp());
        key.read(&config)
    };
    let pairs = keys.iter().zip(&found.at);
    pairs
        .map(|(key, x)| (value(key, start), value(key, start + x)))
        .collect()
}
