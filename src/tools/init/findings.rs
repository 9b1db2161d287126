//! What the motions show, in words and as values of a configuration.

use anyhow::Result;
use posebridge_estimator::hand_motions::{DriveFigures, GyroScale, HandFigures, WheelUnit, usual_gyro_counts};
use posebridge_telemetry::{Polarity, UncertainValue, WheelOrder};

use super::live::GuidedRobot;
use super::robot_source::RobotSource;
use crate::config::{RobotFile, TemplateValue};

/// Figures for a configuration, each with its words.
#[derive(Clone, Debug, Default)]
pub(super) struct Findings {
    /// A table: what, figure, where it is from.
    pub(super) lines: Vec<String>,
    pub(super) values: Vec<TemplateValue>,
    /// What a person should know.
    pub(super) notes: Vec<String>,
}

/// How far a known number of ticks per turn may be from a hand that turns a wheel once.
const KNOWN_TICKS_TOLERANCE: f64 = 0.1;
/// A robot that reports metres with a larger error should be told.
const REPORTED_TOLERANCE: f64 = 0.02;
/// Least sigma of a learned scale: a person does not measure better.
const MIN_SCALE_SIGMA: f64 = 0.005;
const ROBOT: &str = "robot";
const WIRING: &str = "robot.wiring";
const CALIBRATION: &str = "robot.calibration";
const LINE: &str = "robot.line";
const NOISE: &str = "robot.noise";
/// A gyro with smaller steps does not round: 0.1 degrees/s.
const MIN_GYRO_STEP_RAD_PER_S: f64 = 0.001_75;

impl Findings {
    /// What the motions of a robot show.
    pub(super) fn of(guided: &GuidedRobot) -> Result<Self> {
        let GuidedRobot { source, session } = guided;
        let base = source.base_profile()?.robot;
        let figures = session.guide.result(base.ticks_per_turn);
        Ok(Self::new(&figures, session.guide.figures(), source, &base))
    }

    pub(super) fn new(figures: &DriveFigures, motions: &HandFigures, source: &RobotSource, base: &RobotFile) -> Self {
        let mut findings = Self::default();
        findings.add_link(source);
        findings.add_geometry(figures, source, base);
        findings.check_known_ticks(figures, motions);
        findings.add_wiring(figures, motions);
        findings.add_gyro(figures, motions, source);
        findings
    }

    /// The unit of what the wheels report, as the figures have it.
    fn unit(figures: &DriveFigures) -> WheelUnit {
        if figures.reported_m.is_some() { WheelUnit::Meters } else { WheelUnit::Counts }
    }

    fn line(&mut self, what: &str, figure: &str, from: &str) {
        self.lines.push(format!("  {what:<15} {figure:<22} {from}").trim_end().to_owned());
    }

    fn set(&mut self, section: &'static str, key: &'static str, value: String, comment: impl Into<String>) {
        self.values.push(TemplateValue { section, key, value, comment: comment.into() });
    }

    fn add_link(&mut self, source: &RobotSource) {
        self.set(ROBOT, "name", "\"my robot\"".to_owned(), "for tables, page, logs and file names");
        if source.brick != "mavlink" {
            self.set("link", "brick", format!("\"{}\"", source.brick), "what it was heard to speak");
        } else if source.accept_mavlink1 {
            self.set("link", "accept_mavlink1", "true".to_owned(), "what it was heard to speak");
        }
        if let Some(line) = &source.line {
            let columns = toml::Value::from(line.columns.clone());
            self.set(LINE, "columns", columns.to_string(), "the numbers of a line, from left to right");
            if source.brick == "line" && line.separator != "," {
                self.set(LINE, "separator", toml::Value::from(line.separator.clone()).to_string(), "");
            }
        }
    }

