//! The report of the experiment.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::numerics::statistics::{quantile, root_mean_square, wilson_interval_95};
use posebridge_estimator::papers::paper1::WheelMatrices;
use posebridge_estimator::papers::wheel_kf::SingleWheelFilter;
use posebridge_report::chart::plot::{Axes, Curve, CurveShape, Plot, render_plot};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_report::tables::NO_VALUE;
use posebridge_telemetry::DriveGeometry;

use super::methods::DriveState;
use super::noise::{MeanAndVariance, NoiseRecord, RoundingVariances, rounding_variances};
use super::score::{ErrorMetric, MethodOrder, PathErrors, true_speeds};
use super::table::SensorTable;
use super::tuned::ChainMatrices;

/// Methods in the order that the paper claims, over all drives.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodRanking {
    pub matrices: &'static str,
    pub names: Vec<&'static str>,
    pub runs: Vec<Vec<PathErrors>>,
}

/// Another interpretation of the paper, and whether its order holds under it.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperInterpretation {
    pub name: &'static str,
    pub note: &'static str,
    pub metric: ErrorMetric,
    pub order: MethodOrder,
}

#[derive(Clone, Debug)]
pub struct SquareReport {
    pub source: String,
    pub command: String,
    /// The paper's chain under each setting.
    pub rankings: Vec<MethodRanking>,
    pub extended: MethodRanking,
    /// Other interpretations of the paper; empty for a file.
    pub interpretations: Vec<PaperInterpretation>,
    /// Empty for a file.
    pub recoveries: Vec<RecoveryTrial>,
    /// The drives from which `tuned` follows, in a sentence.
    pub tuned_from: String,
    /// The most likely matrices.
    pub tuned: ChainMatrices,
    pub stop: Option<NoiseRecord>,
    pub straight: Option<NoiseRecord>,
    pub example: SquareExample,
}

struct NoiseRow {
    name: &'static str,
    printed: Option<f64>,
    /// From the resolution of the counts alone.
    rounding: Option<fn(&RoundingVariances) -> f64>,
    tuned: Option<fn(&ChainMatrices) -> f64>,
    pick: fn(&NoiseRecord) -> Option<MeanAndVariance>,
}

const SHARE: Format = Format::new(Unit::Percent, 0);
const SPEED: Format = Format::new(Unit::MillimetresPerSecond, 2);
const TURN: Format = Format::new(Unit::DegreesPerSecond, 2);

/// The paper's R, equations 19, 23 and 26, and their sensors.
const NOISE_ROWS: [NoiseRow; 9] = [
    NoiseRow {
        name: "left counter [deg^2]",
        printed: Some(1.5),
        rounding: Some(|rounding| rounding.counter),
        tuned: Some(|tuned| tuned.wheels.variances[0]),
        pick: |record| Some(record.counters?[0]),
    },
    NoiseRow {
        name: "right counter [deg^2]",
        printed: Some(2.5),
        rounding: Some(|rounding| rounding.counter),
        tuned: Some(|tuned| tuned.wheels.variances[1]),
        pick: |record| Some(record.counters?[1]),
    },
    NoiseRow {
        name: "v by counters [(cm/s)^2]",
        printed: Some(5.1),
        rounding: Some(|rounding| rounding.forward),
        tuned: Some(|tuned| tuned.speeds.variances[0]),
        pick: |record| record.forward,
    },
    NoiseRow {
        name: "w by counters [(deg/s)^2]",
        printed: Some(1.938),
        rounding: Some(|rounding| rounding.turn),
        tuned: Some(|tuned| tuned.speeds.variances[1]),
        pick: |record| record.turn,
    },
    NoiseRow {
        name: "th_enc [deg^2]",
        printed: Some(0.938),
        rounding: None,
        tuned: Some(|tuned| tuned.five.variances[1]),
        pick: |record| record.wheel_heading,
    },
    NoiseRow {
        name: "th_gyro [deg^2]",
        printed: Some(0.332),
        rounding: None,
        tuned: Some(|tuned| tuned.five.variances[2]),
        pick: |record| record.gyro_heading,
    },
    NoiseRow::of_sensor("gyro [(deg/s)^2]", |record| record.gyro),
    NoiseRow::of_sensor("accelerometer left [(m/s^2)^2]", |record| Some(record.accelerometers?[0])),
    NoiseRow::of_sensor("camera x [cm^2]", |record| Some(record.camera?[0])),
];

