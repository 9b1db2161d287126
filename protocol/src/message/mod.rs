//! Messages in SI units and our coordinate frames, independent of wire formats.
//!
//! [`crate::dialect`] converts frames to these and back; north-east-down, degrees, millimetres and integer scalings end
//! there. The simulated brick and the station use the same types. Every message can be both decoded and encoded, except
//! [`Message::Compass`], which only bricks with other protocols send.

use posebridge_telemetry::{
    Address, Arena, Celsius, ChannelName, EncoderTicks, GeodeticPoint, Heading, LandmarkId, Meters, MetersPerSecond,
    MetersPerSecondSquared, Odom, Pose, Radians, RadiansPerSecond, SensorId, TimeDelta,
};
use serde::{Deserialize, Serialize};

mod commands;
mod heartbeat;
mod vehicle;
mod vehicle_state;
mod wire_stamp;

pub use commands::{CommandAck, CommandInt, CommandLong, CommandResult, MessageInterval, SetMessageInterval};
pub use heartbeat::Heartbeat;
pub(crate) use vehicle::integer_coordinate;
pub use vehicle::{
    AvailableMode, ComponentMetadata, FileTransfer, ItemPosition, LogMessage, MetadataForm, MissionCurrent,
    MissionItem, MissionResult, PlanContent, PlanMessage, plan,
};
pub use vehicle_state::{
    AttitudeQuaternion, Battery, GlobalPosition, GlobalReference, HeadUpDisplay, ManualControl, PositionTarget,
    SetGlobalOrigin, Setpoint, SystemStatus,
};
pub use wire_stamp::WireStamp;

/// The channel of the thermometer in SCALED_PRESSURE, which has no name on the wire.
pub const SCALED_PRESSURE_CHANNEL: &[u8] = b"scaled_pressure";

