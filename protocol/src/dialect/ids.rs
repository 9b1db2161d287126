//! The messages that this station understands, by number and name.

/// A message that can be decoded and encoded here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageInfo {
    /// The number on the wire.
    pub id: u32,
    /// The name in the dialect's definition.
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
    SYSTEM_TIME = 2,
    PARAM_REQUEST_READ = 20,
    PARAM_REQUEST_LIST = 21,
    PARAM_VALUE = 22,
    PARAM_SET = 23,
    SCALED_IMU = 26,
    SCALED_PRESSURE = 29,
    ATTITUDE = 30,
    LOCAL_POSITION_NED = 32,
    COMMAND_LONG = 76,
    COMMAND_ACK = 77,
    VISION_POSITION_ESTIMATE = 102,
    HIGHRES_IMU = 105,
    TIMESYNC = 111,
    DISTANCE_SENSOR = 132,
    ATT_POS_MOCAP = 138,
    ESTIMATOR_STATUS = 230,
    NAMED_VALUE_FLOAT = 251,
    STATUSTEXT = 253,
    ODOMETRY = 331,
    WHEEL_DISTANCE = 9000,
    PB_WHEEL_TICKS = 42100,
    PB_INERTIAL = 42101,
    PB_PLANAR_POSE = 42102,
    PB_FUSION_HEALTH = 42103,
    PB_ROBOT_DESCRIPTION = 42104,
}

/// MAV_CMD_SET_MESSAGE_INTERVAL, the command that [`crate::message::Message::SetMessageInterval`] is.
pub const COMMAND_SET_MESSAGE_INTERVAL: u16 = 511;
