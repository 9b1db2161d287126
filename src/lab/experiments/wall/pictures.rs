//! The figures of the experiment.

use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_lab::wall::{
    ApproachEstimator, KalmanNoise, PIECE, RangeForecast, WallKalman, WallReading, differences, overlapping_lines,
};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::report::Report;
use posebridge_sim::wall::WallScene;

use super::approaches::{ApproachResult, DistanceSource, EstimatorPlacement};
use super::steps::StepResults;

/// Plots every n-th control cycle: 30 ms are less than a line's width.
const SAMPLE_STRIDE: usize = 4;

fn axes(y_name: &str, curves: impl IntoIterator<Item = Curve>) -> Axes {
    Axes::new("time [s]", y_name, 280.0, curves)
}

pub(super) fn add(report: &mut Report, plot: &Plot) {
    let Plot { title, key_figures, .. } = plot;
    let caption = if key_figures.is_empty() { title.clone() } else { format!("{title}: {key_figures}") };
    report.chart(plot, caption);
}

/// Readings of the first step, and its speed by differences, by lines and in truth.
pub(super) fn step(steps: &StepResults) -> Plot {
    let speeds = |speeds: Vec<posebridge_lab::wall::SpeedSample>| {
        let points = speeds.into_iter().map(|at| (at.at_s, at.towards_m_per_s));
        points.collect::<Vec<_>>()
    };
    let first = &steps.first;
    let commands = first.commands.iter().zip(&first.towards_m_per_s);
    let truth = commands.map(|(command, speed)| (command.at_s, *speed));
    let key = format!("v_ss {:.3} m/s, t90 {:.3} s", steps.all.steady_m_per_s.value, steps.all.rise_90_s.value);
    Plot::new(
        "Step test",
        key,
        vec![
            axes("distance [m]", vec![Curve::dots("readings", steps.log.readings())]),
            axes(
                "speed [m/s]",
                vec![
                    Curve::line("true", truth),
                    Curve::dots("differences", speeds(differences(&steps.log))),
                    Curve::line("lines, half overlapping", speeds(overlapping_lines(&steps.log, PIECE))),
                    Curve::new("v_ss by the fit", CurveShape::Level(steps.all.steady_m_per_s.value)),
                ],
            ),
        ],
    )
}

/// The filter's distance with the paper's three sigmas, minus the fitted distance.
pub(super) fn validation(steps: &StepResults) -> Plot {
    let mut curves = vec![Curve::dots("readings", steps.log.readings())];
    for process_m in [0.01, 0.05, 0.5] {
        let noise = KalmanNoise { process_m, ..KalmanNoise::PAPER };
        let mut kalman = WallKalman::new(steps.all.model(), noise, RangeFilterVariant::Paper);
        let mut points = Vec::new();
        for entry in steps.log.entries() {
            match entry.reading {
                WallReading::Input(input) => kalman.observe_input(entry.at_s, input),
                WallReading::Range(range_m) => kalman.observe_range(entry.at_s, range_m),
            }
            let estimate = kalman.estimate(entry.at_s);
            points.extend(estimate.map(|estimate| (entry.at_s, estimate.distance_m)));
        }
        curves.push(Curve::line(format!("sigma_u {:.0} mm", 1e3 * process_m), points));
    }
    Plot::new("range-kf on the step's own readings", "", vec![axes("distance [m]", curves)])
}

/// The first run of each case with tuned gains on the brick, and the stops of all runs.
pub(super) fn approaches(scene: &WallScene, driven: &[ApproachResult]) -> Plot {
    // The faithful filter's dots would lie under the corrected one's.
    let is_drawn = |driven: &&ApproachResult| {
        let case = driven.case;
        let is_drawn_speed = [scene.approach.most_pwm, scene.approach.fast_pwm].contains(&case.max_pwm);
        let is_method = case.placement == EstimatorPlacement::Brick && case.source != DistanceSource::Faithful;
        case.tuning == "tuned" && is_method && is_drawn_speed
    };
    let tuned: Vec<&ApproachResult> = driven.iter().filter(is_drawn).collect();
    let name = |driven: &ApproachResult| {
        let source = match driven.case.source {
            DistanceSource::LastReading => "last reading",
            DistanceSource::Line => "line",
            DistanceSource::Faithful | DistanceSource::Corrected => "filter",
        };
        format!("{source}, PWM {:.0}", driven.case.max_pwm)
    };
    let curves = tuned.iter().map(|driven| {
        let moments = driven.first.samples.iter().step_by(SAMPLE_STRIDE);
        let trajectory = moments.map(|moment| (moment.at_s, moment.distance_m));
        Curve::line(name(driven), trajectory)
    });
    let mut curves: Vec<Curve> = curves.collect();
    curves.push(Curve::new("target", CurveShape::Level(scene.approach.target_m)));
    let stops = tuned.iter().map(|driven| {
        let stops = driven.stops.iter().flatten();
        let stops = stops.map(|stop| (stop.time_s, 1e3 * stop.error_m));
        Curve::dots(name(driven), stops)
    });
    let stops = axes("error of the stop [mm]", stops);
    Plot::new(
        "Approaches with tuned gains, on the brick",
        "above the first run of each kind, below where and when all of them stopped",
        vec![axes("true distance [m]", curves), stops],
    )
}

