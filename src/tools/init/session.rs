//! A station that reads raw counts, and the guide that gets them: bytes and time in, bytes and events out. Opens and prints nothing.

use anyhow::Result;
use posebridge_estimator::hand_motions::{GuideEvent, GuideSettings, SetupGuide};
use posebridge_station::{Station, StationConfig};
use posebridge_telemetry::severity::NOTICE;
use posebridge_telemetry::{Address, Event, HostClock, Input, Output, Priority, Recipients, RobotId, Timestamp};

/// Texts of the robot or about its bytes that are kept.
const MAX_TEXTS: usize = 20;

pub(super) struct GuideSession {
    station: Station,
    pub(super) guide: SetupGuide,
    /// The robot that is measured: the first that was heard.
    robot: Option<RobotId>,
    /// For the link.
    pub(super) outgoing: Vec<(Recipients, Priority, Vec<u8>)>,
    /// What the robot or its codec said, such as why a line is not understood; new ones only.
    pub(super) texts: Vec<String>,
    texts_seen: Vec<String>,
    /// Of the station, whose own texts are about a pose that nobody asked for.
    own_address: Address,
}

impl GuideSession {
    pub(super) fn new(config: StationConfig, settings: GuideSettings, now: Timestamp<HostClock>) -> Result<Self> {
        Ok(Self {
            own_address: config.own_address,
            station: Station::new(config, now)?,
            guide: SetupGuide::new(settings),
            robot: None,
            outgoing: Vec::new(),
            texts: Vec::new(),
            texts_seen: Vec::new(),
        })
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.station.deadline()
    }

    /// Passes an input to the station; returns what the guide says to its observations.
    pub(super) fn handle(&mut self, now: Timestamp<HostClock>, input: &Input) -> Vec<GuideEvent> {
        let mut events = Vec::new();
        self.station.handle(now, input);
        while let Some(output) = self.station.poll() {
            match output {
                Output::Transmit { to, priority, bytes, .. } => self.outgoing.push((to, priority, bytes)),
                Output::Event(event) => events.extend(self.on_event(&event)),
                Output::Request(_) => {}
            }
        }
        events
    }

    fn on_event(&mut self, event: &Event) -> Option<GuideEvent> {
        if let Event::ObservationAligned { robot, observation, .. } = event {
            if *self.robot.get_or_insert(*robot) == *robot {
                return self.guide.push(observation);
            }
        } else if let Event::Text { source, severity, text } = event
            && *source != self.own_address
            && *severity <= NOTICE
            && self.texts_seen.len() < MAX_TEXTS
            && !self.texts_seen.contains(text)
        {
            self.texts_seen.push(text.clone());
            self.texts.push(text.escape_debug().to_string());
        }
        None
    }
}
