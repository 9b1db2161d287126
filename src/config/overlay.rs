//! What is laid over the configuration of a recording.

use std::path::Path;

use anyhow::Result;

use super::load::{apply_overrides, load_text};
use super::profile::RobotProfile;
use super::setting::Setting;
use super::station::Config;

/// What is laid over the configuration that a recording was made with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Overlay<'a> {
    /// Another robot.
    pub robot: Option<&'a Path>,
    /// Single keys; they go over the robot, too.
    pub settings: &'a [Setting],
}

/// The recording's configuration with another robot, if there is one, and single keys on top.
///
/// # Errors
/// The configuration or what is laid over it makes no sense.
pub fn config_with_overlay(header: &str, overlay: Overlay<'_>) -> Result<Config> {
    let origin = "the recording's own configuration";
    let mut config = load_text(origin, header, &[])?.config;
    if let Some(path) = overlay.robot {
        config = config.with_robot(RobotProfile::read(path)?);
    }
    Ok(apply_overrides(&config, overlay.settings)?)
}
