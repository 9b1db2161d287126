//! The vocabulary of posebridge: what every other crate says and hears.
//!
//! Quantities with units, spaces with typed transforms, three clocks that do not mix, ids, and the values that
//! travel through the house: [`Observation`] in, [`Estimate`] and [`Event`] out, [`Command`] back. This crate
//! depends on nothing of ours, reads no clock, opens nothing and computes no estimate.
//!
//! Conventions: x forward or east, y left or north, counter-clockwise positive, SI units, headings in (-pi, pi].

pub mod calibration;
pub mod clock;
pub mod command;
pub mod ellipse;
pub mod engine;
pub mod estimate;
pub mod event;
pub mod fusion;
pub mod ids;
pub mod link_health;
pub mod observation;
pub mod outbound;
pub mod quantities;
pub mod repeats;
pub mod robot;
pub mod simulator;
pub mod spaces;
pub mod world;

pub use calibration::{Calibration, Known};
pub use clock::{BrickClock, CameraClock, HostClock, Span, Stamp};
pub use command::{Command, Learning, ParameterName, ParameterStorage, Request, Switch};
pub use ellipse::Ellipse;
pub use engine::{Input, Output};
pub use estimate::{Estimate, PoseJump, ScalarEstimate, Validity};
pub use event::{Defect, Event, LinkState, Refusal};
pub use fusion::{FusionRecord, Verdict};
pub use ids::{Address, BeaconId, ChannelName, ComponentId, LandmarkId, LinkId, PeerId, RobotId, SensorId, SystemId};
pub use link_health::{LinkHealth, PortCounts, SourceHealth};
pub use observation::{Fix, Observation, Observed, PositionCovariance};
pub use outbound::{Audience, Priority};
pub use quantities::{
    Celsius, EncoderTicks, Heading, Meters, MetersPerSecond, MetersPerSecondSquared, Radians, RadiansPerSecond, Volts,
};
pub use repeats::{Repeats, Shown};
pub use robot::{DriveGeometry, SensorNoise};
pub use simulator::{SimulatorCommand, SlippingWheel, SteeringSource};
pub use spaces::{Arena, Body, Camera, Odom, Point2, Pose, Tag, Transform2};
pub use world::{Wall, World};
