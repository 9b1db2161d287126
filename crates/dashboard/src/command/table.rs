//! The table of commands.

use posebridge_telemetry::simulator::{ProfileName, SlippingWheel, SteeringSource};
use posebridge_telemetry::{
    Command, FilterComparison, Heading, Meters, OnlineCalibration, ParameterName, ParameterStorage, Pose, SensorId,
    SensorSwitch, SimulatorCommand, TimeDelta,
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
    /// A robot, which the optional field [`ROBOT_FIELD`] or [`FLEET_ROBOT_FIELD`] names.
    Robot,
    Station,
}

pub const ROBOT_FIELD: &str = "robot";

/// Names a robot of the fleet, in place of [`ROBOT_FIELD`].
pub const FLEET_ROBOT_FIELD: &str = "fleet_robot";

/// The longest name of a robot in a fleet.
pub const MAX_FLEET_ROBOT_CHARS: usize = 64;

/// Half-width of a square that no such robot leaves; far below the loss of resolution of f64.
const MAX_COORDINATE_M: f64 = 10_000.0;

const fn number(name: &'static str, least: f64, most: f64) -> CommandField {
    field(name, FieldKind::Number { least, most })
}

/// A number whose range is in [`posebridge_telemetry::simulator::NUMBER_FIELDS`].
const fn simulated(name: &'static str) -> CommandField {
    field(name, FieldKind::Simulated)
}

const fn field(name: &'static str, kind: FieldKind) -> CommandField {
    CommandField { name, kind }
}

