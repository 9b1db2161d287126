//! `posebridge lab links`: the effect of a link on clocks and poses, in virtual time.
//!
//! One part compares all clock alignment methods over links of known delays, the other drives the same lap over link profiles with
//! additional loss, delay and clock skew. docs/impairment.md explains the measurements.

use std::path::Path;

use anyhow::Result;
use clap::Args;
use posebridge_lab::clocks::{ClockRow, compare_methods};
use posebridge_report::chart::{AccuracyChart, AccuracyMark, AccuracyPanel, render_accuracy_chart};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_sim::impairment::{LinkProfile, PROFILES};
use posebridge_sim::{ReceivedEstimate, Scenario, Steering};
use posebridge_telemetry::TimeDelta;
use serde_json::json;

use crate::config::{Config, load_link_profile};
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_cases;
use crate::station::run_report::{SimulationTruth, errors};
use crate::tools::experiment_output::OutputArgs;
use crate::virtual_station::{self, VirtualLink};

/// The seeds of docs/maths/clock.md.
const CLOCK_SEEDS: [u64; 5] = [1, 2, 3, 4, 5];

/// Flags of `lab links`.
#[derive(Args, Clone, Debug)]
pub struct LabLinksArgs {
    /// Bundled link profile by name, or a TOML file. Can be repeated. Default: all bundled ones.
    #[arg(long = "profile", value_name = "NAME|FILE.toml")]
    pub profiles: Vec<String>,
    /// Additional loss probability in each direction; several values separated by commas.
    #[arg(long = "loss", value_name = "P,..", value_delimiter = ',', default_values_t = [0.0, 0.05], value_parser = a_probability)]
    pub losses: Vec<f64>,
    /// Additional delay in each direction, in ms; several values separated by commas.
    #[arg(long = "delay-ms", value_name = "MS,..", value_delimiter = ',', default_values_t = [0.0, 50.0], value_parser = a_delay_ms)]
    pub delays_ms: Vec<f64>,
    /// Rate error of the robot's clock, in ppm; several values separated by commas.
    #[arg(long = "skew-ppm", value_name = "PPM,..", value_delimiter = ',', default_values_t = [50.0, 2021.0], value_parser = a_skew_ppm, allow_hyphen_values = true)]
    pub skews_ppm: Vec<f64>,
    /// Number of laps of each case. Each lap has its own random world and link.
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

/// Limited by the range of the alignment.
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

pub fn execute(args: &LabLinksArgs) -> Result<(), Failure> {
    let cases = cases(args).before_start()?;
    let folder = args.output.folder()?;
    let clock = compare_methods(&CLOCK_SEEDS);
    let pose = pose_rows(&cases, args.runs).while_running()?;
    args.output.write_outcome(&folder, &report(&clock, &pose))
}

fn cases(args: &LabLinksArgs) -> Result<Vec<LinkCase>> {
    let names: Vec<String> = if args.profiles.is_empty() {
        PROFILES.iter().map(|(name, _)| (*name).to_owned()).collect()
    } else {
        args.profiles.clone()
    };
    let mut cases = Vec::new();
    for requested in names {
        let (name, profile) = load_profile(&requested)?;
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

/// A bundled profile by its name, else one from a file, named after the file.
fn load_profile(requested: &str) -> Result<(String, LinkProfile)> {
    let profile = load_link_profile(requested)?;
    let file_name = requested.strip_suffix(".toml").and_then(|path| Path::new(path).file_name());
    let name = file_name.map_or_else(|| requested.to_owned(), |name| name.to_string_lossy().into_owned());
    Ok((name, profile))
}

fn pose_rows(cases: &[LinkCase], runs: u32) -> Result<Vec<PoseRow>> {
    let laps = run_cases(cases, |_| runs, "laps", drive_lap)?;
    let rows = cases.iter().zip(laps).map(|(case, laps)| {
        let laps: Vec<LapResult> = laps.into_iter().collect::<Result<_>>()?;
        Ok(summarise(case, &laps))
    });
    rows.collect()
}

const SCENARIO: &str = "square";
/// Tail of delays and ages beyond p99.
const TAIL_SHARE: f64 = 0.01;
/// Delays of each direction that are combined with each of the other's.
const QUANTILE_SAMPLES: usize = 1_000;

#[derive(Clone, Copy, Debug, PartialEq)]
struct LinkConditions {
    /// Probability of loss per send, each way.
    loss: f64,
    /// Of each direction.
    delay_ms: f64,
    /// Rate error of the brick's clock.
    skew_ppm: f64,
}

struct LinkCase {
    name: String,
    profile: LinkProfile,
    conditions: LinkConditions,
    seed: u64,
}

struct LapResult {
    position_rms_m: Option<f64>,
    odometry_rms_m: Option<f64>,
    ages: Vec<TimeDelta>,
    to_station: Vec<TimeDelta>,
    to_brick: Vec<TimeDelta>,
    outages: u64,
}

#[derive(Clone, Debug, PartialEq)]
struct PoseRow {
    profile: String,
    conditions: LinkConditions,
    /// Root mean squared error over the laps; `None` if a lap had no estimate.
    position_rms_m: Option<f64>,
    /// Of the brick's own odometry.
    odometry_rms_m: Option<f64>,
    /// Age of the estimates on arrival at the brick.
    age_p50_ms: Option<f64>,
    /// 99 % quantile.
    age_p99_ms: Option<f64>,
    /// 99 % quantile of the round trip.
    link_delay_p99_ms: Option<f64>,
    /// In all laps.
    outages: u64,
}

/// Drives one lap; the seeds of world and link depend on the run and not on the case.
fn drive_lap(case: &LinkCase, run: u32) -> Result<LapResult> {
    let seed = case.seed.wrapping_add(u64::from(run));
    let scenario = Scenario::bundled(SCENARIO)?.with_seed(seed).with_steering(Steering::Estimate);
    let config = Config::default().with_camera_of(&scenario);
    let link = VirtualLink {
        profile: case.profile.clone(),
        seed,
        extra_loss: case.conditions.loss,
        extra_delay_ms: case.conditions.delay_ms,
        brick_skew_ppm: Some(case.conditions.skew_ppm),
    };
    let driven = virtual_station::run_over_link(scenario, config.station_config()?, &link)?;
    let (estimate, odometry) = errors(&driven.collector, &SimulationTruth::from_simulation(&driven.simulation));
    let received = driven.simulation.received_estimates();
    Ok(LapResult {
        position_rms_m: estimate.position_rms_m,
        odometry_rms_m: odometry.position_rms_m,
        ages: ages(received),
        to_station: driven.delays_to_station,
        to_brick: driven.delays_to_brick,
        outages: driven.link.outages,
    })
}

/// Age of the first estimate of each instant on arrival at the brick. A late fix corrects an instant for which the brick already has an
/// estimate: it is not counted, because its age does not depend on the link.
fn ages(received: &[ReceivedEstimate]) -> Vec<TimeDelta> {
    let mut latest = None;
    let mut ages = Vec::with_capacity(received.len());
    for estimate in received {
        if latest.is_none_or(|latest| estimate.estimate_time > latest) {
            latest = Some(estimate.estimate_time);
            ages.push(estimate.age());
        }
    }
    ages
}

fn summarise(case: &LinkCase, laps: &[LapResult]) -> PoseRow {
    let ages = sorted(laps, |lap| &lap.ages);
    let directions = [sorted(laps, |lap| &lap.to_station), sorted(laps, |lap| &lap.to_brick)];
    PoseRow {
        profile: case.name.clone(),
        conditions: case.conditions,
        position_rms_m: mean_square(laps, |lap| lap.position_rms_m),
        odometry_rms_m: mean_square(laps, |lap| lap.odometry_rms_m),
        age_p50_ms: quantile_ms(&ages, 0.5),
        age_p99_ms: quantile_ms(&ages, 1.0 - TAIL_SHARE),
        link_delay_p99_ms: round_trip_ms(&directions, 1.0 - TAIL_SHARE),
        outages: laps.iter().map(|lap| lap.outages).sum(),
    }
}

fn sorted(laps: &[LapResult], of: impl Fn(&LapResult) -> &Vec<TimeDelta>) -> Vec<TimeDelta> {
    let mut all: Vec<TimeDelta> = laps.iter().flat_map(|lap| of(lap).iter().copied()).collect();
    all.sort_unstable();
    all
}

fn quantile_ms(sorted: &[TimeDelta], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let index = (last as f64 * share).round() as usize;
    sorted.get(index).map(|delay| delay.as_millis_f64())
}

/// Quantile of the round trip, assuming independent delays of both directions. The sum of both quantiles would be wrong: where one
/// piece in a hundred stalls, one in fifty does there or back.
fn round_trip_ms(directions: &[Vec<TimeDelta>; 2], share: f64) -> Option<f64> {
    let [there, back] = directions.each_ref().map(|direction| even_sample(direction));
    let mut sums: Vec<TimeDelta> = there.iter().flat_map(|there| back.iter().map(move |back| *there + *back)).collect();
    sums.sort_unstable();
    quantile_ms(&sums, share)
}

/// Evenly spaced order statistics, enough that ten of them lie beyond the 99 % quantile.
fn even_sample(sorted: &[TimeDelta]) -> Vec<TimeDelta> {
    let step = |index: usize| sorted.get((2 * index + 1) * sorted.len() / (2 * QUANTILE_SAMPLES));
    (0..QUANTILE_SAMPLES).filter_map(step).copied().collect()
}

fn mean_square(laps: &[LapResult], of: impl Fn(&LapResult) -> Option<f64>) -> Option<f64> {
    let squares = laps.iter().map(|lap| of(lap).map(|rms| rms * rms));
    let sum = squares.sum::<Option<f64>>()?;
    (!laps.is_empty()).then(|| (sum / laps.len() as f64).sqrt())
}

const MS: Unit = Unit::Named("ms");

fn report(clock: &[ClockRow], pose: &[PoseRow]) -> Report {
    let mut report = Report::new("lab-links", "What links do to clocks and poses");
    report.background(
        "Every way to align two clocks gets the same exchanges over links of known delays; then the same lap is driven over each \
         link profile, steered by the estimate. All of it in virtual time.",
    );
    add_clock(&mut report, clock);
    add_pose(&mut report, pose);
    let errors = || pose.iter().filter_map(|row| row.position_rms_m);
    let span = errors().reduce(f64::min).zip(errors().reduce(f64::max));
    let odometry_m = pose.iter().filter_map(|row| row.odometry_rms_m).reduce(f64::max);
    if let (Some((least_m, most_m)), Some(odometry_m)) = (span, odometry_m) {
        report.answer(format!(
            "Over {} links the estimate is {:.1} to {:.1} mm off (rms), the brick's odometry up to {:.1} mm.",
            pose.len(),
            least_m * 1e3,
            most_m * 1e3,
            odometry_m * 1e3
        ));
    }
    report.figure(render_accuracy_chart(&chart(pose)), "Position error of a lap over each link, for each circumstance");
    report
}

fn add_clock(report: &mut Report, rows: &[ClockRow]) {
    let error = Format::new(MS, 3);
    let table = Table::of(rows)
        .text("case", "case", |row| row.case.to_owned())
        .text("method", "method", |row| row.method.to_owned())
        .number("worst_ms", "worst", error, |row| row.worst_ms)
        .number("mean_ms", "mean", error, |row| row.mean_ms);
    report.heading("Clock: error of the offset");
    report.table("clock", &table);
}

fn add_pose(report: &mut Report, rows: &[PoseRow]) {
    let delay = Format::new(MS, 1);
    let table = Table::of(rows)
        .text("profile", "profile", |row| row.profile.clone())
        .text("", "loss", |row| row.conditions.loss.to_string())
        .data("loss", |row| json!(row.conditions.loss))
        .text("", "delay ms", |row| row.conditions.delay_ms.to_string())
        .data("delay_ms", |row| json!(row.conditions.delay_ms))
        .text("", "skew ppm", |row| row.conditions.skew_ppm.to_string())
        .data("skew_ppm", |row| json!(row.conditions.skew_ppm))
        .labels(4)
        .number("position_rms_m", "pose", Format::new(Unit::Millimetres, 2), |row| row.position_rms_m)
        .number("odometry_rms_m", "odometry", Format::new(Unit::Millimetres, 1), |row| row.odometry_rms_m)
        .number("estimate_age_p50_ms", "age p50", delay, |row| row.age_p50_ms)
        .number("estimate_age_p99_ms", "age p99", delay, |row| row.age_p99_ms)
        .number("link_delay_p99_ms", "link p99", delay, |row| row.link_delay_p99_ms)
        .count("outages", "outages", |row| row.outages as usize);
    report.heading("Pose: one lap of the square, steered by the estimate");
    report.table("pose", &table);
}

fn chart(rows: &[PoseRow]) -> AccuracyChart {
    let mut panels: Vec<AccuracyPanel> = Vec::new();
    for row in rows {
        let title = conditions_text(&row.conditions);
        let mark = AccuracyMark { name: row.profile.clone(), rms_m: row.position_rms_m, claimed_m: None, anees: None };
        match panels.iter_mut().find(|panel| panel.title == title) {
            Some(panel) => panel.marks.push(mark),
            None => panels.push(AccuracyPanel { title, marks: vec![mark] }),
        }
    }
    AccuracyChart { title: "Position error of a lap over links".to_owned(), panels }
}

/// The additional impairments in words.
fn conditions_text(of: &LinkConditions) -> String {
    format!("{} % more loss, {} ms more delay, clock {} ppm off", 100.0 * of.loss, of.delay_ms, of.skew_ppm)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(profile: &str) -> LinkCase {
        LinkCase {
            name: profile.to_owned(),
            profile: LinkProfile::bundled(profile).unwrap(),
            conditions: LinkConditions { loss: 0.0, delay_ms: 0.0, skew_ppm: 20.0 },
            seed: 1,
        }
    }

    fn row(profile: &str) -> PoseRow {
        let case = case(profile);
        let laps: Vec<LapResult> = (0..2).map(|run| drive_lap(&case, run).unwrap()).collect();
        summarise(&case, &laps)
    }

    #[test]
    fn two_ways_that_stall_one_time_in_a_hundred_stall_together_one_time_in_fifty() {
        let mut direction: Vec<TimeDelta> = vec![TimeDelta::from_millis(10); 1_000];
        direction[990..].fill(TimeDelta::from_millis(100));
        let directions = [direction.clone(), direction];
        assert_eq!(round_trip_ms(&directions, 0.97), Some(20.0));
        assert_eq!(round_trip_ms(&directions, 0.99), Some(110.0));
        assert_eq!(round_trip_ms(&[Vec::new(), Vec::new()], 0.99), None);
    }

    #[test]
    fn bluetooth_costs_little_accuracy_and_an_estimate_is_no_older_than_its_link() {
        let (usb, bluetooth, wifi) = (row("usb"), row("bluetooth-spp"), row("wifi"));
        println!("{usb:?}\n{bluetooth:?}");
        let ratio = bluetooth.position_rms_m.unwrap() / usb.position_rms_m.unwrap();
        assert!(ratio < 1.2, "{ratio}");
        for row in [usb, bluetooth, wifi] {
            let limit_ms = row.link_delay_p99_ms.unwrap() + 5.0;
            assert!(row.age_p99_ms.unwrap() < limit_ms, "{row:?}");
        }
    }
}
