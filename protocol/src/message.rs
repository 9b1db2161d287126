//! Messages in SI units and our coordinate frames, independent of wire formats.
//!
//! [`crate::dialect`] converts frames to these and back; north-east-down, degrees, millimetres and integer scalings end
//! there. The simulated brick and the station use the same types. Every message can be both decoded and encoded, except
//! [`Message::Compass`], which only bricks with other protocols send.

use posebridge_telemetry::{
    Address, Arena, Celsius, ChannelName, EncoderTicks, Heading, HostClock, Meters, MetersPerSecond,
    MetersPerSecondSquared, Odom, Pose, Radians, RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};

use crate::dialect::ids::{COMMAND_GET_MESSAGE_INTERVAL, COMMAND_REQUEST_MESSAGE, COMMAND_SET_MESSAGE_INTERVAL};

/// The largest message id: 24 bits, all of them exact in a 32-bit float.
const LARGEST_ID: f32 = 16_777_215.0;

/// The channel of the thermometer in SCALED_PRESSURE, which has no name on the wire.
pub const SCALED_PRESSURE_CHANNEL: &[u8] = b"scaled_pressure";

/// A message that the station, the simulated brick or the camera says or understands.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// HEARTBEAT (0).
    Heartbeat(Heartbeat),
    /// SYSTEM_TIME (2): milliseconds since boot; a fall means a restart.
    SystemTime {
        /// Unix time in microseconds, 0 if unknown.
        unix_micros: u64,
        /// Time since boot.
        since_boot: WireStamp,
    },
    /// TIMESYNC (111).
    TimeSync(TimeSync),
    /// COMMAND_LONG (76) with MAV_CMD_SET_MESSAGE_INTERVAL (511).
    SetMessageInterval(SetMessageInterval),
    /// COMMAND_LONG (76) with any other command, known to us or not.
    Command(CommandLong),
    /// COMMAND_INT (75), whatever the command.
    CommandInt(CommandInt),
    /// COMMAND_ACK (77).
    CommandAck(CommandAck),
    /// STATUSTEXT (253), one chunk.
    StatusText {
        /// 0 emergency to 7 debug.
        severity: u8,
        /// At most 50 bytes on the wire.
        text: String,
        /// Which part of a longer text.
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
    /// NAMED_VALUE_FLOAT (251), temperatures apart: those are [`Self::Thermometer`].
    NamedValue(NamedValue),
    /// DEBUG_FLOAT_ARRAY (350).
    FloatArray(FloatArray),
    /// PB_WHEEL_TICKS (own dialect).
    WheelTicks(WheelTicks),
    /// PB_INERTIAL (own dialect).
    Inertial(Inertial),
    /// PB_PLANAR_POSE (own dialect).
    PlanarPose(PlanarPose),
    /// PB_FUSION_HEALTH (own dialect).
    FusionHealth(FusionHealth),
    /// PB_ROBOT_DESCRIPTION (own dialect).
    RobotDescription(RobotDescription),
    /// WHEEL_DISTANCE (9000), first two wheels: left, right.
    WheelDistance {
        /// End of the interval.
        stamp: WireStamp,
        /// Distance that the left wheel has rolled since boot.
        left: Meters,
        /// Distance that the right wheel has rolled since boot.
        right: Meters,
    },
    /// SCALED_IMU (26), RAW-scaled to SI; only the planar parts.
    ScaledImu(PlanarImu),
    /// HIGHRES_IMU (105), only the planar parts.
    HighresImu(PlanarImu),
    /// DISTANCE_SENSOR (132), forward looking.
    DistanceSensor {
        /// Instant of the range.
        stamp: WireStamp,
        /// The range.
        range: Meters,
        /// Standard deviation, if the sender knows it.
        sigma: Option<Meters>,
    },
    /// SCALED_PRESSURE (29), the temperature alone; its channel is called [`SCALED_PRESSURE_CHANNEL`]. NAMED_VALUE_FLOAT (251) with a
    /// name that begins with `temp`, in degrees Celsius.
    Thermometer {
        /// Time since the sender's boot.
        stamp: WireStamp,
        /// Which of the sender's thermometers; at most ten bytes on the wire.
        channel: ChannelName,
        /// What it shows.
        temperature: Celsius,
    },
    /// A compass. No MAVLink message carries it here; bricks with protocols of their own have one.
    Compass {
        /// Instant of the reading.
        stamp: WireStamp,
        /// Heading in the arena, as far as the compass's zero is known.
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
        /// Time since the sender's boot.
        stamp: WireStamp,
        /// x east, y north in the arena.
        x: Meters,
        /// See `x`.
        y: Meters,
        /// Speed along the arena's x.
        x_speed: MetersPerSecond,
        /// Speed along the arena's y.
        y_speed: MetersPerSecond,
    },
    /// ATTITUDE (30), the planar parts.
    Attitude {
        /// Time since the sender's boot.
        stamp: WireStamp,
        /// Heading in the arena.
        heading: Heading,
        /// Turn rate, counter-clockwise positive.
        turn_rate: RadiansPerSecond,
    },
    /// ESTIMATOR_STATUS (230).
    EstimatorStatus(EstimatorStatus),
    /// PARAM_REQUEST_LIST (21).
    ParamRequestList {
        /// Whose parameters.
        target: Address,
    },
    /// PARAM_REQUEST_READ (20).
    ParamRequestRead {
        /// Whose parameter.
        target: Address,
        /// Its name, at most 16 bytes, empty if asked by index.
        name: String,
        /// Its index, -1 if asked by name.
        index: i16,
    },
    /// PARAM_SET (23), real-valued.
    ParamSet {
        /// Whose parameter.
        target: Address,
        /// Its name, at most 16 bytes.
        name: String,
        /// The new value.
        value: f32,
    },
    /// PARAM_SET (23) of a type that does not fit into 32 bits or does not exist. The sender gets the present value.
    ParamSetUnsupported {
        /// Whose parameter.
        target: Address,
        /// Its name, at most 16 bytes.
        name: String,
        /// MAV_PARAM_TYPE of the value.
        kind: u8,
    },
    /// PARAM_VALUE (22), real-valued.
    ParamValue {
        /// Its name, at most 16 bytes.
        name: String,
        /// The value.
        value: f32,
        /// How many parameters there are.
        count: u16,
        /// The index of this one.
        index: u16,
    },
}