/// What the filter knows at each control period of the first approach by `range-kf` at the paper's PWM: distance, speed, input, gate.
pub(super) fn control_periods(driven: &[ApproachResult]) -> Option<Plot> {
    let of = driven.iter().find(|driven| {
        let case = driven.case;
        case.tuning == "tuned" && case.placement == EstimatorPlacement::Brick && case.source == DistanceSource::Faithful
    })?;
    let samples = || of.first.samples.iter().step_by(SAMPLE_STRIDE);
    let estimated = |value: fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
        let known = samples().filter_map(|sample| {
            let estimate = sample.estimate?;
            Some((sample.at_s, value(estimate.distance_m, estimate.towards_m_per_s)))
        });
        known.collect()
    };
    let steps = of.first.samples.len();
    let predicted = 100.0 * (1.0 - of.first.readings.len() as f64 / steps.max(1) as f64);
    let gates = of.gates.iter();
    Some(Plot::new(
        "The first approach by range-kf, at each control period",
        format!("{predicted:.0} % of the steps predict alone"),
        vec![
            axes(
                "distance [m]",
                vec![
                    Curve::line("true", samples().map(|sample| (sample.at_s, sample.distance_m))),
                    Curve::line("range-kf", estimated(|distance_m, _| distance_m)),
                    Curve::dots("readings", of.first.readings.iter().map(|reading| (reading.at_s, reading.range_m))),
                ],
            ),
            Axes::new(
                "time [s]",
                "speed [m/s]",
                160.0,
                [
                    Curve::line("true", samples().map(|sample| (sample.at_s, sample.towards_m_per_s))),
                    Curve::line("range-kf", estimated(|_, towards| towards)),
                ],
            ),
            Axes::new("time [s]", "PWM", 120.0, [Curve::line("motor input", samples().map(|one| (one.at_s, one.pwm)))]),
            Axes::new(
                "time [s]",
                "innovation [mm]",
                160.0,
                [
                    Curve::dots("reading - prediction", gates.clone().map(|one| (one.at_s, 1e3 * one.innovation_m))),
                    Curve::line("gate", gates.clone().map(|one| (one.at_s, 1e3 * one.gate_m))),
                    Curve::line("gate, negative", gates.map(|one| (one.at_s, -1e3 * one.gate_m))),
                ],
            ),
        ],
    ))
}

/// Readings of a recording and their predictions.
pub(super) fn foreseen(run: &str, foreseen: &[RangeForecast], theirs: &[(f64, f64)]) -> Plot {
    let by = |value: &dyn Fn(&RangeForecast) -> Option<f64>| -> Vec<(f64, f64)> {
        let points = foreseen.iter();
        points.filter_map(|foreseen| Some((foreseen.at_s, value(foreseen)?))).collect()
    };
    let readings = by(&|foreseen| Some(foreseen.range_m));
    let (low, high) = readings
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, range_m)| (low.min(*range_m), high.max(*range_m)));
    // A line through two readings of the same instant leads anywhere: the picture would show nothing else.
    let extent = high - low;
    let is_visible = move |value: &f64| *value > low - extent && *value < high + extent;
    let lines = by(&|foreseen| foreseen.lines_m[0].filter(is_visible));
    let within = |sign: f64| by(&|foreseen| Some(foreseen.kalman_m + sign * foreseen.gate_m).filter(is_visible));
    let mut curves = vec![
        Curve::dots("readings", readings),
        Curve::line("line through two", lines),
        Curve::line("filter", by(&|foreseen| Some(foreseen.kalman_m).filter(is_visible))),
        Curve::line("gate, near end", within(-1.0)),
        Curve::line("gate, far end", within(1.0)),
        Curve::dots("refused", by(&|foreseen| Some(foreseen.range_m).filter(|_| foreseen.is_gated))),
    ];
    if !theirs.is_empty() {
        curves.push(Curve::dots("their own filter", theirs.to_vec()));
    }
    let speed = vec![Curve::line("speed towards the wall", by(&|foreseen| Some(foreseen.towards_m_per_s)))];
    let input = vec![Curve::line("motor input", by(&|foreseen| Some(foreseen.input)))];
    Plot::new(
        format!("{run}: each reading, and its prediction"),
        "",
        vec![
            axes("distance [m]", curves),
            Axes::new("time [s]", "speed [m/s]", 160.0, speed),
            Axes::new("time [s]", "input", 120.0, input),
        ],
    )
}
