//! Links as URLs: `scheme:target?option=value`.
//!
//! The schemes and options are those of [`TRANSPORTS`]. Parsing opens nothing and resolves no names, so a valid URL may
//! still name something that does not exist.

use std::fmt;
use std::net::Ipv6Addr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use thiserror::Error;

use crate::transport::{OptionHelp, TRANSPORTS, TargetKind, Transport};

/// The URL of a link, checked against the table of transports; prints as it was written.
///
/// A URL that was [made from a path](LinkUrl::pty) cannot always be parsed again: the path may have a question mark, or bytes
/// that are not UTF-8.
#[derive(Clone)]
pub struct LinkUrl {
    text: String,
    transport: Transport,
    target: Target,
    options: Vec<(&'static str, String)>,
}

/// The target of a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// A device, a pseudo-terminal's link or a file; relative to the working directory unless it begins with `/`.
    Path(PathBuf),
    Host {
        /// A name, an IPv4 address or an IPv6 address without brackets. Empty if none was given; a link that listens is then
        /// reachable from this computer only.
        host: String,
        /// 0 lets the system choose when listening.
        port: u16,
    },
    Bluetooth(BluetoothAddress),
}

/// The address of a Bluetooth device (BD_ADDR), as it is written: the manufacturer's part first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BluetoothAddress(pub [u8; 6]);

impl fmt::Display for BluetoothAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e, g] = self.0;
        write!(f, "{a:02X}:{b:02X}:{c:02X}:{d:02X}:{e:02X}:{g:02X}")
    }
}

/// Why a text is not a link.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum UrlError {
    #[error("`{text}` has no scheme: put one of {known} in front, such as {example}")]
    NoScheme {
        text: String,
        /// The schemes of the table.
        known: String,
        example: &'static str,
    },
    #[error("unknown link scheme `{scheme}`: use one of {known}")]
    UnknownScheme {
        scheme: String,
        /// The schemes of the table.
        known: String,
    },
    #[error("`{text}` names no path: write it like {example}")]
    NoPath { text: String, example: &'static str },
    #[error("`{text}` names no port: write it like {example}")]
    NoPort { text: String, example: &'static str },
    #[error("port `{port}` in `{text}` is not a whole number from 0 to 65535")]
    BadPort { text: String, port: String },
    #[error("host `{host}` in `{text}` is neither a name nor an address (IPv6 goes in brackets)")]
    BadHost { text: String, host: String },
    #[error("`{address}` in `{text}` is not a Bluetooth address: write it like {example}")]
    BadBluetoothAddress {
        text: String,
        /// The text in place of the address.
        address: String,
        example: &'static str,
    },
    #[error("{scheme} links have no option `{name}`: {valid}")]
    UnknownOption {
        scheme: &'static str,
        name: String,
        /// The options that it has, as a sentence.
        valid: String,
    },
    #[error("option {name}=`{value}` of {scheme} links must be {accepted}")]
    BadOption { scheme: &'static str, name: &'static str, value: String, accepted: String },
    #[error("option `{name}` stands twice in `{text}`")]
    RepeatedOption { text: String, name: &'static str },
}

impl LinkUrl {
    /// Reads a link such as `serial:///dev/rfcomm0?baud=57600`, `pty:brick.tty` or `udp://:14550`.
    ///
    /// The last question mark begins the options, so that a pattern of serial ports may use others:
    /// `serial:///dev/ttyUSB??baud=57600`.
    ///
    /// # Errors
    /// [`UrlError`] names the part that is wrong and what is accepted there.
    pub fn parse(text: &str) -> Result<Self, UrlError> {
        let (scheme, rest) = text.split_once(':').ok_or_else(|| UrlError::NoScheme {
            text: text.to_owned(),
            known: known_schemes(),
            example: TRANSPORTS.first().map_or("", |first| first.example()),
        })?;
        let transport = TRANSPORTS
            .iter()
            .copied()
            .find(|transport| transport.scheme() == scheme)
            .ok_or_else(|| UrlError::UnknownScheme { scheme: scheme.to_owned(), known: known_schemes() })?;
        // What follows a question mark in the URL of a network camera is for that camera.
        let is_whole = transport.target_kind() == TargetKind::Pictures && rest.contains("://");
        let (target, query) = rest.rsplit_once('?').filter(|_| !is_whole).unwrap_or((rest, ""));
        let target = target.strip_prefix("//").unwrap_or(target);
        let target = match transport.target_kind() {
            TargetKind::Path | TargetKind::Pictures => check_path(text, Path::new(target), transport)?,
            TargetKind::Host => parse_host(text, target, transport)?,
            TargetKind::Bluetooth => parse_bluetooth(text, target, transport)?,
        };
        Ok(Self { text: text.to_owned(), transport, target, options: parse_options(text, query, transport)? })
    }

    /// A pseudo-terminal that this program creates at `path`. The path is used literally: a question mark begins no options.
    ///
    /// # Errors
    /// [`UrlError::NoPath`] for an empty path or one with a zero byte.
    pub fn pty(path: &Path) -> Result<Self, UrlError> {
        Self::from_path(Transport::Pty, path)
    }

    /// The serial port at `path`, at the default speed. The path is used literally.
    ///
    /// # Errors
    /// [`UrlError::NoPath`] for an empty path or one with a zero byte.
    pub fn serial(path: &Path) -> Result<Self, UrlError> {
        Self::from_path(Transport::Serial, path)
    }

    fn from_path(transport: Transport, path: &Path) -> Result<Self, UrlError> {
        let text = format!("{}:{}", transport.scheme(), path.display());
        Ok(Self { target: check_path(&text, path, transport)?, text, transport, options: Vec::new() })
    }

    pub const fn transport(&self) -> Transport {
        self.transport
    }

    pub const fn target(&self) -> &Target {
        &self.target
    }

    /// The target's path; empty for an address.
    pub fn path(&self) -> &Path {
        match &self.target {
            Target::Path(path) => path,
            Target::Host { .. } | Target::Bluetooth(_) => Path::new(""),
        }
    }

    /// The target's host and port; an empty host and port 0 for a path.
    pub fn host_and_port(&self) -> (&str, u16) {
        match &self.target {
            Target::Path(_) | Target::Bluetooth(_) => ("", 0),
            Target::Host { host, port } => (host, *port),
        }
    }

    /// The value of a whole-number option, or its default; 0 for an option of another kind.
    pub fn integer(&self, option: &OptionHelp) -> u32 {
        self.option_text(option).parse().unwrap_or_default()
    }

    /// The text of an option in the URL, or its default.
    pub fn option_text(&self, option: &OptionHelp) -> String {
        self.options
            .iter()
            .find(|(name, _)| *name == option.name)
            .map_or_else(|| option.kind.default_text(), |(_, value)| value.clone())
    }
}

impl fmt::Display for LinkUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl fmt::Debug for LinkUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "LinkUrl({})", self.text)
    }
}