    fn add_geometry(&mut self, figures: &DriveFigures, source: &RobotSource, base: &RobotFile) {
        self.set(ROBOT, "adopt_description", "false".to_owned(), "these figures were measured");
        match figures.ticks_per_turn {
            Some(UncertainValue { value, sigma }) if sigma > 0.0 => {
                let shown = format!("{value:.0} ± {}", (sigma.ceil()));
                self.line("ticks per turn", &shown, "one wheel by hand");
                self.set(ROBOT, "ticks_per_turn", float(value.round()), format!("{shown}, one wheel turned by hand"));
            }
            Some(UncertainValue { value, .. }) => {
                let from =
                    if source.known_ticks_per_turn() == Some(value) { "its motors count degrees" } else { "given" };
                self.line("ticks per turn", &format!("{value}"), from);
                self.set(ROBOT, "ticks_per_turn", float(value), from);
            }
            None if Self::unit(figures) == WheelUnit::Meters => {}
            None => {
                self.line(
                    "ticks per turn",
                    &base.ticks_per_turn.to_string(),
                    &format!("assumed, of {}", source.base.name),
                );
            }
        }
        match (figures.radii_m, Self::unit(figures)) {
            (Some([left, right]), _) => {
                for (name, key, radius) in
                    [("left wheel", "left_wheel_radius_m", left), ("right wheel", "right_wheel_radius_m", right)]
                {
                    let shown = millimetres(radius);
                    self.line(name, &format!("radius {shown}"), "straight on");
                    self.set(ROBOT, key, metres(radius.value), format!("{shown}, straight on"));
                }
                let relative = (left.sigma / left.value).max(MIN_SCALE_SIGMA);
                self.set(CALIBRATION, "radius_scale", sigma(relative), "a person aims at a mark on the floor");
            }
            (None, WheelUnit::Meters) => self.add_reported(figures),
            (None, WheelUnit::Counts) => {
                let assumed = format!("radius {:.1} mm", 1e3 * base.left_wheel_radius_m);
                self.line("wheels", &assumed, &format!("assumed, of {}", source.base.name));
            }
        }
        let Some(track) = figures.track_m else {
            let assumed = format!("{:.0} mm", 1e3 * base.track_width_m);
            self.line("track", &assumed, &format!("assumed, of {}", source.base.name));
            return;
        };
        let shown = millimetres(track);
        self.line("track", &shown, "on the spot");
        self.set(ROBOT, "track_width_m", metres(track.value), format!("{shown}, on the spot"));
        let relative = (track.sigma / track.value).max(MIN_SCALE_SIGMA);
        self.set(CALIBRATION, "track_scale", sigma(relative), "the same for a heading");
    }

    /// A gear between motor and wheel makes a known number wrong.
    fn check_known_ticks(&mut self, figures: &DriveFigures, motions: &HandFigures) {
        let counted = motions.wheel.and_then(|wheel| wheel.ticks_per_turn);
        let (Some(counted), Some(used)) = (counted, figures.ticks_per_turn) else {
            return;
        };
        let counted = counted.value;
        if (counted / used.value - 1.0).abs() > KNOWN_TICKS_TOLERANCE {
            self.notes.push(format!(
                "the turned wheel counted {counted:.0} in a turn, where {} were expected: with gears give --ticks-per-turn",
                used.value
            ));
        }
    }

    /// A robot that reports metres knows its wheels; how well is what the motion shows.
    fn add_reported(&mut self, figures: &DriveFigures) {
        let Some([left, right]) = figures.reported_m else {
            return;
        };
        let scale = 0.5 * (left.value + right.value);
        self.line("wheels", &format!("a metre is {:.3} of its own", scale.recip()), "straight on");
        let relative = (left.sigma / left.value).max(MIN_SCALE_SIGMA);
        let value = format!("{{ value = {:.4}, sigma = {relative:.4} }}", scale - 1.0);
        self.set(CALIBRATION, "radius_scale", value, "true metres per metre that the robot reports, less one");
        if (scale - 1.0).abs() > REPORTED_TOLERANCE {
            self.notes.push(format!(
                "the robot reports metres and is wrong by {:+.1} %: correct its wheel radius in the program on the robot",
                100.0 * (scale.recip() - 1.0)
            ));
        }
    }

    fn add_wiring(&mut self, figures: &DriveFigures, motions: &HandFigures) {
        let mut words = Vec::new();
        if figures.order == WheelOrder::Swapped {
            words.push("the counters are swapped");
            let from = if motions.wheel.is_some() { "the turned left wheel" } else { "a turn to the left" };
            self.set(WIRING, "swap_wheels", "true".to_owned(), format!("{from} counted so"));
        }
        for (key, word, polarity) in [
            ("reverse_left", "the left wheel counts backwards", figures.polarity[0]),
            ("reverse_right", "the right wheel counts backwards", figures.polarity[1]),
        ] {
            if polarity == Polarity::Reversed {
                words.push(word);
                self.set(WIRING, key, "true".to_owned(), "it counted down while the robot rolled forward");
            }
        }
        let shown = match (words.as_slice(), motions.straight) {
            ([], Some(_)) => "both wheels count forward".to_owned(),
            ([], None) => "not measured: no straight roll".to_owned(),
            _ => words.join(", "),
        };
        self.line("wiring", &shown, "");
    }

