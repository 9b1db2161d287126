//! The configuration lines that undo what was found of a robot's wiring, for `--fix-wiring`.

use std::fmt::Write as _;

use posebridge_estimator::wiring::{WiringFault, WiringFinding};
use posebridge_recording::robot_names::RobotNames;
use posebridge_report::tables::wrapped;
use posebridge_station::Robot;
use posebridge_telemetry::{DriveGeometry, Wiring};

use crate::config::{Config, RobotFile, RobotWiring};

/// The findings of one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct WiringReport {
    /// For people; empty where there is one robot.
    pub robot: String,
    findings: Vec<WiringFinding>,
    wiring: Wiring,
    geometry: DriveGeometry,
    file: RobotFile,
}

impl WiringReport {
    /// One for each robot of a session.
    pub fn of_session<'a>(robots: impl IntoIterator<Item = &'a Robot>, config: &Config) -> Vec<Self> {
        let robots: Vec<&Robot> = robots.into_iter().collect();
        let mut names = RobotNames::default();
        for robot in &robots {
            names.insert(robot.id(), robot.name().unwrap_or_default());
        }
        let label = |robot: &Robot| if robots.len() > 1 { names.label(robot.id()) } else { String::new() };
        robots.iter().map(|robot| Self::of_robot(robot, label(robot), config.robot_file(Some(*robot)))).collect()
    }

    /// `file` is the robot's own configuration.
    pub fn of_robot(robot: &Robot, label: String, file: &RobotFile) -> Self {
        Self {
            robot: label,
            findings: robot.wiring_findings().to_vec(),
            wiring: robot.wiring(),
            geometry: robot.geometry(),
            file: file.clone(),
        }
    }

    /// What was found, in words.
    pub fn summaries(&self) -> impl Iterator<Item = String> {
        let of_robot = if self.robot.is_empty() { String::new() } else { format!("{}: ", self.robot) };
        self.findings.iter().map(move |finding| {
            let cure = if finding.fault().is_some() { " (--fix-wiring prints the lines that undo it)" } else { "" };
            format!("{of_robot}{finding}{cure}")
        })
    }

    /// What was found, as comments, and the lines of a configuration that undo it.
    pub fn to_toml(&self) -> String {
        let of_robot = if self.robot.is_empty() { String::new() } else { format!(" of robot {}", self.robot) };
        if self.findings.is_empty() {
            return format!("# wiring{of_robot}: nothing wrong was found\n");
        }
        let mut text = String::new();
        let mut corrected = self.wiring;
        let mut faults = Vec::new();
        for finding in &self.findings {
            // Writing to a String cannot fail.
            let lines = wrapped("# ", &format!("wiring{of_robot}: {finding}"));
            let _ = writeln!(text, "{}", lines.trim_end().replace("\n  ", "\n# "));
            faults.extend(finding.fault());
        }
        for fault in &faults {
            corrected = fault.correct(corrected).unwrap_or(corrected);
        }
        text += &self.geometry_lines(&faults);
        text += &wiring_lines(self.wiring.into(), corrected.into());
        text
    }

    /// The keys of `[robot]` that change.
    fn geometry_lines(&self, faults: &[WiringFault]) -> String {
        let before = self.file.with_geometry(&self.geometry);
        let mut after = before.clone();
        for fault in faults {
            match fault {
                WiringFault::WheelsReportHalf | WiringFault::WheelsReportDouble => {
                    after.ticks_per_turn /= fault.travel_factor();
                }
                WiringFault::TrackTooWide
                | WiringFault::TrackTooNarrow
                | WiringFault::RadiiInMillimeters
                | WiringFault::TrackInMillimeters
                | WiringFault::RadiiAndTrackInMillimeters => {
                    after.left_wheel_radius_m *= fault.travel_factor();
                    after.right_wheel_radius_m *= fault.travel_factor();
                    after.track_width_m *= fault.track_factor();
                }
                WiringFault::GyroInDegrees
                | WiringFault::GyroInRadians
                | WiringFault::GyroReversed
                | WiringFault::WheelsSwapped
                | WiringFault::LeftWheelReversed
                | WiringFault::RightWheelReversed
                | WiringFault::BothWheelsReversed
                | WiringFault::CameraInMillimeters
                | WiringFault::CameraYDown => {}
            }
        }
        let keys = [
            ("left_wheel_radius_m", before.left_wheel_radius_m, after.left_wheel_radius_m),
            ("right_wheel_radius_m", before.right_wheel_radius_m, after.right_wheel_radius_m),
            ("track_width_m", before.track_width_m, after.track_width_m),
            ("ticks_per_turn", before.ticks_per_turn, after.ticks_per_turn),
        ];
        let is_described = self.file.geometry().is_ok_and(|own| own != self.geometry);
        let mut lines = String::new();
        for (key, _, value) in keys.iter().filter(|(_, before, after)| before != after || is_described) {
            // Nine digits: no rounding of a factor stands in a file. Writing to a String cannot fail.
            let rounded = format!("{value:.9}");
            let shown = rounded.trim_end_matches('0');
            let end = if shown.ends_with('.') { "0" } else { "" };
            let _ = writeln!(lines, "{key} = {shown}{end}");
        }
        if before == after {
            return String::new();
        }
        if is_described && self.file.adopt_description {
            lines += "adopt_description = false    # the robot describes itself otherwise\n";
        }
        format!("[robot]\n{lines}")
    }
}

