//! The topics of a running station for ROS 2: what a bag would hold, live, and requests for robots. A thread encodes and sends; the station
//! loop never waits for it.

mod robot_requests;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, Sender};
use posebridge_fleet::{RosName, RosType};
use posebridge_link::HostTimer;
use posebridge_recording::ros2::{RosEncoder, RosMessage};
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, Input, RobotId, Timestamp};
use posebridge_zenoh::{Connection, Ros2Node};
use tokio::sync::mpsc;

use self::robot_requests::RobotRequests;
use crate::config::{Config, Ros2Section};

/// Name of the node.
const NODE: &str = "posebridge";
/// Inputs whose events wait; more are dropped.
const MAX_BATCHES: usize = 8_192;
/// Requests that wait; more are dropped.
const MAX_REQUESTS: usize = 256;

/// The events of one input.
struct EventBatch {
    now: Timestamp<HostClock>,
    events: Arc<[Event]>,
}

/// The station loop's end.
pub struct Ros2Publisher {
    batches: Option<Sender<EventBatch>>,
    /// What nodes ask of robots.
    requests: mpsc::Receiver<Input>,
    dropped: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Ros2Publisher {
    /// Opens the node, if the configuration wants it.
    pub fn start(config: &Config, timer: HostTimer) -> Result<Option<Self>> {
        let section = &config.ros2;
        if !section.enabled {
            return Ok(None);
        }
        let connections = connections(section);
        let domain = section.domain;
        let (batches, waiting) = crossbeam_channel::bounded(MAX_BATCHES);
        let (opened, result) = crossbeam_channel::bounded(1);
        let dropped = Arc::new(AtomicU64::new(0));
        let unsent = Arc::clone(&dropped);
        let (requests, receiver) = mpsc::channel(MAX_REQUESTS);
        let work = move || match open(&connections, domain) {
            Ok(node) => {
                drop(opened.send(Ok(())));
                publish_all(node, RobotRequests::new(requests, timer), &waiting, &unsent);
            }
            Err(error) => drop(opened.send(Err(error))),
        };
        let thread = std::thread::Builder::new().name("ros2".to_owned()).spawn(work).context("starting the thread")?;
        let started = result.recv().map_err(|_ended| anyhow!("the thread for ROS 2 died"))?;
        started.with_context(|| format!("publishing for ROS 2 at `{}`", section.endpoint))?;
        tracing::info!(domain, endpoint = section.endpoint, "publishing for ROS 2");
        Ok(Some(Self { batches: Some(batches), requests: receiver, dropped, thread: Some(thread) }))
    }

    /// Passes the events of an input on; estimates of robots that another station owns are its to publish.
    pub fn publish(&self, station: &Station, now: Timestamp<HostClock>, events: &Arc<[Event]>) {
        let is_foreign = |event: &Event| estimated_robot(event).is_some_and(|robot| is_standby(station, robot));
        let events = if events.iter().any(is_foreign) {
            events.iter().filter(|event| !is_foreign(event)).cloned().collect()
        } else {
            Arc::clone(events)
        };
        if events.is_empty() {
            return;
        }
        if let Some(batches) = &self.batches
            && batches.try_send(EventBatch { now, events }).is_err()
        {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The next request of a node; pending while there is none.
    pub async fn next_request(&mut self) -> Input {
        match self.requests.recv().await {
            Some(request) => request,
            None => std::future::pending().await,
        }
    }

    /// Waits for what is queued.
    pub fn finish(mut self) {
        self.batches = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread for ROS 2 died");
        }
        let dropped = self.dropped.load(Ordering::Relaxed);
        if dropped > 0 {
            tracing::warn!(dropped, "messages for ROS 2 were not sent: the network was too slow");
        }
    }
}

/// First as a router for nodes of ROS 2, else as a participant beside one.
fn connections(section: &Ros2Section) -> [Connection; 2] {
    let endpoint = vec![section.endpoint.clone()];
    let zenoh_config = section.zenoh_config.as_ref().map(Into::into);
    let router = Connection { listen: endpoint.clone(), zenoh_config, ..Connection::default() };
    let participant = Connection { join: endpoint, listen: Vec::new(), ..router.clone() };
    [router, participant]
}

fn open(connections: &[Connection; 2], domain: u32) -> Result<Ros2Node> {
    let [router, participant] = connections;
    Ros2Node::open(router, domain, NODE).or_else(|refused| {
        tracing::info!("the endpoint for ROS 2 is in use, so a router is there: {refused}");
        Ok(Ros2Node::open(participant, domain, NODE)?)
    })
}

fn publish_all(mut node: Ros2Node, mut requests: RobotRequests, batches: &Receiver<EventBatch>, dropped: &AtomicU64) {
    let zero_nanos = requests.zero_nanos();
    let mut encoder = RosEncoder::new(zero_nanos);
    let mut has_failed = false;
    for EventBatch { now, events } in batches {
        let source_nanos = i64::try_from(zero_nanos).unwrap_or(i64::MAX).saturating_add(now.as_nanos());
        for message in events.iter().flat_map(|event| encoder.encode(now, event)) {
            if let Err(error) = publish(&mut node, message, source_nanos) {
                dropped.fetch_add(1, Ordering::Relaxed);
                if !std::mem::replace(&mut has_failed, true) {
                    tracing::warn!("a message for ROS 2 is not published; further ones are counted only: {error:#}");
                }
            }
        }
        requests.subscribe_to_new(&mut node, &encoder);
    }
}

fn publish(node: &mut Ros2Node, message: RosMessage, source_nanos: i64) -> Result<()> {
    let RosMessage { topic, message_type, data } = message;
    let name = RosName::new(&topic).with_context(|| format!("the topic `{topic}`"))?;
    let message_type = RosType { name: message_type.name, hash: message_type.hash };
    Ok(node.publish(&name, message_type, data, source_nanos)?)
}

const fn estimated_robot(event: &Event) -> Option<RobotId> {
    if let Event::EstimateUpdated { robot, .. } = event { Some(*robot) } else { None }
}

fn is_standby(station: &Station, robot: RobotId) -> bool {
    station.robots().iter().any(|known| known.id() == robot && known.ownership().is_standby())
}
