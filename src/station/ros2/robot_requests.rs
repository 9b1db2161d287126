//! What nodes of ROS 2 ask of the station's robots: `cmd_vel` and `pose_fix`.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};

use posebridge_fleet::{RosName, RosType};
use posebridge_link::HostTimer;
use posebridge_recording::ros2::{REQUEST_TOPICS, RosEncoder, RosRequest, RosRequestType};
use posebridge_telemetry::{Address, Command, HostClock, Input, OutsideFix, RobotId, TimeDelta, Timestamp};
use posebridge_zenoh::Ros2Node;
use tokio::sync::mpsc;

/// As whom the filter knows ROS among its cameras.
const SOURCE: Address = Address::new(255, 191);
/// How far the date of the node's computer may be from this one's: both follow the network's time.
const STAMP_UNCERTAINTY: TimeDelta = TimeDelta::from_millis(5);
/// How old a fix without a stamp may be when it comes.
const ARRIVAL_UNCERTAINTY: TimeDelta = TimeDelta::from_millis(50);

/// The subscriptions for all robots so far.
pub(super) struct RobotRequests {
    requests: mpsc::Sender<Input>,
    timer: HostTimer,
    subscribed: BTreeSet<RobotId>,
}

impl RobotRequests {
    pub(super) const fn new(requests: mpsc::Sender<Input>, timer: HostTimer) -> Self {
        Self { requests, timer, subscribed: BTreeSet::new() }
    }

    /// UTC of the host clock's zero.
    pub(super) const fn zero_nanos(&self) -> u64 {
        self.timer.utc_start() * 1_000
    }

    /// Subscribes to the topics of robots that were not known before.
    pub(super) fn subscribe_to_new(&mut self, node: &mut Ros2Node, encoder: &RosEncoder) {
        for (robot, namespace) in encoder.namespaces() {
            if !self.subscribed.insert(robot) {
                continue;
            }
            for (topic, request) in REQUEST_TOPICS {
                let name = if namespace.is_empty() { format!("/{topic}") } else { format!("/{namespace}/{topic}") };
                let subscribed = RosName::new(&name).map_err(|error| error.to_string()).and_then(|name| {
                    let message = request.message_type();
                    let message = RosType { name: message.name, hash: message.hash };
                    let receive = self.receiver(robot, request, name.as_str().to_owned());
                    node.subscribe(&name, message, receive).map_err(|error| error.to_string())
                });
                if let Err(error) = subscribed {
                    tracing::warn!("nothing is received on `{name}`: {error}");
                }
            }
        }
    }

    /// Decodes the messages of a topic.
    fn receiver(
        &self,
        robot: RobotId,
        request: RosRequestType,
        topic: String,
    ) -> impl Fn(Vec<u8>) + Send + Sync + 'static {
        let (requests, timer) = (self.requests.clone(), self.timer);
        let has_failed = AtomicBool::new(false);
        move |message| match request.decode(&message) {
            // A queue that is full holds newer speeds than this one.
            Ok(request) => drop(requests.try_send(to_input(robot, request, timer))),
            Err(error) => {
                if !has_failed.swap(true, Ordering::Relaxed) {
                    tracing::warn!("a message on `{topic}` is not used, and neither are others like it: {error}");
                }
            }
        }
    }
}

fn to_input(robot: RobotId, request: RosRequest, timer: HostTimer) -> Input {
    match request {
        RosRequest::Drive { forward, turn } => Input::RobotCommand { robot, command: Command::Drive { forward, turn } },
        RosRequest::Fix { unix_nanos, fix } => {
            let zero_nanos = i64::try_from(timer.utc_start() * 1_000).unwrap_or(i64::MAX);
            let (time, uncertainty) = time_of_fix(unix_nanos, zero_nanos, timer.now());
            Input::OutsideFix { robot, fix: OutsideFix { source: SOURCE, time, uncertainty, fix } }
        }
    }
}

/// The host's time of a stamp since 1970, and how far it may be off. One without a stamp, or from the future, is of now.
fn time_of_fix(unix_nanos: i64, zero_nanos: i64, now: Timestamp<HostClock>) -> (Timestamp<HostClock>, TimeDelta) {
    let stamped = Timestamp::from_nanos(unix_nanos.saturating_sub(zero_nanos));
    if unix_nanos == 0 || stamped > now { (now, ARRIVAL_UNCERTAINTY) } else { (stamped, STAMP_UNCERTAINTY) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fix_without_a_stamp_or_from_the_future_is_of_now() {
        let now = Timestamp::from_millis(10_000);
        let zero_nanos = 1_700_000_000_000_000_000;
        let time_of = |unix_nanos| time_of_fix(unix_nanos, zero_nanos, now);
        assert_eq!(time_of(zero_nanos + 9_000_000_000), (Timestamp::from_millis(9_000), STAMP_UNCERTAINTY));
        assert_eq!(time_of(0), (now, ARRIVAL_UNCERTAINTY));
        assert_eq!(time_of(zero_nanos + 11_000_000_000), (now, ARRIVAL_UNCERTAINTY));
    }
}
