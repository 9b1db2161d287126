//! Pictures of a webcam, by Video4Linux 2.
//!
//! Source: Linux media subsystem documentation, "Video for Linux API": buffers and their time stamps, camera controls.

use std::io;
use std::path::Path;
use std::time::Duration;

use moq_v4l::buffer::{Flags, Metadata, Type};
use moq_v4l::control::{Control, Value};
use moq_v4l::format::{Format, FourCC};
use moq_v4l::io::traits::CaptureStream as _;
use moq_v4l::prelude::{Device, MmapStream};
use moq_v4l::video::Capture as _;
use moq_v4l::video::capture::Parameters;
use posebridge_link::transport::{EXPOSURE, GAIN, HEIGHT, PICTURES_PER_SECOND, WIDTH};
use posebridge_link::{HostTimer, LinkError, LinkUrl, OpenError};
use posebridge_telemetry::TimeDelta;

use crate::capture::{Capture, CaptureError};
use crate::device_identity::{device_name, driver_of};
use crate::picture::{EncodedPicture, PictureTime};

/// Few, so that no old picture waits in the driver.
const BUFFERS: u32 = 3;
/// A webcam that gives no picture for so long is lost. Its wait cannot be cut into shorter ones: the next call of the stream would hand the
/// driver a buffer that it has already, which it refuses.
const SILENCE: Duration = Duration::from_secs(5);

/// Errors of the system: no such device; no such kind of pictures, or no such value; no video device at all.
const ENODEV: i32 = 19;
const EINVAL: i32 = 22;
const ENOTTY: i32 = 25;

/// V4L2_CID_EXPOSURE_AUTO with V4L2_EXPOSURE_MANUAL; V4L2_CID_EXPOSURE_ABSOLUTE in units of 100 µs; V4L2_CID_EXPOSURE_DYNAMIC_FRAMERATE,
/// which would slow the pictures down in the dark.
const EXPOSURE_AUTO: u32 = 0x009A_0901;
const EXPOSURE_MANUAL: i64 = 1;
const EXPOSURE_ABSOLUTE: u32 = 0x009A_0902;
const EXPOSURE_UNIT_US: u32 = 100;
const EXPOSURE_DYNAMIC_FRAMERATE: u32 = 0x009A_0903;
/// V4L2_CID_AUTOGAIN and V4L2_CID_GAIN.
const AUTO_GAIN: u32 = 0x0098_0912;
const GAIN_VALUE: u32 = 0x0098_0913;

/// The driver of webcams on USB. It calls its stamps those of the start of exposure, and takes them when the first bytes of a picture
/// arrive (drivers/media/usb/uvc: uvc_queue.c, uvc_video.c), unless it is loaded with `hwtimestamps=1`.
const USB_DRIVER: &str = "uvcvideo";

/// How a webcam gives its pictures, the best first.
const FORMATS: [(PixelLayout, &[u8; 4]); 3] =
    [(PixelLayout::Jpeg, b"MJPG"), (PixelLayout::Grey, b"GREY"), (PixelLayout::Yuyv, b"YUYV")];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PixelLayout {
    Jpeg,
    /// A byte for each pixel.
    Grey,
    /// Brightness and colour in turn.
    Yuyv,
}

/// Receives until the webcam is unplugged or the link is closed.
pub(crate) fn receive(capture: &mut Capture) -> Result<(), CaptureError> {
    let path = capture.url.path().to_owned();
    let device = Device::with_path(&path).map_err(|error| open_error(&path, error))?;
    let (format, layout) = set_format(&device, &capture.url, &path)?;
    let rate = Parameters::with_fps(capture.url.integer(&PICTURES_PER_SECOND));
    // Not every driver can be told; the pictures come as fast as it gives them then.
    let interval = device.set_params(&rate).ok().map(|set| set.interval);
    let frame = interval.filter(|interval| interval.denominator > 0).map_or(TimeDelta::ZERO, |interval| {
        TimeDelta::from_secs_f64(f64::from(interval.numerator) / f64::from(interval.denominator))
    });
    let exposure = hold_exposure(&device, &capture.url, &path)?;
    let is_stamped_on_arrival = driver_of(&path).is_some_and(|driver| driver == USB_DRIVER);
    let mut clock = ExposureClock { timer: capture.timer, exposure, frame, is_stamped_on_arrival, last: None };
    let buffers = MmapStream::with_buffers(&device, Type::VideoCapture, BUFFERS);
    let mut stream = buffers.map_err(|error| open_error(&path, error))?;
    stream.set_timeout(SILENCE);
    while !capture.stop.is_cancelled() {
        let (bytes, metadata) = match stream.next() {
            Ok(next) => next,
            // The stream starts with the first picture, and only then it is known whether the bus has room for it.
            Err(error) if capture.opened.is_some() => return Err(start_error(&capture.url, &path, error).into()),
            Err(error) => return Err(CaptureError::Lost(loss(error))),
        };
        if capture.opened.is_some() {
            let (name, Format { width, height, fourcc, .. }) = (name_of(&path), format);
            capture.report_open(format!("{name}, {width} x {height} {fourcc}"));
        }
        let Some(time) = clock.time_of(metadata) else { continue };
        if metadata.flags.contains(Flags::ERROR) {
            continue;
        }
        let used = bytes.get(..metadata.bytesused as usize).unwrap_or(bytes);
        capture.slot.put(EncodedPicture { time, bytes: encoded(used, layout, &format) });
    }
    Ok(())
}

