//! Requests fixes from cameras when the estimate is too uncertain.
//!
//! # Model
//! ```text
//! request  if  max(sigma_x, sigma_y) > above_m  or  sigma_heading > above_rad  or  the pose is not known
//!          and the last request is at least `interval` old
//! ```
//! The request is MAV_CMD_REQUEST_MESSAGE (512) for VISION_POSITION_ESTIMATE (102), to the camera's own address; the
//! codec of JSON cameras encodes it in its own form. It is sent to senders whose heartbeat has the type camera. One
//! that rejects the command gets no more requests until it is restarted; one that does not react gets none for a while,
//! so that a slow link is not filled.
//!
//! # Sources
//! MAVLink common.xml: MAV_CMD_REQUEST_MESSAGE, MAV_RESULT; minimal.xml: MAV_TYPE_CAMERA. docs/protocols/camera-json.md.

use std::collections::BTreeMap;

use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{CommandAck, CommandLong, Message};
use posebridge_telemetry::{Address, Estimate, HostClock, LinkId, TimeDelta, Timestamp};

use crate::config::FixRequestConfig;

const MAV_TYPE_CAMERA: u8 = 30;
/// MAV_RESULT_ACCEPTED, _TEMPORARILY_REJECTED and _IN_PROGRESS: all others are final rejections.
const NOT_REFUSED: [u8; 3] = [0, 1, 5];
/// Most cameras; later ones get no requests. From the eighth camera on all share the last sensor id
/// ([`SensorId::camera`](posebridge_telemetry::SensorId::camera)).
pub(crate) const MAX_CAMERAS: usize = 64;
/// Consecutive requests without a fix after which a camera gets none for a while.
const MAX_UNANSWERED: u32 = 4;
const PAUSE: TimeDelta = TimeDelta::from_millis(5_000);

/// The cameras to request fixes from, and the instant of the last request.
#[derive(Debug, Default)]
pub(crate) struct FixRequests {
    cameras: BTreeMap<(LinkId, Address), Camera>,
    last_request: Option<Timestamp<HostClock>>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Camera {
    /// It does not support the command.
    has_refused: bool,
    unanswered: u32,
    paused_until: Option<Timestamp<HostClock>>,
}

pub(crate) fn fix_request(target: Address) -> Message {
    let mut params = [0.0; 7];
    params[0] = ids::VISION_POSITION_ESTIMATE as f32;
    Message::Command(CommandLong { target, command: ids::COMMAND_REQUEST_MESSAGE, params })
}

impl FixRequests {
    /// The cameras to send a request now, if the estimate is too uncertain.
    pub(crate) fn due(
        &mut self,
        now: Timestamp<HostClock>,
        config: &FixRequestConfig,
        estimate: Option<&Estimate>,
    ) -> Vec<(LinkId, Address)> {
        let is_early = self.last_request.is_some_and(|last| now - last < config.interval);
        if is_early || !is_fix_needed(config, estimate) {
            return Vec::new();
        }
        let mut requested = Vec::new();
        for (sender, camera) in &mut self.cameras {
            if camera.has_refused || camera.paused_until.is_some_and(|until| now < until) {
                continue;
            }
            camera.unanswered += 1;
            camera.paused_until = None;
            if camera.unanswered >= MAX_UNANSWERED {
                camera.unanswered = 0;
                camera.paused_until = Some(now + PAUSE);
            }
            requested.push(*sender);
        }
        if !requested.is_empty() {
            self.last_request = Some(now);
        }
        requested
    }

    pub(crate) fn observe_message(&mut self, sender: (LinkId, Address), message: &Message) {
        #[expect(clippy::wildcard_enum_match_arm, reason = "no other message says whether a camera answers")]
        match message {
            Message::Heartbeat(heartbeat)
                if heartbeat.vehicle_type == MAV_TYPE_CAMERA && self.cameras.len() < MAX_CAMERAS =>
            {
                self.cameras.entry(sender).or_default();
            }
            Message::CommandAck(CommandAck { command: ids::COMMAND_REQUEST_MESSAGE, result, .. })
                if !NOT_REFUSED.contains(result) =>
            {
                if let Some(camera) = self.cameras.get_mut(&sender) {
                    camera.has_refused = true;
                }
            }
            Message::VisionPosition(_) | Message::MocapPosition(_) | Message::Odometry(_) => {
                if let Some(camera) = self.cameras.get_mut(&sender) {
                    camera.unanswered = 0;
                    camera.paused_until = None;
                }
            }
            _ => {}
        }
    }

    /// A restarted camera may support the request.
    pub(crate) fn reset_camera(&mut self, sender: (LinkId, Address)) {
        if let Some(camera) = self.cameras.get_mut(&sender) {
            *camera = Camera::default();
        }
    }
}

fn is_fix_needed(config: &FixRequestConfig, estimate: Option<&Estimate>) -> bool {
    if config.above_m.is_none() && config.above_rad.is_none() {
        return false;
    }
    let Some(estimate) = estimate else {
        return true;
    };
    let position_sigma_m = estimate.x_sigma_m().max(estimate.y_sigma_m());
    let exceeds =
        |limit: Option<f64>, is_valid: bool, sigma: f64| limit.is_some_and(|limit| !is_valid || sigma > limit);
    let has_position = estimate.validity.position;
    let has_heading = estimate.validity.heading;
    exceeds(config.above_m, has_position, position_sigma_m)
        || exceeds(config.above_rad, has_heading, estimate.heading_sigma_rad())
}

#[cfg(test)]
mod tests {
    use posebridge_protocol::message::Heartbeat;

    use super::*;

    #[test]
    fn only_cameras_by_heartbeat_get_requests_up_to_the_limit() {
        let heartbeat =
            |vehicle_type| Message::Heartbeat(Heartbeat { vehicle_type, autopilot: 8, base_mode: 0, system_status: 4 });
        let sender = |index: usize| (LinkId(0), Address::new(index as u8, 100));
        let mut requests = FixRequests::default();
        requests.observe_message(sender(200), &heartbeat(10));
        for index in 0..=MAX_CAMERAS {
            requests.observe_message(sender(index), &heartbeat(MAV_TYPE_CAMERA));
        }
        let config = FixRequestConfig { above_m: Some(0.1), ..FixRequestConfig::default() };
        let requested = requests.due(Timestamp::ZERO, &config, None);
        assert_eq!(requested, (0..MAX_CAMERAS).map(sender).collect::<Vec<_>>());
    }

    #[test]
    fn a_camera_that_sends_no_fix_rests_for_five_seconds() {
        let config = FixRequestConfig { above_m: Some(0.1), ..FixRequestConfig::default() };
        let camera = (LinkId(0), Address::new(9, 100));
        let heartbeat = Heartbeat { vehicle_type: MAV_TYPE_CAMERA, autopilot: 8, base_mode: 0, system_status: 4 };
        let mut requests = FixRequests::default();
        requests.observe_message(camera, &Message::Heartbeat(heartbeat));
        let times = (0..=5_750).step_by(250);
        let request_times =
            times.filter(|millis| !requests.due(Timestamp::from_millis(*millis), &config, None).is_empty());
        assert_eq!(request_times.collect::<Vec<_>>(), [0, 250, 500, 750, 5_750]);
    }
}
