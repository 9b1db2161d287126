//! `posebridge replay`: runs estimators over a recording, offline, with the engine of a live run, so that the events of a posebridge
//! recording are those of the live run, bit for bit. Estimators of a descriptor's run are scored against the truth or the withheld
//! fixes. `--from` and `--to` select the evaluated part: the filter also gets the inputs before it.

pub mod foreign;
pub mod own;
mod result;
pub mod watch;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use anyhow::{Result, bail};
use posebridge_link::HostTimer;
use posebridge_report::tables::{SmoothRow, estimator_table, smooth_table, source_table, wrapped};
use posebridge_report::{EstimatorRow, RunAnswer, SourceTally, final_pose_text};
use posebridge_telemetry::{TimeDelta, Timestamp};
use serde::Serialize;

use super::own_recording::is_own;
use crate::config::{CalibrationEntry, CalibrationKey, Provenance, learnable_keys};
use crate::console::{colour, print_line, print_result};
use crate::exit::{ExitStage, Failure};
use crate::station::learned_calibration::{LearnedCalibration, learned_table, save_all};
use crate::station::run_report::BRICK_ODOMETRY;
use crate::station::wiring_fix::{WiringReport, wiring_text};

pub use self::result::{
    FilterResult, ReplayArgs, ReplayResult, SmoothError, SmoothedResult, SmoothedRun, SmoothingSpan,
};

/// The filter that integrates the wheels alone.
const ODOMETRY: &str = "odometry";

pub fn execute(args: &ReplayArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let replayed = if is_own(&args.session.recording) { own::replay(args)? } else { foreign::replay(args)? };
    print(args, &replayed, timer.now() - Timestamp::ZERO).while_running()?;
    if args.fix_wiring {
        print_result(&format!("\n{}", wiring_text(&replayed.wiring))).while_running()?;
    }
    save_calibration(args, &replayed, timer.utc_start()).while_running()
}

/// Writes the robot as calibrated by the smoother if there was one, else by the last adaptive estimator.
fn save_calibration(args: &ReplayArgs, replayed: &ReplayResult, utc_micros: u64) -> Result<()> {
    let Some(path) = &args.save_calibration else {
        return Ok(());
    };
    let smoothed: Vec<LearnedCalibration> = replayed.smoothed.iter().filter_map(|run| run.learned.clone()).collect();
    if !smoothed.is_empty() {
        let run = smoothed.first().map_or("", |learned| learned.run.as_str());
        let source = format!("{}, {run}", replayed.recording);
        return save_all(path, &smoothed, &Provenance { utc_micros, source, filter: "pose, smoothed".to_owned() });
    }
    let mut learners = replayed.outcomes.iter().rev();
    let Some(filter) = learners.find_map(|outcome| (!outcome.learned.is_empty()).then_some(&outcome.name)) else {
        let names: Vec<_> = replayed.outcomes.iter().map(|o| o.name.as_str()).collect();
        bail!("there is no calibration to save: of {} none learns one", names.join(", "))
    };
    // Of several runs of one robot the last, also where the filter was asked for twice; of several robots each.
    let mut outcomes: Vec<&FilterResult> = Vec::new();
    for outcome in replayed.outcomes.iter().filter(|outcome| outcome.name == *filter) {
        outcomes.retain(|other| other.robot != outcome.robot);
        outcomes.push(outcome);
    }
    let learned = outcomes.into_iter().filter_map(|outcome| outcome.learned.last().cloned());
    let learned: Vec<LearnedCalibration> = learned.collect();
    let run = learned.first().map_or("", |learned| learned.run.as_str());
    let provenance =
        Provenance { utc_micros, source: format!("{}, {run}", replayed.recording), filter: filter.clone() };
    save_all(path, &learned, &provenance)
}

