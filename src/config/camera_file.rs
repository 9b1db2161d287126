//! The file of a calibrated camera, which `posebridge camera calibrate` writes.

use std::fmt;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_vision::{CameraModel, FloorView};
use schemars::JsonSchema;
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::text_file::read_text;

/// A camera above the floor.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFile {
    /// Its name, up to 16 letters and digits.
    pub name: String,
    /// Where its pictures come from, as after `camera:` in the URL of a link.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Which webcam it is: its name, and the ids and serial number of USB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Width of its pictures, px. A picture of another size has another focal length.
    pub width: usize,
    /// Their height, px.
    pub height: usize,
    /// Focal lengths across and down.
    pub focal_px: [f64; 2],
    /// Where the axis meets the picture; the centre of the first pixel is (0, 0).
    pub centre_px: [f64; 2],
    /// Radial distortion: coefficients of the second and fourth power of the tangent.
    pub radial: [f64; 2],
    /// In the arena, above the floor.
    pub position_m: [f64; 3],
    /// From the camera's axes (right, down, ahead) to the arena's (x, y, up), as a unit quaternion: w, x, y, z.
    pub rotation: [f64; 4],
    /// How long after the exposure a picture comes in, where the camera does not say; without it `camera.json.delay_ms`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_ms: Option<f64>,
    /// It may be so much more or less; without it `camera.json.delay_spread_ms`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_spread_ms: Option<f64>,
    /// How the calibration went.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationNote>,
}

/// For people; nothing reads it.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationNote {
    /// Corners that it was computed from.
    pub points: usize,
    /// Root mean square of what remained of them in the pictures.
    pub rms_px: f64,
    /// The same on the floor.
    pub floor_rms_mm: f64,
}

/// The camera of a link: the path of its file, or what stands in it, as recordings have it.
#[derive(Clone, Debug, JsonSchema, PartialEq, Serialize)]
#[serde(untagged)]
pub enum CameraChoice {
    /// Relative to the working directory.
    File(String),
    /// The content of a file.
    Camera(Box<CameraFile>),
}

impl CameraChoice {
    pub fn read(&self) -> Result<CameraFile> {
        match self {
            Self::File(path) => CameraFile::read(Path::new(path)),
            Self::Camera(camera) => {
                camera.view()?;
                Ok((**camera).clone())
            }
        }
    }
}

/// Not derived: an error in the table would not be named.
impl<'de> Deserialize<'de> for CameraChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ChoiceVisitor;

        impl<'de> Visitor<'de> for ChoiceVisitor {
            type Value = CameraChoice;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the path of a camera's file, or its table")
            }

            fn visit_str<E: de::Error>(self, path: &str) -> Result<CameraChoice, E> {
                Ok(CameraChoice::File(path.to_owned()))
            }

            fn visit_map<M: MapAccess<'de>>(self, map: M) -> Result<CameraChoice, M::Error> {
                CameraFile::deserialize(MapAccessDeserializer::new(map))
                    .map(|file| CameraChoice::Camera(Box::new(file)))
            }
        }

        deserializer.deserialize_any(ChoiceVisitor)
    }
}

impl CameraFile {
    pub fn new(
        name: &str,
        (width, height): (usize, usize),
        view: &FloorView,
        calibration: Option<CalibrationNote>,
    ) -> Self {
        let camera = &view.camera;
        Self {
            name: name.to_owned(),
            source: None,
            device: None,
            width,
            height,
            focal_px: camera.focal_px.into(),
            centre_px: [camera.centre_px.x, camera.centre_px.y],
            radial: camera.radial,
            position_m: view.position_m(),
            rotation: view.rotation(),
            delay_ms: None,
            delay_spread_ms: None,
            calibration,
        }
    }

    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display();
        let text = read_text(path).with_context(|| format!("reading the camera `{name}`"))?;
        let file: Self = toml::from_str(&text).with_context(|| format!("camera `{name}`"))?;
        file.view().with_context(|| format!("camera `{name}`"))?;
        Ok(file)
    }

    pub fn to_toml(&self) -> Result<String> {
        Ok(format!("# Written by `posebridge camera calibrate` (docs/camera.md).\n{}", toml::to_string(self)?))
    }

    pub fn view(&self) -> Result<FloorView> {
        let camera =
            CameraModel { focal_px: self.focal_px.into(), centre_px: self.centre_px.into(), radial: self.radial };
        FloorView::new(camera, self.position_m, self.rotation).context(
            "`focal_px` must be above 0, `position_m` above the floor, `rotation` a unit quaternion, and all numbers finite",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, LinkSection};

    const TEXT: &str = "name = \"overhead\"\nwidth = 1280\nheight = 720\nfocal_px = [900.0, 901.0]\ncentre_px = [639.5, 359.5]\n\
                        radial = [-0.2, 0.05]\nposition_m = [0.4, -0.3, 2.5]\nrotation = [0.0, 1.0, 0.0, 0.0]\n";

    #[test]
    fn the_delay_of_a_camera_is_learned_unless_somebody_knows_it() {
        let sigma_s = |url: &str, delay_ms: Option<f64>, known_s: f64| {
            let camera = CameraFile { delay_ms, ..toml::from_str(TEXT).unwrap() };
            let link = LinkSection { camera: Some(CameraChoice::Camera(Box::new(camera))), ..LinkSection::new(url) };
            let mut config = Config { links: vec![link], ..Config::default() };
            config.robot.calibration.fix_delay_s.value = known_s;
            config.with_cameras_read().unwrap().robot.calibration.fix_delay_s.sigma
        };
        assert_eq!(sigma_s("camera:http://phone/video", None, 0.0), 0.1);
        assert_eq!(sigma_s("camera:http://phone/video", Some(150.0), 0.0), 0.0);
        assert_eq!(sigma_s("camera:http://phone/video", None, 0.08), 0.0);
        assert_eq!(sigma_s("camera:/dev/video0", None, 0.0), 0.03, "its driver stamps its pictures, to about a frame");
        assert_eq!(sigma_s("camera:pictures", None, 0.0), 0.0, "a table says when they were taken");
    }

    #[test]
    fn a_camera_is_read_as_it_was_written_and_a_wrong_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("overhead.toml");
        std::fs::write(&path, TEXT).unwrap();
        let read = CameraFile::read(&path).unwrap();
        let note = CalibrationNote { points: 24, rms_px: 0.2, floor_rms_mm: 0.7 };
        let again = CameraFile::new("overhead", (1280, 720), &read.view().unwrap(), Some(note));
        assert_eq!(CameraFile { calibration: None, ..again.clone() }, read);
        std::fs::write(&path, again.to_toml().unwrap()).unwrap();
        assert_eq!(CameraFile::read(&path).unwrap(), again);
        for (from, to, words) in [
            ("2.5]", "-2.5]", "above the floor"),
            ("[0.0, 1.0,", "[1.0, 1.0,", "unit quaternion"),
            ("900.0", "0.0", "`focal_px`"),
            ("900.0", "nan", "finite"),
            ("radial", "radical", "radical"),
        ] {
            std::fs::write(&path, TEXT.replace(from, to)).unwrap();
            let error = format!("{:#}", CameraFile::read(&path).unwrap_err());
            assert!(error.contains(words) && error.contains("overhead.toml"), "{error}");
        }
    }
}
