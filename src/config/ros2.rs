//! `[ros2]`: the topics of a running station for ROS 2 (docs/ros2.md).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where a router of ROS 2's middleware listens at first.
const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Topics for ROS 2, over Zenoh.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Ros2Section {
    /// Whether they are published.
    pub enabled: bool,
    /// ROS_DOMAIN_ID of the nodes that see them.
    pub domain: u32,
    /// Where nodes of ROS 2 connect. If a router of ROS 2 listens there already, the station connects to it.
    pub endpoint: String,
    /// A configuration of Zenoh with TLS, users and access control.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zenoh_config: Option<String>,
}

impl Default for Ros2Section {
    fn default() -> Self {
        Self { enabled: false, domain: 0, endpoint: DEFAULT_ENDPOINT.to_owned(), zenoh_config: None }
    }
}
