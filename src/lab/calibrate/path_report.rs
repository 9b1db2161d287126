//! What `calibrate path` prints and draws.

use std::fmt::Write as _;

use posebridge_lab::calibration::free_path::{
    DeadReckonedPath, DeadReckoningError, FreePath, PathCalibration, UnknownEstimate, UnknownStatus, Wiring, mean_error,
};
use posebridge_report::chart::plot::{Axes, Curve, CurveShape, Plot, render_plot};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::TextTable;
use posebridge_telemetry::{Calibration, UncertainValue};
use serde_json::{Value, json};

use crate::config::RobotFile;
use crate::tools::experiment_output::ExperimentOutcome;

/// Runs that are drawn.
const MAX_PLOTTED_RUNS: usize = 3;
/// From here on the numbers do not explain the drive.
const UNEXPLAINED: f64 = 100.0;
/// Sigmas are about so rough: a description whose noise is this many times off deserves a word.
const ROUGH: f64 = 4.0;

/// Everything that a report contains.
pub(super) struct PathCalibrationResult {
    pub(super) recording: String,
    pub(super) reference: &'static str,
    pub(super) robot: RobotFile,
    pub(super) calibrated: RobotFile,
    pub(super) residual: Calibration,
    pub(super) fit: PathCalibration,
    pub(super) runs: Vec<RunComparison>,
    pub(super) validation_runs: Vec<RunComparison>,
}

/// A run by dead reckoning, before and after.
pub(super) struct RunComparison {
    pub(super) path: FreePath,
    pub(super) before: DeadReckonedPath,
    pub(super) after: DeadReckonedPath,
}

impl RunComparison {
    /// Errors before and after.
    pub(super) const fn errors(&self) -> [DeadReckoningError; 2] {
        [self.before.error, self.after.error]
    }
}

/// Words, tables, pictures.
pub(super) struct PathReport<'a> {
    result: &'a PathCalibrationResult,
}

impl<'a> PathReport<'a> {
    pub(super) const fn new(result: &'a PathCalibrationResult) -> Self {
        Self { result }
    }

    /// What is wrong with the description, and what to change in which file.
    pub(super) fn findings(&self) -> Vec<String> {
        let result = self.result;
        let mut findings = Vec::new();
        if result.fit.consistency > UNEXPLAINED {
            findings.push(format!(
                "these numbers do not explain the drive: its innovations have {:.0} times the described variance. Do not use them; the wheels slipped, the noise is described far too small, or the drive is too long: choose a shorter one",
                result.fit.consistency
            ));
        }
        findings.extend(self.sanity_warnings());
        findings
    }

