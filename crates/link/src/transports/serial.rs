//! Serial ports, and Bluetooth serial ports (`/dev/rfcomm0`), which look the same.
//!
//! Ports are opened raw and exclusively. Opening may block for as long as a Bluetooth radio takes, so it runs on its
//! own thread. Bytes that were in the input before are discarded, because their age is unknown. Neither the baud rate
//! nor the protocol is guessed. `serial_device` finds the device, `serial_line` sets what the line needs beyond its
//! speed.
//!
//! A thread that hangs in the system cannot be stopped, and dropping the runtime waits for it: a program that must end
//! in time ends its runtime with `shutdown_background`.

use std::fs::Metadata;
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::errno::Errno;
use nix::unistd::{Gid, Group};
use serialport::{ClearBuffer, ErrorKind, SerialPort, TTYPort};
use tokio_serial::SerialStream;

use crate::connection::Connection;
use crate::error::{FileKind, OpenError};
use crate::stream::{ByteStream, StreamConnection, StreamLabel};
use crate::transport::{BAUD, DTR};
use crate::transports::open_request::{DeviceDirectories, LineSettingsPolicy, OpenRequest, QUEUE_BYTES};
use crate::transports::serial_device::{expand_pattern, is_pattern, stable_name};
use crate::transports::serial_line::{
    LatencyTimer, LineSettingsGuard, keep_dtr_on_close, open_settings, shorten_latency_timer,
};

/// Bits on the line per byte: a start bit, eight data bits and a stop bit.
const BITS_PER_BYTE: f64 = 10.0;

/// Upper bound of the bytes in the buffers of a tty before it is opened: Linux allows 64 KiB per direction.
const STALE_BYTES: usize = 64 * 1024;

/// Where Linux keeps the devices of pseudo-terminals.
const PTS_DIRECTORY: &str = "/dev/pts";

impl ByteStream for SerialStream {
    fn kernel_queued_bytes(&self) -> Option<usize> {
        // Pseudo-terminals answer 0 whatever they hold (Linux has no chars_in_buffer for them).
        let waiting = self.bytes_to_write().ok()?;
        usize::try_from(waiting).ok()
    }
}

/// One attempt to open, on its own thread.
struct SerialOpenAttempt {
    /// A path or a pattern.
    path: PathBuf,
    baud: u32,
    /// `None` leaves it unchanged.
    dtr: Option<bool>,
    directories: DeviceDirectories,
    settings: LineSettingsPolicy,
    stable_path: Option<PathBuf>,
}

struct OpenedSerial {
    port: TTYPort,
    /// Dropped after the port, and then restores the settings.
    restore_settings: Option<LineSettingsGuard>,
    /// The path by which it was opened.
    path: PathBuf,
    stable_path: Option<PathBuf>,
    latency: LatencyTimer,
}

pub(super) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let path = request.url.path().to_owned();
    let baud = request.url.integer(&BAUD);
    let attempt = SerialOpenAttempt {
        path: path.clone(),
        baud,
        dtr: match request.url.option_text(&DTR).as_str() {
            "on" => Some(true),
            "off" => Some(false),
            _ => None,
        },
        directories: request.device_directories,
        settings: request.line_settings,
        stable_path: request.stable_path,
    };
    let opened = tokio::task::spawn_blocking(move || attempt.run())
        .await
        .map_err(|error| error_from_io(&path, error.into()))??;
    let mut label = StreamLabel::new(opened.detail(baud));
    let stream = SerialStream::try_from(opened.port).map_err(|error| classify_error(&opened.path, error))?;
    label.stable_path = opened.stable_path;
    let connection = StreamConnection::new(stream, label, request.timer, QUEUE_BYTES)
        .with_line_rate(f64::from(baud) / BITS_PER_BYTE);
    Ok(match opened.restore_settings {
        Some(put_back) => Box::new(connection.with_on_close(Box::new(put_back))),
        None => Box::new(connection),
    })
}

