//! Way-points: what a list of them must satisfy, and how they are read from a file of their own.
//!
//! A scenario names such a file with `file = ".."` under `[path.waypoints]`. The caller reads it, because nothing here opens
//! anything; its points take the place of the key, so that everything behind sees `points_m` only.
//!
//! The file has one point per line, `x_m,y_m`. A first line with just these two names is allowed; empty lines and whatever
//! follows a `#` are left out.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};

use super::checks::{MAX_WAYPOINTS, waypoint_error};
use super::error::ScenarioError;

/// The names of the columns, which may stand in the first line.
const HEADER: [&str; 2] = ["x_m", "y_m"];

/// Parses a scenario and, through `read`, the file of way-points that it may name.
pub(super) fn parse_with_file<T: DeserializeOwned>(
    text: &str,
    read: &mut dyn FnMut(&Path) -> io::Result<String>,
) -> Result<T, ScenarioError> {
    let points_text;
    let mut table = DeTable::parse(text).map_err(ScenarioError::Toml)?;
    if let Some((file, line)) = named_file(text, table.get_mut())? {
        let points = read_points(file, line, read)?;
        // Debug writes each number in its shortest exact form, and as TOML does.
        points_text = format!("{points:?}");
        let value = DeValue::parse(&points_text).map_err(ScenarioError::Toml)?;
        if let Some((_, waypoints)) = waypoints_in(table.get_mut()) {
            waypoints.remove("file");
            waypoints.insert(Spanned::new(0..0, "points_m".into()), value);
        }
    }
    T::deserialize(Deserializer::from(table)).map_err(|mut error| {
        error.set_input(Some(text));
        ScenarioError::Toml(error)
    })
}

/// The table `[path.waypoints]` and where it stands in the text.
fn waypoints_in<'a, 'i>(scenario: &'a mut DeTable<'i>) -> Option<(Range<usize>, &'a mut DeTable<'i>)> {
    let DeValue::Table(path) = scenario.get_mut("path")?.get_mut() else {
        return None;
    };
    let waypoints = path.get_mut("waypoints")?;
    let span = waypoints.span();
    let DeValue::Table(waypoints) = waypoints.get_mut() else {
        return None;
    };
    Some((span, waypoints))
}

