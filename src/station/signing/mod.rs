//! Signing of links: from the key and state files in a live session, from the recording in a replay.
//! The station signs and verifies; this module reads the keys, keeps the timestamps between sessions, and warns where any sender is
//! accepted. Keys are passed only to the station: recordings, events, logs and errors contain their names.

mod files;
mod state_writer;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use posebridge_link::LinkSet;
use posebridge_protocol::signing::{Key, SigningState, SigningTime};
use posebridge_station::{RecordedStation, RecordedStations, StationConfig};
use posebridge_telemetry::{LinkId, TimeDelta};

use self::files::StateFile;
use self::state_writer::SignedLink;
use crate::config::{Config, LinkSection, MemoryRecord, PinChoice, SigningSection, StationShare};
use crate::console::print_line;

pub use files::{create_key, read_key, write_key};
pub use state_writer::SigningStateWriter;

/// A larger lag of the date behind the state is reported: peers may be slightly ahead without an error.
const TOLERATED_LAG: TimeDelta = TimeDelta::from_millis(1_000);

#[derive(Debug, Default)]
pub struct SigningSession(Vec<SignedLink>);

impl SigningSession {
    /// Reads the keys of all signed links and their saved timestamps. `utc_start_micros` is the date at the host clock's zero.
    pub fn open(config: &Config, utc_start_micros: u64) -> Result<Self> {
        let date = SigningTime::from_unix_micros(utc_start_micros);
        let mut session = Self::default();
        for (index, link) in config.links.iter().enumerate() {
            let Some(section) = &link.signing else {
                continue;
            };
            let name = format!("link {index} `{}`", link.url);
            let key = key_of(section).with_context(|| name.clone())?;
            session.check_unused(&key, section.link_id, &name)?;
            let (memory, file) = resume(section, &key, date).with_context(|| name.clone())?;
            warn_of_date(&name, date, &memory);
            let signing = section.to_signing_config(key, memory);
            session.0.push(SignedLink { name, link: LinkId(index as u16), signing, file });
        }
        Ok(session)
    }

    /// Rejects a link that would sign the same stream as another one, however the paths of their key files are spelt.
    fn check_unused(&self, key: &Key, link_id: u8, name: &str) -> Result<()> {
        let is_same = |link: &&SignedLink| link.signing.key == *key && link.signing.link_id == link_id;
        if let Some(other) = self.0.iter().find(is_same) {
            bail!(
                "{name}: {} uses the same key {} with the same `signing.link_id` {link_id}; give each link its own",
                other.name,
                key.name()
            );
        }
        Ok(())
    }

    pub fn apply_to(&self, station_config: &mut StationConfig) {
        for signed in &self.0 {
            for link in station_config.links.iter_mut().filter(|link| link.id == signed.link) {
                link.signing = Some(signed.signing.clone());
            }
        }
    }

    /// The configuration for a recording: with the initial state of each signed link, without the keys.
    pub fn config_for_recording(&self, config: &Config) -> Config {
        let mut config = config.clone();
        for SignedLink { link, signing, .. } in &self.0 {
            let link = config.links.get_mut(usize::from(link.0));
            if let Some(section) = link.and_then(|link| link.signing.as_mut()) {
                section.begun = Some(MemoryRecord::of(&signing.key, &signing.state));
            }
        }
        config
    }

    /// Starts saving the timestamps; `None` without signed links.
    pub fn start_writer(self) -> Result<Option<SigningStateWriter>> {
        if self.0.is_empty() { Ok(None) } else { SigningStateWriter::start(self.0).map(Some) }
    }
}

fn key_of(section: &SigningSection) -> Result<Key> {
    if section.begun.is_some() {
        bail!("`signing.begun` belongs to recordings: take it away");
    }
    read_key(Path::new(&section.key_file))
}

fn resume(section: &SigningSection, key: &Key, date: SigningTime) -> Result<(SigningState, StateFile)> {
    let file = StateFile::lock(Path::new(&section.key_file), section.link_id)?;
    let memory = match file.read(key)? {
        Some((memory, ending)) => memory.resume(date, ending),
        None => SigningState { written_at: date, clock: date, ..SigningState::default() },
    };
    Ok((memory, file))
}

