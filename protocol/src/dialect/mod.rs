//! Decodes frames to [`Message`]s in SI units and our coordinate frames, and encodes messages to frames.
//!
//! Rules for every message: integers saturate when a value does not fit, totals and timestamps wrap, a timestamp of another
//! resolution is converted, text is cut at a character boundary, floats keep the width of the wire; values are not validated
//! beyond "is a number".

pub mod bindings;
pub(crate) mod catalogue;
pub mod commands;
pub mod csv_lines;
pub mod definitions;
pub(crate) mod encoder;
pub mod fields;
pub(crate) mod frames;
#[expect(warnings, reason = "generated code, out of our hands; it is checked by golden bytes")]
pub(crate) mod generated;
pub mod ids;
pub mod message_json;
mod payload;
pub mod plan_items;
mod posebridge;
mod poses;
mod sensors;
pub(crate) mod services;
pub(crate) mod vehicle;
mod vehicle_state;

pub use catalogue::{definition, definition_index, is_stock_message, message_name};
pub use definitions::message_id_named;
pub use encoder::{Encoder, RenumberError, is_signed};
pub use ids::{MESSAGES, MessageInfo};
pub use payload::PayloadError;

use crate::framing::FrameRef;
use crate::message::{ImuMessage, Message, MetadataForm, PlanContent, WireStamp};

/// Decodes a verified frame.
///
/// `None` means that the message is not used: an id without a row in [`MESSAGES`], a range finder that looks sideways,
/// a reading that its sender marks as invalid, an integer parameter. Fails if the content of the frame is invalid.
pub fn decode(frame: &FrameRef<'_>) -> Result<Option<Message>, PayloadError> {
    let payload = frame.payload;
    match frame.message_id {
        ids::HEARTBEAT => Ok(Some(services::heartbeat(payload))),
        ids::SYSTEM_TIME => services::system_time(payload),
        ids::PARAM_REQUEST_READ => Ok(Some(services::param_request_read(payload))),
        ids::PARAM_REQUEST_LIST => Ok(Some(services::param_request_list(payload))),
        ids::PARAM_VALUE => Ok(services::param_value(payload)),
        ids::PARAM_SET => Ok(Some(services::param_set(payload))),
        ids::SET_MODE => Ok(Some(services::set_mode(payload))),
        ids::COMMAND_INT => Ok(Some(services::command_int(payload))),
        ids::COMMAND_LONG => Ok(Some(services::command_long(payload))),
        ids::COMMAND_ACK => Ok(Some(services::command_ack(payload))),
        ids::TIMESYNC => services::time_sync(payload),
        ids::STATUSTEXT => Ok(Some(services::status_text(payload))),
        ids::AUTOPILOT_VERSION => Ok(Some(services::autopilot_version(payload))),
        ids::PROTOCOL_VERSION => Ok(Some(services::protocol_version(payload))),
        ids::COMPONENT_INFORMATION_BASIC => Ok(Some(services::component_information(payload))),
        ids::MESSAGE_INTERVAL => Ok(Some(services::message_interval(payload))),
        ids::DEBUG_FLOAT_ARRAY => Ok(Some(services::float_array(payload))),
        ids::MISSION_REQUEST_PARTIAL_LIST
        | ids::MISSION_WRITE_PARTIAL_LIST
        | ids::MISSION_ITEM
        | ids::MISSION_REQUEST
        | ids::MISSION_SET_CURRENT
        | ids::MISSION_CURRENT
        | ids::MISSION_REQUEST_LIST
        | ids::MISSION_COUNT
        | ids::MISSION_CLEAR_ALL
        | ids::MISSION_ITEM_REACHED
        | ids::MISSION_ACK
        | ids::MISSION_REQUEST_INT
        | ids::MISSION_ITEM_INT
        | ids::FILE_TRANSFER_PROTOCOL
        | ids::LOG_REQUEST_LIST
        | ids::LOG_ENTRY
        | ids::LOG_REQUEST_DATA
        | ids::LOG_DATA
        | ids::AVAILABLE_MODES
        | ids::COMPONENT_INFORMATION
        | ids::COMPONENT_METADATA => Ok(decode_vehicle_service(frame.message_id, payload)),
        ids::SCALED_IMU => sensors::scaled_imu(ImuMessage::Scaled, payload),
        ids::SCALED_IMU2 => sensors::scaled_imu(ImuMessage::Scaled2, payload),
        ids::SCALED_IMU3 => sensors::scaled_imu(ImuMessage::Scaled3, payload),
        ids::RAW_IMU => Ok(sensors::raw_imu(payload)),
        ids::RPM => sensors::wheel_speeds(payload),
        ids::GPS_RAW_INT => Ok(poses::gnss_fix(payload)),
        ids::LANDING_TARGET => poses::landing_target(payload),
        ids::SCALED_PRESSURE => sensors::scaled_pressure(payload),
        ids::NAMED_VALUE_FLOAT => sensors::named_value(payload),
        ids::HIGHRES_IMU => sensors::highres_imu(payload),
        ids::DISTANCE_SENSOR => Ok(sensors::distance_sensor(payload)),
        ids::WHEEL_DISTANCE => sensors::wheel_distance(payload),
        ids::ATTITUDE => poses::attitude(payload),
        ids::LOCAL_POSITION_NED => poses::local_position(payload),
        // The same fields; the second one's frame is called global, and is that of the sender's local positions.
        ids::VISION_POSITION_ESTIMATE | ids::GLOBAL_VISION_POSITION_ESTIMATE => {
            poses::vision_position(frame.message_id, payload)
        }
        ids::ATT_POS_MOCAP => poses::mocap_position(payload),
        ids::ESTIMATOR_STATUS => poses::estimator_status(payload),
        ids::ODOMETRY => poses::odometry(payload),
        ids::SYS_STATUS => Ok(Some(vehicle_state::system_status(payload))),
        ids::BATTERY_STATUS => Ok(vehicle_state::battery_status(payload)),
        ids::EXTENDED_SYS_STATE => Ok(vehicle_state::on_ground(payload)),
        ids::GLOBAL_POSITION_INT => Ok(Some(vehicle_state::global_position(payload))),
        ids::HOME_POSITION => Ok(Some(vehicle_state::home_position(payload))),
        ids::GPS_GLOBAL_ORIGIN => Ok(Some(vehicle_state::global_origin(payload))),
        ids::SET_GPS_GLOBAL_ORIGIN => Ok(Some(vehicle_state::set_global_origin(payload))),
        ids::VFR_HUD => vehicle_state::head_up_display(payload),
        ids::ATTITUDE_QUATERNION => vehicle_state::attitude_quaternion(payload),
        ids::MANUAL_CONTROL => Ok(Some(vehicle_state::manual_control(payload))),
        ids::SET_POSITION_TARGET_LOCAL_NED => vehicle_state::position_target(payload),
        ids::PB_WHEEL_TICKS => posebridge::wheel_ticks(payload),
        ids::PB_INERTIAL => posebridge::inertial(payload),
        ids::PB_PLANAR_POSE => posebridge::planar_pose(payload),
        ids::PB_FUSION_HEALTH => posebridge::fusion_health(payload),
        ids::PB_ROBOT_DESCRIPTION => posebridge::robot_description(payload),
        _ => Ok(None),
    }
}