/// The first format of the table that the webcam has, as large as asked for or as near as it comes.
fn set_format(device: &Device, url: &LinkUrl, path: &Path) -> Result<(Format, PixelLayout), OpenError> {
    let failed = |error| open_error(path, error);
    let refused = |reason| OpenError::CameraRefused { url: url.to_string(), reason };
    let now = device.format().map_err(|error| {
        // Webcams have a second device file, for metadata.
        let gives_none = matches!(error.raw_os_error(), Some(EINVAL | ENOTTY));
        let reason =
            "it gives no pictures; webcams have another device file, often that with the number before".to_owned();
        if gives_none { refused(reason) } else { failed(error) }
    })?;
    let asked = |option, current| Some(url.integer(option)).filter(|pixels| *pixels > 0).unwrap_or(current);
    let (width, height) = (asked(&WIDTH, now.width), asked(&HEIGHT, now.height));
    for (layout, fourcc) in FORMATS {
        let fourcc = FourCC::new(fourcc);
        let set = device.set_format(&Format::new(width, height, fourcc)).map_err(failed)?;
        if set.fourcc == fourcc {
            return Ok((set, layout));
        }
    }
    let reason = format!("it gives pictures as {} only; MJPG, GREY and YUYV are read", now.fourcc);
    Err(refused(reason))
}

/// Sets what the URL holds; returns the exposure if it is known.
fn hold_exposure(device: &Device, url: &LinkUrl, path: &Path) -> Result<Option<TimeDelta>, OpenError> {
    let (exposure_us, gain) = (url.integer(&EXPOSURE), url.integer(&GAIN));
    let set = |id, value| device.set_control(Control { id, value });
    let refused = |what: &str, error: io::Error| {
        if is_unplugged(&error) {
            return open_error(path, error);
        }
        let reason = format!("{} does not let its {what} be set: {error}; take the option away", name_of(path));
        OpenError::CameraRefused { url: url.to_string(), reason }
    };
    let mut held = None;
    if exposure_us > 0 {
        drop(set(EXPOSURE_DYNAMIC_FRAMERATE, Value::Boolean(false)));
        set(EXPOSURE_AUTO, Value::Integer(EXPOSURE_MANUAL)).map_err(|error| refused("exposure", error))?;
        let asked = i64::from(exposure_us.div_ceil(EXPOSURE_UNIT_US));
        set(EXPOSURE_ABSOLUTE, Value::Integer(asked)).map_err(|error| refused("exposure", error))?;
        // It takes the nearest exposure that it has.
        let units = match device.control(EXPOSURE_ABSOLUTE) {
            Ok(Control { value: Value::Integer(units), .. }) => units,
            Ok(_) | Err(_) => asked,
        };
        held = Some(TimeDelta::from_micros(units * i64::from(EXPOSURE_UNIT_US)));
    }
    // The gain comes after the exposure: an automatic exposure sets it, too.
    if gain > 0 {
        // Many have no automatic gain of its own.
        drop(set(AUTO_GAIN, Value::Boolean(false)));
        set(GAIN_VALUE, Value::Integer(gain.into())).map_err(|error| refused("gain", error))?;
    }
    Ok(held)
}

/// When pictures were exposed, from the stamps of their buffers.
struct ExposureClock {
    timer: HostTimer,
    /// If it is known.
    exposure: Option<TimeDelta>,
    /// As the driver tells it; zero if it does not.
    frame: TimeDelta,
    /// Whether its driver stamps a picture when its first bytes arrive, whatever it says.
    is_stamped_on_arrival: bool,
    /// Number and stamp of the last picture.
    last: Option<(u32, Duration)>,
}