impl NoiseRow {
    const fn of_sensor(name: &'static str, pick: fn(&NoiseRecord) -> Option<MeanAndVariance>) -> Self {
        Self { name, printed: None, rounding: None, tuned: None, pick }
    }
}

struct ProcessRow {
    name: &'static str,
    of: fn(&ChainMatrices) -> f64,
}

/// The paper's Q, equations 19, 23 and 26, as far as innovations depend on it.
const PROCESS_ROWS: [ProcessRow; 7] = [
    ProcessRow { name: "wheel-kf, angle [deg^2]", of: |chain| chain.wheels.process[0] },
    ProcessRow { name: "wheel-kf, rate [(deg/s)^2]", of: |chain| chain.wheels.process[1] },
    ProcessRow { name: "velocity-kf, v [(cm/s)^2]", of: |chain| chain.speeds.process[0] },
    ProcessRow { name: "velocity-kf, w [(deg/s)^2]", of: |chain| chain.speeds.process[1] },
    ProcessRow { name: "ekf5, heading [deg^2]", of: |chain| chain.five.process[2] },
    ProcessRow { name: "ekf5, v [(cm/s)^2]", of: |chain| chain.five.process[3] },
    ProcessRow { name: "ekf5, w [(deg/s)^2]", of: |chain| chain.five.process[4] },
];

impl MethodRanking {
    pub fn order(&self, metric: ErrorMetric) -> MethodOrder {
        super::score::compare_order(&self.names, &self.runs, metric)
    }

    /// Root mean square of one method's error over the drives that have it; `None` without any.
    pub fn rms(&self, method: usize, metric: ErrorMetric) -> Option<f64> {
        let errors: Vec<f64> = self.runs.iter().filter_map(|run| run.get(method)?.value(metric)).collect();
        root_mean_square(&errors)
    }

    /// Number of drives in which a method diverged; [`MethodRanking::rms`] omits these.
    pub fn diverged(&self, method: usize) -> usize {
        let errors = self.runs.iter().filter_map(|run| run.get(method));
        errors.filter(|errors| errors.diverged).count()
    }
}

impl SquareReport {
    /// Tables and figures, without data for programs.
    pub fn report(&self) -> Report {
        let mut report = Report::new("lab-nxt-square", "The square: encoders, wheel filter, speed filter, EKF");
        report.paragraph(self.source.as_str());
        report.command(self.command.as_str());
        self.add_errors(&mut report);
        for ranking in &self.rankings {
            add_order(&mut report, ranking);
        }
        self.add_readings(&mut report);
        self.add_recoveries(&mut report);
        self.add_noise(&mut report);
        self.add_pictures(&mut report);
        report
    }

