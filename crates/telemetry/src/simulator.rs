//! What a person may do to the simulated brick while it drives: faults, and who steers.
//!
//! Values only. They are [`Command`](crate::Command)s like the others and so part of a recording; the pipeline hands them on as a
//! [`Request`](crate::Request), and whoever owns the simulated brick carries them out. docs/simulator-commands.md tells what each does.

use std::f64::consts::PI;
use std::fmt;
use std::ops::RangeInclusive;

use crate::clock::Span;
use crate::command::Switch;
use crate::ids::ChannelName;

/// The name of a link profile: that of a file in `config/links/` without its ending.
pub type ProfileName = ChannelName;

/// Something that happens to the simulated brick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SimulatorCommand {
    /// The robot is lifted and put down elsewhere; its wheels spin in the air and count.
    Kidnap {
        /// How far along its own x axis it is carried, in metres.
        forward_m: f64,
        /// How far along its own y axis it is carried, in metres.
        left_m: f64,
        /// By how much it is turned there, counter-clockwise, in radians.
        turn_rad: f64,
    },
    /// Wheels lose grip: they turn and count, and the floor does not follow.
    Slip {
        /// Which.
        wheel: SlippingWheel,
        /// The share of their travel that is lost: 0 grips, 1 spins on the spot.
        factor: f64,
        /// For how long.
        duration: Span,
    },
    /// The camera sees, or is covered.
    Camera(Switch),
    /// What the camera has seen is told so much later from here on.
    CameraDelay {
        /// From the middle of the exposure to the first byte.
        delay: Span,
    },
    /// The gyro shows so much more from here on.
    GyroBiasStep {
        /// The step, in radians per second.
        rad_per_s: f64,
    },
    /// The brick's link gets worse, or is as it was.
    LinkProfile(Option<ProfileName>),
    /// The brick's cable is pulled out and put in again.
    PullCable {
        /// For how long it is out.
        duration: Span,
    },
    /// By what the brick steers from here on.
    Steering(SteeringSource),
    /// A person drives; holds for [`HELD_FOR`].
    Drive {
        /// Forward speed, in metres per second.
        forward_m_per_s: f64,
        /// Turn rate, counter-clockwise, in radians per second.
        turn_rad_per_s: f64,
    },
    /// The brick drives its path again, from where the path is nearest.
    Path,
}

/// A speed that a person asked for holds for so long; then the brick stands, unless it was asked for again. Keyboards repeat a key that is held
/// after 250 ms to 500 ms at first, so that a held key never lets the brick stop.
pub const HELD_FOR: Span = Span::from_millis(500);

/// Which wheels lose grip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlippingWheel {
    /// The left one.
    Left,
    /// The right one.
    Right,
    /// Both.
    Both,
}

impl SlippingWheel {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Left, Self::Right, Self::Both];

    /// Its word, as a command's JSON spells it.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Both => "both",
        }
    }
}

/// By what the simulated brick steers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SteeringSource {
    /// Its own dead reckoning.
    Odometry,
    /// The station's estimate.
    Estimate,
}

impl SteeringSource {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Odometry, Self::Estimate];

    /// Its word, as a command's JSON spells it.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::Estimate => "estimate",
        }
    }
}

/// A number of a command, as people and programs give it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberField {
    /// The command's name in JSON.
    pub command: &'static str,
    /// The field's name in JSON, with its unit.
    pub field: &'static str,
    /// The least value that is taken.
    pub least: f64,
    /// The largest value that is taken.
    pub most: f64,
}

impl NumberField {
    const fn new(command: &'static str, field: &'static str, range: (f64, f64)) -> Self {
        Self { command, field, least: range.0, most: range.1 }
    }

    /// What may stand there.
    #[must_use]
    pub const fn range(&self) -> RangeInclusive<f64> {
        self.least..=self.most
    }

    fn check(&'static self, value: f64) -> Result<(), OutOfRange> {
        // A number that is not finite is in no range.
        if self.range().contains(&value) { Ok(()) } else { Err(OutOfRange { field: self, value }) }
    }
}