/// A message in either direction between station, brick and camera.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// HEARTBEAT (0).
    Heartbeat(Heartbeat),
    /// SYSTEM_TIME (2): a fall of the time since boot means a restart.
    SystemTime {
        /// 0 if unknown.
        unix_micros: u64,
        since_boot: WireStamp,
    },
    /// TIMESYNC (111).
    TimeSync(TimeSync),
    /// COMMAND_LONG (76) with MAV_CMD_SET_MESSAGE_INTERVAL (511).
    SetMessageInterval(SetMessageInterval),
    /// COMMAND_LONG (76) with any other command, or SET_MODE (11) as MAV_CMD_DO_SET_MODE (176).
    Command(CommandLong),
    /// COMMAND_INT (75) with any command.
    CommandInt(CommandInt),
    /// COMMAND_ACK (77).
    CommandAck(CommandAck),
    /// STATUSTEXT (253), one chunk.
    StatusText {
        /// 0 emergency to 7 debug.
        severity: u8,
        /// At most 50 bytes on the wire.
        text: String,
        part: TextPart,
    },
    /// AUTOPILOT_VERSION (148).
    AutopilotVersion(AutopilotVersion),
    /// PROTOCOL_VERSION (300).
    ProtocolVersion(ProtocolVersion),
    /// COMPONENT_INFORMATION_BASIC (396).
    ComponentInformation(ComponentInformation),
    /// MESSAGE_INTERVAL (244).
    MessageInterval(MessageInterval),
    /// NAMED_VALUE_FLOAT (251), except temperatures: those are [`Self::Thermometer`].
    NamedValue(NamedValue),
    /// DEBUG_FLOAT_ARRAY (350).
    FloatArray(FloatArray),
    WheelTicks(WheelTicks),
    Inertial(Inertial),
    PlanarPose(PlanarPose),
    FusionHealth(FusionHealth),
    RobotDescription(RobotDescription),
    /// WHEEL_DISTANCE (9000), first two wheels: distance since boot.
    WheelDistance {
        /// End of the interval.
        stamp: WireStamp,
        left: Meters,
        right: Meters,
    },
    /// The planar parts of a message of [`ImuMessage`], in SI units.
    Imu(PlanarImu),
    /// RPM (226, ardupilotmega): the speeds of both wheels. The message has no timestamp.
    WheelSpeeds {
        left: RadiansPerSecond,
        right: RadiansPerSecond,
    },
    /// GPS_RAW_INT (24) with a fix of two or three dimensions.
    GnssFix(GnssFix),
    /// LANDING_TARGET (149) with a valid position, as a sighting of a landmark.
    LandmarkSighting(LandmarkSighting),
    /// GLOBAL_POSITION_INT (33).
    GlobalPosition(GlobalPosition),
    /// HOME_POSITION (242).
    HomePosition(GlobalReference),
    /// GPS_GLOBAL_ORIGIN (49).
    GlobalOrigin(GlobalReference),
    /// SET_GPS_GLOBAL_ORIGIN (48).
    SetGlobalOrigin(SetGlobalOrigin),
    /// VFR_HUD (74).
    HeadUpDisplay(HeadUpDisplay),
    /// ATTITUDE_QUATERNION (31).
    AttitudeQuaternion(AttitudeQuaternion),
    /// SYS_STATUS (1).
    SystemStatus(SystemStatus),
    /// BATTERY_STATUS (147).
    BatteryStatus(Battery),
    /// EXTENDED_SYS_STATE (245) of a vehicle that does not fly.
    OnGround,
    /// MANUAL_CONTROL (69).
    ManualControl(ManualControl),
    /// SET_POSITION_TARGET_LOCAL_NED (84).
    PositionTarget(PositionTarget),
    /// DISTANCE_SENSOR (132), forward looking.
    DistanceSensor {
        stamp: WireStamp,
        range: Meters,
        /// `None` if the sender does not know it.
        sigma: Option<Meters>,
    },
    /// SCALED_PRESSURE (29), only the temperature; its channel is [`SCALED_PRESSURE_CHANNEL`]. NAMED_VALUE_FLOAT (251)
    /// with a name that begins with `temp`, in degrees Celsius.
    Thermometer {
        stamp: WireStamp,
        /// At most ten bytes on the wire.
        channel: ChannelName,
        temperature: Celsius,
    },
    /// A compass. No MAVLink message carries it here; only bricks with other protocols send it.
    Compass {
        stamp: WireStamp,
        /// Heading in the arena, if the compass's zero is configured.
        heading: Heading,
    },
    /// VISION_POSITION_ESTIMATE (102): a fix from outside, of the body's origin.
    VisionPosition(VisionFix),
    /// ATT_POS_MOCAP (138): a fix from outside, of the body's origin.
    MocapPosition(VisionFix),
    /// ODOMETRY (331).
    Odometry(Odometry),
    /// LOCAL_POSITION_NED (32), the planar parts.
    LocalPosition {
        stamp: WireStamp,
        /// East in the arena; `y` is north.
        x: Meters,
        y: Meters,
        /// Along the arena's x.
        x_speed: MetersPerSecond,
        y_speed: MetersPerSecond,
    },
    /// ATTITUDE (30), the planar parts.
    Attitude {
        stamp: WireStamp,
        heading: Heading,
        /// Counter-clockwise positive.
        turn_rate: RadiansPerSecond,
    },
    /// ESTIMATOR_STATUS (230).
    EstimatorStatus(EstimatorStatus),
    /// PARAM_REQUEST_LIST (21).
    ParamRequestList {
        target: Address,
    },
    /// PARAM_REQUEST_READ (20).
    ParamRequestRead {
        target: Address,
        /// At most 16 bytes; empty in a request by index.
        name: String,
        /// -1 in a request by name.
        index: i16,
    },
    /// PARAM_SET (23), real-valued.
    ParamSet {
        target: Address,
        name: String,
        value: f32,
    },
    /// PARAM_SET (23) of a type that does not fit into 32 bits or does not exist. The sender gets the present value.
    ParamSetUnsupported {
        target: Address,
        name: String,
        /// MAV_PARAM_TYPE of the value.
        kind: u8,
    },
    /// PARAM_VALUE (22), real-valued.
    ParamValue {
        name: String,
        value: f32,
        count: u16,
        index: u16,
    },
    /// PARAM_VALUE (22) with the name `_HASH_CHECK`: a checksum over all parameters, by which a ground station knows whether
    /// those that it keeps are still right.
    ParamHash {
        hash: u32,
        count: u16,
    },
    Plan(PlanMessage),
    MissionItem(MissionItem),
    MissionCurrent(MissionCurrent),
    /// MISSION_ITEM_REACHED (46).
    MissionItemReached {
        sequence: u16,
    },
    FileTransfer(FileTransfer),
    Log(LogMessage),
    AvailableMode(AvailableMode),
    ComponentMetadata(ComponentMetadata),
}