    fn add_errors(&self, report: &mut Report) {
        // A method of several rankings has the same errors in each.
        let mut rows: Vec<(&MethodRanking, usize, &str)> = Vec::new();
        for ranking in self.rankings.iter().chain([&self.extended]) {
            for (method, name) in ranking.names.iter().enumerate() {
                if rows.iter().all(|(.., known)| known != name) {
                    rows.push((ranking, method, name));
                }
            }
        }
        let (mm, degrees) = (Format::new(Unit::Millimetres, 1), Format::new(Unit::Degrees, 2));
        let table = Table::of(&rows)
            .text("", "method", |(.., name)| (*name).to_owned())
            .number("", "position rms", mm, |(ranking, method, _)| ranking.rms(*method, ErrorMetric::Position))
            .number("", "at the end", mm, |(ranking, method, _)| ranking.rms(*method, ErrorMetric::End))
            .number("", "heading rms", degrees, |(ranking, method, _)| ranking.rms(*method, ErrorMetric::Heading))
            .number("", "v rms", SPEED, |(ranking, method, _)| ranking.rms(*method, ErrorMetric::Forward))
            .number("", "w rms", TURN, |(ranking, method, _)| ranking.rms(*method, ErrorMetric::Turn));
        let position = |(ranking, method, _): &&(&MethodRanking, usize, &str)| {
            ranking.rms(*method, ErrorMetric::Position).unwrap_or(f64::INFINITY)
        };
        let ends = [
            rows.iter().min_by(|one, other| position(one).total_cmp(&position(other))),
            rows.iter().max_by(|one, other| position(one).total_cmp(&position(other))),
        ];
        if let [Some(best), Some(worst)] = ends {
            let text = |row: &(&MethodRanking, usize, &str)| {
                row.0.rms(row.1, ErrorMetric::Position).map_or_else(|| "-".to_owned(), |rms_m| mm.text(rms_m))
            };
            report.answer(format!(
                "Nearest: {} with {} rms; farthest: {} with {}.",
                best.2,
                text(best),
                worst.2,
                text(worst)
            ));
        }
        report.heading("How far off");
        report.table("", &table);
        let diverged = rows.iter().filter_map(|(ranking, method, name)| {
            let (count, drives) = (ranking.diverged(*method), ranking.runs.len());
            (count > 0).then(|| format!("{name} diverged in {count} of {drives} drives, which its figures leave out"))
        });
        report.list(diverged);
    }

    fn add_readings(&self, report: &mut Report) {
        if self.interpretations.is_empty() {
            return;
        }
        let step = |reading: &PaperInterpretation, step: usize| Some(reading.order.steps.get(step)?.share());
        let table = Table::of(&self.interpretations)
            .text("", "reading", |reading| reading.name.to_owned())
            .text("", "compared by", |reading| reading.metric.name().to_owned())
            .labels(2)
            .number("", "raw > wheel-kf", SHARE, move |reading| step(reading, 0))
            .number("", "wheel-kf > speeds", SHARE, move |reading| step(reading, 1))
            .number("", "speeds > ekf5", SHARE, move |reading| step(reading, 2))
            .text("", "all three", |reading| share_text(reading.order.all_hold, reading.order.drives))
            .text("", "on average", |reading| if reading.order.holds_on_average() { "yes" } else { "no" }.to_owned());
        report.heading("Other readings of the paper, with its matrices");
        report.paragraph(
            "Share of the drives in which each step of the order holds. Only a share of 95 % or more is the order of figure 7. The last \
             column asks for less: whether the error falls with each step on average, at 95 %.",
        );
        report.table("", &table);
        report.list(self.interpretations.iter().map(|reading| {
            let left_out = excluded_text(&reading.order).map(|text| format!("; {text}"));
            format!("{}: {}{}", reading.name, reading.note, left_out.unwrap_or_default())
        }));
    }

    fn add_recoveries(&self, report: &mut Report) {
        if self.recoveries.is_empty() {
            return;
        }
        let table = Table::of(&self.recoveries)
            .text("", "filter", |trial| trial.method.to_owned())
            .number("", "start off by", Format::new(Unit::Degrees, 0), |trial| Some(trial.start_error_deg.to_radians()))
            .text("", "ends within 50 mm", |trial| share_text(trial.recovered, trial.drives))
            .number("", "median end", Format::new(Unit::Millimetres, 0), |trial| trial.median_end_m);
        report.heading("Recovery from a wrong start");
        report.paragraph(
            "The filter is given a start heading that is wrong, with the sigma of a right one (0.1 rad), and positions without headings.",
        );
        report.table("", &table);
    }