impl OpenedSerial {
    fn detail(&self, baud: u32) -> String {
        let stable = match &self.stable_path {
            Some(stable) if *stable != self.path => format!(" ({})", stable.display()),
            Some(_) | None => String::new(),
        };
        let remark = self.latency.describe();
        format!("{}{stable} at {baud} baud{remark}", self.path.display())
    }
}

impl SerialOpenAttempt {
    fn run(&self) -> Result<OpenedSerial, OpenError> {
        if let Some(stable) = &self.stable_path {
            // Its number may belong to another device by now.
            return self.open_device(stable);
        }
        if !is_pattern(&self.path) {
            return self.open_device(&self.path);
        }
        let mut failure = None;
        for path in expand_pattern(&self.path) {
            match self.open_device(&path) {
                Ok(opened) => return Ok(opened),
                Err(error) => {
                    tracing::debug!(path = %path.display(), %error, "not this one");
                    failure.get_or_insert(error);
                }
            }
        }
        Err(failure.unwrap_or_else(|| OpenError::DeviceMissing { path: self.path.clone() }))
    }

    fn open_device(&self, path: &Path) -> Result<OpenedSerial, OpenError> {
        let device = check_device(path)?;
        let line = open_settings(&device).map_err(|error| error_from_errno(path, error))?;
        let put_back = match self.settings {
            LineSettingsPolicy::Keep => None,
            LineSettingsPolicy::Restore => {
                let line = line.try_clone().map_err(|error| error_from_io(path, error))?;
                Some(LineSettingsGuard::new(line).map_err(|error| error_from_io(path, error))?)
            }
        };
        let mut builder = serialport::new(device.to_string_lossy(), self.baud).timeout(Duration::ZERO);
        if let Some(level) = self.dtr {
            // Fails on lines that have no DTR, which serialport passes over.
            builder = builder.dtr_on_open(level);
        }
        let mut port = builder.open_native().map_err(|error| classify_error(path, error))?;
        if device.starts_with(PTS_DIRECTORY) {
            // TIOCEXCL stays on a pseudo-terminal for as long as its maker holds it open. If we were killed it would
            // lock out our successor for ever, so only the file lock is kept, which dies with us.
            port.set_exclusive(false).map_err(|error| classify_error(path, error))?;
        }
        let latency = match self.settings {
            LineSettingsPolicy::Keep => {
                keep_dtr_on_close(&line).map_err(|error| error_from_errno(path, error))?;
                shorten_latency_timer(&device, &self.directories.usb_serial)
            }
            // Not examined, and nothing to report.
            LineSettingsPolicy::Restore => LatencyTimer::Absent,
        };
        discard_stale_input(&mut port).map_err(|error| classify_error(path, error))?;
        Ok(OpenedSerial {
            port,
            restore_settings: put_back,
            path: path.to_owned(),
            stable_path: self.stable_path.clone().or_else(|| stable_name(&self.path, &self.directories)),
            latency,
        })
    }
}

/// The device behind the path, with symbolic links resolved.
fn check_device(path: &Path) -> Result<PathBuf, OpenError> {
    let metadata = path.metadata().map_err(|error| error_from_io(path, error))?;
    if !metadata.file_type().is_char_device() {
        return Err(OpenError::WrongFileKind {
            path: path.to_owned(),
            found: FileKind::from(metadata.file_type()),
            expected: "a serial port",
        });
    }
    path.canonicalize().map_err(|error| error_from_io(path, error))
}