impl Message {
    /// The number of the tag of a fix, if it has one.
    pub const fn fix_tag(&self) -> Option<u32> {
        if let Self::VisionPosition(fix) | Self::MocapPosition(fix) = self { fix.tag } else { None }
    }

    /// The target of a message about plans, files or logs; `None` for an answer without one, and for every other message.
    #[expect(clippy::wildcard_enum_match_arm, reason = "most messages are about something else")]
    pub const fn service_target(&self) -> Option<Address> {
        match self {
            Self::Plan(PlanMessage { target, .. })
            | Self::MissionItem(MissionItem { target, .. })
            | Self::FileTransfer(FileTransfer { target, .. })
            | Self::Log(LogMessage::RequestList { target, .. } | LogMessage::RequestData { target, .. }) => {
                Some(*target)
            }
            _ => None,
        }
    }

    /// The timestamp of a measurement or an estimate, on its sender's clock; `None` for requests and replies, some of
    /// which hold two clocks.
    pub const fn stamp(&self) -> Option<WireStamp> {
        match self {
            Self::WheelTicks(WheelTicks { stamp, .. })
            | Self::Inertial(Inertial { stamp, .. })
            | Self::PlanarPose(PlanarPose { stamp, .. })
            | Self::FusionHealth(FusionHealth { stamp, .. })
            | Self::WheelDistance { stamp, .. }
            | Self::Imu(PlanarImu { stamp, .. })
            | Self::GnssFix(GnssFix { stamp, .. })
            | Self::LandmarkSighting(LandmarkSighting { stamp, .. })
            | Self::GlobalPosition(GlobalPosition { stamp, .. })
            | Self::AttitudeQuaternion(AttitudeQuaternion { stamp, .. })
            | Self::DistanceSensor { stamp, .. }
            | Self::Thermometer { stamp, .. }
            | Self::Compass { stamp, .. }
            | Self::VisionPosition(VisionFix { stamp, .. })
            | Self::MocapPosition(VisionFix { stamp, .. })
            | Self::Odometry(Odometry { stamp, .. })
            | Self::LocalPosition { stamp, .. }
            | Self::Attitude { stamp, .. }
            | Self::EstimatorStatus(EstimatorStatus { stamp, .. }) => Some(*stamp),
            Self::Heartbeat(_)
            | Self::SystemTime { .. }
            | Self::TimeSync(_)
            | Self::SetMessageInterval(_)
            | Self::Command(_)
            | Self::CommandInt(_)
            | Self::CommandAck(_)
            | Self::StatusText { .. }
            | Self::AutopilotVersion(_)
            | Self::ProtocolVersion(_)
            | Self::ComponentInformation(_)
            | Self::MessageInterval(_)
            // For people's eyes, by whichever clock their sender had at hand.
            | Self::NamedValue(_)
            | Self::FloatArray(_)
            | Self::WheelSpeeds { .. }
            // Places do not move, and the others have no stamp or none that is needed.
            | Self::HomePosition(_)
            | Self::GlobalOrigin(_)
            | Self::SetGlobalOrigin(_)
            | Self::HeadUpDisplay(_)
            | Self::SystemStatus(_)
            | Self::BatteryStatus(_)
            | Self::OnGround
            | Self::ManualControl(_)
            | Self::PositionTarget(_)
            | Self::RobotDescription(_)
            | Self::ParamRequestList { .. }
            | Self::ParamRequestRead { .. }
            | Self::ParamSet { .. }
            | Self::ParamSetUnsupported { .. }
            | Self::ParamValue { .. }
            | Self::ParamHash { .. }
            | Self::Plan(_)
            | Self::MissionItem(_)
            | Self::MissionCurrent(_)
            | Self::MissionItemReached { .. }
            | Self::FileTransfer(_)
            | Self::Log(_)
            | Self::AvailableMode(_)
            | Self::ComponentMetadata(_) => None,
        }
    }
}

/// A time request or its reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeSync {
    /// Clock of the replying side; 0 in a request.
    pub answer_nanos: i64,
    /// Clock of the requesting side at the request; echoed in the reply.
    pub request_nanos: i64,
    /// `None` on the wire is 0/0, a broadcast.
    pub target: Option<Address>,
}

/// Total encoder counts of both wheels, forward positive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WheelTicks {
    pub stamp: WireStamp,
    /// 32 bits on the wire, wraps.
    pub left: EncoderTicks,
    pub right: EncoderTicks,
}