    fn add_noise(&self, report: &mut Report) {
        let length = |record: Option<&NoiseRecord>| record.map_or(0, |record| record.rows);
        let resolution = rounding_variances(self.example.geometry());
        let four = Format::new(Unit::None, 4);
        let variance = |record: &Option<NoiseRecord>, row: &NoiseRow| {
            let spread = record.as_ref().and_then(row.pick);
            spread.map(|spread| spread.variance)
        };
        let table = Table::of(&NOISE_ROWS)
            .text("", "R of", |row| row.name.to_owned())
            .number("", "paper", Format::new(Unit::None, 3), |row| row.printed)
            .number("", "rounding", four, |row| row.rounding.map(|rounding| rounding(&resolution)))
            .number("", "stop", four, move |row| variance(&self.stop, row))
            .number("", "straight run", four, move |row| variance(&self.straight, row))
            .number("", "tuned", four, |row| row.tuned.map(|tuned| tuned(&self.tuned)));
        report.heading("R from a stop and from a straight run");
        report.paragraph(format!(
            "The stop has {} rows, the straight run {}. At rest a counter stands still, so its R comes out as zero: only the straight run \
             shows the rounding, a twelfth of a tick squared. Gyro and accelerometers are taken from the stop: on the straight run the robot \
             steers, and camera x is the motion itself.",
            length(self.stop.as_ref()),
            length(self.straight.as_ref())
        ));
        report.table("", &table);
        let table = Table::of(&PROCESS_ROWS)
            .text("", "Q over 0.05 s of", |row| row.name.to_owned())
            .number("", "as-printed", Format::new(Unit::None, 3), |row| Some((row.of)(&ChainMatrices::AS_PRINTED)))
            .number("", "tuned", four, |row| Some((row.of)(&self.tuned)));
        report.paragraph(self.tuned_from.as_str());
        report.table("", &table);
    }

    fn add_pictures(&self, report: &mut Report) {
        let example = &self.example;
        let chain = |index: usize| self.rankings.get(index).map_or(Vec::new(), |chain| chain.names.clone());
        report.figure(
            example.wheel_figure(&self.tuned),
            "Figure 5 of the paper, wheel velocities left and right, raw and filtered: the angles lie on each other; the filter smooths \
             the speeds, and as printed it lags where they change.",
        );
        report.figure(
            example.speed_figure(&chain(0)),
            "Figure 6 of the paper, v and w: the filters as printed against the differences of the counts.",
        );
        report.figure(
            example.track_figure("Robot's positions of all the experiments, as-printed", &chain(0)),
            "Figure 7 of the paper: raw encoders and wheel-kf lie on each other, velocity-kf adds what its accelerometers add, ekf5 leans \
             on the gyro.",
        );
        report.figure(
            example.track_figure("The same by integrated speeds", &chain(1)),
            "Figure 7 with equation 13 on the filtered speeds: wheel-kf is another track.",
        );
        report.figure(example.track_figure("The same, tuned", &chain(2)), "Figure 7 with the most likely matrices.");
        report.figure(
            example.track_figure("Tracks, the outlook", &self.extended.names),
            "What the paper leaves for later: sigma points, compass, camera, all sensors in one filter.",
        );
        report.figure(
            example.distance_figure(&["raw encoders", "ekf5", "ekf5-camera", "ekf5-camera-corrected", "ukf-all: all sensors"]),
            "How far each filter is from the reference: dead reckoning drifts, a filter with a camera recovers or is lost.",
        );
    }
}

fn add_order(report: &mut Report, ranking: &MethodRanking) {
    let order = ranking.order(ErrorMetric::Position);
    let three = Format::new(Unit::None, 3);
    let table = Table::of(&order.steps)
        .text("", "worse than, by position rms", |step| format!("{} > {}", step.worse, step.better))
        .text("", "share of drives", |step| share_text(step.holds, step.drives))
        .text("", "sign test p", |step| format!("{:.1e}", step.sign_p))
        .number("", "ratio", three, |step| Some(step.ratio?[0]))
        .text("", "95 % interval", |step| {
            step.ratio.map_or(NO_VALUE.to_owned(), |[_, low, high]| format!("{low:.3} to {high:.3}"))
        })
        .text("", "verdict", |step| step.as_text().to_owned());
    report.heading(format!("The order, {}", ranking.matrices));
    report.table("", &table);
    report.paragraph(format!("All of them together: {} of the drives.", share_text(order.all_hold, order.drives)));
    if let Some(text) = excluded_text(&order) {
        report.paragraph(text);
    }
}