    fn sanity_warnings(&self) -> Vec<String> {
        let result = self.result;
        let mut findings = Vec::new();
        let Some(sanity) = &result.fit.hypothesis_test else {
            return findings;
        };
        let found = sanity.found;
        if let Some(wiring) = wiring_text(found.wiring) {
            findings.push(wiring.to_owned());
        }
        if found.track_factor != 1.0 {
            findings.push(format!(
                "`robot.track_width_m` is {} and fits {} times that: {}; write about {:.4}",
                result.robot.track_width_m,
                found.track_factor,
                if found.track_factor > 1.0 {
                    "it is half the distance between the wheels"
                } else {
                    "it is twice the distance between the wheels"
                },
                result.calibrated.track_width_m
            ));
        }
        if found.travel_factor != 1.0 {
            findings.push(format!(
                "a count moves the wheels by {} times what `robot.ticks_per_turn` = {} and the radii say: write ticks_per_turn = {} (a quadrature decoder counts 1, 2 or 4 times) or mend the radii (radius or diameter?)",
                found.travel_factor,
                result.robot.ticks_per_turn,
                result.robot.ticks_per_turn / found.travel_factor
            ));
        }
        if !findings.is_empty() {
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

    /// Comments of the profile.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut remarks = self.findings();
        remarks.extend(self.result.fit.entries.iter().map(|entry| {
            let UncertainValue { value, sigma } = entry.after;
            format!("{} {value:+.5} +- {sigma:.5}: {}", entry.unknown.key(), standing_text(entry.status))
        }));
        for (what, runs) in self.groups() {
            let [before, after] = mean_errors(runs);
            remarks.push(format!(
                "dead reckoning over {what}: rms {:.1} mm before, {:.1} mm after",
                1e3 * before.rms_m,
                1e3 * after.rms_m
            ));
        }
        remarks
    }

    /// Page, tables and object.
    pub(super) fn outcome(&self) -> ExperimentOutcome {
        ExperimentOutcome { name: "calibrate-path", page: self.page(), text: self.text(), json: self.json() }
    }

    fn groups(&self) -> Vec<(&'static str, &'a [RunComparison])> {
        let result = self.result;
        let all =
            [("the runs it was found on", result.runs.as_slice()), ("other runs", result.validation_runs.as_slice())];
        all.into_iter().filter(|(_, runs)| !runs.is_empty()).collect()
    }

    fn text(&self) -> String {
        let result = self.result;
        let mut text = format!("{}: {} run(s) against {}\n\n", result.recording, result.runs.len(), result.reference);
        text += &self.numbers();
        let _ = writeln!(text, "\n{}", self.geometry());
        if let Some(windows) = result.fit.length_windows {
            let _ = writeln!(text, "wheel radius from the length of the way over {windows} windows");
        }
        let _ = writeln!(
            text,
            "innovations: {:.2} times the described variance{}",
            result.fit.consistency,
            if (1.0 / ROUGH..=ROUGH).contains(&result.fit.consistency) {
                ""
            } else {
                " (the sigmas above do not use it)"
            }
        );
        for (what, runs) in self.groups() {
            let _ = writeln!(text, "\ndead reckoning over {what}\n{}", errors_table(runs));
        }
        for finding in self.findings() {
            let _ = writeln!(text, "\nwarning: {finding}");
        }
        text
    }

    fn numbers(&self) -> String {
        let mut table = TextTable::new(["number", "before", "found", "sigma", "standing"]);
        for UnknownEstimate { unknown, before, after, status: standing } in &self.result.fit.entries {
            table.push([
                unknown.key().to_owned(),
                format!("{:+.5}", before.value),
                format!("{:+.5}", after.value),
                format!("{:.5}", after.sigma),
                standing_text(*standing).to_owned(),
            ]);
        }
        table.render()
    }

    fn geometry(&self) -> String {
        let (before, after) = (&self.result.robot, &self.result.calibrated);
        let count_mm = |radius_m: f64, ticks: f64| 1e3 * std::f64::consts::TAU * radius_m / ticks;
        format!(
            "left wheel {:.3} mm -> {:.3} mm, right wheel {:.3} mm -> {:.3} mm, track {:.2} mm -> {:.2} mm, {:.4} mm per count",
            1e3 * before.left_wheel_radius_m,
            1e3 * after.left_wheel_radius_m,
            1e3 * before.right_wheel_radius_m,
            1e3 * after.right_wheel_radius_m,
            1e3 * before.track_width_m,
            1e3 * after.track_width_m,
            count_mm(f64::midpoint(after.left_wheel_radius_m, after.right_wheel_radius_m), after.ticks_per_turn)
        )
    }

    fn page(&self) -> ReportPage {
        let result = self.result;
        let mut parts = vec![ReportBlock::Text(format!(
            "{} run(s) of {}, compared with its {}. docs/lab/calibrate.md says what the numbers mean.",
            result.runs.len(),
            result.recording,
            result.reference
        ))];
        let findings = self.findings();
        if !findings.is_empty() {
            parts.push(ReportBlock::Heading("Mistakes in the description".to_owned()));
            parts.push(ReportBlock::List(findings));
        }
        parts.push(ReportBlock::Heading("Numbers".to_owned()));
        parts.push(ReportBlock::PreformattedText(self.numbers()));
        parts.push(ReportBlock::Text(self.geometry()));
        for (what, runs) in self.groups() {
            parts.push(ReportBlock::Heading(format!("Dead reckoning over {what}")));
            parts.push(ReportBlock::PreformattedText(errors_table(runs)));
        }
        parts.push(ReportBlock::Heading("The way".to_owned()));
        for run in result.runs.iter().chain(&result.validation_runs).take(MAX_PLOTTED_RUNS) {
            parts.push(ReportBlock::Figure {
                svg: picture(run),
                caption: format!("{}: where it was seen, and dead reckoning alone before and after.", run.path.name),
            });
        }
        ReportPage { title: format!("Calibration by a watched drive: {}", result.recording), blocks: parts }
    }

    fn json(&self) -> Value {
        let result = self.result;
        let numbers: serde_json::Map<String, Value> = result
            .fit
            .entries
            .iter()
            .map(|entry| {
                let object = json!({
                    "before": entry.before.value,
                    "value": entry.after.value,
                    "sigma": entry.after.sigma,
                    "standing": standing_key(entry.status),
                });
                (entry.unknown.key().to_owned(), object)
            })
            .collect();
        let sanity = result.fit.hypothesis_test.as_ref().map(|sanity| {
            json!({
                "is_sound": sanity.is_sound(),
                "wiring": sanity.found.wiring.name(),
                "track_factor": sanity.found.track_factor,
                "travel_factor": sanity.found.travel_factor,
                "described_rms_m": sanity.described_rms_m,
                "found_rms_m": sanity.found_rms_m,
                "log_likelihood_gain": sanity.log_likelihood_gain,
            })
        });
        json!({
            "recording": result.recording,
            "against": result.reference,
            "numbers": numbers,
            "robot": {
                "left_wheel_radius_m": result.calibrated.left_wheel_radius_m,
                "right_wheel_radius_m": result.calibrated.right_wheel_radius_m,
                "track_width_m": result.calibrated.track_width_m,
            },
            "length_windows": result.fit.length_windows,
            "consistency": result.fit.consistency,
            "sanity": sanity,
            "findings": self.findings(),
            "runs": result.runs.iter().map(run_json).collect::<Vec<Value>>(),
            "tried": result.validation_runs.iter().map(run_json).collect::<Vec<Value>>(),
        })
    }
}

const fn wiring_text(wiring: Wiring) -> Option<&'static str> {
    match wiring {
        Wiring::AsGiven => None,
        Wiring::Swapped => Some(
            "the wheels are swapped: what is called left is the right one (or the track has the wrong sign); exchange `left` and `right` of the stream in the descriptor, or the two plugs on the brick",
        ),
        Wiring::BothReversed => Some(
            "both wheels count backwards: give both columns `scale = -1` in the descriptor, or turn the motors' direction round on the brick",
        ),
        Wiring::LeftReversed => Some(
            "the left wheel counts backwards: give its column `scale = -1` in the descriptor, or turn its direction round on the brick",
        ),
        Wiring::RightReversed => Some(
            "the right wheel counts backwards: give its column `scale = -1` in the descriptor, or turn its direction round on the brick",
        ),
        Wiring::SwappedLeftReversed => Some(
            "the wheels are swapped, and what is called left counts backwards: exchange `left` and `right` and give the former left column `scale = -1`",
        ),
        Wiring::SwappedRightReversed => Some(
            "the wheels are swapped, and what is called right counts backwards: exchange `left` and `right` and give the former right column `scale = -1`",
        ),
    }
}