fn decode_vehicle_service(message_id: u32, payload: &[u8]) -> Option<Message> {
    Some(match message_id {
        ids::MISSION_REQUEST_PARTIAL_LIST => {
            vehicle::plan_with_range(payload, |first, last| PlanContent::RequestPartialList { first, last })
        }
        ids::MISSION_WRITE_PARTIAL_LIST => {
            vehicle::plan_with_range(payload, |first, last| PlanContent::WritePartialList { first, last })
        }
        ids::MISSION_REQUEST => vehicle::plan_with_number(payload, |sequence| PlanContent::Request { sequence }),
        ids::MISSION_REQUEST_INT => vehicle::plan_with_number(payload, |sequence| PlanContent::RequestInt { sequence }),
        ids::MISSION_COUNT => vehicle::plan_with_number(payload, |items| PlanContent::Count { items }),
        ids::MISSION_REQUEST_LIST => vehicle::plan_of_target(payload, PlanContent::RequestList),
        ids::MISSION_CLEAR_ALL => vehicle::plan_of_target(payload, PlanContent::ClearAll),
        ids::MISSION_SET_CURRENT => vehicle::mission_set_current(payload),
        ids::MISSION_CURRENT => vehicle::mission_current(payload),
        ids::MISSION_ACK => vehicle::mission_ack(payload),
        ids::MISSION_ITEM => vehicle::mission_item(payload),
        ids::MISSION_ITEM_INT => vehicle::mission_item_int(payload),
        ids::MISSION_ITEM_REACHED => vehicle::mission_item_reached(payload),
        ids::FILE_TRANSFER_PROTOCOL => vehicle::file_transfer(payload),
        ids::LOG_REQUEST_LIST => vehicle::log_request_list(payload),
        ids::LOG_ENTRY => vehicle::log_entry(payload),
        ids::LOG_REQUEST_DATA => vehicle::log_request_data(payload),
        ids::LOG_DATA => vehicle::log_data(payload),
        ids::AVAILABLE_MODES => vehicle::available_mode(payload),
        ids::COMPONENT_INFORMATION => vehicle::component_metadata(payload, MetadataForm::Deprecated),
        ids::COMPONENT_METADATA => vehicle::component_metadata(payload, MetadataForm::Current),
        _ => return None,
    })
}

/// The timestamp in a verified frame, on its sender's clock; `None` if it has none or it is invalid.
pub fn timestamp_of(frame: &FrameRef<'_>) -> Option<WireStamp> {
    match frame.message_id {
        // The commonest without one need not be decoded for it.
        ids::HEARTBEAT | ids::TIMESYNC | ids::COMMAND_INT | ids::COMMAND_LONG | ids::COMMAND_ACK | ids::STATUSTEXT => {
            None
        }
        // The most frequent messages need neither.
        ids::PB_WHEEL_TICKS => Some(posebridge::ticks_of(frame.payload).ok().flatten()?.stamp),
        ids::PB_INERTIAL => Some(posebridge::inertial_of(frame.payload).ok()?.stamp),
        _ => decode(frame).ok().flatten()?.stamp(),
    }
}
