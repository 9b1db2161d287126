//! `posebridge identify wall`: identifies the drive of a car before a wall from step tests: d and m, steady speed, rise time, measured
//! dt.
//!
//! Without a recording on the simulated car with known parameters. docs/lab/calibration.md, section 7, has the equations; `lab wall`
//! uses the results.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::numerics::statistics::mean;
use posebridge_lab::wall::{
    ManualStepFit, PIECE, SingleStep, SpeedSample, StepFit, WallLog, find_step, fit_by_hand, fit_steps, loop_period,
    reading_period,
};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::report::Report;
use posebridge_sim::wall::{WallScene, simulate_step};
use posebridge_telemetry::UncertainValue;

use super::report::{Quantity, report};
use crate::exit::{ExitStage, Failure};
use crate::lab::experiments::wall::recorded::RunSelection;
use crate::lab::experiments::wall::steps::log_of;
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
    /// Descriptor, e.g. config/recordings/tof-wall.toml, posebridge recording, or table with the columns time and distance.
    /// Default: the simulated car.
    #[arg(long, value_name = "FILE.toml|FILE.mcap|FILE.csv", group = "real_robot")]
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
    Ok(report(NAME, TITLE, &source, &quantities(&fit, &logs, scene), &notes, &drawn))
}

fn report_of_runs(source: &str, runs: &[recorded::RunLog]) -> Result<Report> {
    let (mut all, mut notes, mut pictures) = (Vec::new(), Vec::new(), Vec::new());
    let mut refusals = Vec::new();
    for run in runs {
        notes.push(format!("{}: {}", run.name, run.input.note));
        match find_step(&run.log, run.input.command) {
            Ok(step) => {
                all.extend(quantities_of_step(&step, run));
                notes.push(window_note(run, &step));
                notes.extend(step.undetermined.map(|reason| format!("{}: {reason}", run.name)));
                pictures.push(picture_of_step(&run.name, &step));
            }
            Err(error) => refusals.push(format!("{}: {error}", run.name)),
        }
    }
    if all.is_empty() {
        bail!("no run has a result: {}", refusals.join("; "));
    }
    notes.extend(refusals);
    Ok(report(NAME, TITLE, source, &all, &notes, &pictures))
}

/// Both ways of finding the speed, by hand and by the fit, and what follows from the fit.
fn quantities_of_step(step: &SingleStep, run: &recorded::RunLog) -> Vec<Quantity> {
    let hand = step.by_hand.as_ref().ok();
    let by_hand = |of: fn(&ManualStepFit) -> f64| hand.map(|hand| UncertainValue { value: of(hand), sigma: f64::NAN });
    let logs = std::slice::from_ref(&run.log);
    let rows = [
        ("v_ss by finite differences", "m/s", by_hand(|hand| hand.steady_by_difference_m_per_s)),
        ("v_ss by lines", "m/s", by_hand(|hand| hand.steady_m_per_s)),
        ("v_ss", "m/s", step.steady_m_per_s),
        ("t90", "s", step.rise_90_s),
        ("d", "s/m", step.drag_s_per_m),
        ("m", "s²/m", step.mass_s2_per_m),
        ("begins to move", "s", Some(step.onset_s)),
        ("dt of the loop", "s", loop_period(logs)),
        ("dt of the readings", "s", reading_period(logs)),
    ];
    let rows = rows.into_iter().map(|(name, unit, known)| {
        let sigma = known.map(|known| known.sigma).filter(|sigma| sigma.is_finite());
        Quantity::new(name, unit, known.map(|known| known.value), sigma).for_run(run.name.clone())
    });
    rows.collect()
}

fn window_note(run: &recorded::RunLog, step: &SingleStep) -> String {
    let (from_s, to_s) = step.window_s;
    let (before, after) = step.left_out;
    let mut note = format!(
        "{}: the step is the {} readings from {from_s:.2} s to {to_s:.2} s, noise {:.1} mm, {:.2} m/s at the last one",
        run.name,
        step.readings,
        1e3 * step.range_sigma_m,
        step.last_m_per_s
    );
    for (count, what) in [
        (before, "before it are another movement"),
        (after, "after it are a stop, a contact or another movement"),
        (step.outliers, "within it are beyond four sigmas"),
    ] {
        if count > 0 {
            // Writing to a String cannot fail.
            let _ = write!(note, "; {count} readings {what}");
        }
    }
    note
}

