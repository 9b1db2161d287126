//! The table of commands.

use posebridge_telemetry::simulator::{ProfileName, SlippingWheel, SteeringSource};
use posebridge_telemetry::{
    Command, Heading, Meters, OnlineCalibration, ParameterName, ParameterStorage, Pose, SensorId, SimulatorCommand,
    TimeDelta,
};

use super::fields::{CommandField, FieldKind, FieldValues};

/// A command: its name, its fields and its constructor.
pub struct CommandRow {
    pub name: &'static str,
    pub help: &'static str,
    pub target: CommandTarget,
    /// All are required.
    pub fields: &'static [CommandField],
    pub(super) build: fn(&FieldValues<'_>) -> Command,
}

/// The target of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandTarget {
    /// A robot, which the optional field [`ROBOT_FIELD`] names.
    Robot,
    Station,
}

pub const ROBOT_FIELD: &str = "robot";

/// Half-width of a square that no such robot leaves; far below the loss of resolution of f64.
const MAX_COORDINATE_M: f64 = 10_000.0;

const fn number(name: &'static str, least: f64, most: f64) -> CommandField {
    let kind = FieldKind::Number { least, most };
    CommandField { name, kind }
}

/// A number whose range is in [`posebridge_telemetry::simulator::NUMBER_FIELDS`].
const fn simulated(name: &'static str) -> CommandField {
    let kind = FieldKind::Simulated;
    CommandField { name, kind }
}

const fn field(name: &'static str, kind: FieldKind) -> CommandField {
    CommandField { name, kind }
}

