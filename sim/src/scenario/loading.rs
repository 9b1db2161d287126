//! Reads a scenario, and the file of way-points that it may name.
//!
//! A scenario names such a file with `file = ".."` under `[path.waypoints]`. The caller reads it, because this crate does no IO; its
//! points replace the key, so that the rest of the crate sees only `points_m`.
//!
//! The file has one point per line, `x_m,y_m`. A first line with exactly these two names is allowed; empty lines and comments after `#`
//! are ignored.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::{Deserialize, DeserializeOwned, Error};
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};

use crate::config_file::{ConfigFileError, LARGEST, check_ranges, line_of};

const HEADER: [&str; 2] = ["x_m", "y_m"];
const MIN_WAYPOINTS: usize = 2;
/// Bounds the list of manoeuvres.
const MAX_WAYPOINTS: usize = 10_000;
/// Closer way-points define no direction.
const MIN_SPACING_M: f64 = 1e-3;
/// The kind of file in error messages.
const WHAT: &str = "scenario";

fn toml_error(error: toml::de::Error) -> ConfigFileError {
    ConfigFileError::Toml { what: WHAT, error }
}

/// Parses a scenario and the file of way-points that it may name, which `read` loads.
pub(super) fn parse_with_file<T: DeserializeOwned>(
    text: &str,
    read: &mut dyn FnMut(&Path) -> io::Result<String>,
) -> Result<T, ConfigFileError> {
    let points_text;
    let mut table = DeTable::parse(text).map_err(toml_error)?;
    if let Some((file, line)) = named_file(text, table.get_mut())? {
        let points = match read(&file) {
            Ok(points) => from_csv(&points),
            Err(source) => return Err(ConfigFileError::WaypointsUnread { line, file, source }),
        };
        let points = points.map_err(|(line, reason)| ConfigFileError::WaypointsFile { file, line, reason })?;
        // Debug writes each number in its shortest exact form, and as TOML does.
        points_text = format!("{points:?}");
        let value = DeValue::parse(&points_text).map_err(toml_error)?;
        if let Some((_, waypoints)) = waypoints_in(table.get_mut()) {
            waypoints.remove("file");
            waypoints.insert(Spanned::new(0..0, "points_m".into()), value);
        }
    }
    let scenario = T::deserialize(Deserializer::from(table)).map_err(|mut error| {
        error.set_input(Some(text));
        toml_error(error)
    })?;
    check_ranges(text).map_err(toml_error)?;
    Ok(scenario)
}

/// The table `[path.waypoints]` and its range in the text.
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

/// The way-point file that the scenario names, and the line that names it.
fn named_file(text: &str, scenario: &mut DeTable<'_>) -> Result<Option<(PathBuf, usize)>, ConfigFileError> {
    let refused = |span: Range<usize>, reason: &str| {
        let reason = format!("line {}: {reason}", line_of(text, span.start));
        Err(ConfigFileError::Impossible { what: WHAT, reason })
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

/// The points of a file; the error is the invalid line, counted from 1, and the reason.
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

pub(super) fn waypoints<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 2]>, D::Error> {
    let points = Vec::<[f64; 2]>::deserialize(deserializer)?;
    match waypoint_error(&points) {
        None => Ok(points),
        Some((_, reason)) => Err(D::Error::custom(reason)),
    }
}

/// Index of the first invalid way-point, or the length if one is missing, and the reason.
pub(super) fn waypoint_error(points: &[[f64; 2]]) -> Option<(usize, String)> {
    let count = points.len();
    if count < MIN_WAYPOINTS {
        let reason = format!("the number of way-points is {count}; give {MIN_WAYPOINTS} to {MAX_WAYPOINTS}");
        return Some((count, reason));
    }
    if count > MAX_WAYPOINTS {
        let reason = format!("there are more than {MAX_WAYPOINTS} way-points; give {MIN_WAYPOINTS} to {MAX_WAYPOINTS}");
        return Some((MAX_WAYPOINTS, reason));
    }
    points.iter().enumerate().find_map(|(index, &[x_m, y_m])| {
        let largest = LARGEST;
        // A NaN is within nothing.
        if !(x_m.abs() <= largest && y_m.abs() <= largest) {
            let reason = format!("way-point ({x_m}, {y_m}) is not within {largest} m of zero");
            return Some((index, reason));
        }
        let [last_x_m, last_y_m] = *points.get(index.checked_sub(1)?)?;
        let is_close = (x_m - last_x_m).hypot(y_m - last_y_m) < MIN_SPACING_M;
        let reason = || format!("way-point ({x_m}, {y_m}) is less than 1 mm from the one before; remove one");
        is_close.then(|| (index, reason()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    const SCENARIO: &str = "seed = 3\n[path.waypoints]\nfile = \"lap/points.csv\"\n";

    fn with_file(file: io::Result<&str>) -> Result<Scenario, ConfigFileError> {
        let mut file = Some(file.map(str::to_owned));
        Scenario::from_toml_with(SCENARIO, &mut |path| {
            assert_eq!(path, Path::new("lap/points.csv"));
            file.take().unwrap()
        })
    }

    fn assert_refused(read: Result<Scenario, ConfigFileError>, parts: &[&str]) {
        let message = read.unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "{message} lacks {part}");
        }
    }

    #[test]
    fn a_scenario_with_a_file_equals_the_one_with_its_points() {
        let text = "seed = 3\n[path.waypoints]\npoints_m = [[0, 0], [1.25, -0.5], [1e-7, 0.1]]\n";
        for file in [
            "0,0\n1.25,-0.5\n1e-7,0.1\n",
            "x_m,y_m\r\n0,0\r\n1.25,-0.5\r\n1e-7,0.1",
            "\u{feff}# a lap\n\n x_m , y_m # metres\n0, 0\n  1.25 ,-0.5 # corner\n\n1e-7,0.1\n",
        ] {
            assert_eq!(with_file(Ok(file)).unwrap(), Scenario::from_toml(text).unwrap(), "{file:?}");
        }
    }

    #[test]
    fn what_cannot_be_read_is_too_long_or_has_a_wrong_key_beside_it_is_refused() {
        let most = "0,0\n1,0\n".repeat(MAX_WAYPOINTS / 2 + 1);
        assert_refused(with_file(Ok(&most)), &["lap/points.csv, line 10001: ", "more than 10000"]);
        assert_refused(with_file(Err(io::Error::other("no such file"))), &["line 3", "lap/points.csv", "no such file"]);
        assert_refused(Scenario::from_toml(SCENARIO), &["line 3", "lap/points.csv", "points_m"]);
        let beside = "[path.waypoints]\nfile = \"a.csv\"\nside_m = 3\n";
        let read = Scenario::from_toml_with(beside, &mut |_| Ok("0,0\n1,0\n".to_owned()));
        assert_refused(read, &["line 3", "side_m"]);
    }
}
