//! `[camera]`: tags, cameras that send JSON, and requests for fixes.

use anyhow::{Context, Result, ensure};
use posebridge_protocol::bricks::camera_json::{CameraJsonSettings, FloorCamera};
use posebridge_station::FixRequestConfig;
use posebridge_telemetry::TimeDelta;
use posebridge_vision::FLOOR_TAGS;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bricks::FixSection;
use super::camera_file::CameraFile;

/// The camera.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// Where the tag sits, forward of mid-axle.
    pub tag_x_m: f64,
    /// Where the tag sits, left of mid-axle.
    pub tag_y_m: f64,
    /// Side of the black rim of the robots' tags, for cameras whose pictures are searched for them (docs/camera.md).
    pub tag_side_m: f64,
    /// Height of the robots' tags above the floor.
    pub tag_height_m: f64,
    /// Number of the first of four tags that lie on the floor and are no robots.
    pub floor_tags_from: u16,
    /// Ask cameras that answer for a fix when the position's standard deviation is above this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ask_above_m: Option<f64>,
    /// Ask them when the heading's standard deviation is above this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ask_above_deg: Option<f64>,
    /// Not sooner after the last request.
    pub ask_interval_ms: u32,
    /// Settings for cameras that send JSON.
    pub json: FixSection,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            tag_x_m: 0.0,
            tag_y_m: 0.0,
            tag_side_m: 0.08,
            tag_height_m: 0.0,
            floor_tags_from: 580,
            ask_above_m: None,
            ask_above_deg: None,
            ask_interval_ms: 250,
            json: FixSection::default(),
        }
    }
}

impl CameraConfig {
    /// Settings of a link to a camera; `camera` is where it stands.
    pub(super) fn json_settings(&self, camera: Option<&CameraFile>) -> Result<CameraJsonSettings> {
        for (key, value, range) in
            [("tag_side_m", self.tag_side_m, 0.005..=2.0), ("tag_height_m", self.tag_height_m, 0.0..=5.0)]
        {
            ensure!(range.contains(&value), "`camera.{key}` is {value}, must lie between {range:?}");
        }
        let Some(camera) = camera else {
            return self.json.settings().context("`[camera.json]`");
        };
        let json = FixSection {
            delay_ms: camera.delay_ms.unwrap_or(self.json.delay_ms),
            delay_spread_ms: camera.delay_spread_ms.unwrap_or(self.json.delay_spread_ms),
            ..self.json
        };
        let floor = FloorCamera {
            view: camera.view()?,
            picture_px: [camera.width, camera.height],
            tag_side_m: self.tag_side_m,
            tag_height_m: self.tag_height_m,
            floor_tags: (u32::from(self.floor_tags_from), u32::from(FLOOR_TAGS)),
        };
        Ok(CameraJsonSettings { floor: Some(floor), ..json.settings().context("the camera's file")? })
    }

    pub(super) fn fix_requests(&self) -> Result<FixRequestConfig> {
        for (key, limit) in [("ask_above_m", self.ask_above_m), ("ask_above_deg", self.ask_above_deg)] {
            ensure!(
                limit.is_none_or(|limit| limit.is_finite() && limit > 0.0),
                "`camera.{key}` is {}, must be more than zero; leave it out to request no fixes",
                limit.unwrap_or_default()
            );
        }
        ensure!(self.ask_interval_ms >= 10, "`camera.ask_interval_ms` must be at least 10");
        Ok(FixRequestConfig {
            above_m: self.ask_above_m,
            above_rad: self.ask_above_deg.map(f64::to_radians),
            interval: TimeDelta::from_millis(i64::from(self.ask_interval_ms)),
        })
    }
}
