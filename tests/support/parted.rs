//! A recording in parts, without a robot.
#![allow(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]
#![allow(clippy::allow_attributes, reason = "whether a helper is used depends on the file that includes it")]

use std::path::Path;

use posebridge::config::Config;
use posebridge::config::RecordingLimits;
use posebridge::station::recording_parts::RecordingParts;
use posebridge_recording::container::{FORMAT, RecordingHeader};
use posebridge_telemetry::{Input, TimeDelta, Timestamp};

/// Seven seconds of ticks, four a second, in parts of two seconds: `recording.mcap` and what continues it.
pub(crate) fn record_ticks(folder: &Path) {
    let limits = RecordingLimits { part_duration: Some(TimeDelta::from_millis(2_000)), ..RecordingLimits::default() };
    let header = RecordingHeader {
        format: FORMAT,
        config_toml: toml::to_string(&Config::default()).unwrap(),
        ..RecordingHeader::default()
    };
    let mut parts = RecordingParts::create(&folder.join("recording.mcap"), header, limits, 0).unwrap();
    for number in 0..28_u32 {
        let now = Timestamp::from_millis(250 * i64::from(number));
        parts.record(now, u64::from(number), &Input::Tick).unwrap();
    }
    parts.finish(28).unwrap();
}