const fn command_without_fields(
    name: &'static str,
    help: &'static str,
    target: CommandTarget,
    build: fn(&FieldValues<'_>) -> Command,
) -> CommandRow {
    CommandRow { name, help, target, fields: &[], build }
}

/// Every command. A new one needs a row here.
pub const COMMANDS: &[CommandRow] = &[
    command_without_fields(
        "reset-pose",
        "forget where the robot is: its configured start, or the next fix, decides",
        CommandTarget::Robot,
        |_| Command::ResetPose,
    ),
    CommandRow {
        name: "set-pose",
        help: "the robot is there",
        target: CommandTarget::Robot,
        fields: &[
            number("x_m", -MAX_COORDINATE_M, MAX_COORDINATE_M),
            number("y_m", -MAX_COORDINATE_M, MAX_COORDINATE_M),
            number("heading_rad", -MAX_COORDINATE_M, MAX_COORDINATE_M),
            number("position_sigma_m", 0.0, MAX_COORDINATE_M),
            number("heading_sigma_rad", 0.0, 100.0),
        ],
        build: |values| Command::SetPose {
            pose: Pose::new(
                Meters(values.number("x_m")),
                Meters(values.number("y_m")),
                Heading::from_rad(values.number("heading_rad")),
            ),
            position_sigma_m: values.number("position_sigma_m"),
            heading_sigma_rad: values.number("heading_sigma_rad"),
        },
    },
    CommandRow {
        name: "set-parameter",
        help: "set one tunable of the filter; /v1/parameters has their names and ranges",
        target: CommandTarget::Station,
        fields: &[field("name", FieldKind::Name), field("value", FieldKind::Finite)],
        build: |values| Command::SetParameter {
            name: ParameterName::from_bytes(values.text("name").as_bytes()),
            value: values.number("value"),
        },
    },
    command_without_fields(
        "save-parameters",
        "write all tunables into parameters.toml in the run's folder",
        CommandTarget::Station,
        |_| Command::Parameters(ParameterStorage::Save),
    ),
    command_without_fields(
        "reload-parameters",
        "go back to the tunables that were saved last, or with which the run began",
        CommandTarget::Station,
        |_| Command::Parameters(ParameterStorage::Reload),
    ),
    command_without_fields(
        "default-parameters",
        "go back to the defaults of all tunables",
        CommandTarget::Station,
        |_| Command::Parameters(ParameterStorage::Default),
    ),
    command_without_fields(
        "freeze-calibration",
        "take the robot's constants as they stand",
        CommandTarget::Robot,
        |_| Command::OnlineCalibration(OnlineCalibration::Frozen),
    ),
    command_without_fields("learn-calibration", "go on learning the robot's constants", CommandTarget::Robot, |_| {
        Command::OnlineCalibration(OnlineCalibration::Enabled)
    }),
    command_without_fields(
        "reset-calibration",
        "forget what was learned about the robot",
        CommandTarget::Robot,
        |_| Command::ResetCalibration,
    ),
    CommandRow {
        name: "switch-source",
        help: "use what a sensor says, or leave it out",
        target: CommandTarget::Robot,
        fields: &[
            field("sensor", FieldKind::Integer { least: 0, most: u8::MAX as u64 }),
            field("on", FieldKind::Switch),
        ],
        build: |values| Command::SwitchSource {
            sensor: SensorId(values.integer("sensor") as u8),
            to: values.switch("on"),
        },
    },
    command_without_fields("start-recording", "begin a new recording", CommandTarget::Station, |_| {
        Command::StartRecording
    }),
    command_without_fields("stop-recording", "end the recording", CommandTarget::Station, |_| Command::StopRecording),
    CommandRow {
        name: "kidnap",
        help: "the simulated robot is lifted and put down there, relative to itself; its wheels spin in the air and count",
        target: CommandTarget::Robot,
        fields: &[simulated("forward_m"), simulated("left_m"), simulated("turn_rad")],
        build: |values| {
            Command::Simulator(SimulatorCommand::Kidnap {
                forward_m: values.number("forward_m"),
                left_m: values.number("left_m"),
                turn_rad: values.number("turn_rad"),
            })
        },
    },
    CommandRow {
        name: "slip",
        help: "wheels of the simulated robot lose grip; a factor of 1 spins on the spot",
        target: CommandTarget::Robot,
        fields: &[
            field("wheel", FieldKind::Choice(&["left", "right", "both"])),
            simulated("factor"),
            simulated("seconds"),
        ],
        build: |values| {
            Command::Simulator(SimulatorCommand::Slip {
                wheel: parse_wheel(values.text("wheel")),
                factor: values.number("factor"),
                duration: TimeDelta::from_secs_f64(values.number("seconds")),
            })
        },
    },
    CommandRow {
        name: "camera",
        help: "the simulated camera sees, or is covered",
        target: CommandTarget::Robot,
        fields: &[field("on", FieldKind::Switch)],
        build: |values| Command::Simulator(SimulatorCommand::Camera(values.switch("on"))),
    },
    CommandRow {
        name: "camera-delay",
        help: "the delay of the simulated camera's fixes",
        target: CommandTarget::Robot,
        fields: &[simulated("delay_ms")],
        build: |values| Command::Simulator(SimulatorCommand::CameraDelay { delay: millis(values.number("delay_ms")) }),
    },
    CommandRow {
        name: "gyro-bias-step",
        help: "the simulated gyro shows so much more from here on",
        target: CommandTarget::Robot,
        fields: &[simulated("rad_per_s")],
        build: |values| Command::Simulator(SimulatorCommand::GyroBiasStep { rad_per_s: values.number("rad_per_s") }),
    },
    CommandRow {
        name: "link-profile",
        help: "the simulated brick's link gets like this one of config/links; null: as it was",
        target: CommandTarget::Robot,
        fields: &[field("profile", FieldKind::NameOrNull)],
        build: |values| {
            let name = values.text("profile");
            let profile = (!name.is_empty()).then(|| ProfileName::from_bytes(name.as_bytes()));
            Command::Simulator(SimulatorCommand::LinkProfile(profile))
        },
    },
    CommandRow {
        name: "pull-cable",
        help: "the simulated brick's cable is out for so long",
        target: CommandTarget::Robot,
        fields: &[simulated("seconds")],
        build: |values| {
            Command::Simulator(SimulatorCommand::PullCable {
                duration: TimeDelta::from_secs_f64(values.number("seconds")),
            })
        },
    },
    CommandRow {
        name: "steering",
        help: "by what the simulated brick steers",
        target: CommandTarget::Robot,
        fields: &[field("by", FieldKind::Choice(&["odometry", "estimate"]))],
        build: |values| Command::Simulator(SimulatorCommand::Steering(parse_steering(values.text("by")))),
    },
    CommandRow {
        name: "drive",
        help: "drive the simulated robot by hand; holds for half a second",
        target: CommandTarget::Robot,
        fields: &[simulated("forward_m_per_s"), simulated("turn_rad_per_s")],
        build: |values| {
            Command::Simulator(SimulatorCommand::Drive {
                forward_m_per_s: values.number("forward_m_per_s"),
                turn_rad_per_s: values.number("turn_rad_per_s"),
            })
        },
    },
    command_without_fields(
        "path",
        "the simulated robot drives its path again, from where it is nearest",
        CommandTarget::Robot,
        |_| Command::Simulator(SimulatorCommand::Path),
    ),
];

/// Parses a checked word; a test compares the words with those of the type.
fn parse_wheel(word: &str) -> SlippingWheel {
    let mut all = SlippingWheel::ALL.into_iter();
    all.find(|wheel| wheel.as_str() == word).unwrap_or(SlippingWheel::Both)
}

/// As [`parse_wheel`].
fn parse_steering(word: &str) -> SteeringSource {
    let mut all = SteeringSource::ALL.into_iter();
    all.find(|source| source.as_str() == word).unwrap_or(SteeringSource::Estimate)
}

/// Rounded to nanoseconds once, so that the bounds of ranges stay in them.
fn millis(millis: f64) -> TimeDelta {
    TimeDelta::from_nanos((millis * 1e6).round() as i64)
}
