//! The stations of a merged recording (`posebridge merge`, docs/recordings.md), each with its own part of the configuration.

use anyhow::{Result, ensure};
use posebridge_telemetry::TimeDelta;

use super::sections::MergedSection;
use super::station::Config;

/// A station of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct StationShare {
    /// As the station itself had it: its links begin with 0. The `[[robot]]` blocks of other stations' links are still in the list, so
    /// that the position of each stays the same; they match no link and have no tag.
    pub config: Config,
    /// The number of its first link in the recording.
    pub first_link: u16,
    /// Its host clock minus that of the recording.
    pub clock_ahead: TimeDelta,
}

/// No station has as many links.
const NO_LINK: u16 = u16::MAX;

impl Config {
    /// The first station of the recording with this configuration, and in a merged recording those behind it.
    pub fn station_shares(&self) -> Result<(StationShare, Vec<StationShare>)> {
        let Some((first, further)) = self.merged.split_first() else {
            return Ok((
                StationShare { config: self.clone(), first_link: 0, clock_ahead: TimeDelta::ZERO },
                Vec::new(),
            ));
        };
        let links: usize = self.merged.iter().map(|station| usize::from(station.links)).sum();
        ensure!(
            links == self.links.len(),
            "the stations of `merged` have {links} links together, but there are {} `link`: the recording was changed by hand",
            self.links.len()
        );
        let mut first_link = 0;
        let mut share = |station: &MergedSection| {
            let share = self.share_of(station, first_link);
            first_link += station.links;
            share
        };
        let first = share(first);
        Ok((first, further.iter().map(share).collect()))
    }

    fn share_of(&self, station: &MergedSection, first_link: u16) -> StationShare {
        let links = self.links.iter().skip(usize::from(first_link)).take(usize::from(station.links));
        let mut config = Self { links: links.cloned().collect(), merged: Vec::new(), ..self.clone() };
        for block in &mut config.robots {
            let Some(link) = block.matches.link else {
                continue;
            };
            let own = link.checked_sub(first_link).filter(|own| *own < station.links);
            block.matches.link = Some(own.unwrap_or(NO_LINK));
            // The station did not know the tag of a robot that is another's.
            block.tag = block.tag.filter(|_| own.is_some());
        }
        StationShare { config, first_link, clock_ahead: TimeDelta::from_nanos(station.clock_ahead_ns) }
    }
}

#[cfg(test)]
mod tests {
    use crate::config::load_text;

    const MERGED: &str = r#"
        [[link]]
        url = "udp://:1"
        [[link]]
        url = "udp://:2"
        [[link]]
        url = "udp://:3"
        [[robot]]
        match = { link = 0 }
        name = "ada"
        [[robot]]
        match = { link = 2 }
        name = "bob"
        [[robot]]
        match = { system = 7 }
        name = "eve"
        [[merged]]
        station = "a"
        links = 1
        clock_ahead_ns = 0
        [[merged]]
        station = "b"
        links = 2
        clock_ahead_ns = -5
    "#;

    #[test]
    fn each_station_has_its_own_links_and_the_blocks_keep_their_positions() {
        let config = load_text("merged", MERGED, &[]).unwrap().config;
        let (first, further) = config.station_shares().unwrap();
        let [second] = further.as_slice() else { panic!("there are two") };
        assert_eq!((first.first_link, second.first_link, second.clock_ahead.as_nanos()), (0, 1, -5));
        let urls = |config: &crate::config::Config| -> Vec<String> {
            config.links.iter().map(|link| link.url.clone()).collect()
        };
        assert_eq!(
            (urls(&first.config), urls(&second.config)),
            (vec!["udp://:1".to_owned()], vec!["udp://:2".to_owned(), "udp://:3".to_owned()])
        );
        let links = |config: &crate::config::Config| -> Vec<Option<u16>> {
            config.robots.iter().map(|block| block.matches.link).collect()
        };
        assert_eq!(links(&first.config), [Some(0), Some(u16::MAX), None]);
        assert_eq!(links(&second.config), [Some(u16::MAX), Some(1), None]);
        assert!(second.config.merged.is_empty());
        let (only, none) = first.config.station_shares().unwrap();
        assert_eq!((only.config, none.len()), (first.config, 0));
    }

    #[test]
    fn a_station_does_not_run_with_it_and_links_that_do_not_add_up_are_refused() {
        let config = load_text("merged", MERGED, &[]).unwrap().config;
        let error = config.validate().unwrap_err().to_string();
        assert!(error.contains("`merged`"), "{error}");
        let config = load_text("merged", &MERGED.replace("links = 2", "links = 3"), &[]).unwrap().config;
        let error = config.station_shares().unwrap_err().to_string();
        assert!(error.contains("4 links together, but there are 3"), "{error}");
    }
}