impl Message {
    /// The number of the tag that a fix is of, if it has one.
    pub const fn fix_tag(&self) -> Option<u32> {
        if let Self::VisionPosition(fix) | Self::MocapPosition(fix) = self { fix.tag } else { None }
    }

    /// The timestamp of a measurement or an estimate, on its sender's clock; `None` for the conversation, in which an
    /// answer holds two clocks.
    pub const fn stamp(&self) -> Option<WireStamp> {
        match self {
            Self::WheelTicks(WheelTicks { stamp, .. })
            | Self::Inertial(Inertial { stamp, .. })
            | Self::PlanarPose(PlanarPose { stamp, .. })
            | Self::FusionHealth(FusionHealth { stamp, .. })
            | Self::WheelDistance { stamp, .. }
            | Self::ScaledImu(PlanarImu { stamp, .. })
            | Self::HighresImu(PlanarImu { stamp, .. })
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
            | Self::RobotDescription(_)
            | Self::ParamRequestList { .. }
            | Self::ParamRequestRead { .. }
            | Self::ParamSet { .. }
            | Self::ParamSetUnsupported { .. }
            | Self::ParamValue { .. } => None,
        }
    }
}

/// A participant's description of itself, sent once per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// MAV_TYPE, e.g. 10 ground rover, 18 onboard controller, 30 camera, 6 ground station.
    pub vehicle_type: u8,
    /// MAV_AUTOPILOT, e.g. 0 generic, 8 invalid (not an autopilot).
    pub autopilot: u8,
    /// MAV_MODE_FLAG bits; 0 unless something is armed.
    pub base_mode: u8,
    /// MAV_STATE, e.g. 4 active.
    pub system_status: u8,
}

/// One half of a time exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeSync {
    /// Clock of the answering side, ns; 0 in a request.
    pub answer_nanos: i64,
    /// Clock of the asking side when it asked, ns; echoed in the answer.
    pub request_nanos: i64,
    /// Whom it is for; `None` on the wire is 0/0, a broadcast.
    pub target: Option<Address>,
}

