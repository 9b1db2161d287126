//! In place of `cameras.rs` in a build without the feature `camera`: no link leads to a camera.
#![expect(clippy::unused_self, clippy::unnecessary_wraps, reason = "as with the feature")]

use std::path::Path;

use anyhow::Result;
use posebridge_dashboard::CameraSource;
use posebridge_link::{HostTimer, Link, LinkOpenConfig};
use posebridge_sim::Scenario;

use crate::config::Config;

pub(super) struct Cameras;

impl Cameras {
    pub(super) const fn new(_config: &Config, _kept: Option<&Path>) -> Result<Self> {
        Ok(Self)
    }

    pub(super) const fn has_simulated(&self) -> bool {
        false
    }

    pub(super) const fn watched(&self, scenario: Scenario) -> Scenario {
        scenario
    }

    pub(super) const fn link(&self, open: LinkOpenConfig, _timer: HostTimer) -> Result<Link, LinkOpenConfig> {
        Err(open)
    }

    pub(super) const fn sources(&self) -> Vec<CameraSource> {
        Vec::new()
    }
}