/// Gyro and wheel accelerometers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// End of the interval over which the rates are means.
    pub stamp: WireStamp,
    /// Bias included.
    pub turn_rate: Option<RadiansPerSecond>,
    /// Turn since power-up, bias included, so that a lost frame costs nothing.
    pub turn: Option<Radians>,
    /// Forward acceleration at the left and at the right wheel.
    pub wheel_accelerations: Option<(MetersPerSecondSquared, MetersPerSecondSquared)>,
}

impl Inertial {
    pub(crate) const fn empty(stamp: WireStamp) -> Self {
        Self { stamp, turn_rate: None, turn: None, wheel_accelerations: None }
    }
}

/// The messages of inertial measurement units. An autopilot sends the readings of its first unit in several of them, and those of
/// further units in messages of their own.
///
/// They are in the order in which they are preferred: by resolution, the autopilot's first unit before the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum ImuMessage {
    /// HIGHRES_IMU (105).
    Highres,
    /// SCALED_IMU (26).
    Scaled,
    /// RAW_IMU (27). The definition leaves its units open; ArduPilot, its most common sender, uses those of SCALED_IMU.
    Raw,
    /// SCALED_IMU2 (116).
    Scaled2,
    /// SCALED_IMU3 (129).
    Scaled3,
}

/// The planar parts of an inertial measurement unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarImu {
    pub message: ImuMessage,
    pub stamp: WireStamp,
    /// Counter-clockwise positive.
    pub turn_rate: Option<RadiansPerSecond>,
    /// Of the body.
    pub forward_acceleration: Option<MetersPerSecondSquared>,
}

/// The estimate on thin links, 52 bytes of payload, and up to 56 in a fleet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarPose {
    /// Brick time for which it holds, microseconds, wrapped as the brick's own counter.
    pub stamp: WireStamp,
    pub pose: Pose<Arena>,
    /// Along the body's x axis.
    pub forward_speed: MetersPerSecond,
    /// About the vertical.
    pub turn_rate: RadiansPerSecond,
    /// Upper triangle of the pose covariance: xx, xy, x-heading, yy, y-heading, heading-heading; m², m rad, rad².
    pub covariance: [f64; 6],
    /// Time since the last fix that was used; `None` before the first.
    pub fix_age: Option<TimeDelta>,
    /// Counts jumps that are not motion.
    pub reset_counter: u8,
    /// The valid parts.
    pub flags: PoseFlags,
    /// Rises with every change of the station that owns the robot; 0 without a fleet.
    pub epoch: u32,
}

impl PlanarPose {
    /// The larger of the standard deviations of x and y; NaN if there is none.
    pub fn position_sigma_m(&self) -> f64 {
        let [xx_m2, _, _, yy_m2, ..] = self.covariance;
        xx_m2.max(yy_m2).sqrt()
    }
}

/// The valid parts of a [`PlanarPose`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "five independent bits of the wire, each with a name")]
pub struct PoseFlags {
    /// Bit 0.
    pub position_valid: bool,
    /// Bit 1.
    pub heading_valid: bool,
    /// Bit 2.
    pub speeds_valid: bool,
    /// Bit 3: no absolute observation has been used for a while.
    pub dead_reckoning: bool,
    /// Bit 4: predicted ahead of the last observation, to the time at which it arrives.
    pub predicted: bool,
}

/// The outcome of the last observation of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionHealth {
    /// Brick time of the observation, microseconds.
    pub stamp: WireStamp,
    pub sensor: SensorId,
    /// 0 accepted, 1 gated, 2 too old, 3 malformed, 4 re-based, 5 reset to, 6 unused.
    pub verdict: u8,
    /// Normalised innovation squared, divided by its degrees of freedom.
    pub nis_per_dof: f64,
    /// Innovation, SI units, up to three components.
    pub innovation: [f64; 3],
    /// Saturates at 65.535 s.
    pub lag: TimeDelta,
    /// Wraps.
    pub accepted: u16,
    /// Wraps.
    pub refused: u16,
}

/// A robot's description of its own build, so that any host can configure itself.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotDescription {
    /// At most 16 bytes.
    pub name: String,
    pub left_wheel_radius: Meters,
    pub right_wheel_radius: Meters,
    /// Distance between the wheels' contact points.
    pub track_width: Meters,
    /// Per turn of a wheel.
    pub ticks_per_turn: f64,
    /// Per sample, one standard deviation; 0 without a gyro.
    pub gyro_sigma: RadiansPerSecond,
    /// 0 when it is finer than the noise, or without a gyro.
    pub gyro_resolution: RadiansPerSecond,
}