/// The interval of MAV_CMD_SET_MESSAGE_INTERVAL that stops a message (common.xml).
pub(crate) const STOP_INTERVAL: f32 = -1.0;

/// A request to send a message at an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SetMessageInterval {
    /// Whom it is for.
    pub target: Address,
    /// The message's id.
    pub message_id: u32,
    /// The interval; `None` stops the message, zero asks for the sender's default.
    pub interval: Option<TimeDelta>,
}

impl SetMessageInterval {
    /// The request that a command is; `None` if it is another one, or its parameters name no message or no interval. Of negative ones
    /// only -1 has a meaning.
    pub fn from_command(command: &CommandLong) -> Option<Self> {
        let [_, interval_micros, ..] = command.params;
        let message_id = command.named_message()?;
        let is_request = command.command == COMMAND_SET_MESSAGE_INTERVAL;
        let stops = interval_micros.to_bits() == STOP_INTERVAL.to_bits();
        let is_interval = interval_micros.is_finite() && interval_micros >= 0.0;
        (is_request && (stops || is_interval)).then(|| Self {
            target: command.target,
            message_id,
            interval: is_interval.then(|| TimeDelta::from_micros(interval_micros.round() as i64)),
        })
    }
}

/// Any other command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandLong {
    /// Whom it is for.
    pub target: Address,
    /// MAV_CMD, known to us or not.
    pub command: u16,
    /// Its seven parameters.
    pub params: [f32; 7],
}

impl CommandLong {
    /// The message that a command about a message names by its first parameter; `None` for other commands, and for what is no id.
    pub fn named_message(&self) -> Option<u32> {
        let is_about_one = matches!(
            self.command,
            COMMAND_GET_MESSAGE_INTERVAL | COMMAND_SET_MESSAGE_INTERVAL | COMMAND_REQUEST_MESSAGE
        );
        let [first, ..] = self.params;
        (is_about_one && (0.0..=LARGEST_ID).contains(&first)).then_some(first as u32)
    }
}

/// Any command, with coordinates in integers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandInt {
    /// Whom it is for.
    pub target: Address,
    /// MAV_FRAME of the coordinates.
    pub frame: u8,
    /// MAV_CMD, known to us or not.
    pub command: u16,
    /// Its first four parameters.
    pub params: [f32; 4],
    /// The fifth: metres times 10^4 in a local frame, degrees of latitude times 10^7 in a global one, itself in a frame of neither kind.
    pub x: i32,
    /// The sixth, like `x`.
    pub y: i32,
    /// The seventh.
    pub z: f32,
}

impl CommandInt {
    /// The same command with seven parameters: coordinates in metres or degrees, to the 24 bits of a float.
    ///
    /// Source: common.xml, COMMAND_INT (fields x and y) and MAV_FRAME (which frames are local).
    pub fn to_long(self) -> CommandLong {
        let unit = match self.frame {
            // LOCAL_NED, LOCAL_ENU, LOCAL_OFFSET_NED to BODY_OFFSET_NED, BODY_FRD to LOCAL_FLU.
            1 | 4 | 7..=9 | 12..=21 => 1e-4,
            // GLOBAL and its relatives, those with INT and those relative to the terrain among them.
            0 | 3 | 5 | 6 | 10 | 11 => 1e-7,
            _ => 1.0,
        };
        let [p1, p2, p3, p4] = self.params;
        let scaled = |value: i32| (f64::from(value) * unit) as f32;
        CommandLong {
            target: self.target,
            command: self.command,
            params: [p1, p2, p3, p4, scaled(self.x), scaled(self.y), self.z],
        }
    }
}

/// What becomes of a command: MAV_RESULT of common.xml, those that are sent or understood here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandResult {
    /// It is valid and was done.
    Accepted = 0,
    /// It is valid but cannot be done now; the sender may try again.
    TemporarilyRejected = 1,
    /// It is known but its parameters are not valid.
    Denied = 2,
    /// It is not known here.
    Unsupported = 3,
    /// It is valid, was tried, and did not succeed.
    Failed = 4,
    /// It was begun; another answer follows.
    InProgress = 5,
}

/// The answer to a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandAck {
    /// The command that is answered.
    pub command: u16,
    /// MAV_RESULT: 0 accepted, 2 denied, 3 unsupported, 4 failed.
    pub result: u8,
    /// Who asked; `None` on the wire is 0/0.
    pub target: Option<Address>,
}

