//! The pipeline's inputs as bytes and back, bit for bit: docs/recording-format.md in code.
//!
//! Little-endian, no padding, every `f64` by its bits. The last four bytes are a CRC-32 over the message's sequence
//! number, its time and the bytes before, so that damage is noticed and named instead of being replayed.

use flate2::Crc;
use posebridge_telemetry::{
    BeaconId, Celsius, Command, Fix, Heading, Input, LandmarkId, LinkId, LinkState, Meters,
    MetersPerSecond, MetersPerSecondSquared, Observation, Observed, PeerId, Point2, PortCounts,
    Pose, PositionCovariance, Radians, RadiansPerSecond, SensorId, Span, Stamp,
};

/// First byte of every message; a change of layout changes it.
const VERSION: u8 = 2;
/// The oldest layout that is still read: it has the same tags, but for those that came later.
const OLDEST: u8 = 1;
/// Bytes of the checksum at the end.
const CHECKSUM_BYTES: usize = 4;

/// Which input a message holds: its second byte.
mod tag {
    pub(super) const BYTES: u8 = 0;
    pub(super) const LINK: u8 = 1;
    pub(super) const OBSERVATION: u8 = 2;
    pub(super) const SET_POSE: u8 = 3;
    pub(super) const TICK: u8 = 4;
    /// Bytes of a peer that is not the first of its link.
    pub(super) const PEER_BYTES: u8 = 5;
    pub(super) const PORT: u8 = 6;
}

/// Which kind of observation follows.
mod kind {
    pub(super) const WHEEL_ANGLES: u8 = 0;
    pub(super) const ODOMETER_POSE: u8 = 1;
    pub(super) const BODY_VELOCITY: u8 = 2;
    pub(super) const TURN_RATE: u8 = 3;
    pub(super) const WHEEL_ACCELERATIONS: u8 = 4;
    pub(super) const FIX: u8 = 5;
    pub(super) const LANDMARK: u8 = 6;
    pub(super) const BEACON_RANGE: u8 = 7;
    pub(super) const WALL_RANGE: u8 = 8;
    pub(super) const COMPASS_HEADING: u8 = 9;
    pub(super) const TEMPERATURE: u8 = 10;
}

/// Flags of a fix: which optional parts follow.
mod fix_flag {
    pub(super) const HEADING: u8 = 1;
    pub(super) const COVARIANCE: u8 = 2;
    pub(super) const ALL: u8 = HEADING | COVARIANCE;
}

/// Why the bytes of a message are not an input.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The message ends before its layout does.
    #[error("the message is too short: {wanted} more bytes wanted, {left} left")]
    TooShort {
        /// Bytes that the next field needs.
        wanted: usize,
        /// Bytes that are left.
        left: usize,
    },
    /// Bytes follow the end of the layout.
    #[error("{0} bytes too many at the end of the message")]
    TooLong(usize),
    /// The bytes are not those that were written.
    #[error("checksum {found:#010x} where {expected:#010x} was expected")]
    Checksum {
        /// The checksum that stands there.
        found: u32,
        /// The checksum of the bytes.
        expected: u32,
    },
    /// Written by a newer program.
    #[error("message layout {0} is unknown: read the file with the program version in its header")]
    Version(u8),
    /// A tag, kind, state or flag that the layout does not have.
    #[error("{field} {value} is not one of this layout")]
    Unknown {
        /// The field.
        field: &'static str,
        /// Its value.
        value: u8,
    },
    /// A heading outside (-pi, pi].
    #[error("heading {0} rad is outside (-pi, pi]")]
    Heading(f64),
    /// A time that no stamp of the host clock can hold; taken as it stands it would lie before the session.
    #[error("time {0} ns is beyond the range of the host clock")]
    Time(u64),
}

/// Where a message stands in the recording: part of its checksum.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Its number, from 0.
    pub(super) sequence: u32,
    /// Its time, host nanoseconds.
    pub(super) log_time: u64,
}

impl Place {
    fn checksum(self, bytes: &[u8]) -> u32 {
        let mut crc = Crc::new();
        crc.update(&self.sequence.to_le_bytes());
        crc.update(&self.log_time.to_le_bytes());
        crc.update(bytes);
        crc.sum()
    }
}

