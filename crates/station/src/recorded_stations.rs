//! The stations of a recording: one, or in a merged recording those of a fleet.
//!
//! Each station of a merged recording gets its own inputs at the times of its own clock, as it did live, so that the merged recording
//! replays exactly: what two stations hear of one robot stays apart, and an answer to a time request holds the time of the station that
//! asked. Events come out at the times of the recording.

use std::collections::BTreeMap;

use posebridge_telemetry::{
    HostClock, Input, LinkId, Output, OutsideFix, Ownership, RobotSnapshot, TimeDelta, Timestamp,
};

use crate::config::{BuildError, StationConfig};
use crate::robot::Robot;
use crate::station::Station;

/// A station of a recording, before its first input.
pub struct RecordedStation {
    /// Link ids are those of the recording.
    pub config: StationConfig,
    /// Its host clock minus that of the recording; zero where it is the only one.
    pub clock_ahead: TimeDelta,
}

/// The stations of a recording, each fed with its own inputs. After every [`handle`](Self::handle) call [`poll`](Self::poll) until it
/// returns `None`.
pub struct RecordedStations {
    first: Station,
    further: Vec<Station>,
    /// Of each station.
    clocks_ahead: Vec<TimeDelta>,
    by_link: BTreeMap<LinkId, usize>,
    /// The station of the last input.
    current: usize,
}

impl RecordedStations {
    /// The first station, and those behind it; each at the zero of its clock.
    ///
    /// Fails if a filter is unknown, or two links of a station share an id.
    pub fn new(first: RecordedStation, further: Vec<RecordedStation>) -> Result<Self, BuildError> {
        let mut by_link = BTreeMap::new();
        let mut clocks_ahead = Vec::new();
        let mut build = |recorded: RecordedStation| {
            let number = clocks_ahead.len();
            clocks_ahead.push(recorded.clock_ahead);
            for link in &recorded.config.links {
                by_link.entry(link.id).or_insert(number);
            }
            Station::new(recorded.config, Timestamp::ZERO)
        };
        let first = build(first)?;
        let further = further.into_iter().map(build).collect::<Result<_, _>>()?;
        Ok(Self { first, further, clocks_ahead, by_link, current: 0 })
    }

    /// Gives an input to its station: by its link or its number, else the first one. An input of a station that is not there is ignored.
    pub fn handle(&mut self, now: Timestamp<HostClock>, input: &Input) {
        self.current = if let Input::OfStation { station, .. } = input {
            usize::from(*station)
        } else {
            input.link().and_then(|link| self.by_link.get(&link)).copied().unwrap_or(0)
        };
        let ahead = self.clock_ahead();
        let Some(station) = self.station_mut() else {
            return;
        };
        match by_own_clock(input, ahead) {
            Some(own) => station.handle(now + ahead, &own),
            None => station.handle(now + ahead, input),
        }
    }

    /// The next output of the last input.
    pub fn poll(&mut self) -> Option<Output> {
        let ahead = self.clock_ahead();
        let mut output = self.station_mut()?.poll()?;
        if let Output::Event(event) = &mut output
            && ahead != TimeDelta::ZERO
        {
            event.shift_host_times(-ahead);
        }
        Some(output)
    }

    pub const fn first(&self) -> &Station {
        &self.first
    }

    /// All robots, those of each station in the order of their first message; before any is detected, the configured one.
    pub fn robots(&self) -> impl Iterator<Item = &Robot> {
        let has_none = self.detected_robots().next().is_none();
        self.detected_robots().chain(has_none.then(|| self.first.first_robot()))
    }

    /// The robots that were heard.
    pub fn detected_robots(&self) -> impl Iterator<Item = &Robot> {
        self.stations().flat_map(Station::detected_robots)
    }

    /// A line for each vehicle that lacks a sensor.
    pub fn missing_sensors(&self) -> Vec<String> {
        self.stations().flat_map(Station::missing_sensors).collect()
    }

    fn stations(&self) -> impl Iterator<Item = &Station> {
        std::iter::once(&self.first).chain(&self.further)
    }

    fn station_mut(&mut self) -> Option<&mut Station> {
        match self.current.checked_sub(1) {
            None => Some(&mut self.first),
            Some(index) => self.further.get_mut(index),
        }
    }

    fn clock_ahead(&self) -> TimeDelta {
        self.clocks_ahead.get(self.current).copied().unwrap_or_default()
    }
}

/// An input as a station heard it whose clock is `ahead` of the recording's; `None` if it holds no time of the host's clock.
fn by_own_clock(input: &Input, ahead: TimeDelta) -> Option<Input> {
    match input {
        Input::Ownership { robot, ownership: Ownership::Owner { epoch, state: Some(state) } } => {
            let state = RobotSnapshot { bytes: state.bytes.clone(), clock_offset: state.clock_offset - ahead };
            Some(Input::Ownership { robot: *robot, ownership: Ownership::Owner { epoch: *epoch, state: Some(state) } })
        }
        Input::OutsideFix { robot, fix } => {
            Some(Input::OutsideFix { robot: *robot, fix: OutsideFix { time: fix.time + ahead, ..*fix } })
        }
        Input::Ownership { .. }
        | Input::Bytes { .. }
        | Input::Link { .. }
        | Input::PeerAddress { .. }
        | Input::Port { .. }
        | Input::Observation(_)
        | Input::Command(_)
        | Input::RobotCommand { .. }
        | Input::Report { .. }
        | Input::Tick
        | Input::OfStation { .. } => None,
    }
}

/// A station whose recording is no merged one.
impl From<Station> for RecordedStations {
    fn from(first: Station) -> Self {
        Self { first, further: Vec::new(), clocks_ahead: Vec::new(), by_link: BTreeMap::new(), current: 0 }
    }
}