/// The keys of `[robot.wiring]` that change.
fn wiring_lines(before: RobotWiring, after: RobotWiring) -> String {
    let (Ok(before), Ok(after)) = (toml::Table::try_from(before), toml::Table::try_from(after)) else {
        return String::new();
    };
    let mut lines = String::new();
    for (key, value) in after.iter().filter(|(key, value)| before.get(*key) != Some(value)) {
        // Writing to a String cannot fail.
        let _ = writeln!(lines, "{key} = {value}");
    }
    if lines.is_empty() { lines } else { format!("# in [robot.wiring] of the robot's file:\n[robot.wiring]\n{lines}") }
}

/// The texts of several robots, for the end of a run.
pub fn wiring_text(reports: &[WiringReport]) -> String {
    let texts: Vec<String> = reports.iter().map(WiringReport::to_toml).collect();
    if let [only] = texts.as_slice() {
        return only.clone();
    }
    // Tables of several robots are no file: each belongs to a `[[robot]]` block.
    let lines = texts.iter().flat_map(|text| text.lines());
    lines.map(|line| if line.starts_with('#') { format!("{line}\n") } else { format!("#   {line}\n") }).collect()
}

#[cfg(test)]
mod tests {
    use posebridge_estimator::wiring::{RatioKind, WiringRatio};
    use posebridge_telemetry::{GyroUnit, Polarity};

    use super::*;

    fn report(faults: &[WiringFault]) -> WiringReport {
        let file = RobotFile::default();
        let ratio = WiringRatio { kind: RatioKind::GyroTurn, value: 2.0, sigma: 0.1 };
        WiringReport {
            robot: String::new(),
            findings: faults
                .iter()
                .map(|fault| WiringFinding { candidates: vec![*fault], ratio, missing: None })
                .collect(),
            wiring: Wiring { gyro: Polarity::Reversed, gyro_unit: GyroUnit::DegreesPerSecond, ..Wiring::default() },
            geometry: file.geometry().unwrap(),
            file,
        }
    }

    #[test]
    fn the_lines_undo_what_was_found_and_say_nothing_else() {
        let text = report(&[WiringFault::WheelsSwapped, WiringFault::GyroReversed]).to_toml();
        assert!(text.ends_with("\n[robot.wiring]\nreverse_gyro = false\nswap_wheels = true\n"), "{text}");
        let text = report(&[WiringFault::WheelsReportHalf]).to_toml();
        assert!(text.ends_with("\n[robot]\nticks_per_turn = 180.0\n"), "{text}");
        assert_eq!(report(&[]).to_toml(), "# wiring: nothing wrong was found\n");
    }

    #[test]
    fn a_robot_that_describes_itself_wrongly_is_no_longer_believed() {
        let mut described = report(&[WiringFault::RadiiInMillimeters]);
        described.geometry = DriveGeometry {
            left_wheel_radius: described.geometry.left_wheel_radius * 1e3,
            right_wheel_radius: described.geometry.right_wheel_radius * 1e3,
            ..described.geometry
        };
        let text = described.to_toml();
        assert!(text.contains("\nleft_wheel_radius_m = 0.028\nright_wheel_radius_m = 0.028\n"), "{text}");
        assert!(text.contains("\nadopt_description = false "), "{text}");
    }

    #[test]
    fn faults_that_look_the_same_change_nothing() {
        let mut undecided = report(&[WiringFault::WheelsSwapped]);
        undecided.findings[0].candidates.push(WiringFault::GyroReversed);
        let text = undecided.to_toml();
        assert!(text.starts_with("# wiring: ") && text.lines().all(|line| line.starts_with("# ")), "{text}");
    }
}
