//! The recording: whether, where, and how large its files become.

use posebridge_telemetry::TimeDelta;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The recording.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct RecordSection {
    /// Whether to record.
    pub enabled: bool,
    /// The folder that holds one folder per run.
    pub directory: String,
    /// The recording goes on in a new file when the old one is so large, in MB of a million bytes; 0: never.
    pub part_max_mb: u32,
    /// The recording goes on in a new file when the old one is so old; 0: never.
    pub part_max_minutes: u32,
    /// The recording ends when the disk has less room than this, in MB of a million bytes.
    pub min_free_mb: u32,
    /// Estimates beside the inputs, for viewers, lie at least so far apart; 0: all of them. A replay is exact whatever stands here.
    pub outputs_interval_ms: u32,
    /// Whether to write a telemetry log (.tlog) beside the recording.
    pub tlog: bool,
}

impl Default for RecordSection {
    fn default() -> Self {
        Self {
            enabled: true,
            directory: "posebridge-runs".to_owned(),
            part_max_mb: 1_000,
            part_max_minutes: 5,
            min_free_mb: 200,
            outputs_interval_ms: 100,
            tlog: false,
        }
    }
}

impl RecordSection {
    /// As the recorder takes them.
    pub fn limits(&self) -> RecordingLimits {
        const MEGABYTE: u64 = 1_000_000;
        let limit = |number: u32| (number != 0).then_some(number);
        RecordingLimits {
            part_bytes: limit(self.part_max_mb).map(|mb| u64::from(mb) * MEGABYTE),
            part_duration: limit(self.part_max_minutes)
                .map(|minutes| TimeDelta::from_millis(i64::from(minutes) * 60_000)),
            min_free_bytes: u64::from(self.min_free_mb) * MEGABYTE,
            output_interval: TimeDelta::from_millis(i64::from(self.outputs_interval_ms)),
        }
    }
}

/// When a recording goes on in a new file, when it ends, and what stands beside the inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordingLimits {
    /// A part ends when it is so large, in bytes.
    pub part_bytes: Option<u64>,
    /// A part ends when it is so old.
    pub part_duration: Option<TimeDelta>,
    /// The recording ends when the disk has less room than this, in bytes.
    pub min_free_bytes: u64,
    /// Estimates beside the inputs lie at least so far apart.
    pub output_interval: TimeDelta,
}

impl Default for RecordingLimits {
    /// Those of the configuration's default.
    fn default() -> Self {
        RecordSection::default().limits()
    }
}