fn warn_of_date(link: &str, date: SigningTime, memory: &SigningState) {
    let lag = memory.clock.since(date);
    if lag > TOLERATED_LAG {
        print_line(&format!(
            "WARNING: {link}: this computer's date stands {:.0} s before the time that signatures have reached; they go on from there",
            lag.as_secs_f64()
        ));
    } else if date == SigningTime::ZERO {
        print_line(&format!(
            "WARNING: {link}: this computer's date lies before 2015; peers refuse our signatures until one of them has told us the time"
        ));
    }
}

/// The stations of a recording with this configuration; keys as in [`recorded_station_config`].
pub fn recorded_stations(config: &Config, files: &[PathBuf]) -> Result<RecordedStations> {
    let (first, further) = recorded_stations_config(config, files)?;
    Ok(RecordedStations::new(first, further)?)
}

/// The configuration of the first station of a recording, and in a merged recording of those behind it.
pub fn recorded_stations_config(config: &Config, files: &[PathBuf]) -> Result<(RecordedStation, Vec<RecordedStation>)> {
    let (first, further) = config.station_shares()?;
    let recorded = |share: &StationShare| {
        let mut station = recorded_station_config(&share.config, files)?;
        for link in &mut station.links {
            link.id.0 += share.first_link;
        }
        // Blocks of other stations' links match none of this one's.
        for (block, section) in station.robots.iter_mut().zip(&config.robots) {
            block.matches = section.matches.to_match();
        }
        Ok(RecordedStation { config: station, clock_ahead: share.clock_ahead })
    };
    let further: Result<Vec<RecordedStation>> = further.iter().map(recorded).collect();
    Ok((recorded(&first)?, further?))
}

/// The station's configuration of a recorded session. The keys of signed links come from these files, else from the original paths.
pub fn recorded_station_config(config: &Config, files: &[PathBuf]) -> Result<StationConfig> {
    ensure!(
        config.merged.is_empty(),
        "this is a merged recording, of several stations: give the recording of the one station that is meant"
    );
    let mut station_config = config.station_config()?;
    let keys = files.iter().map(|path| read_key(path));
    let keys: Vec<Key> = keys.collect::<Result<_>>()?;
    for (index, link) in config.links.iter().enumerate() {
        let Some(section) = &link.signing else {
            continue;
        };
        let name = format!("link {index} `{}`", link.url);
        let Some(begun) = &section.begun else {
            bail!("{name}: the recording does not say with which stamps its signing began");
        };
        let key = key_by_name(&begun.key_name, &keys, section).with_context(|| name.clone())?;
        let signing = section.to_signing_config(key, begun.memory());
        if let Some(link) = station_config.links.get_mut(index) {
            link.signing = Some(signing);
        }
    }
    Ok(station_config)
}

/// The key with this name: from the given ones, else from its original file.
fn key_by_name(key_name: &str, keys: &[Key], section: &SigningSection) -> Result<Key> {
    if let Some(key) = keys.iter().find(|key| key.name() == key_name) {
        return Ok(key.clone());
    }
    let names: Vec<String> = keys.iter().map(Key::name).collect();
    let key_names = if names.is_empty() { String::new() } else { format!(" (you gave {})", names.join(", ")) };
    let cure = format!(
        "this link was signed with the key {key_name}, which no recording holds: give it with `--key FILE`{key_names}"
    );
    let key = read_key(Path::new(&section.key_file)).with_context(|| cure.clone())?;
    if key.name() != key_name {
        bail!("{cure} (`{}` holds {})", section.key_file, key.name());
    }
    Ok(key)
}

/// Warns about every link that listens beyond this computer and accepts frames from any sender.
pub fn warn_of_open_listeners(ports: &LinkSet, config: &Config) {
    for (index, (port, section)) in ports.iter().zip(&config.links).enumerate() {
        let address = port.local_address().filter(|_| port.is_listening());
        if let Some(warning) = address.and_then(|address| warning(index, section, address)) {
            print_line(&warning);
        }
    }
}