fn print(args: &ReplayArgs, replayed: &ReplayResult, wall: TimeDelta) -> Result<()> {
    if args.json {
        print_result(&(json_text(replayed, wall, cpu_time()?)? + "\n"))?;
        return Ok(());
    }
    let runs = replayed.runs.len();
    let labels: Vec<String> = replayed.outcomes.iter().map(FilterResult::label).collect();
    let rows: Vec<EstimatorRow<'_>> = replayed
        .outcomes
        .iter()
        .zip(&labels)
        .map(|(outcome, name)| EstimatorRow {
            name,
            errors: &outcome.errors,
            runs: runs as u64,
            sources: &outcome.sources,
        })
        .collect();
    let mut text = wrapped(&answer_heading(replayed), "");
    text += &answer(replayed).unwrap_or_default();
    let findings: BTreeSet<String> = replayed.wiring.iter().flat_map(WiringReport::summaries).collect();
    for finding in findings {
        text += &wrapped("wiring     ", &finding);
    }
    text += "\n";
    text += &estimator_table(&rows);
    for outcome in &replayed.outcomes {
        if let Some(rms_m) = outcome.position_rms_uncorrected_m {
            let rms_mm = rms_m * 1e3;
            text += &wrapped(
                "",
                &format!(
                    "{}: judged at the fixes' stamps less the delay that it has learned; at the stamps themselves {rms_mm:.1} mm rms",
                    outcome.name
                ),
            );
        }
    }
    for (outcome, label) in replayed.outcomes.iter().zip(&labels) {
        let is_short = outcome.learned.len() <= 1 || args.detail.verbose;
        let learned = if is_short { learned_table(&outcome.learned) } else { String::new() };
        let sources = if args.detail.verbose { source_table(&outcome.sources) } else { String::new() };
        if !(learned.is_empty() && sources.is_empty()) {
            // Writing to a String cannot fail.
            let _ = write!(text, "\n{label}\n{sources}{learned}");
        }
    }
    for (name, runs) in [("smooth", &replayed.smoothed), ("fixed lag", &replayed.lagged)] {
        if !runs.is_empty() {
            let rows: Vec<SmoothRow<'_>> = runs.iter().map(SmoothedRun::row).collect();
            let learned: Vec<LearnedCalibration> = runs.iter().filter_map(|run| run.learned.clone()).collect();
            // Writing to a String cannot fail.
            let _ = write!(text, "\n{}{}", smooth_table(name, &rows), learned_table(&learned));
        }
    }
    if replayed.bad_rows > 0 {
        print_line(&format!("{} rows could not be used", replayed.bad_rows));
    }
    print_result(&text)?;
    Ok(())
}

fn answer_heading(replayed: &ReplayResult) -> String {
    let runs = match replayed.runs.len() {
        0 | 1 => String::new(),
        runs => format!(", mean of {runs} runs"),
    };
    format!("{}: {} observations{runs}", replayed.recording, replayed.observations)
}

/// The result of the first robot: by the filter with the smallest error, or where no truth is known by the first one that is not
/// odometry alone.
fn answer(replayed: &ReplayResult) -> Option<String> {
    let first = replayed.outcomes.first()?;
    let of_robot = || replayed.outcomes.iter().filter(|outcome| outcome.robot == first.robot);
    let error_m = |outcome: &FilterResult| outcome.errors.position_rms_m.unwrap_or(f64::INFINITY);
    let rank = |outcome: &FilterResult| (outcome.last.is_none(), outcome.name == ODOMETRY);
    let best = of_robot()
        .min_by(|one, other| error_m(one).total_cmp(&error_m(other)).then_with(|| rank(one).cmp(&rank(other))))?;
    let odometry = of_robot().find(|outcome| outcome.name == ODOMETRY && outcome.name != best.name);
    let baseline = odometry.map(|outcome| (ODOMETRY, &outcome.errors));
    let recorded = replayed.odometry.as_ref().map(|errors| (BRICK_ODOMETRY, errors));
    let learned = best.learned.last().map(LearnedCalibration::learned_keys).unwrap_or_default();
    let answer = RunAnswer {
        errors: &best.errors,
        baseline: baseline.or(recorded),
        last: best.last.as_ref(),
        verdict: best.verdict(replayed.runs.len()),
        quantity: best.quantity.clone(),
        learned,
    };
    let name = if of_robot().count() > 1 || first.robot.is_some() { best.label() } else { String::new() };
    let is_compared = of_robot().filter(|outcome| outcome.errors.position_rms_m.is_some()).count() > 1;
    let label = if is_compared { "best" } else { "of" };
    let heading = if name.is_empty() { String::new() } else { format!("{label:<11}{name}\n") };
    let mut text = heading + &answer.text(colour());
    if !is_compared {
        let others = of_robot().filter(|outcome| outcome.name != best.name);
        for (name, last) in others.filter_map(|outcome| Some((outcome.label(), outcome.last?))) {
            text += &wrapped("also       ", &format!("{name}: {}", final_pose_text(&last)));
        }
    }
    Some(text)
}