/// A number of a command that makes no sense.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfRange {
    /// Which.
    pub field: &'static NumberField,
    /// What stood there.
    pub value: f64,
}

impl fmt::Display for OutOfRange {
    // Short, because it has to fit into a STATUSTEXT.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let NumberField { command, field, least, most } = self.field;
        write!(f, "{command}: {field} {:?} not in {least}..{most}", self.value)
    }
}

impl std::error::Error for OutOfRange {}

/// Every number of every command, with what may stand there.
///
/// Lengths: the arenas of the bundled scenarios are smaller than 10 m. Times: a minute is as long as somebody watches; a tenth of a second is
/// shorter than a hand pulls a cable. Delay: 5 s is older than the filter keeps late fixes for. Bias: 1 rad/s is ten times what a cheap gyro
/// of docs/simulated-brick.md has. Speeds: beyond what the simulated motors can do, 0.44 m/s at 8 V, so that a key means "as fast as it can".
pub const NUMBER_FIELDS: [&NumberField; 10] = [
    &KIDNAP_FORWARD,
    &KIDNAP_LEFT,
    &KIDNAP_TURN,
    &SLIP_FACTOR,
    &SLIP_SECONDS,
    &CAMERA_DELAY,
    &GYRO_BIAS,
    &CABLE_SECONDS,
    &DRIVE_FORWARD,
    &DRIVE_TURN,
];

/// Divided by these, as the spans' own products are rounded: a minute is 60 s and not a bit more.
const NANOS_PER_SECOND: f64 = 1e9;
const NANOS_PER_MILLISECOND: f64 = 1e6;

static KIDNAP_FORWARD: NumberField = NumberField::new("kidnap", "forward_m", (-10.0, 10.0));
static KIDNAP_LEFT: NumberField = NumberField::new("kidnap", "left_m", (-10.0, 10.0));
static KIDNAP_TURN: NumberField = NumberField::new("kidnap", "turn_rad", (-PI, PI));
static SLIP_FACTOR: NumberField = NumberField::new("slip", "factor", (0.0, 1.0));
static SLIP_SECONDS: NumberField = NumberField::new("slip", "seconds", (0.1, 60.0));
static CAMERA_DELAY: NumberField = NumberField::new("camera-delay", "delay_ms", (0.0, 5_000.0));
static GYRO_BIAS: NumberField = NumberField::new("gyro-bias-step", "rad_per_s", (-1.0, 1.0));
static CABLE_SECONDS: NumberField = NumberField::new("pull-cable", "seconds", (0.1, 60.0));
static DRIVE_FORWARD: NumberField = NumberField::new("drive", "forward_m_per_s", (-1.0, 1.0));
static DRIVE_TURN: NumberField = NumberField::new("drive", "turn_rad_per_s", (-6.3, 6.3));

impl SimulatorCommand {
    /// Its name in JSON.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Kidnap { .. } => "kidnap",
            Self::Slip { .. } => "slip",
            Self::Camera(_) => "camera",
            Self::CameraDelay { .. } => "camera-delay",
            Self::GyroBiasStep { .. } => "gyro-bias-step",
            Self::LinkProfile(_) => "link-profile",
            Self::PullCable { .. } => "pull-cable",
            Self::Steering(_) => "steering",
            Self::Drive { .. } => "drive",
            Self::Path => "path",
        }
    }

    /// Whether its numbers make sense.
    ///
    /// # Errors
    /// One of them is out of its range or not finite.
    pub fn check(&self) -> Result<(), OutOfRange> {
        match *self {
            Self::Kidnap { forward_m, left_m, turn_rad } => {
                KIDNAP_FORWARD.check(forward_m)?;
                KIDNAP_LEFT.check(left_m)?;
                KIDNAP_TURN.check(turn_rad)
            }
            Self::Slip {
                wheel: SlippingWheel::Left | SlippingWheel::Right | SlippingWheel::Both,
                factor,
                duration,
            } => {
                SLIP_FACTOR.check(factor)?;
                SLIP_SECONDS.check(duration.as_nanos() as f64 / NANOS_PER_SECOND)
            }
            Self::CameraDelay { delay } => CAMERA_DELAY.check(delay.as_nanos() as f64 / NANOS_PER_MILLISECOND),
            Self::GyroBiasStep { rad_per_s } => GYRO_BIAS.check(rad_per_s),
            Self::PullCable { duration } => CABLE_SECONDS.check(duration.as_nanos() as f64 / NANOS_PER_SECOND),
            Self::Drive { forward_m_per_s, turn_rad_per_s } => {
                DRIVE_FORWARD.check(forward_m_per_s)?;
                DRIVE_TURN.check(turn_rad_per_s)
            }
            Self::Camera(Switch::On | Switch::Off) | Self::LinkProfile(_) | Self::Steering(_) | Self::Path => Ok(()),
        }
    }
}