/// The scene has the truth of a simulated car.
fn quantities(fit: &StepFit, logs: &[WallLog], scene: &WallScene) -> Vec<Quantity> {
    let car = &scene.car;
    let model = WallApproachModel::from_step_test(car.steady_m_per_s, car.rise_90_s);
    let by_hand: Vec<ManualStepFit> = logs.iter().filter_map(|log| fit_by_hand(log, PIECE).ok()).collect();
    let speeds = |of: fn(&ManualStepFit) -> f64| {
        let (value, sigma) = mean_and_spread(&by_hand.iter().map(of).collect::<Vec<_>>())?;
        Some(UncertainValue { value, sigma })
    };
    let steady = Some(car.steady_m_per_s);
    let rows = [
        ("v_ss by finite differences", "m/s", speeds(|hand| hand.steady_by_difference_m_per_s), steady),
        ("v_ss by lines", "m/s", speeds(|hand| hand.steady_m_per_s), steady),
        ("v_ss", "m/s", Some(fit.steady_m_per_s), steady),
        ("t90", "s", Some(fit.rise_90_s), Some(car.rise_90_s)),
        ("d", "s/m", Some(fit.drag_s_per_m), Some(model.drag_s_per_m)),
        ("m", "s²/m", Some(fit.mass_s2_per_m), Some(model.mass_s2_per_m)),
        ("dt of the loop", "s", loop_period(logs), Some(scene.control.period_s)),
        ("dt of the readings", "s", reading_period(logs), None),
    ];
    let rows = rows.into_iter().map(|(name, unit, known, truth)| {
        let (value, sigma) = (known.map(|known| known.value), known.map(|known| known.sigma));
        Quantity::new(name, unit, value, sigma).with_truth(truth)
    });
    rows.collect()
}

/// Mean over the steps, and the sigma of that mean; `None` for a single step.
fn mean_and_spread(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let centre = mean(values.iter().copied())?;
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    (values.len() > 1).then(|| (centre, (squares / (count - 1.0) / count).sqrt()))
}

fn noise_note(of: &str, fit: &StepFit) -> String {
    format!("{of}: {} readings, noise of a reading by the fit {:.1} mm", fit.readings, 1e3 * fit.range_sigma_m)
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

fn picture_of_step(of: &str, step: &SingleStep) -> Plot {
    let readings: Vec<(f64, f64)> = step.curve.iter().map(|(at_s, range_m, _)| (*at_s, *range_m)).collect();
    let fitted: Vec<(f64, f64)> = step.curve.iter().map(|(at_s, _, fitted_m)| (*at_s, *fitted_m)).collect();
    let left: Vec<(f64, f64)> =
        step.curve.iter().map(|(at_s, range_m, fitted_m)| (*at_s, 1e3 * (range_m - fitted_m))).collect();
    let slopes = |pairs: &[SpeedSample]| pairs.iter().map(|at| (at.at_s, at.towards_m_per_s)).collect::<Vec<_>>();
    let known = |name: &str, unit: &str, known: Option<UncertainValue>| {
        known.map_or_else(
            || format!("{name} not known"),
            |one| format!("{name} {:.3} ± {:.3} {unit}", one.value, one.sigma),
        )
    };
    Plot::new(
        format!("Step test: {of}"),
        format!("{}, {}", known("v_ss", "m/s", step.steady_m_per_s), known("t90", "s", step.rise_90_s)),
        vec![
            Axes::new(
                "time [s]",
                "distance [m]",
                280.0,
                [Curve::dots("readings", readings), Curve::line("fitted drive", fitted)],
            ),
            Axes::new(
                "time [s]",
                "speed [m/s]",
                200.0,
                [
                    Curve::dots("finite differences", slopes(&step.differences)),
                    Curve::line("lines, half overlapping", slopes(&step.lines)),
                    Curve::line("fitted drive", step.speeds.clone()),
                ],
            ),
            Axes::new(
                "time [s]",
                "left [mm]",
                160.0,
                [Curve::dots("reading - fit", left), Curve::new("zero", CurveShape::Level(0.0))],
            ),
        ],
    )
}