const fn standing_text(standing: UnknownStatus) -> &'static str {
    match standing {
        UnknownStatus::Estimated => "found",
        UnknownStatus::Fixed => "held",
        UnknownStatus::Unobservable => "not seen on this drive: left as it was",
        UnknownStatus::NotSeparable => "not told from the track: drive turns to both sides",
    }
}

const fn standing_key(standing: UnknownStatus) -> &'static str {
    match standing {
        UnknownStatus::Estimated => "found",
        UnknownStatus::Fixed => "held",
        UnknownStatus::Unobservable => "unseen",
        UnknownStatus::NotSeparable => "not_separable",
    }
}

fn mean_errors(runs: &[RunComparison]) -> [DeadReckoningError; 2] {
    [0, 1].map(|which| {
        let errors: Vec<DeadReckoningError> = runs.iter().map(|run| run.errors()[which]).collect();
        mean_error(&errors)
    })
}

fn errors_table(runs: &[RunComparison]) -> String {
    let mut table = TextTable::new(["run", "rms mm", "max mm", "end mm", "rms mm", "max mm", "end mm"]);
    let mut push = |name: &str, [before, after]: [DeadReckoningError; 2]| {
        let cell = |metres: f64| format!("{:.1}", 1e3 * metres);
        table.push([
            name.to_owned(),
            cell(before.rms_m),
            cell(before.max_m),
            cell(before.end_m),
            cell(after.rms_m),
            cell(after.max_m),
            cell(after.end_m),
        ]);
    };
    push("(before, then after)", mean_errors(runs));
    for run in runs {
        push(&run.path.name, run.errors());
    }
    table.render()
}

fn run_json(run: &RunComparison) -> Value {
    let [before, after] =
        run.errors().map(|error| json!({ "rms_m": error.rms_m, "max_m": error.max_m, "end_m": error.end_m }));
    json!({ "run": run.path.name, "before": before, "after": after })
}

fn picture(run: &RunComparison) -> String {
    let points = |places: &[[f64; 2]]| places.iter().map(|[x, y]| (*x, *y)).collect();
    let line =
        |name: &str, places: &[[f64; 2]]| Curve { name: name.to_owned(), shape: CurveShape::Line(points(places)) };
    let fix_positions: Vec<[f64; 2]> = run.path.fixes.iter().map(|sight| sight.position_m).collect();
    let off = |places: &[[f64; 2]]| {
        let sights = run.path.fixes.iter().zip(places);
        let off = sights.map(|(sight, [x, y])| {
            let [seen_x, seen_y] = sight.position_m;
            (sight.at_s, 1e3 * (x - seen_x).hypot(y - seen_y))
        });
        CurveShape::Line(off.collect())
    };
    let [before, after] = run.errors();
    render_plot(&Plot {
        title: run.path.name.clone(),
        key_figures: format!("rms {:.1} mm before, {:.1} mm after", 1e3 * before.rms_m, 1e3 * after.rms_m),
        axes: vec![
            Axes {
                x_name: "x [m]".to_owned(),
                y_name: "y [m]".to_owned(),
                height_px: 420.0,
                is_map: true,
                curves: vec![
                    line("seen", &fix_positions),
                    line("before", &run.before.positions_m),
                    line("after", &run.after.positions_m),
                ],
            },
            Axes {
                x_name: "time [s]".to_owned(),
                y_name: "distance [mm]".to_owned(),
                height_px: 200.0,
                is_map: false,
                curves: vec![
                    Curve { name: "seen".to_owned(), shape: CurveShape::Level(0.0) },
                    Curve { name: "before".to_owned(), shape: off(&run.before.positions_m) },
                    Curve { name: "after".to_owned(), shape: off(&run.after.positions_m) },
                ],
            },
        ],
    })
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
