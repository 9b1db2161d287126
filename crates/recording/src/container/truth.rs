//! The true poses of simulated robots, stored beside the inputs for scores and figures.

use mcap::records::op;
use posebridge_telemetry::{Address, Arena, BrickClock, Heading, LinkId, Meters, Pose, RobotId, Timestamp};
use serde::Deserialize;

use super::fields;
use super::reader::RecordingReader;
use super::walk::WalkEnd;
use super::{ReadError, TRUTH_TOPIC};

/// A robot's true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Which robot; `None` for the only one that is simulated.
    pub robot: Option<RobotId>,
    /// When, by the brick's clock as if its ticks were infinitely fine and its register never wrapped.
    pub time: Timestamp<BrickClock>,
    /// Where the robot was.
    pub pose: Pose<Arena>,
    /// The pose by the brick's own dead reckoning, begun at the start pose.
    pub odometry: Option<Pose<Arena>>,
}

/// A message on [`TRUTH_TOPIC`].
#[derive(Deserialize)]
struct TruthJson {
    link: Option<u16>,
    system: Option<u8>,
    component: Option<u8>,
    brick_nanos: i64,
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    odometry_x_m: Option<f64>,
    odometry_y_m: Option<f64>,
    odometry_heading_rad: Option<f64>,
}

impl TruthJson {
    fn sample(&self) -> Result<TruthSample, &'static str> {
        let pose = |x_m, y_m, heading_rad| Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad));
        let odometry = (self.odometry_x_m, self.odometry_y_m, self.odometry_heading_rad);
        Ok(TruthSample {
            robot: self.robot()?,
            time: Timestamp::from_nanos(self.brick_nanos),
            pose: pose(self.x_m, self.y_m, self.heading_rad),
            odometry: match odometry {
                (Some(x_m), Some(y_m), Some(heading_rad)) => Some(pose(x_m, y_m, heading_rad)),
                _ => None,
            },
        })
    }

    /// Fails where some of its ids are missing: without them the sample would count for another robot.
    fn robot(&self) -> Result<Option<RobotId>, &'static str> {
        match (self.link, self.system, self.component) {
            (None, None, None) => Ok(None),
            (Some(link), Some(system), Some(component)) => {
                Ok(Some(RobotId { link: LinkId(link), address: Address::new(system, component) }))
            }
            _ => Err("it has some of `link`, `system` and `component`, but only all three say which robot it is of"),
        }
    }
}

/// The truth that a recording holds, in the order of the robots' own times; empty if it holds none, as that of real robots.
///
/// It is written while a run goes on: a recording that was cut off has none or the beginning of it.
///
/// # Errors
/// The bytes are not a recording of ours, or a sample of the truth is damaged or names a robot by halves. Damage elsewhere is not
/// looked at.
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
                let line = serde_json::from_slice::<TruthJson>(message.data).map_err(|error| error.to_string());
                let sample = line.and_then(|line| line.sample().map_err(str::to_owned));
                samples.push(sample.map_err(|what| ReadError::Truth { offset: record.offset as u64, what })?);
            }
            _ => {}
        }
    }
    samples.sort_by_key(|sample| sample.time);
    Ok(samples)
}