/// Total encoder counts of both wheels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WheelTicks {
    /// When they were read.
    pub stamp: WireStamp,
    /// The left wheel, forward positive; 32 bits on the wire, wraps.
    pub left: EncoderTicks,
    /// The right wheel, forward positive; 32 bits on the wire, wraps.
    pub right: EncoderTicks,
}

/// Gyro and wheel accelerometers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// End of the interval over which the rates are means.
    pub stamp: WireStamp,
    /// Turn rate, bias included.
    pub turn_rate: Option<RadiansPerSecond>,
    /// Turn since power-up, bias included, so that a lost frame costs nothing.
    pub turn: Option<Radians>,
    /// Forward acceleration at the left and at the right wheel.
    pub wheel_accelerations: Option<(MetersPerSecondSquared, MetersPerSecondSquared)>,
}

/// The planar parts of an inertial measurement unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarImu {
    /// Instant of the sample.
    pub stamp: WireStamp,
    /// Turn rate about the vertical, counter-clockwise positive.
    pub turn_rate: Option<RadiansPerSecond>,
    /// Forward acceleration of the body.
    pub forward_acceleration: Option<MetersPerSecondSquared>,
}

/// The estimate on thin links, 52 bytes of payload.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarPose {
    /// Brick time for which it holds, microseconds, wrapped as the brick's own counter.
    pub stamp: WireStamp,
    /// Where the robot is.
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
    /// What of it may be used.
    pub flags: PoseFlags,
}

/// What of a [`PlanarPose`] may be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "five independent bits of the wire, each with a name")]
pub struct PoseFlags {
    /// Bit 0: the position is meaningful.
    pub position_valid: bool,
    /// Bit 1: the heading is meaningful.
    pub heading_valid: bool,
    /// Bit 2: the speeds are meaningful.
    pub speeds_valid: bool,
    /// Bit 3: nothing absolute has been used for a while.
    pub dead_reckoning: bool,
    /// Bit 4: predicted ahead of the last observation, to the time at which it arrives.
    pub predicted: bool,
}

/// How the last observation of one sensor fared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionHealth {
    /// Brick time of the observation, microseconds.
    pub stamp: WireStamp,
    /// The sensor.
    pub sensor: SensorId,
    /// 0 accepted, 1 gated, 2 too old, 3 malformed, 4 re-based, 5 reset to, 6 unused.
    pub verdict: u8,
    /// Normalised innovation squared, divided by its degrees of freedom.
    pub nis_per_dof: f64,
    /// Innovation, SI units, up to three components.
    pub innovation: [f64; 3],
    /// How late it was; saturates at 65.535 s.
    pub lag: TimeDelta,
    /// Accepted observations of this sensor so far, wraps.
    pub accepted: u16,
    /// Refused observations of this sensor so far, wraps.
    pub refused: u16,
}

/// A robot's description of its own build, so that any host can configure itself.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotDescription {
    /// At most 16 bytes.
    pub name: String,
    /// Radius of the left wheel.
    pub left_wheel_radius: Meters,
    /// Radius of the right wheel.
    pub right_wheel_radius: Meters,
    /// Distance between the wheels' contact points.
    pub track_width: Meters,
    /// Encoder counts per turn of a wheel.
    pub ticks_per_turn: f64,
    /// Gyro noise per sample, one standard deviation; 0 when there is no gyro.
    pub gyro_sigma: RadiansPerSecond,
    /// Resolution of the gyro; 0 when it is fine or absent.
    pub gyro_resolution: RadiansPerSecond,
}

/// A pose seen from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionFix {
    /// The observer's own clock, middle of the exposure.
    pub stamp: WireStamp,
    /// Position in the arena.
    pub x: Meters,
    /// Position in the arena.
    pub y: Meters,
    /// Heading in the arena; NaN on the wire when the observer does not know it.
    pub heading: Option<Heading>,
    /// Variances of x, y, heading and the covariance of x and y, if the observer knows them: xx, xy, yy, heading.
    pub covariance: Option<[f64; 4]>,
    /// Counts the observer's own jumps.
    pub reset_counter: u8,
    /// The number of the tag that was seen; MAVLink's messages have none.
    pub tag: Option<u32>,
}

