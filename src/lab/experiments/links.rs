//! `posebridge lab links`: what a link does to clocks and poses, in virtual time.
//!
//! One part holds every way to align two clocks over links of known delays, the other drives the same lap over link profiles with
//! more loss, delay and clock skew. docs/impairment.md says what is measured.

use std::path::Path;

use anyhow::Result;
use clap::Args;
use posebridge_lab::clocks::compare_methods;
use posebridge_sim::impairment::{LinkProfile, PROFILES};

use super::links_pose::{LinkCase, LinkConditions, PoseRow, drive_lap, summarise};
use super::links_report::report;
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_all;
use crate::tools::experiment_output::OutputArgs;
use crate::tools::link_profile;

/// Seeds of the table of clocks: as many as docs/maths/clock.md shows.
const CLOCK_SEEDS: [u64; 5] = [1, 2, 3, 4, 5];

/// Flags of `lab links`.
#[derive(Args, Clone, Debug)]
pub struct LabLinksArgs {
    /// A bundled link profile's name or a TOML file; may be repeated. Without it all bundled ones.
    #[arg(long = "profile", value_name = "NAME|FILE.toml")]
    pub profiles: Vec<String>,
    /// Probability that what is sent at once is lost, each way, on top of the profile; several with commas.
    #[arg(long = "loss", value_name = "P,..", value_delimiter = ',', default_values_t = [0.0, 0.05], value_parser = a_probability)]
    pub losses: Vec<f64>,
    /// Delay of each way on top of the profile, ms; several with commas.
    #[arg(long = "delay-ms", value_name = "MS,..", value_delimiter = ',', default_values_t = [0.0, 50.0], value_parser = a_delay_ms)]
    pub delays_ms: Vec<f64>,
    /// Rate error of the brick's clock, ppm; several with commas.
    #[arg(long = "skew-ppm", value_name = "PPM,..", value_delimiter = ',', default_values_t = [50.0, 2021.0], value_parser = a_skew_ppm, allow_hyphen_values = true)]
    pub skews_ppm: Vec<f64>,
    /// Laps of each case; world and link differ from lap to lap.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Seed of the first lap.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

fn a_probability(text: &str) -> Result<f64, String> {
    number_within(text, 0.0..=0.99)
}

fn a_delay_ms(text: &str) -> Result<f64, String> {
    number_within(text, 0.0..=10_000.0)
}

/// As far off as the alignment allows.
fn a_skew_ppm(text: &str) -> Result<f64, String> {
    let most_ppm = posebridge_station::clock::MAX_SKEW * 1e6;
    number_within(text, -most_ppm..=most_ppm)
}

fn number_within(text: &str, range: std::ops::RangeInclusive<f64>) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_no_number| format!("`{text}` is not a number"))?;
    if range.contains(&number) {
        Ok(number)
    } else {
        Err(format!("{number} is not from {} to {}", range.start(), range.end()))
    }
}

/// Runs the experiment.
///
/// # Errors
/// A profile does not exist or makes no sense, or an output cannot be written.
pub fn execute(args: &LabLinksArgs) -> Result<(), Failure> {
    let cases = cases(args).before_start()?;
    let folder = args.output.folder()?;
    let clock = compare_methods(&CLOCK_SEEDS);
    let pose = pose_rows(&cases, args.runs).while_running()?;
    args.output.write_outcome(&folder, &report(&clock, &pose))
}

/// Every profile under every circumstance.
fn cases(args: &LabLinksArgs) -> Result<Vec<LinkCase>> {
    let names: Vec<String> = if args.profiles.is_empty() {
        PROFILES.iter().map(|(name, _)| (*name).to_owned()).collect()
    } else {
        args.profiles.clone()
    };
    let mut cases = Vec::new();
    for asked in names {
        let (name, profile) = load_profile(&asked)?;
        for &loss in &args.losses {
            for &delay_ms in &args.delays_ms {
                for &skew_ppm in &args.skews_ppm {
                    cases.push(LinkCase {
                        name: name.clone(),
                        profile: profile.clone(),
                        conditions: LinkConditions { loss, delay_ms, skew_ppm },
                        seed: args.seed,
                    });
                }
            }
        }
    }
    Ok(cases)
}

/// A bundled profile by its name, else one from a file, which is called like it.
fn load_profile(asked: &str) -> Result<(String, LinkProfile)> {
    let profile = link_profile::load(asked)?;
    let file_name = asked.strip_suffix(".toml").and_then(|path| Path::new(path).file_name());
    let name = file_name.map_or_else(|| asked.to_owned(), |name| name.to_string_lossy().into_owned());
    Ok((name, profile))
}

/// Drives all cases on all cores; the result does not depend on how many there are.
fn pose_rows(cases: &[LinkCase], runs: u32) -> Result<Vec<PoseRow>> {
    let jobs: Vec<(usize, u32)> = (0..cases.len()).flat_map(|case| (0..runs).map(move |run| (case, run))).collect();
    let bar = progress_bar(jobs.len() as u64, "laps")?;
    let run = |&(case, run): &(usize, u32)| cases.get(case).map(|case| drive_lap(case, run));
    let laps = run_all(&jobs, run, || bar.inc(1));
    let mut driven: Vec<Vec<_>> = cases.iter().map(|_| Vec::new()).collect();
    for ((case, _), lap) in jobs.iter().zip(laps) {
        if let (Some(list), Some(lap)) = (driven.get_mut(*case), lap) {
            list.push(lap);
        }
    }
    bar.finish_and_clear();
    cases
        .iter()
        .zip(driven)
        .map(|(case, laps)| {
            let laps: Result<Vec<_>> = laps.into_iter().collect();
            Ok(summarise(case, &laps?))
        })
        .collect()
}
