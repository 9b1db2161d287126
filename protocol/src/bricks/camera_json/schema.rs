//! Parses one line of a camera: JSON to values in SI units in the arena, or the error and its key.
//!
//! `serde_json` parses the JSON and limits its nesting. Sources: docs/protocols/camera-json.md; RFC 8259 (JSON).

use std::ops::RangeInclusive;

use nalgebra::{Point2, SMatrix};
use posebridge_telemetry::{ChannelName, Heading, Meters, TimeDelta};
use serde_json::{Map, Value};

use super::super::line_splitter::printable;
use super::floor_camera::{FloorCamera, TagCorners};
use crate::dialect::frames::{PlanarPoint, turn_ned};
use crate::framing::TransportKind;

pub(super) const KEYS: &[&str] = &[
    "camera",
    "exposed_s",
    "exposed_us",
    "exposed_ago_us",
    "received_ago_us",
    "corners_px",
    "corners_cov_px2",
    "picture_px",
    "x_m",
    "y_m",
    "heading_rad",
    "heading_deg",
    "sigma_m",
    "sigma_heading_rad",
    "sigma_heading_deg",
    "quality",
    "reset_counter",
    "tag",
    "space",
    "takes_requests",
    "time_answer",
    "time_s",
    "time_us",
];

const DEFAULT_CAMERA_NAME: &[u8] = b"camera";
/// No arena is larger: 100 km.
const MAX_COORDINATE_M: f64 = 1e5;
/// A smaller sigma, m or rad, is a mistake: no camera is precise to a micrometre, and its square must not vanish in
/// 64-bit arithmetic.
const MIN_SIGMA: f64 = 1e-6;
/// A larger sigma carries no information.
const MAX_SIGMA: f64 = 1e3;
/// Largest unwrapped angle that is accepted.
const MAX_ANGLE_RAD: f64 = 1e6;
/// Nanoseconds in 64 bits last for 292 years; UNIX time is far below.
const MAX_TIME_S: f64 = 9e9;
/// No picture is used that is older: the longest history of a filter.
const MAX_AGE_US: f64 = 60e6;
/// No picture is wider or higher; corners may lie somewhat outside of it.
const MAX_PIXEL: f64 = 65_536.0;
/// Standard deviation of a corner of which nothing is said, px.
const DEFAULT_CORNER_SIGMA_PX: f64 = 0.3;

#[derive(Clone, Debug, PartialEq)]
pub(super) struct CameraLine {
    pub(super) camera: ChannelName,
    pub(super) takes_requests: Option<bool>,
    pub(super) message: CameraMessage,
    pub(super) unknown: Vec<String>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum CameraMessage {
    Fix(CameraFixMessage),
    Time {
        request: i64,
        /// Since the clock's zero.
        nanos: i64,
    },
    Hello,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct CameraFixMessage {
    pub(super) exposed: ExposureTime,
    pub(super) place: FixPlace,
    pub(super) quality: Option<f64>,
    pub(super) reset_counter: u8,
    /// `None` if the camera does not distinguish tags.
    pub(super) tag: Option<u32>,
}

/// When the middle of the exposure was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ExposureTime {
    Unknown,
    /// By the camera's clock, µs.
    Stamp(u64),
    /// Before the line was sent.
    Ago {
        least: TimeDelta,
        most: TimeDelta,
    },
    /// The delay of the settings before the picture was received, and that was so long before the line was sent.
    BeforeReception(TimeDelta),
}

/// Where the tag is.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum FixPlace {
    Arena {
        x: Meters,
        y: Meters,
        heading: Option<Heading>,
        /// Variances as in [`VisionFix::covariance`](crate::message::VisionFix::covariance).
        covariance: Option<[f64; 4]>,
    },
    Picture(Box<TagCorners>),
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct FieldError {
    pub(super) key: Option<&'static str>,
    pub(super) text: String,
}

impl FieldError {
    pub(super) fn for_key(key: &'static str, what: &str) -> Self {
        Self { key: Some(key), text: format!("`{key}` {what}") }
    }