/// ODOMETRY, the interoperable pose with covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odometry {
    /// The instant for which it holds.
    pub stamp: WireStamp,
    /// Pose, in the space that its kind says.
    pub pose: OdometryPose,
    /// Along the body's x axis.
    pub forward_speed: MetersPerSecond,
    /// About the vertical.
    pub turn_rate: RadiansPerSecond,
    /// Upper triangle of the pose covariance as in [`PlanarPose::covariance`], if known.
    pub covariance: Option<[f64; 6]>,
    /// Counts jumps that are not motion.
    pub reset_counter: u8,
    /// -1 failed, 0 unset, 1 to 100 per cent.
    pub quality: i8,
}

/// In which space an [`Odometry`] lives.
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
    /// The instant for which it holds.
    pub stamp: WireStamp,
    /// Which parts are good.
    pub flags: PoseFlags,
    /// Horizontal position innovation test ratio: NIS over gate.
    pub position_ratio: f64,
    /// One standard deviation of the horizontal position.
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
    /// What is spoken.
    pub version: u16,
    /// The oldest that is understood.
    pub min_version: u16,
    /// The newest that is understood.
    pub max_version: u16,
}

/// COMPONENT_INFORMATION_BASIC (396).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComponentInformation {
    /// MAV_PROTOCOL_CAPABILITY bits.
    pub capabilities: u64,
    /// Time since the sender's boot.
    pub stamp: WireStamp,
    /// At most 31 bytes.
    pub vendor: String,
    /// At most 31 bytes.
    pub model: String,
    /// At most 23 bytes, as major.minor.patch.
    pub software_version: String,
}

/// MESSAGE_INTERVAL (244).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageInterval {
    /// The message; the wire has room for 16 bits of its id.
    pub message_id: u16,
    /// Microseconds between two of them; -1 when it is not sent, 0 when the sender has no such message.
    pub interval_micros: i32,
}

/// NAMED_VALUE_FLOAT (251) that is no temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NamedValue {
    /// Time since the sender's boot.
    pub stamp: WireStamp,
    /// At most ten bytes on the wire.
    pub name: ChannelName,
    /// The number, in whatever unit its name stands for.
    pub value: f32,
}

/// DEBUG_FLOAT_ARRAY (350).
#[derive(Clone, Debug, PartialEq)]
pub struct FloatArray {
    /// Time since the sender's boot.
    pub stamp: WireStamp,
    /// At most ten bytes on the wire.
    pub name: ChannelName,
    /// Distinguishes arrays of one sender.
    pub id: u16,
    /// At most 58 numbers; zeros at the end are not distinguished from none.
    pub values: Vec<f32>,
}

/// Which part of a text a STATUSTEXT is. The default is the whole of it.
///
/// Source: common.xml, STATUSTEXT (extension fields id and chunk_seq).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TextPart {
    /// The text that it is a part of; 0 for a text of one part.
    pub text_id: u16,
    /// Which of its parts, from 0.
    pub index: u8,
}

/// A time stamp as it stood on the wire, before unwrapping and alignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WireStamp {
    /// Microseconds in 32 bits; wraps after 71.6 minutes.
    Micros32(u32),
    /// Milliseconds in 32 bits; wraps after 49.7 days.
    Millis32(u32),
    /// Microseconds in 64 bits.
    Micros64(u64),
    /// None: the brick was asked, and looked between question and answer by the clock of whoever asked. Never on a wire.
    HostInterval {
        /// When the question left.
        sent: Timestamp<HostClock>,
        /// When the last byte of the answer was there.
        answered: Timestamp<HostClock>,
    },
}

impl WireStamp {
    /// In whole microseconds as it stands there; of an answer the middle between question and answer, by the clock of who asked.
    pub const fn as_micros(self) -> u64 {
        match self {
            Self::Micros32(micros) => micros as u64,
            Self::Millis32(millis) => millis as u64 * 1_000,
            Self::Micros64(micros) => micros,
            Self::HostInterval { sent, answered } => {
                i64::midpoint(sent.as_nanos(), answered.as_nanos()).unsigned_abs() / 1_000
            }
        }
    }
}
