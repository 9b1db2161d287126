//! The shared types of posebridge.
//!
//! Quantities with units, coordinate frames with typed transforms, three clocks that do not mix, ids, and the values that
//! the crates exchange: [`Observation`] in, [`Estimate`] and [`Event`] out, [`Command`] back. This crate depends on no
//! other crate of posebridge, reads no clock, does no input or output and computes no estimate.
//!
//! Conventions: x forward or east, y left or north, counter-clockwise positive, SI units, headings in (-pi, pi].

pub mod admission;
pub mod clock;
pub mod command;
pub mod ellipse;
pub mod estimate;
pub mod event;
pub mod fusion;
pub mod geodesy;
pub mod ids;
pub mod io;
pub mod link_health;
pub mod observation;
mod outside_fix;
pub mod ownership;
pub mod printable;
pub mod quantities;
pub mod quantity_steps;
pub mod repeat_filter;
pub mod robot;
pub mod severity;
pub mod simulator;
pub mod spaces;
pub mod wiring;

pub use admission::{Admission, AdmissionLimits, ClientNetwork, ConnectionUse, Occupant};
pub use clock::{BrickClock, CameraClock, HostClock, TimeDelta, Timestamp};
pub use command::{Command, FilterComparison, OnlineCalibration, ParameterName, ParameterStorage, Request};
pub use ellipse::Ellipse;
pub use estimate::{Estimate, MissingObservation, PoseCorrection, ResetCause, ScalarEstimate, Validity};
pub use event::{Event, LinkState, ReceiveError, SignatureError};
pub use fusion::{FusionOutcome, FusionRecord};
pub use geodesy::{GeodeticOrigin, GeodeticPoint};
pub use ids::{Address, BeaconId, ChannelName, ComponentId, LandmarkId, LinkId, PeerId, RobotId, SensorId, SystemId};
pub use io::{Input, Output, Priority, Recipients, StationInput};
pub use link_health::{LinkCounter, LinkCounts, LinkHealth, SourceHealth};
pub use observation::{Fix, Observation, ObservationKind, PositionCovariance, SensorSwitch};
pub use outside_fix::OutsideFix;
pub use ownership::{Ownership, RobotSnapshot};
pub use printable::{is_printable, printable};
pub use quantities::{
    Celsius, EncoderTicks, Heading, Meters, MetersPerSecond, MetersPerSecondSquared, Radians, RadiansPerSecond,
};
pub use quantity_steps::QuantitySteps;
pub use repeat_filter::{RepeatDecision, RepeatFilter};
pub use robot::{
    ArenaMap, Calibration, DriveGeometry, MountedSensor, Mounting, Mountings, SensorNoise, StartPose, UncertainValue,
    Wall,
};
pub use simulator::{SimulatorCommand, SlippingWheel, SteeringSource};
pub use spaces::{Arena, Body, Camera, Odom, Point2, Pose, Tag, Transform2};
pub use wiring::{CameraUnit, GyroUnit, Polarity, WheelOrder, Wiring};
