//! Cameras as links of the station: pictures of a webcam, of a phone or network camera, of a file or folder, and the tags in them.
//!
//! Two threads serve a camera: one takes its pictures, the other looks for tags in the newest of them. The station's thread is handed
//! lines of JSON only (docs/protocols/camera-json.md), so no picture delays an estimate. What a camera sends is untrusted: its pictures
//! have limits, and one that cannot be decoded is counted.

mod capture;
mod capture_thread;
mod connection;
mod device_identity;
mod http_stream;
mod picture;
mod picture_saver;
mod picture_server;
mod picture_slot;
mod recorded;
mod settings;
mod sighting;
mod still;
mod tag_lines;
mod tag_search_thread;
mod tag_tracker;
mod view;
mod webcam;

pub use connection::camera_opener;
pub use device_identity::device_identity;
pub use picture_saver::PictureSaver;
pub use picture_server::PictureServer;
pub use settings::CameraSettings;
pub use still::take_picture;
pub use view::{CameraView, SeenPicture};
