//! Link profile: the impairments of both directions, in strict TOML.
//!
//! Unknown keys are errors, and so are keys that do not apply to the kind of link: a misspelt impairment would silently not happen.

use serde::Deserialize;
use toml::de::{DeTable, DeValue};

use crate::config_file::{ConfigFileError, LONGEST_MS, bundle, bundled_text, from_toml, line_of};

const NONE: &str = "none";

/// Name and TOML text of every bundled link profile. Adding one: a file in `config/links/` and its name here.
pub const PROFILES: &[(&str, &str)] =
    bundle!("links": "usb", "bluetooth-spp", "hc05-57600", "sik-radio", "wifi", "ble", "harsh");

/// Impairments of a link. The default has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkProfile {
    pub kind: LinkKind,
    pub to_station: DirectionProfile,
    pub to_brick: DirectionProfile,
    pub disconnects: Option<Disconnects>,
}

/// The file format: `both`, or each direction separately.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProfileText {
    kind: LinkKind,
    both: Option<DirectionProfile>,
    to_station: Option<DirectionProfile>,
    to_brick: Option<DirectionProfile>,
    disconnects: Option<Disconnects>,
}

impl LinkProfile {
    /// Reads a profile. An error names the line and the key that is unknown, missing, of the wrong type, out of range, or not
    /// applicable to this kind of link.
    pub fn from_toml(text: &str) -> Result<Self, ConfigFileError> {
        let read: ProfileText = from_toml("link profile", text, |read| {
            let (path, reason) = profile_error(read)?;
            Some(format!("line {}: `{}` {reason}", line_of_key(text, &path), path.join(".")))
        })?;
        let both = read.both.unwrap_or_default();
        Ok(Self {
            kind: read.kind,
            to_station: read.to_station.unwrap_or_else(|| both.clone()),
            to_brick: read.to_brick.unwrap_or(both),
            disconnects: read.disconnects,
        })
    }

    /// `none` is the link without impairments. An error lists the known names.
    pub fn bundled(name: &str) -> Result<Self, ConfigFileError> {
        if name == NONE {
            return Ok(Self::default());
        }
        let text = bundled_text("bundled link profile", PROFILES, name, |names| format!("{NONE}, {names}"))?;
        Self::from_toml(text)
    }

    /// Adds loss of whole units (a probability, clamped to 0 to 1) and delay (at most ten minutes) in both directions. A negative or
    /// non-finite value adds nothing.
    pub fn with_extra(mut self, loss: f64, delay_ms: f64) -> Self {
        let passes = 1.0 - within(loss, 1.0);
        let delay_ms = within(delay_ms, LONGEST_MS);
        for direction in [&mut self.to_station, &mut self.to_brick] {
            direction.loss = 1.0 - (1.0 - direction.loss) * passes;
            direction.delay.base_ms += delay_ms;
        }
        self
    }
}

fn within(value: f64, most: f64) -> f64 {
    if value.is_finite() { value.clamp(0.0, most) } else { 0.0 }
}

/// The first key that contradicts the others, and why.
fn profile_error(read: &ProfileText) -> Option<(Vec<&'static str>, &'static str)> {
    let directions = [("both", &read.both), ("to_station", &read.to_station), ("to_brick", &read.to_brick)];
    if read.both.is_some() && (read.to_station.is_some() || read.to_brick.is_some()) {
        return Some((vec!["both"], "says what to_station or to_brick says too; remove one of them"));
    }
    for (name, direction) in directions {
        let found = direction.as_ref().and_then(|direction| direction_error(read.kind, direction));
        if let Some((key, reason)) = found {
            return Some((vec![name, key], reason));
        }
    }
    let is_reversed = |disconnects: &Disconnects| disconnects.down_from_s > disconnects.down_to_s;
    (read.disconnects.as_ref().is_some_and(is_reversed))
        .then_some((vec!["disconnects", "down_from_s"], "is more than down_to_s; exchange them"))
}

fn direction_error(kind: LinkKind, direction: &DirectionProfile) -> Option<(&'static str, &'static str)> {
    const FOR_DATAGRAMS: &str = "is of no use on a stream, which keeps its order; remove it";
    const FOR_STREAMS: &str = "is of no use for datagrams, which stay whole; remove it";
    const REVERSED: &str = "has a from_ms of more than its to_ms; exchange them";
    let is_stream = kind == LinkKind::Stream;
    let reordered = direction.reorder.as_ref();
    let faults = [
        (is_stream && reordered.is_some(), "reorder", FOR_DATAGRAMS),
        (is_stream && direction.duplicate > 0.0, "duplicate", FOR_DATAGRAMS),
        (!is_stream && direction.fragment.is_some(), "fragment", FOR_STREAMS),
        (!is_stream && direction.byte_loss > 0.0, "byte_loss", FOR_STREAMS),
        (direction.stalls.iter().any(|stall| stall.from_ms > stall.to_ms), "stalls", REVERSED),
        (reordered.is_some_and(|reorder| reorder.from_ms > reorder.to_ms), "reorder", REVERSED),
    ];
    faults.into_iter().find_map(|(is_wrong, key, reason)| is_wrong.then_some((key, reason)))
}

