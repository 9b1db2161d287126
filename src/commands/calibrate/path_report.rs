//! What `calibrate path` prints and draws.

use std::fmt::Write as _;

use posebridge_analysis::calibration::free_path::{Entry, ReckonedError, Standing, Wiring, mean_error};
use posebridge_analysis::figures::plot::{Axes, Curve, Plot, Shape, plot};
use posebridge_analysis::report::Table;
use posebridge_analysis::report::page::{Page, Part};
use posebridge_telemetry::Known;
use serde_json::{Value, json};

use super::path::{CalibratedPath, TriedRun};
use crate::commands::lab::outcome::Outcome;

/// Runs that are drawn.
const DRAWN: usize = 3;
/// From here on the numbers do not explain the drive.
const UNEXPLAINED: f64 = 100.0;
/// Sigmas are about so rough: a description whose noise is this many times off deserves a word.
const ROUGH: f64 = 4.0;

/// Words, tables, pictures.
pub(super) struct Report<'a> {
    told: &'a CalibratedPath,
}

impl<'a> Report<'a> {
    pub(super) const fn of(told: &'a CalibratedPath) -> Self {
        Self { told }
    }

    /// What is wrong with the description, and what to change in which file.
    pub(super) fn findings(&self) -> Vec<String> {
        let told = self.told;
        let mut findings = Vec::new();
        if told.found.consistency > UNEXPLAINED {
            findings.push(format!(
                "these numbers do not explain the drive: its innovations have {:.0} times the described variance. Do not use them; the wheels slipped, the noise is described far too small, or the drive is too long: choose a shorter one",
                told.found.consistency
            ));
        }
        findings.extend(self.mistakes());
        findings
    }

