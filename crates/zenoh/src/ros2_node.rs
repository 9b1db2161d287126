//! A node of ROS 2 over Zenoh, as the middleware `rmw_zenoh` would be one: other nodes see it and its topics, and no ROS is installed.

use std::collections::BTreeMap;

use posebridge_fleet::{EndpointKind, RosAttachment, RosEndpoint, RosName, RosNode, RosQos, RosType};
use thiserror::Error;
use zenoh::Session;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;

use crate::connection::{Connection, ConnectionError};

/// Topics of one node at most.
const MAX_TOPICS: usize = 4_096;

/// Why a message is not published, or a topic not subscribed to.
#[derive(Debug, Error)]
pub enum Ros2Error {
    #[error("more than {MAX_TOPICS} topics")]
    TooManyTopics,
    #[error("Zenoh: {0}")]
    Zenoh(String),
}

impl From<zenoh::Error> for Ros2Error {
    fn from(error: zenoh::Error) -> Self {
        Self::Zenoh(error.to_string())
    }
}

/// The node, for as long as this is kept.
pub struct Ros2Node {
    session: Session,
    node: RosNode,
    next_id: u32,
    topics: BTreeMap<RosName, Topic>,
    subscriptions: Vec<(Subscriber<()>, LivelinessToken)>,
    _presence: LivelinessToken,
}

struct Topic {
    publisher: Publisher<'static>,
    id: [u8; 16],
    sequence: i64,
    _token: LivelinessToken,
}

impl Ros2Node {
    /// Opens a session and shows the node. It must not be called from a runtime's thread.
    pub fn open(connection: &Connection, domain: u32, name: &str) -> Result<Self, ConnectionError> {
        let session = connection.open()?;
        let node = RosNode { domain, session: session.zid().to_string(), namespace: None, name: name.to_owned() };
        let presence = session.liveliness().declare_token(node.token()).wait();
        let presence = presence.map_err(|error| ConnectionError::Open(error.to_string()))?;
        Ok(Self { session, node, next_id: 1, topics: BTreeMap::new(), subscriptions: Vec::new(), _presence: presence })
    }

    /// Publishes a message in CDR; `source_nanos` is its time since 1970. The topic is declared with its first message.
    pub fn publish(
        &mut self,
        topic: &RosName,
        message: RosType<'_>,
        data: Vec<u8>,
        source_nanos: i64,
    ) -> Result<(), Ros2Error> {
        if !self.topics.contains_key(topic) {
            let declared = self.declare(topic, message)?;
            self.topics.insert(topic.clone(), declared);
        }
        let Some(known) = self.topics.get_mut(topic) else { return Ok(()) };
        known.sequence += 1;
        let attachment = RosAttachment { sequence: known.sequence, source_nanos, publisher: known.id };
        Ok(known.publisher.put(data).attachment(attachment.encode().to_vec()).wait()?)
    }

    /// Receives the messages of a topic, in CDR; `receive` must not wait.
    pub fn subscribe(
        &mut self,
        topic: &RosName,
        message: RosType<'_>,
        receive: impl Fn(Vec<u8>) + Send + Sync + 'static,
    ) -> Result<(), Ros2Error> {
        let id = self.take_id()?;
        let kind = EndpointKind::Subscription;
        let endpoint = RosEndpoint { node: &self.node, id, kind, topic, message, qos: RosQos::Default };
        let subscriber = self.session.declare_subscriber(endpoint.key());
        let subscriber = subscriber.callback(move |sample| receive(sample.payload().to_bytes().into_owned())).wait()?;
        let token = self.session.liveliness().declare_token(endpoint.token()).wait()?;
        self.subscriptions.push((subscriber, token));
        Ok(())
    }

    fn declare(&mut self, topic: &RosName, message: RosType<'_>) -> Result<Topic, Ros2Error> {
        let id = self.take_id()?;
        let kind = EndpointKind::Publisher;
        let endpoint = RosEndpoint { node: &self.node, id, kind, topic, message, qos: RosQos::Default };
        let publisher = self.session.declare_publisher(endpoint.key()).congestion_control(CongestionControl::Drop);
        let publisher = publisher.wait()?;
        let token = self.session.liveliness().declare_token(endpoint.token()).wait()?;
        // Any 16 bytes that no other publisher has: the session's id with the endpoint's in its last bytes.
        let mut publisher_id = self.session.zid().to_le_bytes();
        publisher_id[12..].copy_from_slice(&id.to_le_bytes());
        Ok(Topic { publisher, id: publisher_id, sequence: 0, _token: token })
    }

    fn take_id(&mut self) -> Result<u32, Ros2Error> {
        if self.topics.len() + self.subscriptions.len() >= MAX_TOPICS {
            return Err(Ros2Error::TooManyTopics);
        }
        let id = self.next_id;
        self.next_id += 1;
        Ok(id)
    }
}
