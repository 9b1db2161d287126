//! Report and figures of `calibrate path`.

use posebridge_lab::calibration::free_path::{
    DeadReckonedPath, DeadReckoningError, FreePath, PathCalibration, UnknownStatus, Wiring, mean_error,
};
use posebridge_report::chart::plot::{Axes, Curve, CurveShape, Plot};
use posebridge_report::quantity::{Format, Quantity, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_telemetry::Calibration;
use serde_json::{Map, Value, json};

use crate::config::RobotFile;

const MAX_PLOTTED_RUNS: usize = 3;
/// Consistency from which the parameters do not explain the drive.
const UNEXPLAINED: f64 = 100.0;
/// Ratio by which a described noise must be wrong to be reported; sigmas are about as uncertain.
const ROUGH: f64 = 4.0;

pub(super) struct PathCalibrationResult {
    pub(super) recording: String,
    pub(super) reference: &'static str,
    /// Before the calibration.
    pub(super) robot: RobotFile,
    pub(super) calibrated: RobotFile,
    pub(super) residual: Calibration,
    pub(super) fit: PathCalibration,
    pub(super) runs: Vec<RunComparison>,
    pub(super) validation_runs: Vec<RunComparison>,
}

pub(super) struct RunComparison {
    pub(super) path: FreePath,
    /// Before and after the calibration.
    pub(super) reckoned: [DeadReckonedPath; 2],
}

impl RunComparison {
    fn errors(&self) -> [DeadReckoningError; 2] {
        self.reckoned.each_ref().map(|path| path.error)
    }
}

impl PathCalibrationResult {
    pub(super) fn report(&self) -> Report {
        let mut report = Report::new("calibrate-path", format!("Calibration by a watched drive: {}", self.recording));
        report.paragraph(format!("{} run(s), compared with: {}", self.runs.len(), self.reference));
        report.background("docs/lab/calibration.md says what the numbers mean.");
        let findings = self.findings();
        for finding in &findings {
            report.warning(finding);
        }
        self.add_unknowns(&mut report);
        self.add_geometry(&mut report);
        for (what, runs) in [("the runs it was found on", &self.runs), ("other runs", &self.validation_runs)] {
            add_errors(&mut report, what, runs);
        }
        for run in self.runs.iter().chain(&self.validation_runs).take(MAX_PLOTTED_RUNS) {
            let caption = format!("{}: where it was seen, and dead reckoning alone before and after.", run.path.name);
            report.chart(&plot(run), caption);
        }
        report.data("recording", json!(self.recording));
        report.data("against", json!(self.reference));
        report.data("sanity", self.sanity());
        report.data("findings", json!(findings));
        report.data("runs", self.runs.iter().map(run_json).collect());
        report.data("tried", self.validation_runs.iter().map(run_json).collect());
        report
    }

    fn add_unknowns(&self, report: &mut Report) {
        let (signed, plain) = (Format::new(Unit::None, 5).signed(), Format::new(Unit::None, 5));
        let entries = &self.fit.entries;
        let table = Table::of(entries)
            .text("", "number", |entry| entry.unknown.key().to_owned())
            .number("", "before", signed, |entry| Some(entry.before.value))
            .number("", "found", signed, |entry| Some(entry.after.value))
            .number("", "sigma", plain, |entry| Some(entry.after.sigma))
            .text("", "standing", |entry| status_names(entry.status)[0].to_owned());
        report.heading("Numbers");
        report.table("", &table);
        let has = |status| entries.iter().any(|entry| entry.status == status);
        if has(UnknownStatus::Unobservable) {
            report.paragraph("Not seen: this drive does not show it, so that it was left as it was.");
        }
        if has(UnknownStatus::NotSeparable) {
            report.paragraph("Not separable: it could as well be the track; drive turns to both sides.");
        }
        let numbers = entries.iter().map(|entry| {
            let object = json!({
                "before": entry.before.value,
                "value": entry.after.value,
                "sigma": entry.after.sigma,
                "standing": status_names(entry.status)[1],
            });
            (entry.unknown.key().to_owned(), object)
        });
        report.data("numbers", Value::Object(numbers.collect::<Map<String, Value>>()));
        report.values([Quantity::new(
            "consistency",
            "innovations' variance, times what is described",
            self.fit.consistency,
            Format::new(Unit::None, 2),
        )]);
        if !(1.0 / ROUGH..=ROUGH).contains(&self.fit.consistency) {
            report.paragraph("The sigmas do not use the variance of the innovations.");
        }
    }

    fn add_geometry(&self, report: &mut Report) {
        let (before, after) = (&self.robot, &self.calibrated);
        let rows = [
            ("left wheel radius", before.left_wheel_radius_m, after.left_wheel_radius_m),
            ("right wheel radius", before.right_wheel_radius_m, after.right_wheel_radius_m),
            ("track width", before.track_width_m, after.track_width_m),
        ];
        let mm = Format::new(Unit::Millimetres, 3);
        let table = Table::of(&rows)
            .text("", "geometry", |(name, ..)| (*name).to_owned())
            .number("", "before", mm, |(_, before_m, _)| Some(*before_m))
            .number("", "found", mm, |(.., after_m)| Some(*after_m));
        report.heading("Geometry");
        report.table("", &table);
        let radius_m = f64::midpoint(after.left_wheel_radius_m, after.right_wheel_radius_m);
        let count_m = std::f64::consts::TAU * radius_m / after.ticks_per_turn;
        let windows = self.fit.length_windows.map(|windows| windows as f64);
        report.values([
            Quantity::new("", "travel per count", count_m, Format::new(Unit::Millimetres, 4)),
            Quantity::optional("", "windows whose length gave the radius", windows, Format::new(Unit::None, 0)),
        ]);
        report.data("length_windows", json!(self.fit.length_windows));
        report.data(
            "robot",
            json!({
                "left_wheel_radius_m": after.left_wheel_radius_m,
                "right_wheel_radius_m": after.right_wheel_radius_m,
                "track_width_m": after.track_width_m,
            }),
        );
    }

    fn sanity(&self) -> Value {
        let sanity = self.fit.hypothesis_test.as_ref().map(|sanity| {
            json!({
                "is_sound": sanity.is_sound(),
                "wiring": sanity.found.wiring,
                "track_factor": sanity.found.track_factor,
                "travel_factor": sanity.found.travel_factor,
                "described_rms_m": sanity.described_rms_m,
                "found_rms_m": sanity.found_rms_m,
                "log_likelihood_gain": sanity.log_likelihood_gain,
            })
        });
        json!(sanity)
    }

    /// Errors of the description, and what to change in which file.
    fn findings(&self) -> Vec<String> {
        let mut findings = Vec::new();
        if self.fit.consistency > UNEXPLAINED {
            findings.push(format!(
                "these numbers do not explain the drive: its innovations have {:.0} times the described variance. Do not use them; the wheels slipped, the noise is described far too small, or the drive is too long: choose a shorter one",
                self.fit.consistency
            ));
        }
        let Some(sanity) = &self.fit.hypothesis_test else {
            return findings;
        };
        let before = findings.len();
        let found = sanity.found;
        if let Some(wiring) = wiring_text(found.wiring) {
            findings.push(wiring);
        }
        if found.track_factor != 1.0 {
            findings.push(format!(
                "`robot.track_width_m` is {} and fits {} times that: {}; write about {:.4}",
                self.robot.track_width_m,
                found.track_factor,
                if found.track_factor > 1.0 {
                    "it is half the distance between the wheels"
                } else {
                    "it is twice the distance between the wheels"
                },
                self.calibrated.track_width_m
            ));
        }
        if found.travel_factor != 1.0 {
            findings.push(format!(
                "a count moves the wheels by {} times what `robot.ticks_per_turn` = {} and the radii say: write ticks_per_turn = {} (a quadrature decoder counts 1, 2 or 4 times) or mend the radii (radius or diameter?)",
                found.travel_factor,
                self.robot.ticks_per_turn,
                self.robot.ticks_per_turn / found.travel_factor
            ));
        }
        if findings.len() > before {
            findings.push(format!(
                "the way fits to {:.0} mm then and to {:.0} mm as described (ln L {:+.0}, {} descriptions compared)",
                1e3 * sanity.found_rms_m,
                1e3 * sanity.described_rms_m,
                sanity.log_likelihood_gain,
                sanity.compared
            ));
        }
        findings
    }
}

fn wiring_text(wiring: Wiring) -> Option<String> {
    let direction = "in the descriptor, or turn its direction round on the brick";
    let reversed = |wheel| format!("the {wheel} wheel counts backwards: give its column `scale = -1` {direction}");
    let swapped_reversed = |wheel| {
        format!(
            "the wheels are swapped, and what is called {wheel} counts backwards: exchange `left` and `right` and give the former \
             {wheel} column `scale = -1`"
        )
    };
    Some(match wiring {
        Wiring::AsGiven => return None,
        Wiring::Swapped => {
            "the wheels are swapped: what is called left is the right one (or the track has the wrong sign); exchange \
                            `left` and `right` of the stream in the descriptor, or the two plugs on the brick"
                .to_owned()
        }
        Wiring::BothReversed => {
            "both wheels count backwards: give both columns `scale = -1` in the descriptor, or turn the motors' \
                                 direction round on the brick"
                .to_owned()
        }
        Wiring::LeftReversed => reversed("left"),
        Wiring::RightReversed => reversed("right"),
        Wiring::SwappedLeftReversed => swapped_reversed("left"),
        Wiring::SwappedRightReversed => swapped_reversed("right"),
    })
}

/// In the text, and in JSON.
const fn status_names(status: UnknownStatus) -> [&'static str; 2] {
    match status {
        UnknownStatus::Estimated => ["found"; 2],
        UnknownStatus::Fixed => ["held"; 2],
        UnknownStatus::Unobservable => ["not seen", "unseen"],
        UnknownStatus::NotSeparable => ["not separable", "not_separable"],
    }
}

/// A table of the errors of runs, with their mean first.
fn add_errors(report: &mut Report, what: &str, runs: &[RunComparison]) {
    if runs.is_empty() {
        return;
    }
    let mean = [0, 1].map(|which| mean_error(&runs.iter().map(|run| run.errors()[which]).collect::<Vec<_>>()));
    let of_runs = runs.iter().map(|run| (run.path.name.as_str(), run.errors()));
    let rows: Vec<(&str, [DeadReckoningError; 2])> = std::iter::once(("mean", mean)).chain(of_runs).collect();
    let mm = Format::new(Unit::Millimetres, 1);
    let table = Table::of(&rows)
        .text("", "run", |(name, _)| (*name).to_owned())
        .number("", "rms", mm, |(_, [before, _])| Some(before.rms_m))
        .number("", "max", mm, |(_, [before, _])| Some(before.max_m))
        .number("", "end", mm, |(_, [before, _])| Some(before.end_m))
        .number("", "rms after", mm, |(_, [_, after])| Some(after.rms_m))
        .number("", "max after", mm, |(_, [_, after])| Some(after.max_m))
        .number("", "end after", mm, |(_, [_, after])| Some(after.end_m));
    report.heading(format!("Dead reckoning over {what}"));
    report.table("", &table);
}

fn run_json(run: &RunComparison) -> Value {
    let [before, after] =
        run.errors().map(|error| json!({ "rms_m": error.rms_m, "max_m": error.max_m, "end_m": error.end_m }));
    json!({ "run": run.path.name, "before": before, "after": after })
}

fn plot(run: &RunComparison) -> Plot {
    let line = |name: &str, positions: &[[f64; 2]]| {
        Curve::line(name, positions.iter().map(|[x, y]| (*x, *y)).collect::<Vec<_>>())
    };
    let measured: Vec<[f64; 2]> = run.path.fixes.iter().map(|fix| fix.position_m).collect();
    let off_mm = |name: &str, positions: &[[f64; 2]]| {
        let off = run.path.fixes.iter().zip(positions).map(|(fix, [x, y])| {
            let [measured_x, measured_y] = fix.position_m;
            (fix.at_s, 1e3 * (x - measured_x).hypot(y - measured_y))
        });
        Curve::line(name, off.collect::<Vec<_>>())
    };
    let [positions_before, positions_after] = run.reckoned.each_ref().map(|path| &path.positions_m);
    let map = [line("seen", &measured), line("before", positions_before), line("after", positions_after)];
    let distances = [
        Curve::new("seen", CurveShape::Level(0.0)),
        off_mm("before", positions_before),
        off_mm("after", positions_after),
    ];
    let [before, after] = run.errors();
    Plot::new(
        run.path.name.clone(),
        format!("rms {:.1} mm before, {:.1} mm after", 1e3 * before.rms_m, 1e3 * after.rms_m),
        vec![
            Axes::new("x [m]", "y [m]", 420.0, map).with_equal_scales(),
            Axes::new("time [s]", "distance [mm]", 200.0, distances),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mistake_has_words_that_say_what_to_change() {
        for wiring in Wiring::ALL {
            if wiring == Wiring::AsGiven {
                continue;
            }
            let words = wiring_text(wiring).unwrap();
            assert!(words.contains("scale = -1") || words.contains("exchange"), "{words}");
        }
        assert_eq!(wiring_text(Wiring::AsGiven), None);
    }
}
