//! In place of `ros2/` in a build without the feature `fleet`.
#![expect(clippy::unused_async, reason = "as with the feature")]

use std::sync::Arc;

use anyhow::{Result, ensure};
use posebridge_link::HostTimer;
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, Input, Timestamp};

use crate::config::Config;

/// There is none.
pub enum Ros2Publisher {}

impl Ros2Publisher {
    /// Fails if the configuration wants topics for ROS 2.
    pub fn start(config: &Config, _timer: HostTimer) -> Result<Option<Self>> {
        ensure!(
            !config.ros2.enabled,
            "this program was built without ROS 2: build it with `cargo build --release --features fleet`; a bag of a run needs no feature \
             (`posebridge run --mcap ros2`)"
        );
        Ok(None)
    }

    pub fn publish(&self, _station: &Station, _now: Timestamp<HostClock>, _events: &Arc<[Event]>) {
        match *self {}
    }

    pub async fn next_request(&mut self) -> Input {
        match *self {}
    }

    pub fn finish(self) {
        match self {}
    }
}