/// Empties the input. The flush reaches only the line discipline; a pseudo-terminal keeps up to 12 KiB more behind it,
/// which have to be read away.
fn discard_stale_input(port: &mut TTYPort) -> serialport::Result<()> {
    port.clear(ClearBuffer::Input)?;
    let mut stale = [0; 4096];
    for _ in 0..STALE_BYTES / stale.len() {
        match port.read(&mut stale) {
            Ok(0) => break,
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::TimedOut => break,
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Translates an error of serialport, which calls a busy port "no device", for instance.
fn classify_error(path: &Path, error: serialport::Error) -> OpenError {
    match error.kind {
        ErrorKind::NoDevice => OpenError::PortInUse { path: path.to_owned() },
        ErrorKind::Io(_) => error_from_io(path, error.into()),
        ErrorKind::InvalidInput | ErrorKind::Unknown => {
            OpenError::Io { what: path.display().to_string(), source: io::Error::other(error.description) }
        }
    }
}

fn error_from_errno(path: &Path, error: Errno) -> OpenError {
    if error == Errno::EBUSY {
        return OpenError::PortInUse { path: path.to_owned() };
    }
    error_from_io(path, error.into())
}

fn error_from_io(path: &Path, source: io::Error) -> OpenError {
    if source.kind() == io::ErrorKind::NotFound {
        OpenError::DeviceMissing { path: path.to_owned() }
    } else if source.kind() == io::ErrorKind::PermissionDenied {
        OpenError::PermissionDenied { what: path.display().to_string(), advice: access_advice(path) }
    } else {
        OpenError::Io { what: path.display().to_string(), source }
    }
}

/// Names the group that owns this very node, because distributions disagree about it.
fn access_advice(path: &Path) -> String {
    match path.metadata() {
        Ok(metadata) => group_advice(&metadata, &group_name(metadata.gid())),
        Err(_) => "a directory above it may not be entered".to_owned(),
    }
}

fn group_name(gid: u32) -> String {
    match Group::from_gid(Gid::from_raw(gid)) {
        Ok(Some(group)) => group.name,
        Ok(None) | Err(_) => gid.to_string(),
    }
}

fn group_advice(metadata: &Metadata, group: &str) -> String {
    const GROUP_READ_WRITE: u32 = 0o060;
    if metadata.mode() & GROUP_READ_WRITE == GROUP_READ_WRITE {
        format!("it belongs to group {group}: run `sudo usermod -aG {group} $USER`, then log out and in again")
    } else {
        format!(
            "its mode {:04o} lets no group write: a udev rule has to open it to group {group}",
            metadata.mode() & 0o7777
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    fn advice_for_mode(mode: u32) -> String {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        std::fs::set_permissions(file.path(), Permissions::from_mode(mode)).expect("own file");
        group_advice(&file.path().metadata().expect("it exists"), "dialout")
    }

    #[test]
    fn a_refused_device_names_its_group_and_the_cure() {
        assert_eq!(
            advice_for_mode(0o660),
            "it belongs to group dialout: run `sudo usermod -aG dialout $USER`, then log out and in again"
        );
        assert_eq!(
            advice_for_mode(0o600),
            "its mode 0600 lets no group write: a udev rule has to open it to group dialout"
        );
    }

    #[test]
    fn the_group_of_a_node_has_its_name() {
        assert_eq!(group_name(0), "root");
        assert_eq!(group_name(4_123_456), "4123456");
    }

    #[test]
    fn refused_and_busy_devices_stop_the_start_but_only_the_busy_one_heals() {
        let refused = error_from_io(Path::new("/dev/null"), io::ErrorKind::PermissionDenied.into());
        assert!(!refused.is_transient());
        assert!(refused.prevents_start());
        let busy = classify_error(
            Path::new("/dev/ttyUSB0"),
            serialport::Error::new(ErrorKind::NoDevice, "Device or resource busy"),
        );
        assert!(busy.is_transient());
        assert!(busy.prevents_start());
        let missing = error_from_io(Path::new("/dev/ttyUSB0"), io::ErrorKind::NotFound.into());
        assert!(!missing.prevents_start());
        assert_eq!(
            busy.to_string(),
            "port /dev/ttyUSB0 is in use by another program: close it there (`fuser -v /dev/ttyUSB0` names it)"
        );
    }
}