fn line_of_key(text: &str, path: &[&str]) -> usize {
    let offset = DeTable::parse(text).ok().and_then(|table| {
        let mut table = table.into_inner();
        let (last, tables) = path.split_last()?;
        for name in tables {
            let DeValue::Table(inner) = table.remove(*name)?.into_inner() else {
                return None;
            };
            table = inner;
        }
        table.get(*last).map(|value| value.span().start)
    });
    line_of(text, offset.unwrap_or(0))
}

/// The unit of transport.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkKind {
    /// Ordered bytes without boundaries; loss removes bytes.
    #[default]
    Stream,
    /// Datagrams: each arrives whole or not at all, possibly twice or out of order.
    Datagram,
}

/// Impairments of one direction. The default delivers everything at once.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DirectionProfile {
    /// Bandwidth and buffer; `None` is infinitely fast.
    pub rate: Option<Rate>,
    /// Probability that a unit is lost whole, independently of all others.
    pub loss: f64,
    /// Bursty loss: of datagrams, or of a stream's bytes.
    pub burst_loss: Option<BurstLoss>,
    /// Probability that a byte of a stream is missing, independently of all others.
    pub byte_loss: f64,
    /// Probability that a bit arrives wrong, independently of all others.
    pub bit_error_rate: f64,
    pub delay: Delay,
    /// Pauses that delay everything behind them as well.
    pub stalls: Vec<RandomDelay>,
    /// Datagrams that are delayed while later ones pass.
    pub reorder: Option<RandomDelay>,
    /// Probability that a datagram arrives twice.
    pub duplicate: f64,
    /// Delivery slots: bytes arrive only at this interval, a stream's together; `None` is at once.
    pub slot_ms: Option<f64>,
    /// Splits a stream at delivery.
    pub fragment: Option<Fragment>,
}

/// A token bucket with a finite buffer in front of it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rate {
    pub bytes_per_s: f64,
    /// Buffer in front of the line, the unit on the line included. On overflow a stream loses its last bytes, a datagram is dropped
    /// whole.
    pub buffer_bytes: u32,
    /// Bucket depth: bytes that an idle line sends at once.
    #[serde(default)]
    pub burst_bytes: u32,
}

/// Gilbert's and Elliott's two states in continuous time.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BurstLoss {
    pub mean_good_s: f64,
    pub mean_bad_s: f64,
    /// Per datagram or per byte of a stream.
    pub loss_good: f64,
    /// Per datagram or per byte of a stream.
    pub loss_bad: f64,
}

/// A constant delay plus exponential jitter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Delay {
    /// Constant part.
    pub base_ms: f64,
    /// Mean of the exponential part.
    pub jitter_mean_ms: f64,
}

/// A delay that happens now and then.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RandomDelay {
    pub probability: f64,
    /// Uniform from here
    pub from_ms: f64,
    /// to here.
    pub to_ms: f64,
}

/// Fragmentation of a stream at delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fragment {
    pub most_bytes: u32,
    #[serde(default)]
    pub sizes: PieceSizes,
}

/// The size of the fragments of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PieceSizes {
    #[default]
    Fixed,
    /// Uniform from one byte to the largest.
    Random,
}

/// Random outages of both directions of a link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disconnects {
    /// Exponential.
    pub mean_up_s: f64,
    /// Uniform from here
    pub down_from_s: f64,
    /// to here.
    pub down_to_s: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bundled_profile_reads_and_does_something_and_an_unknown_name_lists_them() {
        for (name, _) in PROFILES {
            let profile = LinkProfile::bundled(name).unwrap();
            for direction in [profile.to_station, profile.to_brick] {
                assert_ne!(direction, DirectionProfile::default(), "{name}");
            }
        }
        assert_eq!(LinkProfile::bundled("none").unwrap(), LinkProfile::default());
        let message = LinkProfile::bundled("carrier-pigeon").unwrap_err().to_string();
        assert!(message.contains("carrier-pigeon") && message.contains("none, usb,"), "{message}");
    }

    #[test]
    fn extra_loss_and_delay_are_added_to_what_is_there() {
        let text = "kind = \"stream\"\n[both]\nloss = 0.5\ndelay = { base_ms = 10 }\n";
        let worse = LinkProfile::from_toml(text).unwrap().with_extra(0.2, 30.0);
        assert!((worse.to_brick.loss - 0.6).abs() < 1e-12);
        assert!((worse.to_station.delay.base_ms - 40.0).abs() < 1e-12);
        let same = LinkProfile::default().with_extra(f64::NAN, f64::NAN);
        assert_eq!(same, LinkProfile::default());
    }
}