/// Appends the bytes of `input` to `bytes`, which must be empty.
pub(super) fn encode(input: &Input, place: Place, bytes: &mut Vec<u8>) {
    bytes.push(VERSION);
    match input {
        Input::Bytes {
            link,
            peer,
            bytes: payload,
        } => {
            let is_first = *peer == PeerId::default();
            bytes.push(if is_first {
                tag::BYTES
            } else {
                tag::PEER_BYTES
            });
            bytes.extend_from_slice(&link.0.to_le_bytes());
            if !is_first {
                bytes.extend_from_slice(&peer.0.to_le_bytes());
            }
            bytes.extend_from_slice(payload);
        }
        Input::Port { link, counts } => {
            bytes.push(tag::PORT);
            bytes.extend_from_slice(&link.0.to_le_bytes());
            put_counts(counts, bytes);
        }
        Input::Link { link, state } => {
            bytes.push(tag::LINK);
            bytes.extend_from_slice(&link.0.to_le_bytes());
            bytes.push(match state {
                LinkState::Up => 1,
                LinkState::Down => 0,
            });
        }
        Input::Observation(observation) => {
            bytes.push(tag::OBSERVATION);
            put_observation(observation, bytes);
        }
        Input::Command(Command::SetPose {
            pose,
            position_sigma_m,
            heading_sigma_rad,
        }) => {
            bytes.push(tag::SET_POSE);
            put_pose(*pose, bytes);
            put_all(&[*position_sigma_m, *heading_sigma_rad], bytes);
        }
        Input::Tick => bytes.push(tag::TICK),
    }
    let checksum = place.checksum(bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
}

fn put_all(values: &[f64], bytes: &mut Vec<u8>) {
    for value in values {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
}

fn put_pose<S>(pose: Pose<S>, bytes: &mut Vec<u8>) {
    put_all(&[pose.x.0, pose.y.0, pose.heading.rad()], bytes);
}

fn put_counts(counts: &PortCounts, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&counts.bytes_out.to_le_bytes());
    bytes.extend_from_slice(&counts.drops_out.to_le_bytes());
    for count in [counts.peers, counts.queued_frames, counts.queued_bytes] {
        bytes.extend_from_slice(&count.to_le_bytes());
    }
    // No link takes less than nothing: a negative capacity says that none was measured.
    put_all(&[counts.capacity_bytes_per_s.unwrap_or(-1.0)], bytes);
}

fn put_observation(observation: &Observation, bytes: &mut Vec<u8>) {
    bytes.push(observation.sensor.0);
    bytes.extend_from_slice(&observation.stamp.as_nanos().to_le_bytes());
    bytes.extend_from_slice(&observation.stamp_sigma.as_nanos().to_le_bytes());
    put_observed(&observation.observed, bytes);
}

fn put_observed(observed: &Observed, bytes: &mut Vec<u8>) {
    let mut put = |kind: u8, values: &[f64]| {
        bytes.push(kind);
        put_all(values, bytes);
    };
    match observed {
        Observed::WheelAngles { left, right } => put(kind::WHEEL_ANGLES, &[left.0, right.0]),
        Observed::OdometerPose(pose) => put(
            kind::ODOMETER_POSE,
            &[pose.x.0, pose.y.0, pose.heading.rad()],
        ),
        Observed::BodyVelocity { forward, turn } => put(kind::BODY_VELOCITY, &[forward.0, turn.0]),
        Observed::TurnRate(rate) => put(kind::TURN_RATE, &[rate.0]),
        Observed::WheelAccelerations { left, right } => {
            put(kind::WHEEL_ACCELERATIONS, &[left.0, right.0]);
        }
        Observed::WallRange(range) => put(kind::WALL_RANGE, &[range.0]),
        Observed::CompassHeading(heading) => put(kind::COMPASS_HEADING, &[heading.rad()]),
        Observed::Temperature(temperature) => put(kind::TEMPERATURE, &[temperature.0]),
        Observed::Fix(fix) => {
            bytes.push(kind::FIX);
            put_fix(fix, bytes);
        }
        Observed::Landmark { id, range, bearing } => {
            bytes.push(kind::LANDMARK);
            bytes.extend_from_slice(&id.0.to_le_bytes());
            put_all(&[range.0, bearing.0], bytes);
        }
        Observed::BeaconRange { id, range } => {
            bytes.push(kind::BEACON_RANGE);
            bytes.extend_from_slice(&id.0.to_le_bytes());
            put_all(&[range.0], bytes);
        }
    }
}

fn put_fix(fix: &Fix, bytes: &mut Vec<u8>) {
    let heading = if fix.heading.is_some() {
        fix_flag::HEADING
    } else {
        0
    };
    let covariance = if fix.covariance.is_some() {
        fix_flag::COVARIANCE
    } else {
        0
    };
    bytes.push(heading | covariance);
    bytes.push(fix.reset_counter);
    put_all(
        &[
            fix.position.x.0,
            fix.position.y.0,
            fix.tag_in_body.x.0,
            fix.tag_in_body.y.0,
        ],
        bytes,
    );
    if let Some(heading) = fix.heading {
        put_all(&[heading.rad()], bytes);
    }
    if let Some(c) = fix.covariance {
        put_all(&[c.xx_m2, c.xy_m2, c.yy_m2, c.heading_rad2], bytes);
    }
}

/// Turns the bytes of one message into the input that was given.
pub(super) fn decode(bytes: &[u8], place: Place) -> Result<Input, DecodeError> {
    let Some((body, checksum)) = bytes.split_last_chunk::<CHECKSUM_BYTES>() else {
        return Err(DecodeError::TooShort {
            wanted: CHECKSUM_BYTES,
            left: bytes.len(),
        });
    };
    let (found, expected) = (u32::from_le_bytes(*checksum), place.checksum(body));
    if found != expected {
        return Err(DecodeError::Checksum { found, expected });
    }
    if i64::try_from(place.log_time).is_err() {
        return Err(DecodeError::Time(place.log_time));
    }
    let mut cursor = Cursor { bytes: body };
    let version = cursor.u8()?;
    if !(OLDEST..=VERSION).contains(&version) {
        return Err(DecodeError::Version(version));
    }
    let input = cursor.input()?;
    match cursor.bytes.len() {
        0 => Ok(input),
        left => Err(DecodeError::TooLong(left)),
    }
}

/// What is left of a message while it is taken apart.
struct Cursor<'a> {
    bytes: &'a [u8],
}

