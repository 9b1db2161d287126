//! The figures of the experiment.

use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_lab::wall::{
    ApproachEstimator, KalmanNoise, RangeForecast, WallKalman, WallReading, differences, overlapping_lines,
};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::report::Report;
use posebridge_sim::wall::WallScene;

use super::approaches::{ApproachResult, DistanceSource, EstimatorPlacement};
use super::steps::{PIECE, StepResults};

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
        case.tuning == "tuned" && case.placement == EstimatorPlacement::Brick && case.source != DistanceSource::Faithful
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
    let mut curves = vec![
        Curve::dots("readings", readings),
        Curve::line("line through two", by(&|foreseen| foreseen.line_m.filter(is_visible))),
        Curve::line("range-kf-corrected", by(&|foreseen| Some(foreseen.kalman_m).filter(is_visible))),
    ];
    if !theirs.is_empty() {
        curves.push(Curve::dots("their own filter", theirs.to_vec()));
    }
    Plot::new(format!("{run}: each reading, and what was foretold of it"), "", vec![axes("distance [m]", curves)])
}
