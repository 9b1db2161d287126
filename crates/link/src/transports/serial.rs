//! Serial ports, and Bluetooth serial ports (`/dev/rfcomm0`), which look the same.
//!
//! Ports are opened raw and exclusively. Opening may block for as long as a Bluetooth radio takes, so it runs on its
//! own thread. Bytes that were in the input before are discarded, because their age is unknown. Neither the baud rate
//! nor the protocol is guessed. `serial_device` finds the device.
//!
//! A thread that hangs in the system cannot be stopped, and dropping the runtime waits for it: a program that must end
//! in time ends its runtime with `shutdown_background`.
//!
//! # Settings of the line
//! Arduino-class boards wire DTR to their reset: its rising edge restarts the sketch, which takes two seconds. Linux
//! raises DTR whenever a port is opened, which is no edge if it is still up, and lowers it when the port is closed,
//! unless HUPCL is cleared (termios(3)). So HUPCL is always cleared: the first open after plugging in resets the board
//! once, and later ones, by any program, do not.
//!
//! A program that only listens for a moment restores the settings that it found: [`LineSettingsGuard`].
//!
//! FTDI adapters collect received bytes for up to 16 ms; their driver offers that time as a file. The other way to set
//! it, ASYNC_LOW_LATENCY by TIOCSSERIAL, has no safe interface and the same effect on these adapters.

use std::fs::{self, Metadata};
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::OFlag;
use nix::sys::stat::Mode;
use nix::sys::termios::{ControlFlags, SetArg, tcgetattr, tcsetattr};
use nix::unistd::{Gid, Group};
use rustix::termios::{OptionalActions, Termios};
use serialport::{ClearBuffer, ErrorKind, SerialPort, TTYPort};
use tokio_serial::SerialStream;

use crate::connection::Connection;
use crate::error::{FileKind, OpenError};
use crate::stream::{ByteStream, StreamConnection, StreamLabel};
use crate::transport::{BAUD, DTR};
use crate::transports::open_request::{LineSettingsPolicy, LinkTuning, OpenRequest, QUEUE_BYTES};
use crate::transports::pty::PTS_DIRECTORY;
use crate::transports::serial_device::{expand_pattern, is_pattern, stable_name};

/// Bits on the line per byte: a start bit, eight data bits and a stop bit.
const BITS_PER_BYTE: f64 = 10.0;

/// Upper bound of the bytes in the buffers of a tty before it is opened: Linux allows 64 KiB per direction.
const STALE_BYTES: usize = 64 * 1024;

