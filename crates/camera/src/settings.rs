//! The settings of a camera.

use std::sync::Arc;

use crate::picture_saver::PictureSaver;
use crate::view::CameraView;

/// How a camera's tags are looked for and called.
#[derive(Clone, Debug)]
pub struct CameraSettings {
    /// Its name in the lines: 1 to 16 printable ASCII characters, no space.
    pub name: String,
    /// Tags that lie on the floor and are not followed.
    pub floor_tags: std::ops::Range<u16>,
    pub view: CameraView,
    /// Keeps the pictures; `None` if nobody asked for it.
    pub saver: Option<Arc<PictureSaver>>,
}