    pub(super) const fn for_line(text: String) -> Self {
        Self { key: None, text }
    }
}

/// Fails if the line is not a JSON object, or if a key is missing or has an invalid value.
pub(super) fn parse_line(line: &[u8]) -> Result<CameraLine, FieldError> {
    let value: Value = serde_json::from_slice(line).map_err(|error| json_error(line, &error))?;
    let Value::Object(map) = value else {
        let text = "a line must be one JSON object, such as {\"x_m\": 1.0, \"y_m\": 2.0}";
        return Err(FieldError::for_line(text.to_owned()));
    };
    let keys = LineKeys(&map);
    let is_unknown = |key: &&String| !KEYS.contains(&key.as_str());
    Ok(CameraLine {
        camera: keys.camera()?,
        takes_requests: keys.flag("takes_requests")?,
        message: keys.message()?,
        unknown: map.keys().filter(is_unknown).map(|key| printable(key.as_bytes())).collect(),
    })
}

fn json_error(line: &[u8], error: &serde_json::Error) -> FieldError {
    let has = |word: &[u8]| line.windows(word.len()).any(|part| part == word);
    let hint = if has(b"NaN") || has(b"Infinity") {
        "; JSON knows no NaN and no Infinity: leave the key out, or the whole line"
    } else {
        ""
    };
    let byte = error.column();
    FieldError::for_line(format!("this is no JSON from byte {byte} on{hint}"))
}

struct LineKeys<'a>(&'a Map<String, Value>);

