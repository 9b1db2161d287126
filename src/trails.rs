//! The trails of a recording, as the dashboard shows them: the same engine and the same views as live.

use std::collections::VecDeque;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_dashboard::model::Frame;
use posebridge_dashboard::{Gatherer, TruthSample};
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{self, Reader};
use posebridge_telemetry::{Address, Event, HostClock, Output, Span, Stamp};

use crate::aligned::Aligned;
use crate::config::Config;
use crate::import::{self, Beyond, Room};
use crate::notes::Notes;
use crate::own_recording::{Overlay, laid_over};
use crate::signing;
use crate::tasks::dashboard::standing_of;

/// What stands is told so often, as live.
const SECOND: Span = Span::from_millis(1_000);
/// MAVLink's warning: what is missing makes the replay another one than the live run.
const WARNING: u8 = 4;
/// A replay of the page shares memory and cores with a station that steers: more than 256 MiB, some hours of the bundled brick, are replayed
/// by `posebridge replay`, or from a later part on.
const ROOM: Room = Room { most_bytes: 256 << 20, beyond: Beyond::LeftOut };

/// Runs a recording through the engine and gathers what it shows. What is missing, damaged or cut off stands first in its log.
///
/// # Errors
/// The file cannot be read or is no recording of ours.
pub fn of(path: &Path) -> Result<Frame> {
    let name = path.display();
    let (bytes, found) = import::own_recording_bytes(path, ROOM)?;
    let mut reader = Reader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
    let config = laid_over(&reader.header().config_toml, Overlay::default())?;
    let truth = container::truth(&bytes).with_context(|| format!("the truth in `{name}`"))?;
    let mut showing = Showing::new(&config, truth.into())?;
    let mut notes = Notes::of(&found);
    notes.add_lack(reader.beginning());
    for item in &mut reader {
        match item {
            Ok((now, input)) => {
                showing.pipeline.handle(now, &input);
                showing.follow(now);
            }
            Err(error) => notes.add_damage(&error),
        }
    }
    notes.add_ending(&reader.ending());
    Ok(showing.history(notes, station_of(&config)))
}

/// As who the station says something.
const fn station_of(config: &Config) -> Address {
    Address::new(config.station.system, config.station.component)
}

/// A recording on its way through the engine.
struct Showing {
    pipeline: Pipeline,
    gatherer: Gatherer,
    truth: VecDeque<container::TruthSample>,
    /// As the last exchange of times with the brick had it.
    exchanged: Option<Aligned>,
    /// As the last estimate came, for a brick that never answers a question for its time.
    heard: Option<Aligned>,
    /// When the first input was given.
    begun: Option<Stamp<HostClock>>,
    next_second: Stamp<HostClock>,
}

impl Showing {
    fn new(config: &Config, truth: VecDeque<container::TruthSample>) -> Result<Self> {
        let mut pipeline_config = config.pipeline()?;
        signing::recall(config, &[], &mut pipeline_config)?;
        let links = config.links.iter().map(|link| link.url.clone());
        Ok(Self {
            pipeline: Pipeline::new(pipeline_config, Stamp::ZERO)?,
            gatherer: Gatherer::new(links.collect()),
            truth,
            exchanged: None,
            heard: None,
            begun: None,
            next_second: Stamp::ZERO,
        })
    }

    /// Shows what an input has led to, and the truth up to it.
    fn follow(&mut self, now: Stamp<HostClock>) {
        self.begun.get_or_insert(now);
        while let Some(output) = self.pipeline.poll() {
            if let Output::Event(event) = output {
                self.align(now, &event);
                self.show_truth(now);
                self.gatherer.take(now, &event);
            }
        }
        if now >= self.next_second {
            self.next_second = now + SECOND;
            self.show_standing();
        }
    }

    fn align(&mut self, now: Stamp<HostClock>, event: &Event) {
        self.exchanged = Aligned::of(event).or(self.exchanged);
        if let Event::Estimated { estimate, .. } = event {
            self.heard = Some(Aligned { host: now, brick: estimate.stamp, skew_ppm: 0.0 });
        }
    }

    /// Shows the truth as live: each sample at its own instant, by the alignment that was in force.
    fn show_truth(&mut self, until: Stamp<HostClock>) {
        let Some(aligned) = self.exchanged.or(self.heard) else {
            return;
        };
        while let Some(sample) = self.truth.front() {
            let now = aligned.host_at(sample.stamp);
            if now > until {
                return;
            }
            self.gatherer.take_truth(&TruthSample {
                now: now.max(Stamp::ZERO),
                stamp: sample.stamp,
                pose: sample.pose,
                odometry: sample.odometry,
            });
            self.truth.pop_front();
        }
    }

    fn show_standing(&mut self) {
        self.gatherer.take_standing(&standing_of(&self.pipeline, None));
    }

    fn history(mut self, notes: Notes, source: Address) -> Frame {
        self.show_standing();
        let begun = self.begun.unwrap_or(Stamp::ZERO);
        let mut history = self.gatherer.history();
        let mut noted = Gatherer::new(Vec::new());
        for text in notes.finish() {
            let said = Event::Text { source, severity: WARNING, text };
            noted.take(begun, &said);
        }
        history.log.splice(0..0, noted.history().log);
        history
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_recording_is_not_read_to_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.mcap");
        // A hole: it takes no room on the disk, but would in memory.
        let file = std::fs::File::create(&path).unwrap();
        file.set_len(ROOM.most_bytes + 1).unwrap();
        let refused = format!("{:#}", of(&path).unwrap_err());
        assert!(refused.contains("not begin with the MCAP magic"), "{refused}");
        // One that begins like one is refused for its size.
        std::fs::write(&path, b"\x89MCAP0\r\n").unwrap();
        let file = std::fs::File::options().append(true).open(&path).unwrap();
        file.set_len(ROOM.most_bytes + 1).unwrap();
        let refused = format!("{:#}", of(&path).unwrap_err());
        assert!(refused.contains("holds more than 256 MiB"), "{refused}");
    }
}
