//! What stands at the other end of a link: a participant of MAVLink, or a brick with a protocol of its own.
//!
//! The link says which protocol it is, the robot's file what is plugged in where.

mod ev3;
mod fixes;
mod line;
mod nxt;

use anyhow::{Context, Result, bail, ensure};
use posebridge_protocol::bricks::camera_json::CameraJsonSettings;
use posebridge_protocol::bricks::{BRICK_PROTOCOLS, CodecSettings, brick_protocol};
use posebridge_station::BrickLink;

use super::link::{LinkSection, framing_of};
use super::robot::RobotFile;

pub use ev3::{Ev3Distance, Ev3Section};
pub use fixes::FixSection;
pub use line::LineSection;
pub use nxt::{NxtSection, NxtSensorKind, NxtSensorSection, Place};

/// The protocol whose participants need no codec of their own.
const MAVLINK: &str = "mavlink";

/// The settings of a link's codec; `None` for MAVLink.
///
/// # Errors
/// There is no such protocol, or the link has keys that only MAVLink has.
pub(super) fn brick_link(link: &LinkSection, robot: &RobotFile, cameras: &FixSection) -> Result<Option<BrickLink>> {
    let Some(name) = &link.brick else {
        return Ok(None);
    };
    let Some(protocol) = brick_protocol(name) else {
        let known: Vec<&str> = BRICK_PROTOCOLS.iter().map(|row| row.name).collect();
        bail!("`brick` is `{name}`; there are: {}", known.join(", "));
    };
    if protocol.name == MAVLINK {
        return Ok(None);
    }
    for (key, is_set) in [
        ("signing", link.signing.is_some()),
        ("ground_station", link.ground_station),
        ("accept_mavlink1", link.accept_mavlink1),
        ("send_mavlink1", link.send_mavlink1),
        ("group", link.group.is_some()),
    ] {
        ensure!(!is_set, "`{key}` belongs to MAVLink, and `brick = \"{name}\"` speaks none; take one of them away");
    }
    let settings = CodecSettings {
        fixes: CameraJsonSettings { framing: framing_of(&link.url), ..cameras.settings().context("`[camera.json]`")? },
        ..settings(robot)?
    };
    Ok(Some(BrickLink { protocol, settings }))
}

/// Every codec's part of the robot's file; what is not said there is as usual.
fn settings(robot: &RobotFile) -> Result<CodecSettings> {
    let nxt = robot.nxt.clone().unwrap_or_default();
    let ev3 = robot.ev3.clone().unwrap_or_default();
    let line = robot.line.clone().unwrap_or_default();
    Ok(CodecSettings {
        nxt: nxt.settings().context("`[robot.nxt]`")?,
        ev3: ev3.settings().context("`[robot.ev3]`")?,
        line: line.settings().context("`[robot.line]`")?,
        ..CodecSettings::default()
    })
}
