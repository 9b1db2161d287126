//! The ids and names of the messages that the station decodes.

/// A message that can be decoded and encoded here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageInfo {
    pub id: u32,
    pub name: &'static str,
}

macro_rules! messages {
    ($($name:ident = $id:literal,)*) => {
        $(
            #[doc = concat!("Id of ", stringify!($name), ".")]
            pub const $name: u32 = $id;
        )*

        /// Every message that can be decoded and encoded, by rising id.
        pub const MESSAGES: &[MessageInfo] = &[
            $(MessageInfo { id: $name, name: stringify!($name) },)*
        ];
    };
}

messages! {
    HEARTBEAT = 0,
    SYS_STATUS = 1,
    SYSTEM_TIME = 2,
    SET_MODE = 11,
    PARAM_REQUEST_READ = 20,
    PARAM_REQUEST_LIST = 21,
    PARAM_VALUE = 22,
    PARAM_SET = 23,
    GPS_RAW_INT = 24,
    SCALED_IMU = 26,
    RAW_IMU = 27,
    SCALED_PRESSURE = 29,
    ATTITUDE = 30,
    ATTITUDE_QUATERNION = 31,
    LOCAL_POSITION_NED = 32,
    GLOBAL_POSITION_INT = 33,
    MISSION_REQUEST_PARTIAL_LIST = 37,
    MISSION_WRITE_PARTIAL_LIST = 38,
    MISSION_ITEM = 39,
    MISSION_REQUEST = 40,
    MISSION_SET_CURRENT = 41,
    MISSION_CURRENT = 42,
    MISSION_REQUEST_LIST = 43,
    MISSION_COUNT = 44,
    MISSION_CLEAR_ALL = 45,
    MISSION_ITEM_REACHED = 46,
    MISSION_ACK = 47,
    SET_GPS_GLOBAL_ORIGIN = 48,
    GPS_GLOBAL_ORIGIN = 49,
    MISSION_REQUEST_INT = 51,
    MANUAL_CONTROL = 69,
    MISSION_ITEM_INT = 73,
    VFR_HUD = 74,
    COMMAND_INT = 75,
    COMMAND_LONG = 76,
    COMMAND_ACK = 77,
    SET_POSITION_TARGET_LOCAL_NED = 84,
    GLOBAL_VISION_POSITION_ESTIMATE = 101,
    VISION_POSITION_ESTIMATE = 102,
    HIGHRES_IMU = 105,
    FILE_TRANSFER_PROTOCOL = 110,
    TIMESYNC = 111,
    SCALED_IMU2 = 116,
    LOG_REQUEST_LIST = 117,
    LOG_ENTRY = 118,
    LOG_REQUEST_DATA = 119,
    LOG_DATA = 120,
    SCALED_IMU3 = 129,
    DISTANCE_SENSOR = 132,
    ATT_POS_MOCAP = 138,
    BATTERY_STATUS = 147,
    AUTOPILOT_VERSION = 148,
    LANDING_TARGET = 149,
    RPM = 226,
    ESTIMATOR_STATUS = 230,
    HOME_POSITION = 242,
    MESSAGE_INTERVAL = 244,
    EXTENDED_SYS_STATE = 245,
    NAMED_VALUE_FLOAT = 251,
    STATUSTEXT = 253,
    PROTOCOL_VERSION = 300,
    ODOMETRY = 331,
    DEBUG_FLOAT_ARRAY = 350,
    COMPONENT_INFORMATION = 395,
    COMPONENT_INFORMATION_BASIC = 396,
    COMPONENT_METADATA = 397,
    AVAILABLE_MODES = 435,
    WHEEL_DISTANCE = 9000,
    PB_WHEEL_TICKS = 42100,
    PB_INERTIAL = 42101,
    PB_PLANAR_POSE = 42102,
    PB_FUSION_HEALTH = 42103,
    PB_ROBOT_DESCRIPTION = 42104,
}

