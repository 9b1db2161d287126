//! The estimate of a robot as the owner publishes it to the fleet: 100 bytes, little-endian.
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | u8 | version, 1 |
//! | 1 | u8 | flags: 1 position valid, 2 heading valid, 4 speeds valid, 8 dead reckoning; the others are zero |
//! | 2 | u8 | reset counter |
//! | 3 | u8 | zero |
//! | 4 | u32 | epoch, not zero |
//! | 8 | u32 | sequence number, per robot and owner; wraps |
//! | 12 | i64 | host time of the owner, ns |
//! | 20 | f64 | x, m |
//! | 28 | f64 | y, m |
//! | 36 | f64 | heading, rad, in (-pi, pi] |
//! | 44 | 6 × f64 | upper triangle of the covariance of x, y, heading: xx, xy, xh, yy, yh, hh; m², m rad, rad² |
//! | 92 | f32 | forward speed, m/s |
//! | 96 | f32 | turn rate, rad/s |

use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{
    Arena, Ellipse, Estimate, Heading, HostClock, Meters, MetersPerSecond, Pose, RadiansPerSecond, Timestamp, Validity,
};
use thiserror::Error;

use crate::epoch::Epoch;

const VERSION: u8 = 1;

const POSITION_VALID: u8 = 1;
const HEADING_VALID: u8 = 2;
const SPEEDS_VALID: u8 = 4;
const DEAD_RECKONING: u8 = 8;
const KNOWN_FLAGS: u8 = POSITION_VALID | HEADING_VALID | SPEEDS_VALID | DEAD_RECKONING;

/// A robot's estimate with the epoch of its owner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FleetEstimate {
    pub epoch: Epoch,
    /// Counts the estimates of this robot by this owner, so that gaps are seen; wraps.
    pub sequence: u32,
    /// The instant of the estimate on the owner's clock. Clocks of different owners do not compare.
    pub host_time: Timestamp<HostClock>,
    pub pose: Pose<Arena>,
    /// Upper triangle, by rows: xx, xy, xh, yy, yh, hh. That it is positive semi-definite is not checked.
    pub covariance: [f64; 6],
    pub forward_speed: MetersPerSecond,
    pub turn_rate: RadiansPerSecond,
    pub validity: Validity,
    pub is_dead_reckoning: bool,
    /// Counts jumps of the estimate that are not motion.
    pub reset_counter: u8,
}

/// Why bytes are no estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum EstimateError {
    #[error("an estimate has {len} bytes, not {0}", len = FleetEstimate::LEN)]
    Length(usize),
    #[error("version {0} is unknown")]
    Version(u8),
    #[error("unknown flags {0:#04x}, or a reserved byte that is not zero")]
    Reserved(u8),
    #[error("the epoch is zero")]
    Epoch,
    #[error("a number is not finite, a variance is negative, or the heading is not in (-pi, pi]")]
    Number,
}

impl FleetEstimate {
    /// The length of every estimate, in bytes.
    pub const LEN: usize = 100;

    /// From the engine's estimate; `host_time` is its stamp on the host's clock.
    pub fn new(epoch: Epoch, sequence: u32, host_time: Timestamp<HostClock>, estimate: &Estimate) -> Self {
        let [x_row, y_row, heading_row, ..] = estimate.covariance;
        Self {
            epoch,
            sequence,
            host_time,
            pose: estimate.pose,
            covariance: [
                x_row[row::X],
                x_row[row::Y],
                x_row[row::HEADING],
                y_row[row::Y],
                y_row[row::HEADING],
                heading_row[row::HEADING],
            ],
            forward_speed: estimate.forward_speed,
            turn_rate: estimate.turn_rate,
            validity: estimate.validity,
            is_dead_reckoning: estimate.is_dead_reckoning,
            reset_counter: estimate.reset_counter,
        }
    }

    /// The ellipse that holds the position with 95 %; `None` if the covariance is none.
    pub fn ellipse_95(&self) -> Option<Ellipse> {
        let [xx, xy, _, yy, ..] = self.covariance;
        Ellipse::from_covariance(xx, xy, yy, Ellipse::SIGMAS_95)
    }

    /// One standard deviation, in radians.
    pub fn heading_sigma_rad(&self) -> f64 {
        let [.., variance] = self.covariance;
        variance.sqrt()
    }