impl ByteStream for SerialStream {
    fn kernel_queued_bytes(&self) -> Option<usize> {
        // Pseudo-terminals answer 0 whatever they hold (Linux has no chars_in_buffer for them).
        let waiting = self.bytes_to_write().ok()?;
        usize::try_from(waiting).ok()
    }
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
    let timer = request.timer;
    let opened = tokio::task::spawn_blocking(move || open_serial(&request))
        .await
        .map_err(|error| error_from_io(&path, error.into()))??;
    let mut label = StreamLabel::new(opened.detail(baud));
    let stream = SerialStream::try_from(opened.port).map_err(|error| classify_error(&opened.path, error))?;
    label.stable_path = opened.stable_path;
    let mut connection =
        StreamConnection::new(stream, label, timer, QUEUE_BYTES).with_line_rate(f64::from(baud) / BITS_PER_BYTE);
    connection.on_close = opened.restore_settings.map(|guard| -> Box<dyn Send> { Box::new(guard) });
    Ok(Box::new(connection))
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

/// Opens the link's path, or the first match of its pattern that can be opened. Blocks.
fn open_serial(request: &OpenRequest) -> Result<OpenedSerial, OpenError> {
    let path = request.url.path();
    if let Some(stable) = &request.stable_path {
        // Its number may belong to another device by now.
        return open_device(request, stable);
    }
    if !is_pattern(path) {
        return open_device(request, path);
    }
    let mut failure = None;
    for path in expand_pattern(path) {
        match open_device(request, &path) {
            Ok(opened) => return Ok(opened),
            Err(error) => {
                tracing::debug!(path = %path.display(), %error, "not this one");
                failure.get_or_insert(error);
            }
        }
    }
    Err(failure.unwrap_or_else(|| OpenError::DeviceMissing { path: path.to_owned() }))
}

fn open_device(request: &OpenRequest, path: &Path) -> Result<OpenedSerial, OpenError> {
    let OpenRequest { url, tuning: LinkTuning { device_directories, line_settings, .. }, .. } = request;
    let device = check_device(path)?;
    let line = open_settings(&device).map_err(|error| error_from_errno(path, error))?;
    let restore_settings = match line_settings {
        LineSettingsPolicy::Keep => None,
        LineSettingsPolicy::Restore => {
            let line = line.try_clone().map_err(|error| error_from_io(path, error))?;
            Some(LineSettingsGuard::new(line).map_err(|error| error_from_io(path, error))?)
        }
    };
    let mut builder = serialport::new(device.to_string_lossy(), url.integer(&BAUD)).timeout(Duration::ZERO);
    let dtr = url.option_text(&DTR);
    if dtr != "keep" {
        // Fails on lines that have no DTR, which serialport passes over.
        builder = builder.dtr_on_open(dtr == "on");
    }
    let mut port = builder.open_native().map_err(|error| classify_error(path, error))?;
    if device.starts_with(PTS_DIRECTORY) {
        // TIOCEXCL stays on a pseudo-terminal for as long as its maker holds it open. If we were killed it would
        // lock out our successor for ever, so only the file lock is kept, which dies with us.
        port.set_exclusive(false).map_err(|error| classify_error(path, error))?;
    }
    let latency = match line_settings {
        LineSettingsPolicy::Keep => {
            keep_dtr_on_close(&line).map_err(|error| error_from_errno(path, error))?;
            shorten_latency_timer(&device, &device_directories.usb_serial)
        }
        // Not examined, and nothing to report.
        LineSettingsPolicy::Restore => LatencyTimer::Absent,
    };
    discard_stale_input(&mut port).map_err(|error| classify_error(path, error))?;
    let stable_path = request.stable_path.clone().or_else(|| stable_name(url.path(), device_directories));
    Ok(OpenedSerial { port, restore_settings, path: path.to_owned(), stable_path, latency })
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

/// The adapter's latency timer, in milliseconds: its smallest value (FTDI application note AN232B-04, section 3.3).
const LATENCY_MS: &str = "1";

/// A second descriptor of the line, through which its settings are reached. It has to be opened before the line is
/// locked, and is of no use for reading.
///
/// # Errors
/// As open(2); EBUSY if another program holds the line.
fn open_settings(device: &Path) -> nix::Result<OwnedFd> {
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
    nix::fcntl::open(device, flags, Mode::empty())
}

/// Keeps DTR unchanged when any program closes the line.
fn keep_dtr_on_close(line: &OwnedFd) -> nix::Result<()> {
    let mut settings = tcgetattr(line)?;
    settings.control_flags.remove(ControlFlags::HUPCL);
    tcsetattr(line, SetArg::TCSANOW, &settings)
}

/// The original settings of a line, restored on drop.
///
/// Read and written with their speed as a number (Linux, TCGETS2): termios(3) of the C library has names for the usual
/// speeds only, and serialport sets every speed as a number.
struct LineSettingsGuard {
    line: OwnedFd,
    original: Termios,
}

impl LineSettingsGuard {
    /// Stores the settings of a line; `line` is a separate descriptor of it.
    fn new(line: OwnedFd) -> io::Result<Self> {
        let found = rustix::termios::tcgetattr(&line)?;
        Ok(Self { line, original: found })
    }
}

impl Drop for LineSettingsGuard {
    fn drop(&mut self) {
        let put_back = rustix::termios::tcsetattr(&self.line, OptionalActions::Now, &self.original);
        if let Err(error) = put_back {
            // A device that was pulled has nothing to put back.
            tracing::debug!(%error, "the settings of a line were not put back");
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum LatencyTimer {
    /// The driver has no such setting.
    Absent,
    Shortened,
    /// It is not writable: the file's path and its current value.
    Unchanged {
        file: String,
        ms: String,
    },
}

fn shorten_latency_timer(device: &Path, directory: &Path) -> LatencyTimer {
    let Some(name) = device.file_name() else {
        return LatencyTimer::Absent;
    };
    let file = directory.join(name).join("latency_timer");
    let Ok(before) = fs::read_to_string(&file) else {
        return LatencyTimer::Absent;
    };
    if before.trim() == LATENCY_MS || fs::write(&file, LATENCY_MS).is_ok() {
        return LatencyTimer::Shortened;
    }
    LatencyTimer::Unchanged { file: file.display().to_string(), ms: before.trim().to_owned() }
}

impl LatencyTimer {
    fn describe(&self) -> String {
        match self {
            Self::Absent => String::new(),
            Self::Shortened => ", latency timer 1 ms".to_owned(),
            Self::Unchanged { file, ms } => {
                format!(", latency timer {ms} ms: run `echo {LATENCY_MS} | sudo tee {file}` to shorten it")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    fn advice_for_mode(mode: u32) -> String {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        fs::set_permissions(file.path(), Permissions::from_mode(mode)).expect("own file");
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

    #[test]
    fn a_timer_that_may_not_be_written_is_reported_with_the_remedy() {
        let latency = LatencyTimer::Unchanged { file: "/sys/x/latency_timer".to_owned(), ms: "16".to_owned() };
        assert_eq!(
            latency.describe(),
            ", latency timer 16 ms: run `echo 1 | sudo tee /sys/x/latency_timer` to shorten it"
        );
    }
}
