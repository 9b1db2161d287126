//! `[camera.pictures]`: a camera whose pictures of the floor are rendered.

use posebridge_telemetry::TimeDelta;
use serde::Deserialize;
use serde::de::{Deserializer, Error};

/// Ids of the family tag36h11.
const TAG_IDS: u16 = 587;
/// Least height of the camera above a tag, m.
const MIN_DISTANCE_M: f64 = 0.05;
const MAX_FLOOR_TAGS: usize = 64;
/// Steps from the middle of the picture to its farthest corner in which the distortion must not turn back.
const LENS_STEPS: u32 = 200;

/// A camera above the arena with its lens, its sensor and the tags that it sees. Defaults: a webcam of 640 x 480 on a stand, 2.5 m above
/// the floor, that looks down on the bundled paths.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderedCameraSettings {
    pub width_px: u16,
    pub height_px: u16,
    pub rate_hz: f64,
    /// Of the camera.
    pub x_m: f64,
    pub y_m: f64,
    /// Above the floor.
    pub height_m: f64,
    /// From straight down.
    pub tilt_deg: f64,
    /// Direction on the floor in which the picture's upper edge lies, and to which the camera is tilted: counter-clockwise from x.
    pub azimuth_deg: f64,
    pub focal_px: f64,
    /// Where the axis meets the picture, right and down of its middle.
    pub axis_offset_px: [f64; 2],
    /// A direction at the distance r from the axis is scaled by 1 + a r² + b r⁴ (Brown, 1966).
    pub radial: [f64; 2],
    pub exposure_ms: f64,
    /// Between the exposures of two rows; 0 for a global shutter.
    pub line_time_us: f64,
    /// Sigma of the lens's blur.
    pub blur_px: f64,
    /// Grey level of white paper in the middle of the picture.
    pub white_level: f64,
    /// Relative change of the light from the left edge to the right one, and from the upper edge to the lower one.
    pub light_change: [f64; 2],
    /// Sigma of the noise of a dark pixel, grey levels.
    pub read_noise: f64,
    /// Added variance per grey level.
    pub shot_noise: f64,
    /// Mean, from the middle of the exposure to the delivery. A frame is never delivered before its last row is exposed.
    pub latency_ms: f64,
    /// Half the width of the uniform spread of the latency.
    pub jitter_ms: f64,
    pub jpeg_quality: u8,
    pub robot_tag: RobotTagSettings,
    pub floor_tags: Vec<FloorTagSettings>,
}

impl Default for RenderedCameraSettings {
    fn default() -> Self {
        // The sheet of `posebridge camera sheet`, its lower left corner at (0.395, 0.35).
        let floor_tag = |id, x_m, y_m| FloorTagSettings { id, side_m: 0.08, x_m, y_m, heading_deg: 90.0 };
        Self {
            width_px: 640,
            height_px: 480,
            rate_hz: 15.0,
            x_m: 0.5,
            y_m: -0.95,
            height_m: 2.5,
            tilt_deg: 30.0,
            azimuth_deg: 90.0,
            focal_px: 600.0,
            axis_offset_px: [0.0, 0.0],
            radial: [-0.08, 0.02],
            exposure_ms: 8.0,
            line_time_us: 0.0,
            blur_px: 0.6,
            white_level: 205.0,
            light_change: [0.15, -0.1],
            read_noise: 1.5,
            shot_noise: 0.02,
            latency_ms: 60.0,
            jitter_ms: 10.0,
            jpeg_quality: 80,
            robot_tag: RobotTagSettings::default(),
            floor_tags: vec![
                floor_tag(580, 0.45, 0.43),
                floor_tag(581, 0.55, 0.43),
                floor_tag(582, 0.45, 0.565),
                floor_tag(583, 0.55, 0.565),
            ],
        }
    }
}

/// The tag on the robot, above the point (`tag_x_m`, `tag_y_m`) of `[camera]`, its way up ahead.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotTagSettings {
    pub id: u16,
    /// Of the black rim.
    pub side_m: f64,
    /// Above the floor.
    pub height_m: f64,
}

