//! Cameras whose pictures this program searches for tags: their links, and their pictures for the page.

use std::net::{Ipv4Addr, TcpListener};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use posebridge_camera::{CameraSettings, CameraView, PictureSaver, SeenPicture, camera_opener, device_identity};
use posebridge_dashboard::model::SeenTagRow;
use posebridge_dashboard::{CameraPicture, CameraSource};
use posebridge_link::{HostTimer, Link, LinkOpenConfig, LinkUrl};
use posebridge_sim::Scenario;
use posebridge_telemetry::LinkId;
use posebridge_vision::{FLOOR_TAGS, GreyPicture};

use super::simulator::RenderedPictures;
use crate::config::{CameraChoice, Config, LinkSection, LinkTarget};

/// Of a camera without a file.
const DEFAULT_CAMERA_NAME: &str = "camera";

/// The cameras of a session.
pub(super) struct Cameras {
    cameras: Vec<Camera>,
    /// Where the pictures of the simulated one are served.
    simulated: Option<TcpListener>,
}

struct Camera {
    link: LinkId,
    is_simulated: bool,
    is_calibrated: bool,
    settings: CameraSettings,
}

impl Cameras {
    /// Binds a port for the pictures of the simulated brick's camera, if the configuration has it. `kept` is where pictures are kept, if
    /// at all.
    pub(super) fn new(config: &Config, kept: Option<&Path>) -> Result<Self> {
        let first = config.camera.floor_tags_from;
        let cameras = config.links.iter().enumerate().filter(|(_, link)| link.has_pictures()).map(|(index, link)| {
            let name = name_of(link);
            warn_of_another_camera(link);
            let saver = kept.map(|folder| start_saver(&folder.join(format!("pictures-{name}")))).transpose()?;
            let settings = CameraSettings {
                name: name.to_owned(),
                floor_tags: first..first.saturating_add(FLOOR_TAGS),
                view: CameraView::default(),
                saver: saver.map(Arc::new),
            };
            Ok(Camera {
                link: LinkId(index as u16),
                is_simulated: link.is_simulated_camera(),
                is_calibrated: link.camera.is_some(),
                settings,
            })
        });
        let cameras: Vec<Camera> = cameras.collect::<Result<_>>()?;
        let is_simulated = cameras.iter().any(|camera| camera.is_simulated);
        let has_brick = config.links.iter().any(|link| matches!(LinkTarget::parse(&link.url), Ok(LinkTarget::Sim(_))));
        ensure!(!is_simulated || has_brick, "--camera sim is the camera of a simulated brick: add --link sim://square");
        let simulated = is_simulated.then(|| TcpListener::bind((Ipv4Addr::LOCALHOST, 0))).transpose();
        Ok(Self { cameras, simulated: simulated.context("a port for the pictures of the simulated camera")? })
    }

    pub(super) const fn has_simulated(&self) -> bool {
        self.simulated.is_some()
    }

    /// The scenario as the simulated camera needs it.
    pub(super) fn watched(&self, scenario: Scenario) -> Scenario {
        if self.has_simulated() { scenario.with_rendered_camera() } else { scenario }
    }

    /// Starts to serve the pictures of the simulated camera.
    pub(super) fn rendered(&self, scenario: &Scenario, timer: HostTimer) -> Result<Option<RenderedPictures>> {
        let (Some(listener), Some(settings)) = (&self.simulated, &scenario.camera.pictures) else {
            return Ok(None);
        };
        RenderedPictures::start(listener.try_clone()?, settings, scenario.seed, timer).map(Some)
    }

    /// The link to a camera, or what was to be opened if it leads to none.
    pub(super) fn link(&self, open: LinkOpenConfig, timer: HostTimer) -> Result<Link, LinkOpenConfig> {
        let Some(camera) = self.cameras.iter().find(|camera| camera.link == open.id) else {
            return Err(open);
        };
        let url = self.url_of(camera).unwrap_or_else(|| open.url.clone());
        Ok(Link::with_opener(open, camera_opener(url, camera.settings.clone()), timer))
    }

    /// Of the simulated one.
    fn url_of(&self, camera: &Camera) -> Option<LinkUrl> {
        let listener = self.simulated.as_ref().filter(|_| camera.is_simulated)?;
        LinkUrl::parse(&format!("camera:http://{}/", listener.local_addr().ok()?)).ok()
    }

    /// For the page.
    pub(super) fn sources(&self) -> Vec<CameraSource> {
        let source = |camera: &Camera| {
            let (view, pictures) = (camera.settings.view.subscribe(), camera.settings.view.subscribe());
            CameraSource {
                link: camera.link,
                name: camera.settings.name.clone(),
                is_calibrated: camera.is_calibrated,
                floor_tags: [camera.settings.floor_tags.start, camera.settings.floor_tags.end.saturating_sub(1)],
                latest: Box::new(move || view.borrow().as_ref().map(picture_of)),
                bytes: Box::new(move || {
                    let newest = pictures.borrow().as_ref().map(|seen| Arc::clone(&seen.bytes));
                    newest.and_then(shown)
                }),
            }
        };
        self.cameras.iter().map(source).collect()
    }
}

/// A file of another camera gives wrong fixes that look right.
fn warn_of_another_camera(link: &LinkSection) {
    let Some(CameraChoice::Camera(file)) = &link.camera else { return };
    let Ok(LinkTarget::Url(url)) = LinkTarget::parse(&link.url) else { return };
    if let (Some(calibrated), Some(present)) = (&file.device, device_identity(&url))
        && *calibrated != present
    {
        tracing::warn!(
            link = link.url,
            calibrated,
            present,
            "another camera stands here than the one that was calibrated: calibrate it, or plug in the other one"
        );
    }
}

fn start_saver(folder: &Path) -> Result<PictureSaver> {
    let name = folder.display().to_string();
    let failed = {
        let name = name.clone();
        move |error| tracing::warn!(folder = name, %error, "the pictures of the camera are not kept any more")
    };
    PictureSaver::start(folder, failed).with_context(|| format!("creating `{name}` for the pictures"))
}

fn name_of(link: &LinkSection) -> &str {
    match &link.camera {
        Some(CameraChoice::Camera(camera)) => &camera.name,
        Some(CameraChoice::File(_)) | None => DEFAULT_CAMERA_NAME,
    }
}

/// As a browser shows it: a webcam or a video may give bare pixels.
fn shown(bytes: Arc<[u8]>) -> Option<Arc<[u8]>> {
    if !bytes.starts_with(b"P5") {
        return Some(bytes);
    }
    let mut picture = GreyPicture::default();
    picture.decode(&bytes).ok()?;
    picture.to_png().map(Arc::from)
}

fn picture_of(seen: &SeenPicture) -> CameraPicture {
    let tags = seen.tags.iter().map(|tag| SeenTagRow {
        id: tag.id,
        corners: tag.corners.map(|corner| [corner.x, corner.y]),
        margin: tag.margin,
    });
    CameraPicture {
        width: seen.width,
        height: seen.height,
        tags: tags.collect(),
        at: seen.at,
        latency: seen.counts.age,
        searched: seen.counts.searched,
        dropped: seen.counts.dropped,
        damaged: seen.counts.damaged,
    }
}