impl PartialEq for LinkUrl {
    /// URLs are equal if scheme, target and given options are; `serial:a` and `serial://a` are equal.
    fn eq(&self, other: &Self) -> bool {
        self.transport.scheme() == other.transport.scheme()
            && self.target == other.target
            && self.options == other.options
    }
}

impl Eq for LinkUrl {}

impl FromStr for LinkUrl {
    type Err = UrlError;
    fn from_str(text: &str) -> Result<Self, UrlError> {
        Self::parse(text)
    }
}

fn known_schemes() -> String {
    let schemes: Vec<_> = TRANSPORTS.iter().map(|transport| transport.scheme()).collect();
    schemes.join(", ")
}

fn check_path(text: &str, path: &Path, transport: Transport) -> Result<Target, UrlError> {
    let bytes = path.as_os_str().as_encoded_bytes();
    if bytes.is_empty() || bytes.contains(&0) {
        return Err(UrlError::NoPath { text: text.to_owned(), example: transport.example() });
    }
    Ok(Target::Path(path.to_owned()))
}

fn parse_host(text: &str, authority: &str, transport: Transport) -> Result<Target, UrlError> {
    let authority = authority.strip_suffix('/').unwrap_or(authority);
    let Some((host, port)) = authority.rsplit_once(':') else {
        return Err(UrlError::NoPort { text: text.to_owned(), example: transport.example() });
    };
    let bad_port = || UrlError::BadPort { text: text.to_owned(), port: port.to_owned() };
    // `u16::from_str` also accepts a plus sign.
    if !port.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(bad_port());
    }
    let port = port.parse().map_err(|_not_16_bits| bad_port())?;
    let host =
        parse_host_name(host).ok_or_else(|| UrlError::BadHost { text: text.to_owned(), host: host.to_owned() })?;
    Ok(Target::Host { host, port })
}

fn parse_bluetooth(text: &str, address: &str, transport: Transport) -> Result<Target, UrlError> {
    let address = address.strip_suffix('/').unwrap_or(address);
    match bluetooth_address(address) {
        Some(address) => Ok(Target::Bluetooth(address)),
        None => Err(UrlError::BadBluetoothAddress {
            text: text.to_owned(),
            address: address.to_owned(),
            example: transport.example(),
        }),
    }
}

/// Six bytes of two hexadecimal digits, with colons between them.
fn bluetooth_address(text: &str) -> Option<BluetoothAddress> {
    let mut bytes = [0; 6];
    let mut parts = text.split(':');
    for byte in &mut bytes {
        let part = parts.next()?;
        // `from_str_radix` also accepts a plus sign.
        if part.len() != 2 || !part.bytes().all(|digit| digit.is_ascii_hexdigit()) {
            return None;
        }
        *byte = u8::from_str_radix(part, 16).ok()?;
    }
    parts.next().is_none().then_some(BluetoothAddress(bytes))
}

fn parse_host_name(host: &str) -> Option<String> {
    if let Some(inner) = host.strip_prefix('[') {
        let address: Ipv6Addr = inner.strip_suffix(']')?.parse().ok()?;
        return Some(address.to_string());
    }
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || b"-._".contains(&byte);
    host.bytes().all(is_name).then(|| host.to_owned())
}

fn parse_options(text: &str, query: &str, transport: Transport) -> Result<Vec<(&'static str, String)>, UrlError> {
    let mut options: Vec<(&'static str, String)> = Vec::new();
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        let option =
            transport.options().iter().find(|option| option.name == name).ok_or_else(|| UrlError::UnknownOption {
                scheme: transport.scheme(),
                name: name.to_owned(),
                valid: valid_options(transport),
            })?;
        if !option.kind.accepts(value) {
            return Err(UrlError::BadOption {
                scheme: transport.scheme(),
                name: option.name,
                value: value.to_owned(),
                accepted: option.kind.to_string(),
            });
        }
        if options.iter().any(|(known, _)| *known == option.name) {
            return Err(UrlError::RepeatedOption { text: text.to_owned(), name: option.name });
        }
        options.push((option.name, value.to_owned()));
    }
    options.sort_unstable();
    Ok(options)
}

fn valid_options(transport: Transport) -> String {
    let names: Vec<_> = transport.options().iter().map(|option| option.name).collect();
    if names.is_empty() { "they take none".to_owned() } else { format!("use {}", names.join(", ")) }
}
