//! The file of a calibrated camera, which `posebridge camera calibrate` writes.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_vision::{CameraModel, FloorView};
use serde::{Deserialize, Serialize};

use crate::text_file::read_text;

/// A camera above the floor.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFile {
    pub name: String,
    /// Of its pictures, px. A picture of another size has another focal length.
    pub width: usize,
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
    /// How the calibration went.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationNote>,
}

/// For people; nothing reads it.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationNote {
    pub points: usize,
    pub rms_px: f64,
    pub floor_rms_mm: f64,
}

impl CameraFile {
    pub fn new(name: &str, (width, height): (usize, usize), view: &FloorView, calibration: CalibrationNote) -> Self {
        let camera = &view.camera;
        Self {
            name: name.to_owned(),
            width,
            height,
            focal_px: camera.focal_px.into(),
            centre_px: [camera.centre_px.x, camera.centre_px.y],
            radial: camera.radial,
            position_m: view.position_m(),
            rotation: view.rotation(),
            calibration: Some(calibration),
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

    const TEXT: &str = "name = \"overhead\"\nwidth = 1280\nheight = 720\nfocal_px = [900.0, 901.0]\ncentre_px = [639.5, 359.5]\n\
                        radial = [-0.2, 0.05]\nposition_m = [0.4, -0.3, 2.5]\nrotation = [0.0, 1.0, 0.0, 0.0]\n";

    #[test]
    fn a_camera_is_read_as_it_was_written_and_a_wrong_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("overhead.toml");
        std::fs::write(&path, TEXT).unwrap();
        let read = CameraFile::read(&path).unwrap();
        let note = CalibrationNote { points: 24, rms_px: 0.2, floor_rms_mm: 0.7 };
        let again = CameraFile::new("overhead", (1280, 720), &read.view().unwrap(), note);
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
