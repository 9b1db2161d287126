//! Serial ports, and Bluetooth serial ports (`/dev/rfcomm0`), which look the same.
//!
//! Opened raw and exclusively. Opening may block for as long as a Bluetooth radio pleases, so it runs on a thread of its
//! own. What lay in the input before we came is thrown away: it is of unknown age. Neither the baud rate nor the protocol
//! is guessed. Which device is meant says `serial_device`, what else the line is told `serial_line`.
//!
//! A thread that hangs in the system cannot be stopped, and a runtime that is dropped waits for it: a program that wants
//! to end in time ends its runtime with `shutdown_background`.

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
use crate::transports::serial_device::{is_pattern, matches, stable_name};
use crate::transports::serial_line::{Latency, PutBack, keep_dtr_on_close, open_settings, shorten_latency};
use crate::transports::{DeviceDirectories, LineSettings, OpenFuture, OpenRequest, QUEUE_BYTES, RATE, Transport};
use crate::url::{OptionHelp, OptionKind, TargetKind};

/// The speed of the line. 115200 is what MAVLink boards and their radios are set to in the factory; the range is that
/// of Linux's termios constants.
const BAUD: OptionHelp = OptionHelp {
    name: "baud",
    kind: OptionKind::Integer { min: 50, max: 4_000_000, default: 115_200 },
    help: "speed of the line in bits per second; Bluetooth and pseudo-terminals ignore it",
};

/// What happens to DTR. Linux raises it when the port is opened, whatever is asked for here.
const DTR: OptionHelp = OptionHelp {
    name: "dtr",
    kind: OptionKind::Choice { words: &["keep", "on", "off"] },
    help: "keep leaves DTR alone once the port is open, on and off set it then; closing never drops it",
};

/// Bits on the line per byte: a start bit, eight data bits and a stop bit.
const BITS_PER_BYTE: f64 = 10.0;

/// Most that can lie in the buffers of a tty before it is opened, generously: Linux allows 64 KiB per direction.
const STALE_BYTES: usize = 64 * 1024;

/// Where Linux keeps the devices of pseudo-terminals.
const PTS_DIRECTORY: &str = "/dev/pts";

/// See the module.
pub(crate) struct Serial;

impl Transport for Serial {
    fn scheme(&self) -> &'static str {
        "serial"
    }
    fn summary(&self) -> &'static str {
        "a serial port: USB, UART, a bound Bluetooth port, or a pseudo-terminal made by somebody else"
    }
    fn example(&self) -> &'static str {
        "serial:///dev/ttyUSB0?baud=115200"
    }
    fn target_kind(&self) -> TargetKind {
        TargetKind::Path
    }
    fn options(&self) -> &'static [OptionHelp] {
        &[BAUD, DTR, RATE]
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        Box::pin(open(request))
    }
}

impl ByteStream for SerialStream {
    fn system_bytes(&self) -> Option<usize> {
        // Pseudo-terminals answer 0 whatever they hold (Linux has no chars_in_buffer for them).
        let waiting = self.bytes_to_write().ok()?;
        usize::try_from(waiting).ok()
    }
}

/// What one attempt needs to know, on its own thread.
struct Attempt {
    /// The path of the link; a pattern perhaps.
    path: PathBuf,
    baud: u32,
    /// `None` leaves it alone.
    dtr: Option<bool>,
    directories: DeviceDirectories,
    settings: LineSettings,
    stable_path: Option<PathBuf>,
}

/// A line that was opened.
struct Opened {
    port: TTYPort,
    /// Dropped after the port: its settings go back when nobody uses them any more.
    put_back: Option<PutBack>,
    /// The path by which it was opened.
    path: PathBuf,
    stable_path: Option<PathBuf>,
    latency: Latency,
}

async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let path = request.url.path().to_owned();
    let baud = request.url.integer(&BAUD);
    let attempt = Attempt {
        path: path.clone(),
        baud,
        dtr: match request.url.option_text(&DTR).as_str() {
            "on" => Some(true),
            "off" => Some(false),
            _ => None,
        },
        directories: request.directories,
        settings: request.line_settings,
        stable_path: request.stable_path,
    };
    let opened =
        tokio::task::spawn_blocking(move || attempt.run()).await.map_err(|error| io_error(&path, error.into()))??;
    let mut label = StreamLabel::new(opened.detail(baud));
    let stream = SerialStream::try_from(opened.port).map_err(|error| name_error(&opened.path, error))?;
    label.stable_path = opened.stable_path;
    let connection = StreamConnection::new(stream, label, request.timer, QUEUE_BYTES)
        .with_line_rate(f64::from(baud) / BITS_PER_BYTE);
    Ok(match opened.put_back {
        Some(put_back) => Box::new(connection.closing_with(Box::new(put_back))),
        None => Box::new(connection),
    })
}