/// A pose seen from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionFix {
    /// The observer's own clock, middle of the exposure.
    pub stamp: WireStamp,
    /// In the arena.
    pub x: Meters,
    pub y: Meters,
    /// NaN on the wire when the observer does not know it.
    pub heading: Option<Heading>,
    /// xx, xy, yy and heading, if the observer knows them.
    pub covariance: Option<[f64; 4]>,
    /// Counts the jumps of the observer's frame.
    pub reset_counter: u8,
    /// MAVLink's messages have none.
    pub tag: Option<u32>,
}

/// GPS_RAW_INT: a position by satellites.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssFix {
    /// Time since boot, or since 1970: the definition leaves it open, and the magnitude tells.
    pub stamp: WireStamp,
    pub position: GeodeticPoint,
    /// One standard deviation of each horizontal axis; `None` if the sender does not know it.
    pub sigma: Option<Meters>,
    /// Over the ground, never negative; `None` if the sender does not know it.
    pub ground_speed: Option<MetersPerSecond>,
}

/// LANDING_TARGET with a position relative to the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkSighting {
    pub stamp: WireStamp,
    /// The number of the target, which is that of the landmark.
    pub landmark: LandmarkId,
    /// Its position in the vehicle's own axes.
    pub forward: Meters,
    pub left: Meters,
}

/// ODOMETRY: a pose with covariance in the standard dialect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odometry {
    pub stamp: WireStamp,
    pub pose: OdometryPose,
    pub forward_speed: MetersPerSecond,
    pub turn_rate: RadiansPerSecond,
    /// As in [`PlanarPose::covariance`], if known.
    pub covariance: Option<[f64; 6]>,
    pub reset_counter: u8,
    /// In per cent from 1; 0 unset, -1 failed.
    pub quality: i8,
}

/// The frame of an [`Odometry`] pose, with the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OdometryPose {
    /// A pose in the arena (estimator type vision or mocap, or the station's own output).
    Arena(Pose<Arena>),
    /// A pose that drifts: a foreign odometer's own integration.
    Odom(Pose<Odom>),
}

/// ESTIMATOR_STATUS, the parts that make sense for a planar robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorStatus {
    pub stamp: WireStamp,
    pub flags: PoseFlags,
    /// Horizontal position innovation test ratio: NIS over gate.
    pub position_ratio: f64,
    /// One standard deviation, horizontal.
    pub position_sigma: Meters,
}

/// AUTOPILOT_VERSION (148), the parts that a component without hardware of its own has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AutopilotVersion {
    /// MAV_PROTOCOL_CAPABILITY bits.
    pub capabilities: u64,
    /// Major, minor and patch number, and FIRMWARE_VERSION_TYPE (0 development, 255 release).
    pub software: [u8; 4],
}

/// PROTOCOL_VERSION (300), in hundredths: MAVLink 2 is 200.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProtocolVersion {
    pub version: u16,
    pub min_version: u16,
    pub max_version: u16,
}

/// COMPONENT_INFORMATION_BASIC (396).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComponentInformation {
    /// MAV_PROTOCOL_CAPABILITY bits.
    pub capabilities: u64,
    pub stamp: WireStamp,
    /// At most 31 bytes.
    pub vendor: String,
    pub model: String,
    /// At most 23 bytes, as major.minor.patch.
    pub software_version: String,
}

/// NAMED_VALUE_FLOAT (251) that is no temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NamedValue {
    pub stamp: WireStamp,
    /// At most ten bytes on the wire.
    pub name: ChannelName,
    pub value: f32,
}

/// DEBUG_FLOAT_ARRAY (350).
#[derive(Clone, Debug, PartialEq)]
pub struct FloatArray {
    pub stamp: WireStamp,
    /// At most ten bytes on the wire.
    pub name: ChannelName,
    /// Distinguishes arrays of one sender.
    pub id: u16,
    /// At most 58 numbers; zeros at the end are truncated on the wire.
    pub values: Vec<f32>,
}

/// The position of a STATUSTEXT in a longer text. The default is a whole text.
///
/// Source: common.xml, STATUSTEXT (extension fields id and chunk_seq).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TextPart {
    /// The id of the longer text; 0 for a text of one part.
    pub text_id: u16,
    /// From 0.
    pub index: u8,
}
