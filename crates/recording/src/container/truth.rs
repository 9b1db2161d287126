//! The true poses of a simulated run, stored beside the inputs for scores and figures.

use mcap::records::op;
use posebridge_telemetry::{Arena, BrickClock, Heading, Meters, Pose, Timestamp};
use serde::Deserialize;

use super::TRUTH_TOPIC;
use super::error::ReadError;
use super::fields;
use super::reader::RecordingReader;
use super::walk::WalkEnd;

/// The robot's true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// When, by the brick's clock as if its ticks were infinitely fine and its register never wrapped.
    pub time: Timestamp<BrickClock>,
    /// Where the robot was.
    pub pose: Pose<Arena>,
    /// Where the brick's own dead reckoning, begun at the start pose, believed it to be.
    pub odometry: Option<Pose<Arena>>,
}

/// A message on [`TRUTH_TOPIC`].
#[derive(Deserialize)]
struct TruthJson {
    brick_nanos: i64,
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    odometry_x_m: Option<f64>,
    odometry_y_m: Option<f64>,
    odometry_heading_rad: Option<f64>,
}

impl TruthJson {
    fn sample(&self) -> TruthSample {
        let pose = |x_m, y_m, heading_rad| Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad));
        let odometry = (self.odometry_x_m, self.odometry_y_m, self.odometry_heading_rad);
        TruthSample {
            time: Timestamp::from_nanos(self.brick_nanos),
            pose: pose(self.x_m, self.y_m, self.heading_rad),
            odometry: match odometry {
                (Some(x_m), Some(y_m), Some(heading_rad)) => Some(pose(x_m, y_m, heading_rad)),
                _ => None,
            },
        }
    }
}

/// The truth that a recording holds, in the order of the brick's time; empty if it holds none, as that of a real robot.
///
/// It is written when a run ends: a recording that was cut off has none or the beginning of it.
///
/// # Errors
/// The bytes are not a recording of ours, or a sample of the truth is damaged. Damage elsewhere is not looked at.
pub fn read_truth(bytes: &[u8]) -> Result<Vec<TruthSample>, ReadError> {
    let mut walk = RecordingReader::open(bytes)?.into_walker();
    let mut channel_id = None;
    let mut samples = Vec::new();
    loop {
        let record = match walk.next() {
            Ok(record) => record,
            Err(WalkEnd::Error(_)) => continue,
            Err(WalkEnd::End(_)) => break,
        };
        match record.opcode {
            op::CHANNEL => {
                let channel = fields::channel(record.body);
                if let Some(channel) = channel.filter(|channel| channel.topic == TRUTH_TOPIC) {
                    channel_id = Some(channel.id);
                }
            }
            op::MESSAGE if channel_id.is_some() => {
                let message = fields::message(record.body);
                let Some(message) = message.filter(|one| Some(one.channel_id) == channel_id) else {
                    continue;
                };
                let line: TruthJson = serde_json::from_slice(message.data).map_err(|error| {
                    let offset = record.offset as u64;
                    let what = error.to_string();
                    ReadError::Truth { offset, what }
                })?;
                samples.push(line.sample());
            }
            _ => {}
        }
    }
    samples.sort_by_key(|sample| sample.time);
    Ok(samples)
}
