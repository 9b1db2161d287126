//! ROS 2 over Zenoh, as the middleware `rmw_zenoh` speaks it: the keys under which a node and its topics are found, and what goes with each
//! message.
//!
//! ```text
//! messages       {domain}/{topic}/{type}/{hash}
//! node           @ros2_lv/{domain}/{session}/{node}/{node}/NN/%/{namespace}/{name}
//! its topics     @ros2_lv/{domain}/{session}/{node}/{entity}/{MP|MS}/%/{namespace}/{name}/{topic}/{type}/{hash}/{qos}
//! ```
//! Those below `@ros2_lv` are liveliness tokens: MP is a publisher, MS a subscription. Slashes of names become `%` in them.
//!
//! Source: rmw_zenoh, `docs/design.md`; compared with zenoh-ros2-sdk 0.1.8.

use thiserror::Error;

/// First chunk of all tokens.
const TOKENS: &str = "@ros2_lv";
/// Of the security that is not used.
const NO_ENCLAVE: &str = "%";
/// A session has one node of ours, whose number is its own id.
const NODE_ID: u32 = 0;
/// Most bytes of a name.
const MAX_NAME: usize = 255;

/// Why a text is no name of a topic or namespace.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum RosNameError {
    #[error("a name of ROS begins with `/`")]
    Relative,
    #[error("a name of ROS has no empty part, and none that begins with a digit")]
    Part,
    #[error("a name of ROS has {0:?}; letters and digits of ASCII and single `_` are allowed")]
    Character(char),
    #[error("a name of ROS is longer than {MAX_NAME} bytes")]
    TooLong,
}

/// The full name of a topic, such as `/robot1/odom`, or a namespace.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RosName(String);

impl RosName {
    pub fn new(text: &str) -> Result<Self, RosNameError> {
        let parts = text.strip_prefix('/').ok_or(RosNameError::Relative)?;
        if text.len() > MAX_NAME {
            return Err(RosNameError::TooLong);
        }
        let is_allowed = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '_' | '/');
        if let Some(other) = text.chars().find(|letter| !is_allowed(*letter)) {
            return Err(RosNameError::Character(other));
        }
        if text.contains("__") {
            return Err(RosNameError::Character('_'));
        }
        let is_part = |part: &str| part.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_');
        if parts.split('/').all(is_part) { Ok(Self(text.to_owned())) } else { Err(RosNameError::Part) }
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn in_token(&self) -> String {
        self.0.replace('/', "%")
    }
}

/// A type of messages, as ROS names it, with the hash of its definition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RosType<'a> {
    /// `package/msg/Type`.
    pub name: &'a str,
    /// `RIHS01_` and 64 digits (REP 2016).
    pub hash: &'a str,
}

impl RosType<'_> {
    /// As DDS names it: `package::msg::dds_::Type_`.
    fn dds_name(&self) -> String {
        match self.name.rsplit_once('/') {
            Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
            None => format!("dds_::{}_", self.name),
        }
    }
}

/// Whether a node sends or receives the messages of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndpointKind {
    Publisher,
    Subscription,
}

/// What a publisher offers or a subscription asks for; all keep the last messages and have no deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RosQos {
    /// Reliable, volatile, the last 10: what ROS uses unless it is told otherwise.
    Default,
    /// Best effort, volatile, the last 5: for sensors and commands that the next one replaces.
    SensorData,
    /// Reliable, the last one also for those that come later: for what is said once.
    Latched,
}

impl RosQos {
    /// Reliability, durability, history, deadline, lifespan, liveliness; what is the default is left out.
    const fn in_token(self) -> &'static str {
        match self {
            Self::Default => "::,10:,:,:,,",
            Self::SensorData => "2::,5:,:,:,,",
            Self::Latched => ":1:,1:,:,:,,",
        }
    }
}

/// A node of ROS, one for each Zenoh session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosNode {
    /// ROS_DOMAIN_ID.
    pub domain: u32,
    /// The id of the Zenoh session, in hexadecimal.
    pub session: String,
    /// `None` is the root.
    pub namespace: Option<RosName>,
    pub name: String,
}

impl RosNode {
    /// The token that shows the node to others.
    pub fn token(&self) -> String {
        let Self { domain, session, name, .. } = self;
        format!("{TOKENS}/{domain}/{session}/{NODE_ID}/{NODE_ID}/NN/{NO_ENCLAVE}/{}/{name}", self.namespace())
    }

    fn namespace(&self) -> String {
        self.namespace.as_ref().map_or_else(|| "%".to_owned(), RosName::in_token)
    }
}

/// A topic as a node sends or receives it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosEndpoint<'a> {
    pub node: &'a RosNode,
    /// Above 0, another one for each endpoint of the node.
    pub id: u32,
    pub kind: EndpointKind,
    pub topic: &'a RosName,
    pub message: RosType<'a>,
    pub qos: RosQos,
}

impl RosEndpoint<'_> {
    /// The token that shows the endpoint to others.
    pub fn token(&self) -> String {
        let RosNode { domain, session, name, .. } = self.node;
        let kind = match self.kind {
            EndpointKind::Publisher => "MP",
            EndpointKind::Subscription => "MS",
        };
        let (id, namespace, topic) = (self.id, self.node.namespace(), self.topic.in_token());
        let (message, hash, qos) = (self.message.dds_name(), self.message.hash, self.qos.in_token());
        format!(
            "{TOKENS}/{domain}/{session}/{NODE_ID}/{id}/{kind}/{NO_ENCLAVE}/{namespace}/{name}/{topic}/{message}/{hash}/{qos}"
        )
    }

    /// The key of its messages.
    pub fn key(&self) -> String {
        let topic = self.topic.as_str().trim_start_matches('/');
        format!("{}/{topic}/{}/{}", self.node.domain, self.message.dds_name(), self.message.hash)
    }
}

/// What goes with each message, beside its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RosAttachment {
    /// Counts the messages of a publisher.
    pub sequence: i64,
    /// When it was published, since 1970.
    pub source_nanos: i64,
    /// Of the publisher, another one for each.
    pub publisher: [u8; Self::ID_LEN],
}

impl RosAttachment {
    const ID_LEN: usize = 16;
    /// Little-endian: sequence, time, length of the publisher's id, the id.
    pub const LEN: usize = 8 + 8 + 1 + Self::ID_LEN;

    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut bytes = [0; Self::LEN];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.source_nanos.to_le_bytes());
        bytes[16] = Self::ID_LEN as u8;
        bytes[17..].copy_from_slice(&self.publisher);
        bytes
    }

    /// `None` if the bytes are no attachment.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; Self::LEN] = bytes.try_into().ok()?;
        let (sequence, rest) = bytes.split_first_chunk()?;
        let (source_nanos, rest) = rest.split_first_chunk()?;
        let (len, publisher) = rest.split_first()?;
        (usize::from(*len) == Self::ID_LEN).then_some(())?;
        Some(Self {
            sequence: i64::from_le_bytes(*sequence),
            source_nanos: i64::from_le_bytes(*source_nanos),
            publisher: publisher.try_into().ok()?,
        })
    }
}
