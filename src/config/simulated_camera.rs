//! The camera of a simulated brick that renders pictures, as the station knows it: `camera:sim`.

use anyhow::{Context, Result, ensure};
use posebridge_sim::Scenario;
use posebridge_sim::rendered_camera::Projection;
use posebridge_sim::scenario::RenderedCameraSettings;
use posebridge_vision::{CameraModel, FloorView};

use super::camera::CameraConfig;
use super::camera_file::{CameraChoice, CameraFile};
use super::link::LinkSection;
use super::station::Config;

/// The source of the simulated brick's own pictures.
const SIMULATED: &str = "camera:sim";

impl LinkSection {
    /// Whether its pictures are those of the simulated brick in this process.
    pub fn is_simulated_camera(&self) -> bool {
        self.url == SIMULATED
    }
}

impl Config {
    /// Takes what is known of the camera that renders, as far as the configuration does not say it: where it stands, and the tags.
    pub fn with_rendered_camera(mut self, scenario: &Scenario) -> Result<Self> {
        let cameras = self.links.iter_mut().filter(|link| link.is_simulated_camera()).collect::<Vec<_>>();
        ensure!(cameras.len() <= 1, "only one link may be `{SIMULATED}`");
        let Some(link) = cameras.into_iter().next() else { return Ok(self) };
        let settings = scenario.camera.pictures.clone().unwrap_or_default();
        if link.camera.is_none() {
            let camera = camera_file(&settings).context("the simulated camera stands where no camera can")?;
            link.camera = Some(CameraChoice::Camera(Box::new(camera)));
        }
        let usual = CameraConfig::default();
        if self.camera.tag_side_m == usual.tag_side_m {
            self.camera.tag_side_m = settings.robot_tag.side_m;
        }
        if self.camera.tag_height_m == usual.tag_height_m {
            self.camera.tag_height_m = settings.robot_tag.height_m;
        }
        if let (true, Some(first)) = (self.camera.floor_tags_from == usual.floor_tags_from, settings.floor_tags.first())
        {
            self.camera.floor_tags_from = first.id;
        }
        Ok(self)
    }
}

/// As a perfect calibration would find it.
fn camera_file(settings: &RenderedCameraSettings) -> Option<CameraFile> {
    let projection = Projection::new(settings);
    let (width, height) = (usize::from(settings.width_px), usize::from(settings.height_px));
    let axis = settings.axis_px();
    let camera =
        CameraModel { focal_px: [settings.focal_px; 2].into(), centre_px: axis.into(), radial: settings.radial };
    let view = FloorView::from_axes(camera, projection.position_m(), projection.axes())?;
    Some(CameraFile {
        delay_ms: Some(settings.latency_ms),
        delay_spread_ms: Some(settings.jitter_ms),
        ..CameraFile::new("simulated", (width, height), &view, None)
    })
}
