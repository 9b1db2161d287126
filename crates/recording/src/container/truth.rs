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
    /// `None` for the only simulated robot.
    pub robot: Option<RobotId>,
    /// Brick time, without rounding or register wraps.
    pub time: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
    /// The brick's dead reckoning from the start pose.
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

    /// Fails if an id is missing: the sample would be assigned to another robot.
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

/// The ground truth in a recording, sorted by each robot's own time; empty if there is none, as for real robots.
///
/// It is written during the run: a truncated recording contains none or only the beginning.
///
/// # Errors
/// The bytes are not a posebridge recording, or a truth sample is damaged or has an incomplete robot id. Damage elsewhere is ignored.
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