/// The file that holds the way-points, if the scenario names one, and the line in which it does.
fn named_file(text: &str, scenario: &mut DeTable<'_>) -> Result<Option<(PathBuf, usize)>, ScenarioError> {
    let refused = |span: Range<usize>, reason| {
        let line = line_of(text, span.start);
        Err(ScenarioError::Waypoints { line, reason })
    };
    let Some((span, waypoints)) = waypoints_in(scenario) else {
        return Ok(None);
    };
    let has_points = waypoints.contains_key("points_m");
    match waypoints.get("file") {
        None if has_points => Ok(None),
        None => refused(span, "way-points need points_m or file; give one of them"),
        Some(file) if has_points => refused(file.span(), "way-points have both points_m and file; remove one of them"),
        Some(file) => match file.get_ref().as_str() {
            Some(name) => Ok(Some((name.into(), line_of(text, file.span().start)))),
            None => refused(file.span(), "file is no text; write its name in quotes"),
        },
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    let before = text.bytes().take(offset);
    1 + before.filter(|byte| *byte == b'\n').count()
}

fn read_points(
    file: PathBuf,
    line: usize,
    read: &mut dyn FnMut(&Path) -> io::Result<String>,
) -> Result<Vec<[f64; 2]>, ScenarioError> {
    match read(&file) {
        Ok(text) => from_csv(&text).map_err(|(line, reason)| ScenarioError::WaypointsFile { file, line, reason }),
        Err(source) => Err(ScenarioError::WaypointsUnread { line, file, source }),
    }
}

/// The points of a file, or the line that is wrong, counted from 1, and why.
fn from_csv(text: &str) -> Result<Vec<[f64; 2]>, (usize, String)> {
    // Spreadsheets begin a file with a byte order mark.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let (mut points, mut lines) = (Vec::new(), Vec::new());
    let mut may_be_header = true;
    for (index, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or("").trim();
        if content.is_empty() {
            continue;
        }
        let is_header = may_be_header && content.split(',').map(str::trim).eq(HEADER);
        may_be_header = false;
        if is_header {
            continue;
        }
        points.push(point(content).map_err(|reason| (index + 1, reason))?);
        lines.push(index + 1);
        if points.len() > MAX_WAYPOINTS {
            break;
        }
    }
    match waypoint_error(&points) {
        None => Ok(points),
        Some((index, reason)) => {
            let last = text.lines().count().max(1);
            Err((lines.get(index).copied().unwrap_or(last), reason))
        }
    }
}

fn point(content: &str) -> Result<[f64; 2], String> {
    let mut fields = content.split(',').map(str::trim);
    let (Some(x), Some(y), None) = (fields.next(), fields.next(), fields.next()) else {
        return Err(format!("{content:?} is no way-point; write x_m,y_m with a comma between them"));
    };
    Ok([number(x)?, number(y)?])
}

fn number(field: &str) -> Result<f64, String> {
    let expected = "write metres with a decimal point, such as 1.25";
    field.parse().map_err(|_error| format!("{field:?} is no number; {expected}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Course, Scenario};

    const SCENARIO: &str = "seed = 3\n[path.waypoints]\nfile = \"lap/points.csv\"\n";

    fn with_file(file: &str) -> Result<Scenario, ScenarioError> {
        Scenario::from_toml_with(SCENARIO, &mut |path| {
            assert_eq!(path, Path::new("lap/points.csv"));
            Ok(file.to_owned())
        })
    }

    fn refusal(read: Result<Scenario, ScenarioError>) -> String {
        read.expect_err("it is wrong").to_string()
    }

    #[test]
    fn a_scenario_with_a_file_equals_the_one_with_its_points() {
        let written =
            Scenario::from_toml("seed = 3\n[path.waypoints]\npoints_m = [[0, 0], [1.25, -0.5], [1e-7, 0.1]]\n")
                .unwrap();
        for file in [
            "0,0\n1.25,-0.5\n1e-7,0.1\n",
            "x_m,y_m\r\n0,0\r\n1.25,-0.5\r\n1e-7,0.1",
            "\u{feff}# a lap\n\n x_m , y_m # metres\n0, 0\n  1.25 ,-0.5 # corner\n\n1e-7,0.1\n",
        ] {
            assert_eq!(with_file(file).unwrap(), written, "{file:?}");
        }
        let Course::Waypoints { points_m } = written.path else {
            unreachable!("the text says way-points");
        };
        assert_eq!(points_m, [[0.0, 0.0], [1.25, -0.5], [1e-7, 0.1]]);
    }

    #[test]
    fn a_wrong_file_is_refused_by_name_and_line() {
        let most = "0,0\n1,0\n".repeat(MAX_WAYPOINTS / 2 + 1);
        for (file, line, reason) in [
            ("", 1, "number of way-points is 0"),
            ("x_m,y_m\n# nothing\n1,2\n", 3, "number of way-points is 1"),
            ("x,y\n0,0\n1,0\n", 1, "\"x\" is no number"),
            ("0,0\nx_m,y_m\n1,0\n", 2, "\"x_m\" is no number"),
            ("0,0\n\n1;0\n", 3, "\"1;0\" is no way-point"),
            ("0,0\n1,0,0\n", 2, "is no way-point"),
            ("0,0\n1,\n", 2, "\"\" is no number"),
            ("0,0\n1,0\nnan,0\n", 3, "(NaN, 0) is not within"),
            ("# inf\n0,inf\n1,0\n", 2, "(0, inf) is not within"),
            ("0,0\n1e7,0\n", 2, "(10000000, 0) is not within"),
            ("0,0\n# again\n0,0.0005\n", 3, "less than 1 mm"),
            (&most, 10_001, "more than 10000"),
        ] {
            let message = refusal(with_file(file));
            let place = format!("lap/points.csv, line {line}: ");
            assert!(message.contains(&place), "{message} lacks {place}");
            assert!(message.contains(reason), "{message} lacks {reason}");
        }
    }

    #[test]
    fn a_wrong_key_is_refused_with_its_line_before_any_file_is_read() {
        for (text, line, reason) in [
            ("[path.waypoints]\n", "line 1", "points_m or file"),
            ("[path.waypoints]\npoints_m = [[0, 0], [1, 0]]\nfile = \"a.csv\"\n", "line 3", "both"),
            ("\n[path.waypoints]\nfile = 3\n", "line 3", "in quotes"),
            ("[path.square]\nfile = \"a.csv\"\n", "line 2", "file"),
            ("path = 3\n", "line 1", "path"),
            ("[path.waypoints\n", "line 1", "path.waypoints"),
        ] {
            let read = Scenario::from_toml_with(text, &mut |_| unreachable!("nothing to read"));
            let message = refusal(read);
            assert!(message.contains(line), "{message} lacks {line}");
            assert!(message.contains(reason), "{message} lacks {reason}");
        }
    }

    #[test]
    fn keys_beside_a_file_are_checked_with_their_line() {
        let text = "[path.waypoints]\nfile = \"a.csv\"\nside_m = 3\n";
        let read = Scenario::from_toml_with(text, &mut |_| Ok("0,0\n1,0\n".to_owned()));
        let message = refusal(read);
        assert!(message.contains("line 3") && message.contains("side_m"));
    }

    #[test]
    fn a_file_that_cannot_be_read_is_named_with_the_line_that_names_it() {
        let read =
            Scenario::from_toml_with(SCENARIO, &mut |_| Err(io::Error::new(io::ErrorKind::NotFound, "no such file")));
        let message = refusal(read);
        for part in ["line 3", "lap/points.csv", "no such file"] {
            assert!(message.contains(part), "{message} lacks {part}");
        }
        let alone = refusal(Scenario::from_toml(SCENARIO));
        for part in ["line 3", "lap/points.csv", "points_m"] {
            assert!(alone.contains(part), "{alone} lacks {part}");
        }
    }
}