impl LineKeys<'_> {
    fn message(&self) -> Result<CameraMessage, FieldError> {
        if let Some(request) = self.0.get("time_answer") {
            let Some(request) = request.as_i64() else {
                return Err(FieldError::for_key("time_answer", "must be the number of the request"));
            };
            let nanos = self.time("time_s", "time_us", 1e9)?;
            let nanos = nanos.ok_or_else(|| FieldError::for_key("time_s", "is missing beside `time_answer`"))?;
            return Ok(CameraMessage::Time { request, nanos: nanos as i64 });
        }
        let is_hello = self.0.contains_key("takes_requests")
            && !["x_m", "y_m", "corners_px"].iter().any(|key| self.0.contains_key(*key));
        if is_hello {
            return Ok(CameraMessage::Hello);
        }
        self.fix().map(CameraMessage::Fix)
    }

    fn fix(&self) -> Result<CameraFixMessage, FieldError> {
        let tag = self.integer("tag", u32::MAX)?;
        let place = match self.corners()? {
            Some(_) if tag.is_none() => return Err(FieldError::for_key("tag", "is missing beside `corners_px`")),
            Some(corners) => FixPlace::Picture(Box::new(corners)),
            None => {
                let pose = self.planar_pose()?;
                let heading = self.heading_rad()?.map(|_| Heading::from_rad(pose.angle));
                FixPlace::Arena { x: Meters(pose.x), y: Meters(pose.y), heading, covariance: self.covariance(heading)? }
            }
        };
        Ok(CameraFixMessage {
            exposed: self.exposure_time()?,
            place,
            quality: self.bounded("quality", 0.0, 100.0)?,
            reset_counter: self.integer("reset_counter", u32::from(u8::MAX))?.unwrap_or(0) as u8,
            tag,
        })
    }

    fn exposure_time(&self) -> Result<ExposureTime, FieldError> {
        let stamp = self.time("exposed_s", "exposed_us", 1e6)?.map(|micros| ExposureTime::Stamp(micros as u64));
        let age = |micros: f64| TimeDelta::from_secs_f64(1e-6 * micros);
        let ago = match self.numbers::<2>("exposed_ago_us", 0.0, MAX_AGE_US)? {
            Some([least, most]) if least > most => {
                return Err(FieldError::for_key("exposed_ago_us", "must be the least and the most"));
            }
            ago => ago.map(|[least, most]| ExposureTime::Ago { least: age(least), most: age(most) }),
        };
        let received = self.bounded("received_ago_us", 0.0, MAX_AGE_US)?;
        let received = received.map(|micros| ExposureTime::BeforeReception(age(micros)));
        let mut given = [(stamp, "exposed_s"), (ago, "exposed_ago_us"), (received, "received_ago_us")]
            .into_iter()
            .filter_map(|(time, key)| Some((time?, key)));
        let first = given.next();
        match given.next() {
            Some((_, key)) => Err(FieldError::for_key(key, "says the same as another key of time")),
            None => Ok(first.map_or(ExposureTime::Unknown, |(time, _)| time)),
        }
    }

    /// The corners of a tag in the picture, if the line has any.
    fn corners(&self) -> Result<Option<TagCorners>, FieldError> {
        let Some(corners) = self.0.get("corners_px").filter(|value| !value.is_null()) else {
            return Ok(None);
        };
        if let Some(key) =
            ["x_m", "y_m", "heading_rad", "heading_deg", "sigma_m"].iter().find(|key| self.0.contains_key(**key))
        {
            return Err(FieldError::for_key(key, "says the same as `corners_px`"));
        }
        let wrong =
            || FieldError::for_key("corners_px", "must be four pairs of pixels: [[x, y], [x, y], [x, y], [x, y]]");
        let pair = |value: &Value| {
            let [x, y] = value.as_array()?.as_slice() else { return None };
            let is_pixel = |number: &f64| number.abs() <= MAX_PIXEL;
            Some(Point2::new(x.as_f64().filter(is_pixel)?, y.as_f64().filter(is_pixel)?))
        };
        let pairs: Option<Vec<_>> = corners.as_array().ok_or_else(wrong)?.iter().map(pair).collect();
        let corners: [Point2<f64>; 4] = pairs.and_then(|pairs| pairs.try_into().ok()).ok_or_else(wrong)?;
        let covariance = self.corner_covariance()?;
        let picture = self.numbers::<2>("picture_px", 1.0, MAX_PIXEL)?;
        Ok(Some(TagCorners { corners, covariance, picture_px: picture.map(|size| size.map(|side| side as usize)) }))
    }

    /// From its lower triangle, row by row.
    fn corner_covariance(&self) -> Result<SMatrix<f64, 8, 8>, FieldError> {
        let Some(triangle) = self.numbers::<36>("corners_cov_px2", -MAX_PIXEL, MAX_PIXEL)? else {
            return Ok(SMatrix::identity() * DEFAULT_CORNER_SIGMA_PX.powi(2));
        };
        let mut covariance = SMatrix::<f64, 8, 8>::zeros();
        let mut entries = triangle.into_iter();
        for row in 0..8 {
            for (column, entry) in (0..=row).zip(&mut entries) {
                covariance[(row, column)] = entry;
                covariance[(column, row)] = entry;
            }
        }
        match covariance.cholesky() {
            Some(_) => Ok(covariance),
            None => {
                Err(FieldError::for_key("corners_cov_px2", "must be the lower triangle of a covariance, row by row"))
            }
        }
    }

    fn numbers<const N: usize>(
        &self,
        key: &'static str,
        least: f64,
        most: f64,
    ) -> Result<Option<[f64; N]>, FieldError> {
        let Some(value) = self.0.get(key).filter(|value| !value.is_null()) else {
            return Ok(None);
        };
        let number = |value: &Value| value.as_f64().filter(|number| (least..=most).contains(number));
        let numbers: Option<Vec<f64>> = value.as_array().and_then(|list| list.iter().map(number).collect());
        let wrong = || FieldError::for_key(key, &format!("must be {N} numbers between {least:?} and {most:?}"));
        numbers.and_then(|list| list.try_into().ok()).map(Some).ok_or_else(wrong)
    }

    /// Position and heading in the arena; 0 stands for a missing heading.
    fn planar_pose(&self) -> Result<PlanarPoint, FieldError> {
        let coordinate = |key| {
            let value = self.bounded(key, -MAX_COORDINATE_M, MAX_COORDINATE_M)?;
            value.ok_or_else(|| FieldError::for_key(key, "is missing"))
        };
        let pose =
            PlanarPoint { x: coordinate("x_m")?, y: coordinate("y_m")?, angle: self.heading_rad()?.unwrap_or(0.0) };
        match self.0.get("space").map(Value::as_str) {
            None | Some(Some("arena")) => Ok(pose),
            Some(Some("ned")) => Ok(turn_ned(pose)),
            Some(_) => Err(FieldError::for_key("space", "must be \"arena\" or \"ned\"")),
        }
    }

    fn heading_rad(&self) -> Result<Option<f64>, FieldError> {
        let range = -MAX_ANGLE_RAD..=MAX_ANGLE_RAD;
        self.angle("heading_rad", "heading_deg", range)
    }

    /// Variances from the sigmas. With a heading, both sigmas or none: the station cannot guess the variance of the
    /// heading.
    fn covariance(&self, heading: Option<Heading>) -> Result<Option<[f64; 4]>, FieldError> {
        let position = self.bounded("sigma_m", MIN_SIGMA, MAX_SIGMA)?;
        let turn = self.angle("sigma_heading_rad", "sigma_heading_deg", MIN_SIGMA..=MAX_SIGMA)?;
        let Some(sigma_m) = position else {
            return match turn {
                None => Ok(None),
                Some(_) => Err(FieldError::for_key("sigma_m", "is missing beside the heading's sigma")),
            };
        };
        if heading.is_some() && turn.is_none() {
            return Err(FieldError::for_key(
                "sigma_heading_rad",
                "is missing beside `sigma_m` and a heading; give both sigmas or none",
            ));
        }
        let position_m2 = sigma_m.powi(2);
        let heading_rad2 = turn.map_or(f64::INFINITY, |sigma_rad| sigma_rad.powi(2));
        Ok(Some([position_m2, 0.0, position_m2, heading_rad2]))
    }

    /// An instant, in seconds under one key or in microseconds under the other, as a whole number of units.
    fn time(&self, seconds: &'static str, micros: &'static str, units_per_s: f64) -> Result<Option<f64>, FieldError> {
        let in_seconds = self.bounded(seconds, 0.0, MAX_TIME_S)?;
        let in_micros = self.bounded(micros, 0.0, MAX_TIME_S * 1e6)?;
        match (in_seconds, in_micros) {
            (Some(_), Some(_)) => Err(FieldError::for_key(micros, "says the same as the one in seconds")),
            (Some(seconds), None) => Ok(Some((seconds * units_per_s).round())),
            (None, micros) => Ok(micros.map(|micros| (micros * (units_per_s / 1e6)).round())),
        }
    }

    /// An angle in radians under one key or in degrees under the other, within a range of radians.
    fn angle(
        &self,
        radians: &'static str,
        degrees: &'static str,
        range_rad: RangeInclusive<f64>,
    ) -> Result<Option<f64>, FieldError> {
        let (least, most) = range_rad.into_inner();
        let in_radians = self.bounded(radians, least, most)?;
        let in_degrees = self.bounded(degrees, least.to_degrees(), most.to_degrees())?;
        match (in_radians, in_degrees) {
            (Some(_), Some(_)) => Err(FieldError::for_key(degrees, "says the same as the one in radians")),
            (in_radians, in_degrees) => Ok(in_radians.or(in_degrees.map(f64::to_radians))),
        }
    }

    fn bounded(&self, key: &'static str, least: f64, most: f64) -> Result<Option<f64>, FieldError> {
        let Some(value) = self.0.get(key).filter(|value| !value.is_null()) else {
            return Ok(None);
        };
        let Some(number) = value.as_f64() else {
            return Err(FieldError::for_key(key, "must be a number"));
        };
        if (least..=most).contains(&number) {
            return Ok(Some(number));
        }
        let range = format!("is {number:?}, must lie between {least:?} and {most:?}");
        Err(FieldError::for_key(key, &range))
    }

    fn integer(&self, key: &'static str, most: u32) -> Result<Option<u32>, FieldError> {
        match self.bounded(key, 0.0, f64::from(most))? {
            Some(number) if number.fract() != 0.0 => Err(FieldError::for_key(key, "must be a whole number")),
            number => Ok(number.map(|number| number as u32)),
        }
    }

    fn flag(&self, key: &'static str) -> Result<Option<bool>, FieldError> {
        match self.0.get(key) {
            None => Ok(None),
            Some(Value::Bool(flag)) => Ok(Some(*flag)),
            Some(_) => Err(FieldError::for_key(key, "must be true or false")),
        }
    }

    fn camera(&self) -> Result<ChannelName, FieldError> {
        let name = match self.0.get("camera") {
            None => return Ok(ChannelName::from_bytes(DEFAULT_CAMERA_NAME)),
            Some(Value::String(name)) => name.as_bytes(),
            Some(_) => return Err(FieldError::for_key("camera", "must be a text")),
        };
        let is_name = (1..=ChannelName::MAX_LEN).contains(&name.len()) && name.iter().all(u8::is_ascii_graphic);
        if !is_name {
            let what = "must be 1 to 16 printable ASCII characters without a space";
            return Err(FieldError::for_key("camera", what));
        }
        Ok(ChannelName::from_bytes(name))
    }
}