impl Opened {
    fn detail(&self, baud: u32) -> String {
        let stable = match &self.stable_path {
            Some(stable) if *stable != self.path => format!(" ({})", stable.display()),
            Some(_) | None => String::new(),
        };
        let remark = self.latency.remark();
        format!("{}{stable} at {baud} baud{remark}", self.path.display())
    }
}

impl Attempt {
    fn run(&self) -> Result<Opened, OpenError> {
        if let Some(stable) = &self.stable_path {
            // Its number may belong to another device by now.
            return self.open_device(stable);
        }
        if !is_pattern(&self.path) {
            return self.open_device(&self.path);
        }
        let mut failure = None;
        for path in matches(&self.path) {
            match self.open_device(&path) {
                Ok(opened) => return Ok(opened),
                Err(error) => {
                    tracing::debug!(path = %path.display(), %error, "not this one");
                    failure.get_or_insert(error);
                }
            }
        }
        Err(failure.unwrap_or_else(|| OpenError::Missing { path: self.path.clone() }))
    }

    fn open_device(&self, path: &Path) -> Result<Opened, OpenError> {
        let device = check_device(path)?;
        let line = open_settings(&device).map_err(|error| errno_error(path, error))?;
        let put_back = match self.settings {
            LineSettings::Keep => None,
            LineSettings::PutBack => {
                let line = line.try_clone().map_err(|error| io_error(path, error))?;
                Some(PutBack::new(line).map_err(|error| io_error(path, error))?)
            }
        };
        let mut builder = serialport::new(device.to_string_lossy(), self.baud).timeout(Duration::ZERO);
        if let Some(level) = self.dtr {
            // Fails on lines that have no DTR, which serialport passes over.
            builder = builder.dtr_on_open(level);
        }
        let mut port = builder.open_native().map_err(|error| name_error(path, error))?;
        if device.starts_with(PTS_DIRECTORY) {
            // TIOCEXCL stays on a pseudo-terminal for as long as its maker holds it open. If we were killed it would
            // lock out our successor for ever, so only the file lock is kept, which dies with us.
            port.set_exclusive(false).map_err(|error| name_error(path, error))?;
        }
        let latency = match self.settings {
            LineSettings::Keep => {
                keep_dtr_on_close(&line).map_err(|error| errno_error(path, error))?;
                shorten_latency(&device, &self.directories.usb_serial)
            }
            // Not looked at, and nothing to tell.
            LineSettings::PutBack => Latency::NoTimer,
        };
        discard_stale_input(&mut port).map_err(|error| name_error(path, error))?;
        Ok(Opened {
            port,
            put_back,
            path: path.to_owned(),
            stable_path: self.stable_path.clone().or_else(|| stable_name(&self.path, &self.directories)),
            latency,
        })
    }
}

/// The device behind the path, links followed.
fn check_device(path: &Path) -> Result<PathBuf, OpenError> {
    let metadata = path.metadata().map_err(|error| io_error(path, error))?;
    if !metadata.file_type().is_char_device() {
        return Err(OpenError::WrongKind {
            path: path.to_owned(),
            found: FileKind::from(metadata.file_type()),
            wanted: "a serial port",
        });
    }
    path.canonicalize().map_err(|error| io_error(path, error))
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

/// Turns what serialport says into what a person needs: it calls a busy port "no device", for instance.
fn name_error(path: &Path, error: serialport::Error) -> OpenError {
    match error.kind {
        ErrorKind::NoDevice => OpenError::PortInUse { path: path.to_owned() },
        ErrorKind::Io(_) => io_error(path, error.into()),
        ErrorKind::InvalidInput | ErrorKind::Unknown => {
            OpenError::Io { what: path.display().to_string(), source: io::Error::other(error.description) }
        }
    }
}

fn errno_error(path: &Path, error: Errno) -> OpenError {
    if error == Errno::EBUSY {
        return OpenError::PortInUse { path: path.to_owned() };
    }
    io_error(path, error.into())
}

fn io_error(path: &Path, source: io::Error) -> OpenError {
    if source.kind() == io::ErrorKind::NotFound {
        OpenError::Missing { path: path.to_owned() }
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
        let refused = io_error(Path::new("/dev/null"), io::ErrorKind::PermissionDenied.into());
        assert!(!refused.can_heal());
        assert!(refused.stops_start());
        let busy = name_error(
            Path::new("/dev/ttyUSB0"),
            serialport::Error::new(ErrorKind::NoDevice, "Device or resource busy"),
        );
        assert!(busy.can_heal());
        assert!(busy.stops_start());
        let missing = io_error(Path::new("/dev/ttyUSB0"), io::ErrorKind::NotFound.into());
        assert!(!missing.stops_start());
        assert_eq!(
            busy.to_string(),
            "port /dev/ttyUSB0 is in use by another program: close it there (`fuser -v /dev/ttyUSB0` names it)"
        );
    }
}
