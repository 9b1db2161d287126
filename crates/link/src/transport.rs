//! The table of transports: scheme, URL form and options of each.
//!
//! Help texts, the URL parser and the conformance tests read this table. A new transport needs a variant here and a file in
//! `transports/`.

use std::fmt;

/// Every transport, in the order of the help texts.
pub const TRANSPORTS: &[Transport] = &[
    Transport::Serial,
    Transport::Bluetooth,
    Transport::Pty,
    Transport::Tcp,
    Transport::Udp,
    Transport::Ev3,
    Transport::File,
    Transport::Camera,
];

/// The option of every transport; [`crate::Link`] applies it.
pub(crate) const RATE: OptionHelp = OptionHelp {
    name: "rate",
    kind: OptionKind::Integer { min: 0, max: 1_000_000_000, default: 0 },
    help: "most bytes per second that are sent, counted once per peer; 0 is no limit",
};

/// The version of MAVLink that is spoken; the program applies it, links do not know protocols.
pub const VERSION: OptionHelp = OptionHelp {
    name: "version",
    kind: OptionKind::Choice { choices: &["2", "1"] },
    help: "version of MAVLink: 1 sends it, and accepts both",
};

/// The speed of a serial line. 115200 is the factory setting of MAVLink boards and their radios; the range is that of Linux's
/// termios constants.
pub(crate) const BAUD: OptionHelp = OptionHelp {
    name: "baud",
    kind: OptionKind::Integer { min: 50, max: 4_000_000, default: 115_200 },
    help: "speed of the line in bits per second; Bluetooth and pseudo-terminals ignore it",
};

/// What to do with DTR. Linux always raises it when the port is opened.
pub(crate) const DTR: OptionHelp = OptionHelp {
    name: "dtr",
    kind: OptionKind::Choice { choices: &["keep", "on", "off"] },
    help: "keep leaves DTR alone once the port is open, on and off set it then; closing never drops it",
};

/// The RFCOMM channel, 1 to 30 (Bluetooth RFCOMM specification, section 5.4); NXT, EV3 and HC-05 listen on the first.
pub(crate) const CHANNEL: OptionHelp = OptionHelp {
    name: "channel",
    kind: OptionKind::Integer { min: 1, max: 30, default: 1 },
    help: "RFCOMM channel of the device",
};

/// When a UDP peer is forgotten. The default lasts ten MAVLink heartbeats.
pub(crate) const IDLE: OptionHelp = OptionHelp {
    name: "idle_s",
    kind: OptionKind::Integer { min: 1, max: 86_400, default: 10 },
    help: "seconds of silence after which a peer is not written to any more",
};

pub(crate) const SERIAL_NUMBER: OptionHelp = OptionHelp {
    name: "serial",
    kind: OptionKind::HexDigits { count: 12 },
    help: "the brick's serial number, on the brick under Brick Info; a link that listens takes any brick without it",
};

/// Whether a file is read or written.
pub(crate) const MODE: OptionHelp = OptionHelp {
    name: "mode",
    kind: OptionKind::Choice { choices: &["read", "append"] },
    help: "read plays the file's bytes in, append writes sent frames to its end and makes it if needed",
};

/// The size of one read from a file; the default is one page.
pub(crate) const CHUNK: OptionHelp = OptionHelp {
    name: "chunk",
    kind: OptionKind::Integer { min: 1, max: 65_536, default: 4_096 },
    help: "bytes per delivered chunk",
};

/// Pixels across and down that a webcam is asked for.
pub const WIDTH: OptionHelp = OptionHelp {
    name: "width",
    kind: OptionKind::Integer { min: 0, max: 4_928, default: 1_280 },
    help: "pixels across that a webcam is asked for; 0 takes what it has",
};
pub const HEIGHT: OptionHelp =
    OptionHelp { name: "height", kind: OptionKind::Integer { min: 0, max: 4_928, default: 720 }, help: "pixels down" };
pub const PICTURES_PER_SECOND: OptionHelp = OptionHelp {
    name: "fps",
    kind: OptionKind::Integer { min: 1, max: 240, default: 30 },
    help: "pictures per second that a webcam is asked for, and with which a folder of pictures without times is played",
};
/// Held against the camera's automatic control, which lengthens the exposure in the dark until moving tags are blurred.
pub const EXPOSURE: OptionHelp = OptionHelp {
    name: "exposure_us",
    kind: OptionKind::Integer { min: 0, max: 1_000_000, default: 0 },
    help: "exposure of a webcam, microseconds, set and held; 0 leaves it to the camera",
};
pub const GAIN: OptionHelp = OptionHelp {
    name: "gain",
    kind: OptionKind::Integer { min: 0, max: 65_535, default: 0 },
    help: "gain of a webcam in its own unit, set and held; 0 leaves it to the camera",
};