/// Settings for cameras that send JSON.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraJsonSettings {
    /// In a datagram, the end of the chunk ends the last line.
    pub framing: TransportKind,
    /// Delay between exposure and arrival of a fix without a time.
    pub delay: TimeDelta,
    /// Deviation of the delay, either way.
    pub delay_spread: TimeDelta,
    /// Fixes of lower quality are dropped, in per cent; a camera that has failed sends 0.
    pub min_quality: f64,
    /// Without it tags in the picture have no place.
    pub floor: Option<FloorCamera>,
}

impl Default for CameraJsonSettings {
    /// A camera program at 30 images per second takes the time of one to three images.
    fn default() -> Self {
        Self {
            framing: TransportKind::Stream,
            delay: TimeDelta::from_millis(60),
            delay_spread: TimeDelta::from_millis(40),
            min_quality: 1.0,
            floor: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(line: &str) -> (Meters, Meters, Option<Heading>, Option<[f64; 4]>) {
        match parse_line(line.as_bytes()).unwrap().message {
            CameraMessage::Fix(CameraFixMessage { place: FixPlace::Arena { x, y, heading, covariance }, .. }) => {
                (x, y, heading, covariance)
            }
            other @ (CameraMessage::Fix(_) | CameraMessage::Time { .. } | CameraMessage::Hello) => {
                panic!("{line}: {other:?}")
            }
        }
    }

    #[test]
    fn a_fix_is_in_the_arena_or_north_east_down() {
        let (x, y, heading, _) = place("{\"x_m\": 3, \"y_m\": 4, \"heading_deg\": 30, \"space\": \"ned\"}");
        assert_eq!((x, y), (Meters(4.0), Meters(3.0)));
        assert!((heading.unwrap().rad().to_degrees() - 60.0).abs() < 1e-9);
        let (.., heading, _) = place("{\"x_m\": 3, \"y_m\": 4, \"space\": \"ned\"}");
        assert_eq!(heading, None);
    }

    #[test]
    fn sigmas_become_variances_and_no_heading_is_left_without_one() {
        let line = "{\"x_m\": 0, \"y_m\": 0, \"heading_rad\": 0, \"sigma_m\": 0.1, \"sigma_heading_rad\": 0.2}";
        let [xx, xy, yy, hh] = place(line).3.unwrap();
        assert!((xx - 0.01).abs() < 1e-15 && xy == 0.0 && yy == xx);
        assert!((hh - 0.04).abs() < 1e-15);
        let [.., hh] = place("{\"x_m\": 0, \"y_m\": 0, \"sigma_m\": 0.1}").3.unwrap();
        assert_eq!(hh, f64::INFINITY);
    }

    /// A line, its wrong key, and the error text.
    const WRONG: &str = r#"
{"y_m": 0}                                                  | x_m               | is missing
{"x_m": "1", "y_m": 0}                                      | x_m               | a number
{"x_m": 1e9, "y_m": 0}                                      | x_m               | 100000
{"x_m": 0, "y_m": 0, "sigma_m": 0}                          | sigma_m           | between 1e-6
{"x_m": 0, "y_m": 0, "sigma_m": 1, "heading_rad": 0}        | sigma_heading_rad | both sigmas
{"x_m": 0, "y_m": 0, "sigma_heading_rad": 1}                | sigma_m           | is missing
{"x_m": 0, "y_m": 0, "exposed_s": -1}                       | exposed_s         | between 0
{"x_m": 0, "y_m": 0, "exposed_s": 1, "exposed_us": 1}       | exposed_us        | the same
{"x_m": 0, "y_m": 0, "heading_rad": 1, "heading_deg": 1}    | heading_deg       | the same
{"x_m": 0, "y_m": 0, "quality": 101}                        | quality           | 100
{"x_m": 0, "y_m": 0, "reset_counter": 1.5}                  | reset_counter     | whole
{"x_m": 0, "y_m": 0, "tag": -1}                             | tag               | between
{"x_m": 0, "y_m": 0, "space": "moon"}                       | space             | "ned"
{"x_m": 0, "y_m": 0, "camera": "a b"}                       | camera            | 16
{"time_answer": 1}                                          | time_s            | is missing
{"takes_requests": 1}                                       | takes_requests    | true or false
[1]                                                         | -                 | object
{"x_m": NaN}                                                | -                 | no NaN
{"x_m"                                                      | -                 | byte 6
"#;

    #[test]
    fn an_error_names_its_key() {
        for row in WRONG.trim().lines() {
            let [line, key, expected] = row.split('|').map(str::trim).collect::<Vec<_>>()[..] else {
                panic!("{row}");
            };
            let flaw = parse_line(line.as_bytes()).unwrap_err();
            assert_eq!(flaw.key.unwrap_or("-"), key, "{line}: {flaw:?}");
            assert!(flaw.text.contains(expected), "{line}: {flaw:?}");
        }
    }
}