    /// Speeds are rounded to 32 bits. The decoder refuses an estimate that is not finite.
    pub fn encode(&self) -> [u8; Self::LEN] {
        let flag = |is_set: bool, flag: u8| if is_set { flag } else { 0 };
        let flags = flag(self.validity.position, POSITION_VALID)
            | flag(self.validity.heading, HEADING_VALID)
            | flag(self.validity.speeds, SPEEDS_VALID)
            | flag(self.is_dead_reckoning, DEAD_RECKONING);
        let mut writer = Writer { bytes: [0; Self::LEN], len: 0 };
        writer.put([VERSION, flags, self.reset_counter, 0]);
        writer.put(self.epoch.get().to_le_bytes());
        writer.put(self.sequence.to_le_bytes());
        writer.put(self.host_time.as_nanos().to_le_bytes());
        for number in [self.pose.x.0, self.pose.y.0, self.pose.heading.rad()].into_iter().chain(self.covariance) {
            writer.put(number.to_le_bytes());
        }
        writer.put((self.forward_speed.0 as f32).to_le_bytes());
        writer.put((self.turn_rate.0 as f32).to_le_bytes());
        writer.bytes
    }

    /// Never panics; refuses whatever the encoder does not write for a finite estimate.
    pub fn decode(bytes: &[u8]) -> Result<Self, EstimateError> {
        // A later version may have another length.
        if let Some(version) = bytes.first().filter(|version| **version != VERSION) {
            return Err(EstimateError::Version(*version));
        }
        let mut reader = Reader { bytes };
        let decoded = Self::read(&mut reader);
        let estimate = decoded.filter(|_| reader.bytes.is_empty()).ok_or(EstimateError::Length(bytes.len()))?;
        estimate.and_then(Self::validate)
    }

    /// `None` where the bytes end too early.
    fn read(reader: &mut Reader<'_>) -> Option<Result<Self, EstimateError>> {
        let [_, flags, reset_counter, reserved] = reader.take()?;
        let epoch = u32::from_le_bytes(reader.take()?);
        let sequence = u32::from_le_bytes(reader.take()?);
        let host_time = Timestamp::from_nanos(i64::from_le_bytes(reader.take()?));
        let mut doubles = [0.0; 9];
        for number in &mut doubles {
            *number = f64::from_le_bytes(reader.take()?);
        }
        let [x_m, y_m, heading_rad, covariance @ ..] = doubles;
        let forward_speed = MetersPerSecond(f64::from(f32::from_le_bytes(reader.take()?)));
        let turn_rate = RadiansPerSecond(f64::from(f32::from_le_bytes(reader.take()?)));
        if flags & !KNOWN_FLAGS != 0 || reserved != 0 {
            return Some(Err(EstimateError::Reserved(flags)));
        }
        let Some(epoch) = Epoch::new(epoch) else { return Some(Err(EstimateError::Epoch)) };
        let heading = Heading::from_rad(heading_rad);
        if heading.rad().to_bits() != heading_rad.to_bits() {
            return Some(Err(EstimateError::Number));
        }
        Some(Ok(Self {
            epoch,
            sequence,
            host_time,
            pose: Pose::new(Meters(x_m), Meters(y_m), heading),
            covariance,
            forward_speed,
            turn_rate,
            validity: Validity {
                position: flags & POSITION_VALID != 0,
                heading: flags & HEADING_VALID != 0,
                speeds: flags & SPEEDS_VALID != 0,
            },
            is_dead_reckoning: flags & DEAD_RECKONING != 0,
            reset_counter,
        }))
    }

    fn validate(self) -> Result<Self, EstimateError> {
        let [xx, _, _, yy, _, hh] = self.covariance;
        let numbers = [self.pose.x.0, self.pose.y.0, self.pose.heading.rad(), self.forward_speed.0, self.turn_rate.0];
        let is_finite = numbers.iter().chain(&self.covariance).all(|number| number.is_finite());
        if is_finite && [xx, yy, hh].iter().all(|variance| *variance >= 0.0) {
            Ok(self)
        } else {
            Err(EstimateError::Number)
        }
    }
}

struct Writer {
    bytes: [u8; FleetEstimate::LEN],
    len: usize,
}

impl Writer {
    /// The layout fits the length, which the golden bytes hold.
    fn put<const N: usize>(&mut self, field: [u8; N]) {
        for (slot, byte) in self.bytes.iter_mut().skip(self.len).zip(field) {
            *slot = byte;
        }
        self.len += N;
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (field, rest) = self.bytes.split_first_chunk()?;
        self.bytes = rest;
        Some(*field)
    }
}