/// A kind of link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    Serial,
    /// A Bluetooth Classic serial port (RFCOMM), by the device's address.
    Bluetooth,
    /// A pseudo-terminal that this program creates.
    Pty,
    /// TCP, client or server.
    Tcp,
    Udp,
    /// An EV3 by WiFi.
    Ev3,
    /// A file of raw bytes.
    File,
    /// Pictures of a camera, in which tags are looked for.
    Camera,
}

impl Transport {
    /// The word before the colon.
    pub const fn scheme(self) -> &'static str {
        match self {
            Self::Serial => "serial",
            Self::Bluetooth => "bluetooth",
            Self::Pty => "pty",
            Self::Tcp => "tcp",
            Self::Udp => "udp",
            Self::Ev3 => "ev3",
            Self::File => "file",
            Self::Camera => "camera",
        }
    }

    pub const fn summary(self) -> &'static str {
        match self {
            Self::Serial => "a serial port: USB, UART, a bound Bluetooth port, or a pseudo-terminal of another program",
            Self::Bluetooth => "a paired Bluetooth device by its address",
            Self::Pty => "a pseudo-terminal that we make: others open the path like a serial port",
            Self::Tcp => "a TCP client, or a server for many clients where the link listens",
            Self::Udp => "UDP: without a host it listens and replies to its peers, with a host it sends there first",
            Self::Ev3 => {
                "an EV3 by WiFi: listens for one that announces itself, or dials one by address and serial number"
            }
            Self::File => "raw bytes from a file, or sent frames to the end of one",
            Self::Camera => {
                "tags in the pictures of a webcam, of a phone or network camera by http://, of a video file or a folder"
            }
        }
    }

    pub const fn example(self) -> &'static str {
        match self {
            Self::Serial => "serial:///dev/ttyUSB0?baud=115200",
            Self::Bluetooth => "bluetooth://00:16:53:AA:BB:CC?channel=1",
            Self::Pty => "pty:brick.tty",
            Self::Tcp => "tcp://192.168.4.1:5760",
            Self::Udp => "udp://:14550",
            Self::Ev3 => "ev3://0.0.0.0:3015",
            Self::File => "file://run.bin",
            Self::Camera => "camera:/dev/video0",
        }
    }

    pub const fn target_kind(self) -> TargetKind {
        match self {
            Self::Serial | Self::Pty | Self::File => TargetKind::Path,
            Self::Camera => TargetKind::Pictures,
            Self::Bluetooth => TargetKind::Bluetooth,
            Self::Tcp | Self::Udp | Self::Ev3 => TargetKind::Host,
        }
    }

    pub const fn options(self) -> &'static [OptionHelp] {
        match self {
            Self::Serial => &[BAUD, DTR, RATE, VERSION],
            Self::Bluetooth => &[CHANNEL, RATE, VERSION],
            Self::Pty | Self::Tcp => &[RATE, VERSION],
            Self::Udp => &[IDLE, RATE, VERSION],
            Self::Ev3 => &[SERIAL_NUMBER, RATE],
            Self::File => &[MODE, CHUNK, RATE, VERSION],
            Self::Camera => &[WIDTH, HEIGHT, PICTURES_PER_SECOND, EXPOSURE, GAIN, RATE],
        }
    }

    /// True if each delivered chunk is one datagram, so that no frame crosses two of them.
    pub const fn is_datagram(self) -> bool {
        matches!(self, Self::Udp)
    }
}

/// The form of a link's target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetKind {
    Path,
    Host,
    Bluetooth,
    /// A path, or a whole URL with options of its own.
    Pictures,
}

/// One option of a transport, with its help text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OptionHelp {
    pub name: &'static str,
    pub kind: OptionKind,
    /// Its effect, units included.
    pub help: &'static str,
}

/// The values of an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionKind {
    Integer {
        min: u32,
        max: u32,
        default: u32,
    },
    Choice {
        /// The first is the default.
        choices: &'static [&'static str],
    },
    /// Hexadecimal digits; the default is none.
    HexDigits {
        count: usize,
    },
}

impl OptionKind {
    pub(crate) fn accepts(self, value: &str) -> bool {
        match self {
            Self::Integer { min, max, .. } => value.parse::<u32>().is_ok_and(|number| (min..=max).contains(&number)),
            Self::Choice { choices } => choices.contains(&value),
            Self::HexDigits { count } => {
                value.is_empty() || value.len() == count && value.bytes().all(|byte| byte.is_ascii_hexdigit())
            }
        }
    }

    /// The default, as it would be written.
    pub fn default_text(self) -> String {
        match self {
            Self::Integer { default, .. } => default.to_string(),
            Self::Choice { choices } => choices.first().copied().unwrap_or_default().to_owned(),
            Self::HexDigits { .. } => String::new(),
        }
    }
}

impl fmt::Display for OptionKind {
    /// The accepted values, such as "a whole number from 50 to 4000000".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer { min, max, .. } => write!(f, "a whole number from {min} to {max}"),
            Self::Choice { choices } => write!(f, "one of {}", choices.join(", ")),
            Self::HexDigits { count } => write!(f, "{count} hexadecimal digits"),
        }
    }
}