/// User plus system time of this process.
fn cpu_time() -> Result<TimeDelta> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_SELF)?;
    let micros = |time: nix::sys::time::TimeVal| TimeDelta::from_micros(time.tv_sec() * 1_000_000 + time.tv_usec());
    Ok(micros(usage.user_time()) + micros(usage.system_time()))
}

#[derive(Serialize)]
struct Report<'a> {
    recording: &'a str,
    observations: u64,
    wall_seconds: f64,
    cpu_seconds: f64,
    recorded_seconds: f64,
    times_real_time: Option<f64>,
    changed: &'a [String],
    estimators: Vec<Estimator<'a>>,
    runs: &'a [String],
    bad_rows: u64,
    smooth: Option<BTreeMap<&'a str, SmootherEntry<'a>>>,
    fixed_lag: Option<BTreeMap<&'a str, SmootherEntry<'a>>>,
}

#[derive(Serialize)]
struct SmootherEntry<'a> {
    position_rms_m: Option<f64>,
    position_max_m: Option<f64>,
    position_rms_uncorrected_m: Option<f64>,
    heading_rms_rad: Option<f64>,
    fixes_used: Option<usize>,
    fixes_left_out: Option<usize>,
    iterations: Option<u32>,
    /// `None` without a path, and with a fixed lag.
    converged: Option<bool>,
    cost: Option<f64>,
    anees: Option<f64>,
    calibration: Option<CalibrationEntries>,
    seconds: f64,
    not_read: &'a BTreeMap<&'static str, u64>,
    reason: Option<String>,
}

#[derive(Serialize)]
struct Estimator<'a> {
    name: &'a str,
    /// `None` for a single robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    robot: Option<&'a str>,
    position_rms_m: Option<f64>,
    position_max_m: Option<f64>,
    position_end_m: Option<f64>,
    position_rms_uncorrected_m: Option<f64>,
    heading_rms_rad: Option<f64>,
    anees: Option<f64>,
    consistency: &'static str,
    verdict: String,
    sources: Vec<SourceEntry>,
    calibration: Option<BTreeMap<&'a str, CalibrationEntries>>,
}

pub(super) type CalibrationEntries = BTreeMap<&'static str, CalibrationEntry>;

#[derive(Serialize)]
pub(super) struct SourceEntry {
    name: &'static str,
    used: u64,
    slip: u64,
    gated: u64,
    too_old: u64,
    malformed: u64,
    rebased: u64,
    reset_to: u64,
    unused: u64,
    mean_nis_per_dof: Option<f64>,
    degrees_of_freedom: u64,
    consistency: &'static str,
    due: Option<[f64; 2]>,
}