impl ExposureClock {
    /// The middle of the exposure. The stamp is of its start, or of the end of reading out. `None` for the first picture: how long a
    /// frame is shows with the second, because an automatic exposure may make it longer than the driver says.
    fn time_of(&mut self, metadata: &Metadata) -> Option<PictureTime> {
        if metadata.flags & Flags::TIMESTAMP_MASK != Flags::TIMESTAMP_MONOTONIC {
            return Some(PictureTime::Received(self.timer.now()));
        }
        let stamp = Duration::from(metadata.timestamp);
        let (last_number, last_stamp) = self.last.replace((metadata.sequence, stamp))?;
        let apart = stamp.saturating_sub(last_stamp) / metadata.sequence.wrapping_sub(last_number).max(1);
        let frame = self.frame.max(TimeDelta::from_secs_f64(apart.as_secs_f64()));
        // No exposure is longer than a frame.
        let half = |whole: TimeDelta| TimeDelta::from_nanos(whole.as_nanos() / 2);
        let shortest = half(self.exposure.unwrap_or(TimeDelta::ZERO).min(frame));
        let longest = half(self.exposure.unwrap_or(frame).min(frame));
        let stamp = self.timer.at_monotonic(stamp);
        Some(if self.is_stamped_on_arrival {
            // The first rows are exposed by then, the last ones soon; the camera may have held the picture back for a frame.
            PictureTime::Exposed { earliest: stamp - frame - longest, latest: stamp + half(frame) - shortest }
        } else if metadata.flags & Flags::TSTAMP_SRC_MASK == Flags::TSTAMP_SRC_SOE {
            PictureTime::Exposed { earliest: stamp + shortest, latest: stamp + longest }
        } else {
            // Reading out takes a frame at most.
            PictureTime::Exposed { earliest: stamp - frame - longest, latest: stamp - shortest }
        })
    }
}

fn encoded(bytes: &[u8], layout: PixelLayout, format: &Format) -> Vec<u8> {
    let step = match layout {
        PixelLayout::Jpeg => return bytes.to_vec(),
        PixelLayout::Grey => 1,
        PixelLayout::Yuyv => 2,
    };
    let width = format.width as usize;
    let stride = (format.stride as usize).max(step * width);
    let mut picture = format!("P5 {} {} 255\n", format.width, format.height).into_bytes();
    for row in bytes.chunks(stride).take(format.height as usize) {
        picture.extend(row.iter().step_by(step).take(width));
    }
    picture
}

/// As its driver calls it, else its path.
fn name_of(path: &Path) -> String {
    let name = device_name(path);
    let path = path.display();
    name.map_or_else(|| path.to_string(), |name| format!("{name} ({path})"))
}

/// Why the first picture of a webcam does not come.
fn start_error(url: &LinkUrl, path: &Path, error: io::Error) -> OpenError {
    let what = url.to_string();
    if error.kind() == io::ErrorKind::StorageFull {
        let reason = "the USB bus has no room for its pictures: plug it into another USB port, or ask for fewer or smaller ones \
                      (fps, width, height)";
        OpenError::CameraRefused { url: what, reason: reason.to_owned() }
    } else if error.kind() == io::ErrorKind::TimedOut {
        OpenError::TimedOut { what, limit_secs: SILENCE.as_secs() }
    } else {
        open_error(path, error)
    }
}

/// Why no picture follows.
fn loss(error: io::Error) -> LinkError {
    if error.kind() == io::ErrorKind::TimedOut {
        LinkError::Camera("the webcam gives no more pictures".to_owned())
    } else if is_unplugged(&error) {
        LinkError::HungUp
    } else {
        error.into()
    }
}

fn is_unplugged(error: &io::Error) -> bool {
    error.raw_os_error() == Some(ENODEV)
}

fn open_error(path: &Path, source: io::Error) -> OpenError {
    let (what, kind) = (path.display().to_string(), source.kind());
    if kind == io::ErrorKind::NotFound || is_unplugged(&source) {
        OpenError::DeviceMissing { path: path.to_owned() }
    } else if kind == io::ErrorKind::PermissionDenied {
        OpenError::PermissionDenied { what, advice: "add yourself to the group `video` and log in again".to_owned() }
    } else if kind == io::ErrorKind::ResourceBusy {
        OpenError::PortInUse { path: path.to_owned() }
    } else {
        OpenError::Io { what, source }
    }
}
