//! Tags in the pictures of cameras.
//!
//! A picture comes in as grey pixels or as the bytes of a recording, what was found goes out as values: no camera, no path, no clock.

mod avi;
mod blurred_pattern;
mod camera_fit;
mod camera_model;
mod decode;
mod flat_tag;
mod floor_calibration;
mod floor_view;
mod grey_image;
mod grey_picture;
mod homography;
mod multipart;
mod normal_table;
mod outline;
mod picture_times;
mod quad;
mod refine;
mod riff;
mod rough_view;
mod seen_point;
mod tag36h11;
mod tag_detector;
mod tag_pose;
mod tag_search;
mod tag_sheet;
mod threshold;
mod video_frame;
mod y4m;

pub use avi::{AviError, AviReader};
pub use camera_model::CameraModel;
pub use flat_tag::FlatTag;
pub use floor_calibration::FloorCalibration;
pub use floor_view::FloorView;
pub use grey_image::{GreyImage, ImageWindow};
pub use grey_picture::{GreyPicture, PictureError};
pub use multipart::{MultipartReader, Part};
pub use picture_times::{PictureTime, PictureTimesError, parse_picture_times};
pub use riff::AviCutOff;
pub use seen_point::{CalibrationError, LensKnowledge, SeenPoint};
pub use tag_detector::{DetectedTag, Tag36h11Detector, TagDetector};
pub use tag_pose::FloorTagPose;
pub use tag_search::TagSearch;
pub use tag_sheet::{FLOOR_TAGS, RULER_M, SHEET_SIZE_M, SheetPlacement, SheetTag, floor_sheet, robot_sheet};
pub use tag36h11::tag36h11_modules;
pub use video_frame::{FrameRate, VideoFrame};
pub use y4m::{Y4mError, Y4mReader};