fn warning(index: usize, section: &LinkSection, address: SocketAddr) -> Option<String> {
    if address.ip().to_canonical().is_loopback() {
        return None;
    }
    let (state, cure) = match &section.signing {
        Some(signing) if signing.required || section.pin == Some(PinChoice::Key) => return None,
        Some(_) => ("its signing is not required", "set `required = true` in its `signing`"),
        None => (
            "it is not signed",
            "make a key with `posebridge key new FILE` and give the link `signing = { key_file = \"FILE\" }` (docs/routing.md)",
        ),
    };
    let who = if section.pin.is_some() { "who comes before it" } else { "who can reach it" };
    Some(format!(
        "WARNING: link {index} `{}` listens on {address} and {state}: anybody {who} can send as the robot. To keep others \
         out, {cure}, or listen on 127.0.0.1.",
        section.url
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load_text;

    fn section(file: &Path) -> SigningSection {
        SigningSection {
            key_file: file.display().to_string(),
            link_id: 0,
            accept_unsigned: vec![],
            required: true,
            begun: None,
        }
    }

    #[test]
    fn one_key_and_link_id_under_two_spellings_is_refused_with_both_links_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        create_key(&path).unwrap();
        let copy = folder.path().join("copy.key");
        std::fs::copy(&path, &copy).unwrap();
        let link = |port: u16, file: &Path, link_id: u8| {
            let file = file.display();
            format!(
                "[[link]]\nurl = \"udp://127.0.0.1:{port}\"\nsigning = {{ key_file = \"{file}\", link_id = {link_id} }}\n"
            )
        };
        let open = |links: &str| {
            let config = load_text("test", links, &[]).unwrap().config;
            config.station_config().unwrap();
            SigningSession::open(&config, 1_750_000_000_000_000)
        };
        let dotted = folder.path().join("./a.key");
        for other in [&copy, &dotted] {
            let error = open(&(link(1, &path, 7) + &link(2, other, 7))).unwrap_err();
            let error = format!("{error:#}");
            assert!(error.contains("link 0 `udp://127.0.0.1:1`"), "{error}");
            assert!(error.contains("link 1 `udp://127.0.0.1:2`"), "{error}");
            assert!(error.contains("`signing.link_id` 7"), "{error}");
            assert!(open(&(link(1, &path, 7) + &link(2, other, 8))).is_ok());
        }
    }

    #[test]
    fn of_two_keys_one_may_be_given_and_the_other_lie_where_it_did() {
        let folder = tempfile::tempdir().unwrap();
        let [here, supplied, foreign] = ["a", "b", "c"].map(|name| folder.path().join(name));
        let [own, other, third] = [&here, &supplied, &foreign].map(|path| create_key(path).unwrap());
        let both = [third.clone(), other.clone()];
        for (expected, file) in [(&own, &here), (&other, &here)] {
            let found = key_by_name(&expected.name(), &both, &section(file)).unwrap();
            assert_eq!(found, *expected);
        }
        let error = key_by_name(&own.name(), &both, &section(&foreign)).unwrap_err();
        let error = format!("{error:#}");
        for named in [&own, &other, &third] {
            assert!(error.contains(&named.name()), "{error}");
        }
        assert!(error.contains("--key FILE"), "{error}");
    }

    fn is_warned(address: &str, required: Option<bool>, pin: Option<PinChoice>) -> bool {
        let section = LinkSection {
            pin,
            signing: required.map(|required| SigningSection {
                key_file: "a.key".to_owned(),
                link_id: 0,
                accept_unsigned: vec![],
                required,
                begun: None,
            }),
            ..LinkSection::new("udp://:14550")
        };
        let warning = warning(0, &section, address.parse().unwrap());
        if let Some(text) = &warning {
            assert!(text.contains("link 0 `udp://:14550`"), "{text}");
            assert!(text.contains(address), "{text}");
            assert_eq!(text.contains("who comes before it"), pin.is_some(), "{text}");
        }
        warning.is_some()
    }

    #[test]
    fn only_a_listener_that_keeps_nobody_out_is_told() {
        for address in ["0.0.0.0:14550", "192.168.4.1:14550", "[::]:14550"] {
            assert!(is_warned(address, None, None));
            assert!(is_warned(address, None, Some(PinChoice::Address)));
            assert!(is_warned(address, Some(false), Some(PinChoice::First)));
            assert!(!is_warned(address, Some(false), Some(PinChoice::Key)));
            assert!(!is_warned(address, Some(true), None));
        }
        for address in ["127.0.0.1:14550", "[::1]:14550", "[::ffff:127.0.0.1]:14550"] {
            assert!(!is_warned(address, None, None));
        }
    }
}
