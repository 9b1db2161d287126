//! A link's profile: what both directions are like, read from strict TOML.
//!
//! Unknown keys are errors, and so is a key that makes no sense for the kind of link, because a misspelt impairment is one that
//! silently does not happen. Reading files is the caller's business.

use serde::Deserialize;
use toml::de::{DeTable, DeValue};

use super::bundled::{self, PROFILES};
use super::checks;
use super::settings::{DirectionProfile, Disconnects, LinkKind};

/// What a link is like. The default is the clean one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkProfile {
    /// What travels on it.
    pub kind: LinkKind,
    /// From the brick to the station.
    pub to_station: DirectionProfile,
    /// From the station to the brick.
    pub to_brick: DirectionProfile,
    /// How both directions go away together.
    pub disconnects: Option<Disconnects>,
}

/// A profile as it is written: `both`, or each direction by itself.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProfileText {
    kind: LinkKind,
    both: Option<DirectionProfile>,
    to_station: Option<DirectionProfile>,
    to_brick: Option<DirectionProfile>,
    disconnects: Option<Disconnects>,
}

/// Why a profile cannot be had. Lines count from 1.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// The text is not TOML, a key is unknown, or a value does not fit; the message shows the line and the key.
    #[error("link profile is not usable: {0}")]
    Toml(toml::de::Error),
    /// A key does not go together with the others.
    #[error("link profile is not usable: line {line}: `{key}` {reason}")]
    Misplaced {
        /// Line of the profile.
        line: usize,
        /// The key.
        key: String,
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// No bundled profile is called like this.
    #[error("no bundled link profile is called \"{name}\"; there are {known}")]
    UnknownName {
        /// The name that was asked for.
        name: String,
        /// The names that exist, joined by commas.
        known: String,
    },
}

impl LinkProfile {
    /// Reads a profile.
    ///
    /// # Errors
    /// [`ProfileError::Toml`] and [`ProfileError::Misplaced`] name the line and the key that is unknown, missing, of the wrong type,
    /// out of its range, or of no use on this kind of link.
    pub fn from_toml(text: &str) -> Result<Self, ProfileError> {
        let read: ProfileText = toml::from_str(text).map_err(ProfileError::Toml)?;
        if let Some((path, reason)) = profile_error(&read) {
            return Err(ProfileError::Misplaced { line: line_of(text, &path), key: path.join("."), reason });
        }
        let both = read.both.unwrap_or_default();
        Ok(Self {
            kind: read.kind,
            to_station: read.to_station.unwrap_or_else(|| both.clone()),
            to_brick: read.to_brick.unwrap_or(both),
            disconnects: read.disconnects,
        })
    }

    /// The bundled profile of this name; `none` is the clean link.
    ///
    /// # Errors
    /// [`ProfileError::UnknownName`] lists the names that exist.
    pub fn bundled(name: &str) -> Result<Self, ProfileError> {
        if name == bundled::NONE {
            return Ok(Self::default());
        }
        let (_, text) = PROFILES
            .iter()
            .find(|(known, _)| *known == name)
            .ok_or_else(|| ProfileError::UnknownName { name: name.to_owned(), known: bundled::names() })?;
        Self::from_toml(text)
    }

    /// The same link with more loss of whole units (a probability, clamped to 0 to 1) and more delay (milliseconds, at most ten
    /// minutes) in both directions. A negative value, or one that is not finite, adds nothing.
    pub fn with_extra(mut self, loss: f64, delay_ms: f64) -> Self {
        let passes = 1.0 - within(loss, 1.0);
        let delay_ms = within(delay_ms, checks::LONGEST_MS);
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

/// The first key that does not go together with the others, and why.
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

/// The line in which the value of a key begins.
fn line_of(text: &str, path: &[&str]) -> usize {
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
    let before = text.bytes().take(offset.unwrap_or(0));
    1 + before.filter(|byte| *byte == b'\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bundled_profile_reads_and_does_something() {
        for (name, _) in PROFILES {
            let profile = LinkProfile::bundled(name).unwrap();
            let clean = DirectionProfile::default();
            assert_ne!(profile.to_station, clean, "{name}");
            assert_ne!(profile.to_brick, clean, "{name}");
        }
        assert_eq!(LinkProfile::bundled("none").unwrap(), LinkProfile::default());
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let said = LinkProfile::bundled("carrier-pigeon").unwrap_err().to_string();
        assert!(said.contains("carrier-pigeon") && said.contains("none, usb,"), "{said}");
    }

    #[test]
    fn errors_name_the_line_and_the_key() {
        let cases = [
            ("kind = \"stream\"\nspeling = 3\n", "line 2", "speling"),
            ("[both]\n", "line 1", "kind"),
            ("kind = \"stream\"\n[both]\nloss = 1.5\n", "line 3", "loss"),
            ("kind = \"stream\"\n[both]\nloss = nan\n", "line 3", "loss"),
            ("kind = \"stream\"\n[both.delay]\nbase = 3\n", "line 3", "base"),
            ("kind = \"stream\"\n\n[both]\nduplicate = 0.1\n", "line 4", "both.duplicate"),
            ("kind = \"datagram\"\n[to_brick]\nbyte_loss = 0.1\n", "line 3", "to_brick.byte_loss"),
            (
                "kind = \"stream\"\n[both]\nstalls = [\n{ probability = 0.1, from_ms = 2, to_ms = 1 }]\n",
                "line 3",
                "both.stalls",
            ),
            ("kind = \"stream\"\n[to_brick]\n[both]\n", "line 3", "both"),
            (
                "kind = \"stream\"\n[disconnects]\nmean_up_s = 9\ndown_from_s = 3\ndown_to_s = 1\n",
                "line 4",
                "disconnects.down_from_s",
            ),
            ("kind = \"datagram\"\n[both]\nfragment = { most_bytes = 20 }\n", "line 3", "both.fragment"),
        ];
        for (text, line, key) in cases {
            let said = LinkProfile::from_toml(text).unwrap_err().to_string();
            assert!(said.contains(line), "{said} lacks {line}");
            assert!(said.contains(key), "{said} lacks {key}");
        }
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
