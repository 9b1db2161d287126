//! In place of `fleet/` in a build without the feature `fleet`.
#![expect(clippy::unused_async, clippy::needless_pass_by_value, reason = "as with the feature")]

use anyhow::{Result, ensure};
use posebridge_dashboard::{FleetSource, OperatorTokens};
use posebridge_link::HostTimer;
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, Input, OutsideFix, Timestamp};

use crate::config::Config;

/// There is none.
pub enum Fleet {}

/// There is none.
pub enum FleetEvent {}

impl Fleet {
    /// Fails if the configuration names a fleet.
    pub fn start(config: &Config, _timer: HostTimer) -> Result<Option<Self>> {
        let is_alone = config.fleet.checked(&config.robots)?.is_none();
        ensure!(
            is_alone,
            "this program was built without fleets: build it with `cargo build --release --features fleet`"
        );
        Ok(None)
    }

    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        match *self {}
    }

    pub fn advance(&mut self) {
        match *self {}
    }

    pub async fn next_event(&mut self) -> FleetEvent {
        match *self {}
    }

    pub fn handle(&mut self, event: FleetEvent) {
        match event {}
    }

    pub fn may_send(&self) -> bool {
        match *self {}
    }

    pub fn observe(&mut self, _station: &Station, _now: Timestamp<HostClock>, _input: &Input, _events: &[Event]) {
        match *self {}
    }

    pub fn share_fix(&mut self, _tag: u32, _fix: &OutsideFix) {
        match *self {}
    }

    pub fn next_input(&mut self, _station: &Station) -> Option<Input> {
        match *self {}
    }

    pub fn source(&self) -> FleetSource {
        match *self {}
    }

    pub fn set_operator_tokens(&mut self, _tokens: OperatorTokens) {
        match *self {}
    }

    pub fn shut_down(&mut self, _station: &Station) {
        match *self {}
    }
}