const fn robot_command(
    name: &'static str,
    help: &'static str,
    fields: &'static [CommandField],
    build: fn(&FieldValues<'_>) -> Command,
) -> CommandRow {
    CommandRow { name, help, target: CommandTarget::Robot, fields, build }
}

const fn station_command(
    name: &'static str,
    help: &'static str,
    fields: &'static [CommandField],
    build: fn(&FieldValues<'_>) -> Command,
) -> CommandRow {
    CommandRow { target: CommandTarget::Station, ..robot_command(name, help, fields, build) }
}

/// Every command. A new one needs a row here.
#[rustfmt::skip]
pub const COMMANDS: &[CommandRow] = &[
    robot_command("reset-pose", "forget where the robot is: its configured start, or the next fix, decides", &[], |_| Command::ResetPose),
    robot_command("set-pose", "the robot is there", &[
        number("x_m", -MAX_COORDINATE_M, MAX_COORDINATE_M),
        number("y_m", -MAX_COORDINATE_M, MAX_COORDINATE_M),
        number("heading_rad", -MAX_COORDINATE_M, MAX_COORDINATE_M),
        number("position_sigma_m", 0.0, MAX_COORDINATE_M),
        number("heading_sigma_rad", 0.0, 100.0),
    ], |of| Command::SetPose {
        pose: Pose::new(Meters(of.number("x_m")), Meters(of.number("y_m")), Heading::from_rad(of.number("heading_rad"))),
        position_sigma_m: of.number("position_sigma_m"),
        heading_sigma_rad: of.number("heading_sigma_rad"),
    }),
    station_command("set-parameter", "set one tunable of the filter; /v1/parameters has their names and ranges", &[
        field("name", FieldKind::Name),
        field("value", FieldKind::Finite),
    ], |of| Command::SetParameter { name: ParameterName::from_bytes(of.text("name").as_bytes()), value: of.number("value") }),
    station_command("save-parameters", "write all tunables into parameters.toml in the run's folder", &[], |_| {
        Command::Parameters(ParameterStorage::Save)
    }),
    station_command("reload-parameters", "go back to the tunables that were saved last, or with which the run began", &[], |_| {
        Command::Parameters(ParameterStorage::Reload)
    }),
    station_command("default-parameters", "go back to the defaults of all tunables", &[], |_| {
        Command::Parameters(ParameterStorage::Default)
    }),
    robot_command("freeze-calibration", "take the robot's constants as they stand", &[], |_| {
        Command::OnlineCalibration(OnlineCalibration::Frozen)
    }),
    robot_command("learn-calibration", "go on learning the robot's constants", &[], |_| {
        Command::OnlineCalibration(OnlineCalibration::Enabled)
    }),
    robot_command("reset-calibration", "forget what was learned about the robot", &[], |_| Command::ResetCalibration),
    robot_command("switch-source", "use what a sensor says, or leave it out", &[
        field("sensor", FieldKind::Integer { least: 0, most: u8::MAX as u64 }),
        field("on", FieldKind::Switch),
    ], |of| Command::SwitchSource { sensor: SensorId(of.integer("sensor") as u8), to: of.switch("on") }),
    station_command("compare-filters", "run further filters beside the one that sends, or stop them", &[field("on", FieldKind::Switch)], |of| {
        Command::CompareFilters(match of.switch("on") {
            SensorSwitch::On => FilterComparison::On,
            SensorSwitch::Off => FilterComparison::Off,
        })
    }),
    station_command("start-recording", "begin a new recording", &[], |_| Command::StartRecording),
    station_command("stop-recording", "end the recording", &[], |_| Command::StopRecording),
    robot_command(
        "kidnap",
        "the simulated robot is lifted and put down there, relative to itself; its wheels spin in the air and count",
        &[simulated("forward_m"), simulated("left_m"), simulated("turn_rad")],
        |of| Command::Simulator(SimulatorCommand::Kidnap {
            forward_m: of.number("forward_m"),
            left_m: of.number("left_m"),
            turn_rad: of.number("turn_rad"),
        }),
    ),
    robot_command("slip", "wheels of the simulated robot lose grip; a factor of 1 spins on the spot", &[
        field("wheel", FieldKind::Choice(&["left", "right", "both"])),
        simulated("factor"),
        simulated("seconds"),
    ], |of| Command::Simulator(SimulatorCommand::Slip {
        wheel: parse_wheel(of.text("wheel")),
        factor: of.number("factor"),
        duration: TimeDelta::from_secs_f64(of.number("seconds")),
    })),
    robot_command("camera", "the simulated camera sees, or is covered", &[field("on", FieldKind::Switch)], |of| {
        Command::Simulator(SimulatorCommand::Camera(of.switch("on")))
    }),
    robot_command("camera-delay", "the delay of the simulated camera's fixes", &[simulated("delay_ms")], |of| {
        Command::Simulator(SimulatorCommand::CameraDelay { delay: millis(of.number("delay_ms")) })
    }),
    robot_command("gyro-bias-step", "the simulated gyro shows so much more from here on", &[simulated("rad_per_s")], |of| {
        Command::Simulator(SimulatorCommand::GyroBiasStep { rad_per_s: of.number("rad_per_s") })
    }),
    robot_command("link-profile", "the simulated brick's link gets like this one of config/links; null: as it was", &[
        field("profile", FieldKind::NameOrNull),
    ], |of| {
        let name = of.text("profile");
        let profile = (!name.is_empty()).then(|| ProfileName::from_bytes(name.as_bytes()));
        Command::Simulator(SimulatorCommand::LinkProfile(profile))
    }),
    robot_command("pull-cable", "the simulated brick's cable is out for so long", &[simulated("seconds")], |of| {
        Command::Simulator(SimulatorCommand::PullCable { duration: TimeDelta::from_secs_f64(of.number("seconds")) })
    }),
    robot_command("steering", "by what the simulated brick steers", &[field("by", FieldKind::Choice(&["odometry", "estimate"]))], |of| {
        Command::Simulator(SimulatorCommand::Steering(parse_steering(of.text("by"))))
    }),
    robot_command("drive", "drive the simulated robot by hand; holds for half a second", &[
        simulated("forward_m_per_s"),
        simulated("turn_rad_per_s"),
    ], |of| Command::Simulator(SimulatorCommand::Drive {
        forward_m_per_s: of.number("forward_m_per_s"),
        turn_rad_per_s: of.number("turn_rad_per_s"),
    })),
    robot_command("path", "the simulated robot drives its path again, from where it is nearest", &[], |_| {
        Command::Simulator(SimulatorCommand::Path)
    }),
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