/// MAV_CMD_GET_HOME_POSITION, superseded by MAV_CMD_REQUEST_MESSAGE and still sent.
pub const COMMAND_GET_HOME_POSITION: u16 = 410;
/// MAV_CMD_GET_MESSAGE_INTERVAL: parameter 1 is the message.
pub const COMMAND_GET_MESSAGE_INTERVAL: u16 = 510;
/// MAV_CMD_REQUEST_MESSAGE: parameter 1 is the message, parameter 2 distinguishes it from others of its kind.
pub const COMMAND_REQUEST_MESSAGE: u16 = 512;
/// MAV_CMD_REQUEST_PROTOCOL_VERSION, an older form of a request for PROTOCOL_VERSION.
pub const COMMAND_REQUEST_PROTOCOL_VERSION: u16 = 519;
/// MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, an older form of a request for AUTOPILOT_VERSION.
pub const COMMAND_REQUEST_CAPABILITIES: u16 = 520;
/// MAV_CMD_SET_MESSAGE_INTERVAL, the command that [`crate::message::Message::SetMessageInterval`] is.
pub const COMMAND_SET_MESSAGE_INTERVAL: u16 = 511;
/// MAV_CMD_PREFLIGHT_STORAGE; [`super::commands`] defines the meaning of this and the following.
pub const COMMAND_PREFLIGHT_STORAGE: u16 = 245;
pub const COMMAND_LOGGING_START: u16 = 2_510;
pub const COMMAND_LOGGING_STOP: u16 = 2_511;
/// MAV_CMD_USER_1: set the pose.
pub const COMMAND_SET_POSE: u16 = 31_010;
/// MAV_CMD_USER_2: forget the pose.
pub const COMMAND_RESET_POSE: u16 = 31_011;
/// MAV_CMD_USER_3: freeze, learn or forget the calibration.
pub const COMMAND_CALIBRATION: u16 = 31_012;
/// MAV_CMD_USER_4: switch a sensor off or on.
pub const COMMAND_SOURCE: u16 = 31_013;

/// MAV_CMD_NAV_WAYPOINT, in plans; [`super::plan_items`] defines the meaning of this and the following.
pub const COMMAND_WAYPOINT: u16 = 16;
/// MAV_CMD_NAV_RETURN_TO_LAUNCH, in plans and by itself.
pub const COMMAND_RETURN_TO_LAUNCH: u16 = 20;
/// MAV_CMD_NAV_DELAY, in plans.
pub const COMMAND_DELAY: u16 = 93;
pub const COMMAND_SET_MODE: u16 = 176;
pub const COMMAND_REPOSITION: u16 = 192;
pub const COMMAND_PAUSE_CONTINUE: u16 = 193;
pub const COMMAND_SET_MISSION_CURRENT: u16 = 224;
pub const COMMAND_MISSION_START: u16 = 300;

/// Whether a command starts, stops or directs the drive of a vehicle to goals.
pub const fn is_drive_command(command: u16) -> bool {
    matches!(
        command,
        COMMAND_RETURN_TO_LAUNCH
            | COMMAND_SET_MODE
            | COMMAND_REPOSITION
            | COMMAND_PAUSE_CONTINUE
            | COMMAND_SET_MISSION_CURRENT
            | COMMAND_MISSION_START
    )
}

/// Whether a command asks a component what it is: its version, its modes, its files about itself. `about` is the message that the command
/// names.
pub const fn is_description(command: u16, about: Option<u32>) -> bool {
    match (command, about) {
        (COMMAND_REQUEST_PROTOCOL_VERSION | COMMAND_REQUEST_CAPABILITIES, _) => true,
        (COMMAND_REQUEST_MESSAGE, Some(message)) => matches!(
            message,
            AUTOPILOT_VERSION
                | PROTOCOL_VERSION
                | COMPONENT_INFORMATION
                | COMPONENT_INFORMATION_BASIC
                | COMPONENT_METADATA
                | AVAILABLE_MODES
        ),
        _ => false,
    }
}

/// Whether a message may ask a component for something: those that a station answers in the name of a vehicle.
pub const fn is_request(message: u32) -> bool {
    matches!(
        message,
        COMMAND_LONG
            | COMMAND_INT
            | PARAM_REQUEST_LIST
            | PARAM_REQUEST_READ
            | PARAM_SET
            | MISSION_REQUEST_LIST
            | MISSION_REQUEST_PARTIAL_LIST
            | MISSION_WRITE_PARTIAL_LIST
            | MISSION_ITEM
            | MISSION_ITEM_INT
            | MISSION_REQUEST
            | MISSION_REQUEST_INT
            | MISSION_SET_CURRENT
            | MISSION_COUNT
            | MISSION_CLEAR_ALL
            | MISSION_ACK
            | FILE_TRANSFER_PROTOCOL
            | LOG_REQUEST_LIST
            | LOG_REQUEST_DATA
    )
}