/// Number of drives that an order omits; `None` for zero.
fn excluded_text(order: &MethodOrder) -> Option<String> {
    (order.excluded > 0).then(|| {
        format!(
            "{} of {} drives are left out: a method diverged, or there was nothing to compare with",
            order.excluded,
            order.excluded + order.drives
        )
    })
}

/// A share with its 95 % interval.
fn share_text(holds: u64, drives: u64) -> String {
    let [low, high] = wilson_interval_95(holds, drives).map(|share| 100.0 * share);
    format!("{} % ({low:.0} to {high:.0})", (100.0 * holds as f64 / drives.max(1) as f64).round())
}

/// One method over drives whose start is wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct RecoveryTrial {
    pub method: &'static str,
    /// Error of the heading that the filter is given at the start, degrees.
    pub start_error_deg: f64,
    /// Drives that end within [`RecoveryTrial::LIMIT_M`] of the truth.
    pub recovered: u64,
    pub drives: u64,
    pub median_end_m: Option<f64>,
}

impl RecoveryTrial {
    pub const LIMIT_M: f64 = 0.05;

    /// `ends_m` are the distances to the truth at the end; `None` where the method diverged.
    pub fn new(method: &'static str, start_error_deg: f64, ends_m: &[Option<f64>]) -> Self {
        let known: Vec<f64> = ends_m.iter().flatten().copied().collect();
        Self {
            method,
            start_error_deg,
            recovered: known.iter().filter(|end_m| **end_m <= Self::LIMIT_M).count() as u64,
            drives: ends_m.len() as u64,
            median_end_m: quantile(&known, 0.5),
        }
    }
}

#[derive(Clone, Debug)]
pub struct SquareExample {
    pub table: SensorTable,
    pub config: FilterConfig,
    /// Every `camera_every`-th image is used by the filters.
    pub camera_every: usize,
    pub paths: Vec<(&'static str, Vec<DriveState>)>,
}

impl SquareExample {
    fn path(&self, name: &str) -> &[DriveState] {
        let known = self.paths.iter().find(|(known, _)| *known == name);
        known.map_or(&[], |(_, path)| path)
    }

    fn over_time(&self, values: impl Fn(usize) -> Option<f64>) -> Vec<(f64, f64)> {
        let rows = self.table.rows.iter().enumerate();
        rows.filter_map(|(row, known)| Some((known.time_s, values(row)?))).collect()
    }

    /// Both wheels, filtered with these matrices, row by row.
    fn wheels(&self, matrices: &WheelMatrices) -> Vec<[SingleWheelFilter; 2]> {
        let unit_deg = self.table.unit.rad_per_unit(&self.config.geometry).to_degrees();
        let mut wheels = SingleWheelFilter::pair(matrices);
        let base = self.table.rows.first().map_or([0.0; 2], |row| row.encoders);
        let mut before_s = None;
        let rows = self.table.rows.iter().map(|row| {
            if let Some(before_s) = before_s.replace(row.time_s) {
                for (side, wheel) in wheels.iter_mut().enumerate() {
                    wheel.predict(row.time_s - before_s);
                    let _innovation = wheel.update((row.encoders[side] - base[side]) * unit_deg);
                }
            }
            wheels
        });
        rows.collect()
    }