impl fmt::Display for SimulatorCommand {
    /// What happens, for people: the name first.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name();
        match self {
            Self::Kidnap { forward_m, left_m, turn_rad } => {
                write!(f, "{name}: {forward_m:.2} m forward, {left_m:.2} m left, {:.0} deg", turn_rad.to_degrees())
            }
            Self::Slip { wheel, factor, duration } => {
                write!(f, "{name}: {} lost {:.0} % for {:.1} s", wheel.word(), factor * 100.0, duration.as_secs_f64())
            }
            Self::Camera(Switch::On) => write!(f, "{name}: on"),
            Self::Camera(Switch::Off) => write!(f, "{name}: off"),
            Self::CameraDelay { delay } => write!(f, "{name}: {:.0} ms", delay.as_millis_f64()),
            Self::GyroBiasStep { rad_per_s } => write!(f, "{name}: {rad_per_s} rad/s"),
            Self::LinkProfile(Some(profile)) => write!(f, "{name}: {profile}"),
            Self::LinkProfile(None) => write!(f, "{name}: none"),
            Self::PullCable { duration } => write!(f, "{name}: {:.1} s", duration.as_secs_f64()),
            Self::Steering(source) => write!(f, "{name}: by {}", source.word()),
            Self::Drive { forward_m_per_s, turn_rad_per_s } => {
                write!(f, "{name}: {forward_m_per_s:.2} m/s, {turn_rad_per_s:.2} rad/s")
            }
            Self::Path => write!(f, "{name}: followed again"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_out_of_its_range_is_named() {
        let slip = |factor, millis| SimulatorCommand::Slip {
            wheel: SlippingWheel::Both,
            factor,
            duration: Span::from_millis(millis),
        };
        assert_eq!(slip(1.0, 60_000).check(), Ok(()));
        let told = |command: SimulatorCommand| command.check().unwrap_err().to_string();
        assert_eq!(told(slip(1.5, 1_000)), "slip: factor 1.5 not in 0..1");
        assert_eq!(told(slip(0.5, 0)), "slip: seconds 0.0 not in 0.1..60");
        let kidnap = SimulatorCommand::Kidnap { forward_m: 0.0, left_m: f64::NAN, turn_rad: 0.0 };
        assert_eq!(told(kidnap), "kidnap: left_m NaN not in -10..10");
    }

    #[test]
    fn what_happens_fits_into_a_line_of_mavlink() {
        let profile = ProfileName::from_bytes(b"bluetooth-spp");
        for (command, line) in [
            (
                SimulatorCommand::Kidnap { forward_m: -10.0, left_m: -10.0, turn_rad: -PI },
                "kidnap: -10.00 m forward, -10.00 m left, -180 deg",
            ),
            (SimulatorCommand::LinkProfile(Some(profile)), "link-profile: bluetooth-spp"),
            (SimulatorCommand::Steering(SteeringSource::Odometry), "steering: by odometry"),
        ] {
            assert_eq!(command.to_string(), line);
            // MAVLink's STATUSTEXT holds 50 characters.
            assert!(line.len() <= 50, "{line}");
        }
    }
}
