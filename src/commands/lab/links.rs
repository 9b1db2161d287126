//! `posebridge lab links`: what a link does to clocks and poses, in virtual time.
//!
//! One part holds every way to align two clocks over links of known delays, the other drives the same lap over link profiles with
//! more loss, delay and clock skew. docs/lab-links.md says what is measured.

use std::path::Path;

use anyhow::Result;
use posebridge_analysis::figures::{AccuracyChart, AccuracyMark, AccuracyPanel, accuracy_chart};
use posebridge_analysis::report::page::{Page, Part};
use posebridge_sim::impairment::{LinkProfile, PROFILES};

use super::links_clock::{self, CLOCK_SEEDS};
use super::links_pose::{Case, Circumstance, PoseRow, drive, summarise};
use super::links_report as report;
use super::outcome::Outcome;
use crate::cli::LabLinksArgs;
use crate::commands::{Failure, Stage};
use crate::parallel::run_all;
use crate::{link_profile, progress};

/// Runs the experiment.
///
/// # Errors
/// A profile does not exist or makes no sense, or an output cannot be written.
pub fn execute(args: &LabLinksArgs) -> Result<(), Failure> {
    let cases = cases(args).at_start()?;
    let folder = args.output.folder()?;
    let clock = links_clock::rows(&CLOCK_SEEDS);
    let pose = pose_rows(&cases, args.runs).while_running()?;
    let text = report::tables(&clock, &pose);
    let outcome = Outcome {
        name: "lab-links",
        page: page(&text, &pose),
        json: report::json(&clock, &pose).while_running()?,
        text,
    };
    args.output.deliver(&folder, &outcome)
}

fn page(tables: &str, pose: &[PoseRow]) -> Page {
    Page {
        title: "What links do to clocks and poses".to_owned(),
        parts: vec![
            Part::Text(
                "Every way to align two clocks gets the same exchanges over links of known delays; then the same lap is driven over each \
                 link profile, steered by the estimate. All of it in virtual time."
                    .to_owned(),
            ),
            Part::Lines(tables.to_owned()),
            Part::Figure {
                svg: accuracy_chart(&chart(pose)),
                caption: "Position error of a lap over each link, for each circumstance".to_owned(),
            },
        ],
    }
}

/// Every profile under every circumstance.
fn cases(args: &LabLinksArgs) -> Result<Vec<Case>> {
    let names: Vec<String> = if args.profiles.is_empty() {
        PROFILES.iter().map(|(name, _)| (*name).to_owned()).collect()
    } else {
        args.profiles.clone()
    };
    let mut cases = Vec::new();
    for asked in names {
        let (name, profile) = profile(&asked)?;
        for &loss in &args.losses {
            for &delay_ms in &args.delays_ms {
                for &skew_ppm in &args.skews_ppm {
                    cases.push(Case {
                        name: name.clone(),
                        profile: profile.clone(),
                        circumstance: Circumstance { loss, delay_ms, skew_ppm },
                        seed: args.seed,
                    });
                }
            }
        }
    }
    Ok(cases)
}

/// A bundled profile by its name, else one from a file, which is called like it.
fn profile(asked: &str) -> Result<(String, LinkProfile)> {
    let profile = link_profile::load(asked)?;
    let file_name = asked.strip_suffix(".toml").and_then(|path| Path::new(path).file_name());
    let name = file_name.map_or_else(|| asked.to_owned(), |name| name.to_string_lossy().into_owned());
    Ok((name, profile))
}

/// Drives all cases on all cores; the result does not depend on how many there are.
fn pose_rows(cases: &[Case], runs: u32) -> Result<Vec<PoseRow>> {
    let jobs: Vec<(usize, u32)> = (0..cases.len()).flat_map(|case| (0..runs).map(move |run| (case, run))).collect();
    let bar = progress::bar(jobs.len() as u64, "laps")?;
    let run = |&(case, run): &(usize, u32)| cases.get(case).map(|case| drive(case, run));
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

/// One panel per circumstance, one mark per profile.
fn chart(rows: &[PoseRow]) -> AccuracyChart {
    let mut panels: Vec<AccuracyPanel> = Vec::new();
    for row in rows {
        let title = report::circumstance(&row.circumstance);
        let mark = AccuracyMark { name: row.profile.clone(), rms_m: row.position_rms_m, claimed_m: None, anees: None };
        match panels.iter_mut().find(|panel| panel.title == title) {
            Some(panel) => panel.marks.push(mark),
            None => panels.push(AccuracyPanel { title, marks: vec![mark] }),
        }
    }
    AccuracyChart { title: "Position error of a lap over links".to_owned(), panels }
}