impl Default for RobotTagSettings {
    fn default() -> Self {
        Self { id: 0, side_m: 0.1, height_m: 0.085 }
    }
}

/// A tag that lies on the floor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FloorTagSettings {
    pub id: u16,
    /// Of the black rim.
    pub side_m: f64,
    /// Of its middle.
    pub x_m: f64,
    pub y_m: f64,
    /// Of its way up, counter-clockwise from x.
    #[serde(default)]
    pub heading_deg: f64,
}

impl RenderedCameraSettings {
    pub fn exposure(&self) -> TimeDelta {
        TimeDelta::from_secs_f64(self.exposure_ms * 1e-3)
    }

    /// From the exposure of the first row to that of the last one.
    pub fn readout(&self) -> TimeDelta {
        TimeDelta::from_secs_f64(self.line_time_us * 1e-6 * (f64::from(self.height_px) - 1.0))
    }

    /// Where the axis meets the picture; the centre of the first pixel is (0, 0).
    pub fn axis_px(&self) -> [f64; 2] {
        let [right, down] = self.axis_offset_px;
        [(f64::from(self.width_px) - 1.0) / 2.0 + right, (f64::from(self.height_px) - 1.0) / 2.0 + down]
    }

    /// The keys that contradict each other, and why. The ranges of single numbers are not checked here.
    pub(crate) fn contradiction(&self) -> Option<String> {
        let needed_ms = (self.exposure() + self.readout()).as_millis_f64();
        let period_ms = 1e3 / self.rate_hz;
        if needed_ms > period_ms {
            return Some(format!(
                "exposure_ms and line_time_us take {needed_ms:.3} ms, but rate_hz leaves {period_ms:.3} ms for a picture"
            ));
        }
        let (camera_m, tag_m) = (self.height_m, self.robot_tag.height_m);
        if camera_m < tag_m + MIN_DISTANCE_M {
            return Some(format!(
                "height_m of the camera is {camera_m}, that of robot_tag {tag_m}; the camera must be {MIN_DISTANCE_M} m above it"
            ));
        }
        if !self.lens_reaches_the_corners() {
            return Some("radial turns the picture back before its corners; give smaller numbers".to_owned());
        }
        self.tag_error()
    }

    fn tag_error(&self) -> Option<String> {
        let count = self.floor_tags.len();
        if count > MAX_FLOOR_TAGS {
            return Some(format!("there are {count} floor_tags; give at most {MAX_FLOOR_TAGS}"));
        }
        let mut ids: Vec<u16> = self.floor_tags.iter().map(|tag| tag.id).collect();
        ids.push(self.robot_tag.id);
        ids.sort_unstable();
        let repeated = ids.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0]);
        if let Some(id) = repeated {
            return Some(format!("two tags have the id {id}; give each its own"));
        }
        let unknown = ids.last().filter(|id| **id >= TAG_IDS);
        unknown.map(|id| format!("id {id} is no tag of the family tag36h11; give 0 to {}", TAG_IDS - 1))
    }

    /// Whether each pixel has one direction.
    fn lens_reaches_the_corners(&self) -> bool {
        let [right, down] = self.axis_px();
        let across = right.abs().max((f64::from(self.width_px) - right).abs());
        let along = down.abs().max((f64::from(self.height_px) - down).abs());
        let corner = (across + 1.0).hypot(along + 1.0) / self.focal_px;
        let [second, fourth] = self.radial;
        // The direction at the corner is at most this much farther out, else the picture is hardly one.
        let step = 2.0 * corner / f64::from(LENS_STEPS);
        let mut last = 0.0;
        for index in 1..=LENS_STEPS {
            let distance = f64::from(index) * step;
            let squared = distance * distance;
            let distorted = distance * (1.0 + second * squared + fourth * squared * squared);
            if distorted <= last {
                return false;
            }
            if distorted >= corner {
                return true;
            }
            last = distorted;
        }
        false
    }
}

pub(super) fn pictures<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<RenderedCameraSettings>, D::Error> {
    let settings = RenderedCameraSettings::deserialize(deserializer)?;
    match settings.contradiction() {
        None => Ok(Some(settings)),
        Some(reason) => Err(D::Error::custom(reason)),
    }
}
