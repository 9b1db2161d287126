//! The trails of a recording, as the dashboard shows them: the same engine and the same views as live.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_dashboard::model::Frame;
use posebridge_dashboard::{Gatherer, TruthSample};
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{self, Reader};
use posebridge_telemetry::{BrickClock, Event, HostClock, Output, Stamp};

use crate::import::{self, Beyond, Room};
use crate::own_recording::{Overlay, laid_over};
use crate::signing;
use crate::tasks::dashboard::standing_of;

/// A replay of the page shares memory and cores with a station that steers: more than 256 MiB, some hours of the bundled brick, are replayed
/// by `posebridge replay`, or from a later part on.
const ROOM: Room = Room {
    most_bytes: 256 << 20,
    beyond: Beyond::LeftOut,
};

/// Runs a recording through the engine and gathers what it shows; what is damaged or cut off is left out.
///
/// # Errors
/// The file cannot be read or is no recording of ours.
pub fn of(path: &Path) -> Result<Frame> {
    let name = path.display();
    let (bytes, _notes) = import::own_recording_bytes(path, ROOM)?;
    let mut reader = Reader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
    let config = laid_over(&reader.header().config_toml, Overlay::default())?;
    let mut pipeline_config = config.pipeline()?;
    signing::recall(&config, &[], &mut pipeline_config)?;
    let mut pipeline = Pipeline::new(pipeline_config, Stamp::ZERO)?;
    let links = config.links.iter().map(|link| link.url.clone());
    let mut gatherer = Gatherer::new(links.collect());
    let mut heard = Vec::new();
    for (now, input) in (&mut reader).flatten() {
        pipeline.handle(now, &input);
        while let Some(output) = pipeline.poll() {
            if let Output::Event(event) = output {
                if let Event::Estimated { estimate, .. } = &event {
                    heard.push((estimate.stamp, now));
                }
                gatherer.take(now, &event);
            }
        }
    }
    gatherer.take_standing(&standing_of(&pipeline, None));
    heard.sort_unstable();
    let truth = container::truth(&bytes).with_context(|| format!("the truth in `{name}`"))?;
    for sample in truth {
        if let Some(now) = told_at(&heard, sample.stamp) {
            gatherer.take_truth(&TruthSample {
                now,
                stamp: sample.stamp,
                pose: sample.pose,
                odometry: sample.odometry,
            });
        }
    }
    Ok(gatherer.history())
}

/// When the first estimate of an instant or after it was made: there a truth of that instant stands on the page.
fn told_at(
    heard: &[(Stamp<BrickClock>, Stamp<HostClock>)],
    stamp: Stamp<BrickClock>,
) -> Option<Stamp<HostClock>> {
    let index = heard.partition_point(|(estimated, _)| *estimated < stamp);
    heard.get(index).map(|(_, now)| *now)
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
        assert!(
            refused.contains("not begin with the MCAP magic"),
            "{refused}"
        );
        // One that begins like one is refused for its size.
        std::fs::write(&path, b"\x89MCAP0\r\n").unwrap();
        let file = std::fs::File::options().append(true).open(&path).unwrap();
        file.set_len(ROOM.most_bytes + 1).unwrap();
        let refused = format!("{:#}", of(&path).unwrap_err());
        assert!(refused.contains("holds more than 256 MiB"), "{refused}");
    }
}
