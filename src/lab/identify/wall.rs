//! `posebridge identify wall`: identifies the drive of a car before a wall from step tests: d and m, steady speed, rise time, measured
//! dt.
//!
//! Without a recording on the simulated car with known parameters. docs/lab/calibration.md, section 7, has the equations; `lab wall`
//! uses the results.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_lab::wall::{StepFit, WallLog, fit_by_hand, fit_steps, loop_period, reading_period};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::report::Report;
use posebridge_sim::wall::{WallScene, simulate_step};

use super::report::{Quantity, report};
use crate::exit::{ExitStage, Failure};
use crate::lab::experiments::wall::recorded::RunSelection;
use crate::lab::experiments::wall::steps::{PIECE, log_of};
use crate::lab::experiments::wall::{recorded, scene};
use crate::tools::experiment_output::OutputArgs;

/// Flags of `identify wall`.
#[derive(clap::Args, Clone, Debug)]
pub struct WallArgs {
    /// Car and sensor, as a TOML file. Default: those of paper 3 (config/scenarios/lab/wall.toml).
    #[arg(long, value_name = "FILE.toml", conflicts_with = "recording")]
    pub scene: Option<PathBuf>,
    /// Number of simulated step tests.
    #[arg(long, value_name = "N", default_value_t = 20, conflicts_with = "recording", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub steps: u32,
    /// Seed of the simulated car. Default: that of the scene.
    #[arg(long, value_name = "N", conflicts_with = "recording")]
    pub seed: Option<u64>,
    /// Descriptor, e.g. config/recordings/tof-wall.toml. Default: the simulated car.
    #[arg(long, value_name = "FILE.toml", group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// What to read of it.
    #[command(flatten)]
    pub selection: RunSelection,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

pub(super) fn execute(args: &WallArgs) -> Result<(), Failure> {
    if let Some(path) = &args.recording {
        let prepared = recorded::prepare(path, &args.selection, None).before_start()?;
        let folder = args.output.folder()?;
        let report = report_of_runs(&path.display().to_string(), &prepared.runs).while_running()?;
        return args.output.write_outcome(&folder, &report);
    }
    let scene = scene(args.scene.as_deref(), args.seed).before_start()?;
    let folder = args.output.folder()?;
    args.output.write_outcome(&folder, &simulated(&scene, args.steps).while_running()?)
}

const NAME: &str = "identify-wall";
const TITLE: &str = "The drive of a car before a wall";

fn simulated(scene: &WallScene, count: u32) -> Result<Report> {
    let logs: Vec<WallLog> = (0..count).map(|run| log_of(scene, &simulate_step(scene, run))).collect();
    let fit = fit_steps(&logs).context("evaluating the steps")?;
    let mut notes = vec![noise_note("all steps", &fit)];
    notes.extend(logs.first().and_then(hand_note));
    let drawn: Vec<Plot> = logs.first().map(|log| picture("the first step", log, &fit)).into_iter().collect();
    let source = format!("simulated, {count} steps, seed {}", scene.seed);
    Ok(report(NAME, TITLE, &source, &quantities(&fit, &logs, Some(scene), None), &notes, &drawn))
}

fn report_of_runs(source: &str, runs: &[recorded::RunLog]) -> Result<Report> {
    let (mut all, mut notes, mut pictures) = (Vec::new(), Vec::new(), Vec::new());
    for run in runs {
        let logs = std::slice::from_ref(&run.log);
        match fit_steps(logs) {
            Ok(fit) => {
                all.extend(quantities(&fit, logs, None, Some(&run.name)));
                notes.push(noise_note(&run.name, &fit));
                notes.push(coverage_note(run, &fit));
                notes.extend(hand_note(&run.log).map(|note| format!("{}: {note}", run.name)));
                pictures.push(picture(&run.name, &run.log, &fit));
            }
            Err(error) => notes.push(format!("{}: {error}", run.name)),
        }
    }
    if all.is_empty() {
        bail!("no run has a result: {}", notes.join("; "));
    }
    Ok(report(NAME, TITLE, source, &all, &notes, &pictures))
}

/// The scene has the truth of a simulated car.
fn quantities(fit: &StepFit, logs: &[WallLog], scene: Option<&WallScene>, of: Option<&str>) -> Vec<Quantity> {
    let car = scene.map(|scene| &scene.car);
    let model = car.map(|car| WallApproachModel::from_step_test(car.steady_m_per_s, car.rise_90_s));
    let rows = [
        ("v_ss", "m/s", Some(fit.steady_m_per_s), car.map(|car| car.steady_m_per_s)),
        ("t90", "s", Some(fit.rise_90_s), car.map(|car| car.rise_90_s)),
        ("d", "s/m", Some(fit.drag_s_per_m), model.map(|model| model.drag_s_per_m)),
        ("m", "s²/m", Some(fit.mass_s2_per_m), model.map(|model| model.mass_s2_per_m)),
        ("dt of the loop", "s", loop_period(logs), scene.map(|scene| scene.control.period_s)),
        ("dt of the readings", "s", reading_period(logs), None),
    ];
    let rows = rows.into_iter().map(|(name, unit, known, truth)| {
        let (value, sigma) = (known.map(|known| known.value), known.map(|known| known.sigma));
        Quantity::new(name, unit, value, sigma).for_run(of.map(str::to_owned)).with_truth(truth)
    });
    rows.collect()
}

fn noise_note(of: &str, fit: &StepFit) -> String {
    format!("{of}: {} readings, noise of a reading by the fit {:.1} mm", fit.readings, 1e3 * fit.range_sigma_m)
}

fn coverage_note(run: &recorded::RunLog, fit: &StepFit) -> String {
    let last_s = run.log.readings().last().map(|(at_s, _)| at_s);
    let driven = run.log.drives_from_s().zip(last_s);
    let driven_s = driven.map_or(0.0, |(from_s, last_s)| last_s - from_s);
    let share = 100.0 * fit.share_reached(driven_s);
    let input = if run.knows_input {
        "the files say what the motors were told"
    } else {
        "no motor input in the files: taken for full drive from the first reading on, of which the sigmas do not know"
    };
    format!("{}: driven for {driven_s:.2} s, by then at {share:.0} % of v_ss; {input}", run.name)
}

fn hand_note(log: &WallLog) -> Option<String> {
    let hand = fit_by_hand(log, PIECE).ok()?;
    Some(format!(
        "one step by hand, lines through {PIECE} readings: v_ss {:.3} m/s, t90 {:.3} s, d {:.4}, m {:.4}",
        hand.steady_m_per_s, hand.rise_90_s, hand.model.drag_s_per_m, hand.model.mass_s2_per_m
    ))
}

fn picture(of: &str, log: &WallLog, fit: &StepFit) -> Plot {
    let explained = fit.fitted_curve(log);
    let points = |value: &dyn Fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
        let rows = explained.iter();
        rows.map(|(at_s, range_m, fitted_m)| (*at_s, value(*range_m, *fitted_m))).collect()
    };
    let above = [
        Curve::dots("readings", points(&|range_m, _| range_m)),
        Curve::line("fitted drive", points(&|_, fitted_m| fitted_m)),
    ];
    let below = [
        Curve::dots("reading - fit", points(&|range_m, fitted_m| 1e3 * (range_m - fitted_m))),
        Curve::new("zero", CurveShape::Level(0.0)),
    ];
    Plot::new(
        format!("Step test: {of}"),
        format!(
            "v_ss {:.3} ± {:.3} m/s, t90 {:.3} ± {:.3} s",
            fit.steady_m_per_s.value, fit.steady_m_per_s.sigma, fit.rise_90_s.value, fit.rise_90_s.sigma
        ),
        vec![Axes::new("time [s]", "distance [m]", 280.0, above), Axes::new("time [s]", "left [mm]", 160.0, below)],
    )
}