/// The JSON object as one line of text.
fn json_text(replayed: &ReplayResult, wall: TimeDelta, cpu: TimeDelta) -> Result<String> {
    let report = Report {
        recording: &replayed.recording,
        observations: replayed.observations,
        wall_seconds: wall.as_secs_f64(),
        cpu_seconds: cpu.as_secs_f64(),
        recorded_seconds: replayed.duration.as_secs_f64(),
        times_real_time: (wall > TimeDelta::ZERO).then(|| replayed.duration.as_secs_f64() / wall.as_secs_f64()),
        changed: &replayed.changed_settings,
        estimators: replayed.outcomes.iter().map(|outcome| estimator(outcome, replayed.runs.len())).collect(),
        runs: &replayed.runs,
        bad_rows: replayed.bad_rows,
        smooth: smooth(&replayed.smoothed),
        fixed_lag: smooth(&replayed.lagged),
    };
    Ok(serde_json::to_string(&report)?)
}

fn estimator(outcome: &FilterResult, runs: usize) -> Estimator<'_> {
    let errors = &outcome.errors;
    let verdict = outcome.verdict(runs);
    Estimator {
        name: &outcome.name,
        robot: outcome.robot.as_deref(),
        position_rms_m: errors.position_rms_m,
        position_max_m: errors.position_max_m,
        position_end_m: errors.position_end_m,
        position_rms_uncorrected_m: outcome.position_rms_uncorrected_m,
        heading_rms_rad: errors.heading_rms_rad,
        anees: errors.anees,
        consistency: verdict.finding.as_text(),
        verdict: verdict.to_string(),
        sources: outcome.sources.iter().map(source).collect(),
        calibration: calibration(&outcome.learned),
    }
}

/// Smoother results of each run; `None` if not requested.
fn smooth(runs: &[SmoothedRun]) -> Option<BTreeMap<&str, SmootherEntry<'_>>> {
    let by_run = runs.iter().map(|run| (run.run.as_str(), smooth_of(run)));
    (!runs.is_empty()).then(|| by_run.collect())
}

fn smooth_of(run: &SmoothedRun) -> SmootherEntry<'_> {
    let found = run.result.as_ref().ok();
    let of_found = |count: fn(&SmoothedResult) -> usize| found.map(count);
    SmootherEntry {
        position_rms_m: run.errors.position_rms_m,
        position_max_m: run.errors.position_max_m,
        position_rms_uncorrected_m: run.uncorrected.position_rms_m,
        heading_rms_rad: run.errors.heading_rms_rad,
        fixes_used: of_found(|found| found.fixes_used),
        fixes_left_out: of_found(|found| found.fixes_skipped),
        iterations: found.map(|found| found.iterations),
        converged: found.and_then(|found| found.convergence).map(|convergence| convergence.shortfall().is_none()),
        cost: found.filter(|found| found.convergence.is_some()).map(|found| found.cost),
        anees: run.errors.anees,
        calibration: run.learned.as_ref().map(calibration_entries),
        seconds: run.elapsed.as_secs_f64(),
        not_read: &run.ignored,
        reason: run.reason(),
    }
}

/// Calibration of each run; `None` for an estimator that is not adaptive.
fn calibration(runs: &[LearnedCalibration]) -> Option<BTreeMap<&str, CalibrationEntries>> {
    let by_run = runs.iter().map(|run| (run.run.as_str(), calibration_entries(run)));
    (!runs.is_empty()).then(|| by_run.collect())
}

fn calibration_entries(learned: &LearnedCalibration) -> CalibrationEntries {
    let entry = |key: &CalibrationKey| (key.key, (key.read)(&learned.calibration).into());
    learnable_keys().map(entry).collect()
}

pub(super) fn source(tally: &SourceTally) -> SourceEntry {
    let verdict = tally.verdict();
    SourceEntry {
        name: tally.sensor.name(),
        used: tally.used + tally.reset_to,
        slip: tally.slip,
        gated: tally.gated,
        too_old: tally.too_old,
        malformed: tally.malformed,
        rebased: tally.rebased,
        reset_to: tally.reset_to,
        unused: tally.unused,
        mean_nis_per_dof: tally.mean_nis_per_dof(),
        degrees_of_freedom: tally.degrees_of_freedom(),
        consistency: verdict.finding.as_text(),
        due: verdict.band.map(|band| [band.low, band.high]),
    }
}