    fn mistakes(&self) -> Vec<String> {
        let told = self.told;
        let mut findings = Vec::new();
        let Some(sanity) = &told.found.sanity else {
            return findings;
        };
        let found = sanity.found;
        if let Some(wiring) = wiring_words(found.wiring) {
            findings.push(wiring.to_owned());
        }
        if found.track_factor != 1.0 {
            findings.push(format!(
                "`robot.track_width_m` is {} and fits {} times that: {}; write about {:.4}",
                told.robot.track_width_m,
                found.track_factor,
                if found.track_factor > 1.0 {
                    "it is half the distance between the wheels"
                } else {
                    "it is twice the distance between the wheels"
                },
                told.calibrated.track_width_m
            ));
        }
        if found.travel_factor != 1.0 {
            findings.push(format!(
                "a count moves the wheels by {} times what `robot.ticks_per_turn` = {} and the radii say: write ticks_per_turn = {} (a quadrature decoder counts 1, 2 or 4 times) or mend the radii (radius or diameter?)",
                found.travel_factor,
                told.robot.ticks_per_turn,
                told.robot.ticks_per_turn / found.travel_factor
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
        remarks.extend(self.told.found.entries.iter().map(|entry| {
            let Known { value, sigma } = entry.after;
            format!("{} {value:+.5} +- {sigma:.5}: {}", entry.unknown.key(), standing_words(entry.standing))
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
    pub(super) fn outcome(&self) -> Outcome {
        Outcome { name: "calibrate-path", page: self.page(), text: self.text(), json: self.json() }
    }

    fn groups(&self) -> Vec<(&'static str, &'a [TriedRun])> {
        let told = self.told;
        let all = [("the runs it was found on", told.runs.as_slice()), ("other runs", told.tried.as_slice())];
        all.into_iter().filter(|(_, runs)| !runs.is_empty()).collect()
    }

    fn text(&self) -> String {
        let told = self.told;
        let mut text = format!("{}: {} run(s) against {}\n\n", told.recording, told.runs.len(), told.against);
        text += &self.numbers();
        let _ = writeln!(text, "\n{}", self.geometry());
        if let Some(windows) = told.found.length_windows {
            let _ = writeln!(text, "wheel radius from the length of the way over {windows} windows");
        }
        let _ = writeln!(
            text,
            "innovations: {:.2} times the described variance{}",
            told.found.consistency,
            if (1.0 / ROUGH..=ROUGH).contains(&told.found.consistency) {
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
        let mut table = Table::new(["number", "before", "found", "sigma", "standing"]);
        for Entry { unknown, before, after, standing } in &self.told.found.entries {
            table.push([
                unknown.key().to_owned(),
                format!("{:+.5}", before.value),
                format!("{:+.5}", after.value),
                format!("{:.5}", after.sigma),
                standing_words(*standing).to_owned(),
            ]);
        }
        table.render()
    }

    fn geometry(&self) -> String {
        let (before, after) = (&self.told.robot, &self.told.calibrated);
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

    fn page(&self) -> Page {
        let told = self.told;
        let mut parts = vec![Part::Text(format!(
            "{} run(s) of {}, compared with its {}. docs/lab/calibrate.md says what the numbers mean.",
            told.runs.len(),
            told.recording,
            told.against
        ))];
        let findings = self.findings();
        if !findings.is_empty() {
            parts.push(Part::Heading("Mistakes in the description".to_owned()));
            parts.push(Part::List(findings));
        }
        parts.push(Part::Heading("Numbers".to_owned()));
        parts.push(Part::Lines(self.numbers()));
        parts.push(Part::Text(self.geometry()));
        for (what, runs) in self.groups() {
            parts.push(Part::Heading(format!("Dead reckoning over {what}")));
            parts.push(Part::Lines(errors_table(runs)));
        }
        parts.push(Part::Heading("The way".to_owned()));
        for run in told.runs.iter().chain(&told.tried).take(DRAWN) {
            parts.push(Part::Figure {
                svg: picture(run),
                caption: format!("{}: where it was seen, and dead reckoning alone before and after.", run.path.name),
            });
        }
        Page { title: format!("Calibration by a watched drive: {}", told.recording), parts }
    }

    fn json(&self) -> Value {
        let told = self.told;
        let numbers: serde_json::Map<String, Value> = told
            .found
            .entries
            .iter()
            .map(|entry| {
                let object = json!({
                    "before": entry.before.value,
                    "value": entry.after.value,
                    "sigma": entry.after.sigma,
                    "standing": standing_key(entry.standing),
                });
                (entry.unknown.key().to_owned(), object)
            })
            .collect();
        let sanity = told.found.sanity.as_ref().map(|sanity| {
            json!({
                "is_sound": sanity.is_sound(),
                "wiring": format!("{:?}", sanity.found.wiring),
                "track_factor": sanity.found.track_factor,
                "travel_factor": sanity.found.travel_factor,
                "described_rms_m": sanity.described_rms_m,
                "found_rms_m": sanity.found_rms_m,
                "log_likelihood_gain": sanity.log_likelihood_gain,
            })
        });
        json!({
            "recording": told.recording,
            "against": told.against,
            "numbers": numbers,
            "robot": {
                "left_wheel_radius_m": told.calibrated.left_wheel_radius_m,
                "right_wheel_radius_m": told.calibrated.right_wheel_radius_m,
                "track_width_m": told.calibrated.track_width_m,
            },
            "length_windows": told.found.length_windows,
            "consistency": told.found.consistency,
            "sanity": sanity,
            "findings": self.findings(),
            "runs": told.runs.iter().map(run_json).collect::<Vec<Value>>(),
            "tried": told.tried.iter().map(run_json).collect::<Vec<Value>>(),
        })
    }
}

const fn wiring_words(wiring: Wiring) -> Option<&'static str> {
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

const fn standing_words(standing: Standing) -> &'static str {
    match standing {
        Standing::Found => "found",
        Standing::Held => "held",
        Standing::Unseen => "not seen on this drive: left as it was",
        Standing::NotSeparable => "not told from the track: drive turns to both sides",
    }
}

const fn standing_key(standing: Standing) -> &'static str {
    match standing {
        Standing::Found => "found",
        Standing::Held => "held",
        Standing::Unseen => "unseen",
        Standing::NotSeparable => "not_separable",
    }
}

fn mean_errors(runs: &[TriedRun]) -> [ReckonedError; 2] {
    [0, 1].map(|which| {
        let errors: Vec<ReckonedError> = runs.iter().map(|run| run.errors()[which]).collect();
        mean_error(&errors)
    })
}

fn errors_table(runs: &[TriedRun]) -> String {
    let mut table = Table::new(["run", "rms mm", "max mm", "end mm", "rms mm", "max mm", "end mm"]);
    let mut push = |name: &str, [before, after]: [ReckonedError; 2]| {
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

fn run_json(run: &TriedRun) -> Value {
    let [before, after] =
        run.errors().map(|error| json!({ "rms_m": error.rms_m, "max_m": error.max_m, "end_m": error.end_m }));
    json!({ "run": run.path.name, "before": before, "after": after })
}

fn picture(run: &TriedRun) -> String {
    let points = |places: &[[f64; 2]]| places.iter().map(|[x, y]| (*x, *y)).collect();
    let line = |name: &str, places: &[[f64; 2]]| Curve { name: name.to_owned(), shape: Shape::Line(points(places)) };
    let seen: Vec<[f64; 2]> = run.path.sights.iter().map(|sight| sight.place_m).collect();
    let off = |places: &[[f64; 2]]| {
        let sights = run.path.sights.iter().zip(places);
        let off = sights.map(|(sight, [x, y])| {
            let [seen_x, seen_y] = sight.place_m;
            (sight.at_s, 1e3 * (x - seen_x).hypot(y - seen_y))
        });
        Shape::Line(off.collect())
    };
    let [before, after] = run.errors();
    plot(&Plot {
        title: run.path.name.clone(),
        key_figures: format!("rms {:.1} mm before, {:.1} mm after", 1e3 * before.rms_m, 1e3 * after.rms_m),
        axes: vec![
            Axes {
                x_name: "x [m]".to_owned(),
                y_name: "y [m]".to_owned(),
                height_px: 420.0,
                is_map: true,
                curves: vec![
                    line("seen", &seen),
                    line("before", &run.before.places_m),
                    line("after", &run.after.places_m),
                ],
            },
            Axes {
                x_name: "time [s]".to_owned(),
                y_name: "distance [mm]".to_owned(),
                height_px: 200.0,
                is_map: false,
                curves: vec![
                    Curve { name: "seen".to_owned(), shape: Shape::Level(0.0) },
                    Curve { name: "before".to_owned(), shape: off(&run.before.places_m) },
                    Curve { name: "after".to_owned(), shape: off(&run.after.places_m) },
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
            let words = wiring_words(wiring).unwrap();
            assert!(words.contains("scale = -1") || words.contains("exchange"), "{words}");
        }
        assert_eq!(wiring_words(Wiring::AsGiven), None);
    }
}