    /// Figure 5: the left wheel's angle and both wheels' speeds, counted and filtered.
    pub fn wheel_figure(&self, tuned: &ChainMatrices) -> String {
        let unit_deg = self.table.unit.rad_per_unit(&self.config.geometry).to_degrees();
        let rows = &self.table.rows;
        let printed = self.wheels(&WheelMatrices::AS_PRINTED);
        let tuned = self.wheels(&tuned.wheels);
        let base = rows.first().map_or([0.0; 2], |row| row.encoders);
        let side = |side: usize| {
            let counted = self.over_time(|row| {
                let before = rows.get(row.checked_sub(1)?)?;
                let dt_s = rows[row].time_s - before.time_s;
                Some((rows[row].encoders[side] - before.encoders[side]) * unit_deg / dt_s)
            });
            vec![
                Curve::line("differences of counts", counted),
                Curve::line("wheel-kf, as-printed", self.over_time(|row| Some(printed[row][side].mean[1]))),
                Curve::line("wheel-kf, tuned", self.over_time(|row| Some(tuned[row][side].mean[1]))),
            ]
        };
        let angle = |side: usize| self.over_time(|row| Some((rows[row].encoders[side] - base[side]) * unit_deg));
        let angles = vec![
            Curve::line("left, counted", angle(0)),
            Curve::line("left, wheel-kf", self.over_time(|row| Some(printed[row][0].mean[0]))),
            Curve::line("right, counted", angle(1)),
            Curve::line("right, wheel-kf", self.over_time(|row| Some(printed[row][1].mean[0]))),
        ];
        render_figure(
            "Wheel positions and speeds",
            "figure 5 of the paper: what a counter says, and one Kalman filter per wheel",
            vec![
                ("angle [degrees]", angles),
                ("left wheel [degrees/s]", side(0)),
                ("right wheel [degrees/s]", side(1)),
            ],
        )
    }

    /// Figure 6: v and w.
    pub fn speed_figure(&self, names: &[&str]) -> String {
        let panel = |state: usize, truth: usize, factor: f64| {
            let mut curves: Vec<Curve> = names
                .iter()
                .map(|name| {
                    let path = self.path(name);
                    Curve::line(*name, self.over_time(|row| Some(path.get(row)?[state] * factor)))
                })
                .collect();
            let true_ones = self.over_time(|row| Some(true_speeds(&self.table, row)?[truth] * factor));
            if !true_ones.is_empty() {
                curves.push(Curve::line("truth", true_ones));
            }
            curves
        };
        render_figure(
            "Forward speed and turn rate",
            "figure 6 of the paper",
            vec![("v [cm/s]", panel(3, 0, 100.0)), ("w [degrees/s]", panel(4, 1, 1f64.to_degrees()))],
        )
    }

    /// Figure 7: the tracks of some methods with the reference.
    pub fn track_figure(&self, title: &str, names: &[&str]) -> String {
        let measured: Vec<(f64, f64)> = (self.table.references(self.camera_every).into_iter())
            .flatten()
            .map(|measured| (measured.x_m, measured.y_m))
            .collect();
        let reference = if self.table.has_truth() { "truth" } else { "camera" };
        // Of a closed path nothing is known but its end: a line of one point would not be seen.
        let shape = if measured.len() > 1 { CurveShape::Line(measured) } else { CurveShape::Dots(measured) };
        let mut curves = vec![Curve::new(reference, shape)];
        curves.extend(names.iter().map(|name| {
            let path = self.path(name).iter().map(|state| (state[0], state[1]));
            Curve::line(*name, path)
        }));
        render_plot(&Plot::new(
            title,
            "figure 7 of the paper: x and y",
            vec![Axes::new("x [m]", "y [m]", 560.0, curves).with_equal_scales()],
        ))
    }

    /// Distance to the reference over time.
    pub fn distance_figure(&self, names: &[&str]) -> String {
        let references = self.table.references(self.camera_every);
        let curves = names.iter().map(|name| {
            let path = self.path(name);
            let distance = self.over_time(|row| {
                let (state, reference) = (path.get(row)?, (*references.get(row)?)?);
                Some(1e3 * (state[0] - reference.x_m).hypot(state[1] - reference.y_m))
            });
            Curve::line(*name, distance)
        });
        render_figure("Distance to the reference", "with and without a camera", vec![("mm", curves.collect())])
    }

    pub const fn geometry(&self) -> &DriveGeometry {
        &self.config.geometry
    }
}

fn render_figure(title: &str, key_figures: &str, panels: Vec<(&str, Vec<Curve>)>) -> String {
    let axes = panels.into_iter().map(|(y_name, curves)| Axes::new("time [s]", y_name, 220.0, curves));
    render_plot(&Plot::new(title, key_figures, axes.collect()))
}
