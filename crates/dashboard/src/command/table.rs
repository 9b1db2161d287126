//! Every command that browsers and programs may give.

use posebridge_telemetry::simulator::{ProfileName, SlippingWheel, SteeringSource};
use posebridge_telemetry::{
    Command, Heading, Learning, Meters, ParameterName, ParameterStorage, Pose, SensorId, SimulatorCommand, Span,
};

use super::fields::{Field, Kind, Values};

/// A command: its name, its fields, what it asks for.
pub struct CommandRow {
    /// Its name.
    pub name: &'static str,
    /// What it does, in one line.
    pub help: &'static str,
    /// Its fields; all of them are needed.
    pub fields: &'static [Field],
    /// Makes it from fields that were checked.
    pub(super) make: fn(&Values<'_>) -> Command,
}

/// No robot of this class leaves a square of this half-width, and it is far below where f64 gets coarse.
const FARTHEST_M: f64 = 10_000.0;

const fn number(name: &'static str, least: f64, most: f64) -> Field {
    let kind = Kind::Number { least, most };
    Field { name, kind }
}

/// A number whose range stands in the vocabulary.
const fn simulated(name: &'static str) -> Field {
    let kind = Kind::Simulated;
    Field { name, kind }
}

const fn field(name: &'static str, kind: Kind) -> Field {
    Field { name, kind }
}

const fn plain(name: &'static str, help: &'static str, make: fn(&Values<'_>) -> Command) -> CommandRow {
    CommandRow { name, help, fields: &[], make }
}

/// Every command. Adding one: a row here.
pub const COMMANDS: &[CommandRow] = &[
    plain("reset-pose", "forget where the robot is: its configured start, or the next fix, decides", |_| {
        Command::ResetPose
    }),
    CommandRow {
        name: "set-pose",
        help: "the robot is there",
        fields: &[
            number("x_m", -FARTHEST_M, FARTHEST_M),
            number("y_m", -FARTHEST_M, FARTHEST_M),
            number("heading_rad", -FARTHEST_M, FARTHEST_M),
            number("position_sigma_m", 0.0, FARTHEST_M),
            number("heading_sigma_rad", 0.0, 100.0),
        ],
        make: |values| Command::SetPose {
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
        fields: &[field("name", Kind::Name), field("value", Kind::Finite)],
        make: |values| Command::SetParameter {
            name: ParameterName::from_bytes(values.text("name").as_bytes()),
            value: values.number("value"),
        },
    },
    plain("save-parameters", "write all tunables into parameters.toml in the run's folder", |_| {
        Command::Parameters(ParameterStorage::Save)
    }),
    plain("reload-parameters", "go back to the tunables that were saved last, or with which the run began", |_| {
        Command::Parameters(ParameterStorage::Reload)
    }),
    plain("default-parameters", "go back to the defaults of all tunables", |_| {
        Command::Parameters(ParameterStorage::Default)
    }),
    plain("freeze-calibration", "take the robot's constants as they stand", |_| Command::Learning(Learning::Frozen)),
    plain("learn-calibration", "go on learning the robot's constants", |_| Command::Learning(Learning::Free)),
    plain("reset-calibration", "forget what was learned about the robot", |_| Command::ResetCalibration),
    CommandRow {
        name: "switch-source",
        help: "use what a sensor says, or leave it out",
        fields: &[field("sensor", Kind::Whole { least: 0, most: u8::MAX as u64 }), field("on", Kind::Switch)],
        make: |values| Command::SwitchSource {
            sensor: SensorId(values.whole("sensor") as u8),
            to: values.switch("on"),
        },
    },
    plain("start-recording", "begin a new recording", |_| Command::StartRecording),
    plain("stop-recording", "end the recording", |_| Command::StopRecording),
    CommandRow {
        name: "kidnap",
        help: "the simulated robot is lifted and put down there, relative to itself; its wheels spin in the air and count",
        fields: &[simulated("forward_m"), simulated("left_m"), simulated("turn_rad")],
        make: |values| {
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
        fields: &[field("wheel", Kind::Choice(&["left", "right", "both"])), simulated("factor"), simulated("seconds")],
        make: |values| {
            Command::Simulator(SimulatorCommand::Slip {
                wheel: wheel(values.text("wheel")),
                factor: values.number("factor"),
                duration: Span::from_secs_f64(values.number("seconds")),
            })
        },
    },
    CommandRow {
        name: "camera",
        help: "the simulated camera sees, or is covered",
        fields: &[field("on", Kind::Switch)],
        make: |values| Command::Simulator(SimulatorCommand::Camera(values.switch("on"))),
    },
    CommandRow {
        name: "camera-delay",
        help: "the simulated camera tells what it has seen so much later",
        fields: &[simulated("delay_ms")],
        make: |values| Command::Simulator(SimulatorCommand::CameraDelay { delay: millis(values.number("delay_ms")) }),
    },
    CommandRow {
        name: "gyro-bias-step",
        help: "the simulated gyro shows so much more from here on",
        fields: &[simulated("rad_per_s")],
        make: |values| Command::Simulator(SimulatorCommand::GyroBiasStep { rad_per_s: values.number("rad_per_s") }),
    },
    CommandRow {
        name: "link-profile",
        help: "the simulated brick's link gets like this one of config/links; null: as it was",
        fields: &[field("profile", Kind::NameOrNull)],
        make: |values| {
            let name = values.text("profile");
            let profile = (!name.is_empty()).then(|| ProfileName::from_bytes(name.as_bytes()));
            Command::Simulator(SimulatorCommand::LinkProfile(profile))
        },
    },
    CommandRow {
        name: "pull-cable",
        help: "the simulated brick's cable is out for so long",
        fields: &[simulated("seconds")],
        make: |values| {
            Command::Simulator(SimulatorCommand::PullCable { duration: Span::from_secs_f64(values.number("seconds")) })
        },
    },
    CommandRow {
        name: "steering",
        help: "by what the simulated brick steers",
        fields: &[field("by", Kind::Choice(&["odometry", "estimate"]))],
        make: |values| Command::Simulator(SimulatorCommand::Steering(steering(values.text("by")))),
    },
    CommandRow {
        name: "drive",
        help: "drive the simulated robot by hand; holds for half a second",
        fields: &[simulated("forward_m_per_s"), simulated("turn_rad_per_s")],
        make: |values| {
            Command::Simulator(SimulatorCommand::Drive {
                forward_m_per_s: values.number("forward_m_per_s"),
                turn_rad_per_s: values.number("turn_rad_per_s"),
            })
        },
    },
    plain("path", "the simulated robot drives its path again, from where it is nearest", |_| {
        Command::Simulator(SimulatorCommand::Path)
    }),
];

/// Of a word that was checked; a test compares the words with the vocabulary's.
fn wheel(word: &str) -> SlippingWheel {
    let mut all = SlippingWheel::ALL.into_iter();
    all.find(|wheel| wheel.word() == word).unwrap_or(SlippingWheel::Both)
}

/// As [`wheel`].
fn steering(word: &str) -> SteeringSource {
    let mut all = SteeringSource::ALL.into_iter();
    all.find(|source| source.word() == word).unwrap_or(SteeringSource::Estimate)
}

/// Rounded to nanoseconds once, so that the ends of ranges stay in them.
fn millis(millis: f64) -> Span {
    Span::from_nanos((millis * 1e6).round() as i64)
}