impl Cursor<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let (head, rest) = self
            .bytes
            .split_first_chunk::<N>()
            .ok_or(DecodeError::TooShort {
                wanted: N,
                left: self.bytes.len(),
            })?;
        self.bytes = rest;
        Ok(*head)
    }

    fn u8(&mut self) -> Result<u8, DecodeError> {
        self.take::<1>().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Result<u16, DecodeError> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, DecodeError> {
        self.take().map(u32::from_le_bytes)
    }

    fn i64(&mut self) -> Result<i64, DecodeError> {
        self.take().map(i64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, DecodeError> {
        self.take().map(f64::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, DecodeError> {
        self.take().map(u64::from_le_bytes)
    }

    fn counts(&mut self) -> Result<PortCounts, DecodeError> {
        Ok(PortCounts {
            bytes_out: self.u64()?,
            drops_out: self.u64()?,
            peers: self.u32()?,
            queued_frames: self.u32()?,
            queued_bytes: self.u32()?,
            capacity_bytes_per_s: Some(self.f64()?).filter(|capacity| *capacity >= 0.0),
        })
    }

    fn heading(&mut self) -> Result<Heading, DecodeError> {
        let angle_rad = self.f64()?;
        let heading = Heading::from_rad(angle_rad);
        // What `Heading` would change was not written by us: refused, because replay promises the same bits.
        if heading.rad().to_bits() == angle_rad.to_bits() {
            Ok(heading)
        } else {
            Err(DecodeError::Heading(angle_rad))
        }
    }

    fn pose<S>(&mut self) -> Result<Pose<S>, DecodeError> {
        Ok(Pose::new(
            Meters(self.f64()?),
            Meters(self.f64()?),
            self.heading()?,
        ))
    }

    fn point<S>(&mut self) -> Result<Point2<S>, DecodeError> {
        Ok(Point2::new(Meters(self.f64()?), Meters(self.f64()?)))
    }

    fn input(&mut self) -> Result<Input, DecodeError> {
        Ok(match self.u8()? {
            tag::BYTES => Input::Bytes {
                link: LinkId(self.u16()?),
                peer: PeerId::default(),
                bytes: std::mem::take(&mut self.bytes).to_vec(),
            },
            tag::PEER_BYTES => Input::Bytes {
                link: LinkId(self.u16()?),
                peer: PeerId(self.u32()?),
                bytes: std::mem::take(&mut self.bytes).to_vec(),
            },
            tag::PORT => Input::Port {
                link: LinkId(self.u16()?),
                counts: self.counts()?,
            },
            tag::LINK => Input::Link {
                link: LinkId(self.u16()?),
                state: match self.u8()? {
                    0 => LinkState::Down,
                    1 => LinkState::Up,
                    value => {
                        return Err(DecodeError::Unknown {
                            field: "link state",
                            value,
                        });
                    }
                },
            },
            tag::OBSERVATION => Input::Observation(self.observation()?),
            tag::SET_POSE => Input::Command(Command::SetPose {
                pose: self.pose()?,
                position_sigma_m: self.f64()?,
                heading_sigma_rad: self.f64()?,
            }),
            tag::TICK => Input::Tick,
            value => {
                return Err(DecodeError::Unknown {
                    field: "input tag",
                    value,
                });
            }
        })
    }

    fn observation(&mut self) -> Result<Observation, DecodeError> {
        Ok(Observation {
            sensor: SensorId(self.u8()?),
            stamp: Stamp::from_nanos(self.i64()?),
            stamp_sigma: Span::from_nanos(self.i64()?),
            observed: self.observed()?,
        })
    }

    fn observed(&mut self) -> Result<Observed, DecodeError> {
        Ok(match self.u8()? {
            kind::WHEEL_ANGLES => Observed::WheelAngles {
                left: Radians(self.f64()?),
                right: Radians(self.f64()?),
            },
            kind::ODOMETER_POSE => Observed::OdometerPose(self.pose()?),
            kind::BODY_VELOCITY => Observed::BodyVelocity {
                forward: MetersPerSecond(self.f64()?),
                turn: RadiansPerSecond(self.f64()?),
            },
            kind::TURN_RATE => Observed::TurnRate(RadiansPerSecond(self.f64()?)),
            kind::WHEEL_ACCELERATIONS => Observed::WheelAccelerations {
                left: MetersPerSecondSquared(self.f64()?),
                right: MetersPerSecondSquared(self.f64()?),
            },
            kind::FIX => Observed::Fix(self.fix()?),
            kind::LANDMARK => Observed::Landmark {
                id: LandmarkId(self.u32()?),
                range: Meters(self.f64()?),
                bearing: Radians(self.f64()?),
            },
            kind::BEACON_RANGE => Observed::BeaconRange {
                id: BeaconId(self.u32()?),
                range: Meters(self.f64()?),
            },
            kind::WALL_RANGE => Observed::WallRange(Meters(self.f64()?)),
            kind::COMPASS_HEADING => Observed::CompassHeading(self.heading()?),
            kind::TEMPERATURE => Observed::Temperature(Celsius(self.f64()?)),
            value => {
                return Err(DecodeError::Unknown {
                    field: "observation kind",
                    value,
                });
            }
        })
    }

    fn fix(&mut self) -> Result<Fix, DecodeError> {
        let flags = self.u8()?;
        if flags & !fix_flag::ALL != 0 {
            return Err(DecodeError::Unknown {
                field: "fix flags",
                value: flags,
            });
        }
        let reset_counter = self.u8()?;
        let (position, tag_in_body) = (self.point()?, self.point()?);
        let heading = match flags & fix_flag::HEADING {
            0 => None,
            _ => Some(self.heading()?),
        };
        let covariance = match flags & fix_flag::COVARIANCE {
            0 => None,
            _ => Some(PositionCovariance {
                xx_m2: self.f64()?,
                xy_m2: self.f64()?,
                yy_m2: self.f64()?,
                heading_rad2: self.f64()?,
            }),
        };
        Ok(Fix {
            position,
            heading,
            covariance,
            tag_in_body,
            reset_counter,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: Place = Place {
        sequence: 0,
        log_time: 0,
    };

    /// Appends the checksum as the format page describes it, computed bit by bit and not by the library.
    fn sealed(body: &[u8], place: Place) -> Vec<u8> {
        let mut crc = u32::MAX;
        let prefix = [
            &place.sequence.to_le_bytes()[..],
            &place.log_time.to_le_bytes()[..],
        ]
        .concat();
        for byte in prefix.iter().chain(body) {
            crc ^= u32::from(*byte);
            for _ in 0..8 {
                crc = if crc & 1 == 1 {
                    (crc >> 1) ^ 0xEDB8_8320
                } else {
                    crc >> 1
                };
            }
        }
        [body, &(!crc).to_le_bytes()].concat()
    }

    #[test]
    fn a_time_beyond_the_host_clock_is_refused_and_not_turned_negative() {
        let at = |log_time| {
            let place = Place {
                sequence: 0,
                log_time,
            };
            decode(&sealed(&[VERSION, tag::TICK], place), place)
        };
        let last = i64::MAX as u64;
        assert_eq!(at(last), Ok(Input::Tick));
        assert_eq!(at(last + 1), Err(DecodeError::Time(last + 1)));
        assert_eq!(at(u64::MAX), Err(DecodeError::Time(u64::MAX)));
    }

    fn check(body: &[u8], input: &Input) {
        let place = Place {
            sequence: 7,
            log_time: 1_234_567_890,
        };
        let bytes = sealed(body, place);
        let mut written = Vec::new();
        encode(input, place, &mut written);
        assert_eq!(written, bytes, "{input:?}");
        assert_eq!(decode(&bytes, place).as_ref(), Ok(input));
    }

    #[test]
    fn the_bytes_are_those_of_the_format_page() {
        check(
            &[2, 0, 0x02, 0x01, 0xFE, 0x09],
            &Input::Bytes {
                link: LinkId(0x0102),
                peer: PeerId(0),
                bytes: vec![0xFE, 0x09],
            },
        );
        check(
            &[2, 5, 0x02, 0x01, 9, 0, 0, 1, 0xFE],
            &Input::Bytes {
                link: LinkId(0x0102),
                peer: PeerId(0x0100_0009),
                bytes: vec![0xFE],
            },
        );
        let mut counts = vec![2, 6, 7, 0];
        counts.extend_from_slice(&[1, 0, 0, 0, 0, 0, 0, 0]);
        counts.extend_from_slice(&[2, 0, 0, 0, 0, 0, 0, 0]);
        counts.extend_from_slice(&[3, 0, 0, 0, 4, 0, 0, 0, 5, 0, 0, 0]);
        counts.extend_from_slice(&[0, 0, 0, 0, 0, 0, 0xF0, 0xBF]); // -1: none measured
        check(
            &counts,
            &Input::Port {
                link: LinkId(7),
                counts: PortCounts {
                    bytes_out: 1,
                    drops_out: 2,
                    peers: 3,
                    queued_frames: 4,
                    queued_bytes: 5,
                    capacity_bytes_per_s: None,
                },
            },
        );
        check(
            &[2, 1, 3, 0, 1],
            &Input::Link {
                link: LinkId(3),
                state: LinkState::Up,
            },
        );
        check(&[2, 4], &Input::Tick);
    }

    #[test]
    fn a_turn_rate_stands_where_the_format_page_says() {
        let mut body = vec![2, 2, 1];
        body.extend_from_slice(&[0x00, 0xCA, 0x9A, 0x3B, 0, 0, 0, 0]); // 1e9 ns
        body.extend_from_slice(&[0xFF; 8]); // -1 ns
        body.push(3);
        body.extend_from_slice(&[0, 0, 0, 0, 0, 0, 0xE0, 0xBF]); // -0.5
        check(
            &body,
            &Input::Observation(Observation {
                sensor: SensorId::GYRO,
                stamp: Stamp::from_nanos(1_000_000_000),
                stamp_sigma: Span::from_nanos(-1),
                observed: Observed::TurnRate(RadiansPerSecond(-0.5)),
            }),
        );
    }

    #[test]
    fn what_the_layout_does_not_have_is_named() {
        let check = |body: &[u8], error: DecodeError| {
            assert_eq!(decode(&sealed(body, PLACE), PLACE), Err(error));
        };
        check(&[9, 4], DecodeError::Version(9));
        check(&[1, 4, 0, 0], DecodeError::TooLong(2));
        check(&[1, 0, 5], DecodeError::TooShort { wanted: 2, left: 1 });
        check(
            &[2, 7],
            DecodeError::Unknown {
                field: "input tag",
                value: 7,
            },
        );
        check(
            &[1, 1, 0, 0, 2],
            DecodeError::Unknown {
                field: "link state",
                value: 2,
            },
        );
        let set_pose = [&[1, 3][..], &[0; 16], &4.0_f64.to_le_bytes(), &[0; 16]].concat();
        check(&set_pose, DecodeError::Heading(4.0));
    }

    #[test]
    fn the_layout_before_this_one_is_still_read() {
        assert_eq!(decode(&sealed(&[1, 4], PLACE), PLACE), Ok(Input::Tick));
    }

    #[test]
    fn a_message_at_another_place_is_damage() {
        let bytes = sealed(&[1, 4], PLACE);
        let elsewhere = Place {
            sequence: 1,
            log_time: 0,
        };
        assert!(matches!(
            decode(&bytes, elsewhere),
            Err(DecodeError::Checksum { .. })
        ));
    }
}