    fn add_gyro(&mut self, figures: &DriveFigures, motions: &HandFigures, source: &RobotSource) {
        let Some(UncertainValue { value: ratio, .. }) = figures.gyro_ratio else {
            let shown = if motions.spot.is_some() { "none was heard" } else { "not measured: no turn on the spot" };
            self.line("gyro", shown, "");
            return;
        };
        let scale = GyroScale::from_ratio(ratio);
        if scale == GyroScale::Still {
            self.line("gyro", "it did not feel the turn", "on the spot");
            self.notes.push(
                "the gyro did not feel the turn: is its axis upright, and is it plugged in where the configuration says?".to_owned(),
            );
            return;
        }
        let direction = if ratio < 0.0 { "to the right" } else { "to the left" };
        // How many times the true rate the readings are, as they are configured now; exactly, where the unit is known.
        let mut times = match scale {
            GyroScale::RadiansPerSecond => 1.0,
            GyroScale::DegreesPerSecond => 1_f64.to_degrees(),
            GyroScale::Other | GyroScale::Still => ratio.abs(),
        };
        let unit = if source.reads_text() {
            let (unit, of_column) = self.column_unit(ratio, scale, source);
            times = of_column.unwrap_or(times);
            unit
        } else {
            match scale {
                GyroScale::DegreesPerSecond => {
                    self.set(
                        WIRING,
                        "gyro_unit",
                        "\"deg/s\"".to_owned(),
                        format!("{:.1} times the true turn", ratio.abs()),
                    );
                    "degrees/s".to_owned()
                }
                GyroScale::RadiansPerSecond => "as its protocol says".to_owned(),
                GyroScale::Other | GyroScale::Still => {
                    self.notes.push(format!(
                        "the gyro turned {:.3} times as far as the robot, which is no unit: correct its scale in the program on the robot",
                        ratio.abs()
                    ));
                    "of a wrong scale".to_owned()
                }
            }
        };
        if ratio < 0.0 {
            self.set(WIRING, "reverse_gyro", "true".to_owned(), "it counted down in a turn to the left");
        }
        self.line("gyro", &format!("positive {direction}"), &unit);
        let step_rad_per_s = figures.gyro_step.map(|step| step / times);
        if let Some(step) = step_rad_per_s.filter(|step| *step >= MIN_GYRO_STEP_RAD_PER_S) {
            let shown = format!("{:.2} degrees/s", step.to_degrees());
            self.line("", &format!("in steps of {shown}"), "");
            self.set(NOISE, "gyro_resolution_rad_per_s", format!("{step:.5}"), format!("it reads in steps of {shown}"));
        }
    }

    /// The quantity of the gyro's column that fits the turn: says its unit, and how many times the true rate the readings were.
    fn column_unit(&mut self, ratio: f64, scale: GyroScale, source: &RobotSource) -> (String, Option<f64>) {
        let Some(line) = &source.line else {
            return (String::new(), None);
        };
        let column = line.columns.iter().position(|name| name.trim_start_matches('-').starts_with("gyro_"));
        let Some(name) = column.and_then(|index| line.columns.get(index)) else {
            return (String::new(), None);
        };
        let readings_per_deg_per_s = |name: &str, counts: f64| match name.trim_start_matches('-') {
            "gyro_deg_per_s" => 1.0,
            "gyro_rad_per_s" => 1_f64.to_radians(),
            _ => counts,
        };
        let configured = readings_per_deg_per_s(name, line.gyro_counts_per_deg_per_s);
        // What the column reads at one degree per second.
        let per_deg_per_s = ratio.abs() * configured;
        let unit = match (name.trim_start_matches('-'), scale) {
            ("gyro_deg_per_s" | "gyro_rad_per_s", GyroScale::RadiansPerSecond) => name.trim_start_matches('-'),
            _ => match GyroScale::from_ratio(per_deg_per_s.recip()) {
                GyroScale::RadiansPerSecond => "gyro_deg_per_s",
                GyroScale::DegreesPerSecond => "gyro_rad_per_s",
                GyroScale::Other | GyroScale::Still => "gyro_counts",
            },
        };
        let sign = if name.starts_with('-') { "-" } else { "" };
        let renamed =
            line.columns.iter().map(|other| if other == name { format!("{sign}{unit}") } else { other.clone() });
        let columns = toml::Value::from(renamed.collect::<Vec<_>>()).to_string();
        for value in self.values.iter_mut().filter(|value| value.section == LINE && value.key == "columns") {
            value.value.clone_from(&columns);
        }
        let counts = usual_gyro_counts(per_deg_per_s);
        let times = Some(readings_per_deg_per_s(unit, counts) / configured);
        if unit != "gyro_counts" {
            return (unit.trim_start_matches("gyro_").replace("_per_", "/"), times);
        }
        let comment = format!("{per_deg_per_s:.1} counted in the turn on the spot");
        self.set(LINE, "gyro_counts_per_deg_per_s", format!("{counts:.1}"), comment);
        (format!("{counts:.1} counts at 1 degree/s"), times)
    }
}

fn millimetres(length: UncertainValue) -> String {
    format!("{:.1} ± {:.1} mm", 1e3 * length.value, 1e3 * length.sigma)
}

/// Tenths of a millimetre more would be no knowledge.
fn metres(value_m: f64) -> String {
    format!("{value_m:.5}")
}

fn float(value: f64) -> String {
    format!("{value:.1}")
}

fn sigma(relative: f64) -> String {
    format!("{{ value = 0.0, sigma = {relative:.4} }}")
}
