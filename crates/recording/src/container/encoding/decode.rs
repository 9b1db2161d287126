//! Decodes a message: version, checksum and input.

use posebridge_telemetry::{
    Address, BeaconId, Celsius, ChannelName, Command, FilterComparison, Fix, Heading, Input, LandmarkId, LinkCounts,
    LinkId, LinkState, Meters, MetersPerSecond, MetersPerSecondSquared, Observation, ObservationKind,
    OnlineCalibration, OutsideFix, Ownership, ParameterStorage, PeerId, Point2, Pose, PositionCovariance, Radians,
    RadiansPerSecond, RobotId, RobotSnapshot, SensorId, SensorSwitch, SimulatorCommand, SlippingWheel, StationInput,
    SteeringSource, TimeDelta, Timestamp,
};

use super::super::fields::ByteReader;
use super::{
    CHECKSUM_BYTES, DROPPED_DATAGRAMS_VERSION, DecodeError, NEWEST_VERSION, OLDEST_VERSION, RecordPosition, command,
    fix_flag, kind, ownership, simulator, tag,
};

pub(in crate::container) fn decode(bytes: &[u8], position: RecordPosition) -> Result<Input, DecodeError> {
    let Some((body, checksum)) = bytes.split_last_chunk::<CHECKSUM_BYTES>() else {
        return Err(DecodeError::TooShort { wanted: CHECKSUM_BYTES, left: bytes.len() });
    };
    let (found, expected) = (u32::from_le_bytes(*checksum), position.checksum(body));
    if found != expected {
        return Err(DecodeError::Checksum { found, expected });
    }
    if i64::try_from(position.log_time).is_err() {
        return Err(DecodeError::Time(position.log_time));
    }
    let mut reader = ByteReader { remaining: body };
    let version = reader.u8()?;
    if !(OLDEST_VERSION..=NEWEST_VERSION).contains(&version) {
        return Err(DecodeError::Version(version));
    }
    let input = reader.input(version)?;
    match reader.remaining.len() {
        0 => Ok(input),
        left => Err(DecodeError::TooLong(left)),
    }
}

impl<'a> ByteReader<'a> {
    fn counts(&mut self, version: u8) -> Result<LinkCounts, DecodeError> {
        let mut counts = LinkCounts {
            bytes_out: self.u64()?,
            drops_out: self.u64()?,
            peers: self.u32()?,
            queued_frames: self.u32()?,
            queued_bytes: self.u32()?,
            capacity_bytes_per_s: Some(self.f64()?).filter(|capacity| *capacity >= 0.0),
            ..LinkCounts::default()
        };
        if version >= DROPPED_DATAGRAMS_VERSION {
            counts.kernel_drops = self.u64()?;
            counts.flood_drops = self.u64()?;
        }
        Ok(counts)
    }

    fn heading(&mut self) -> Result<Heading, DecodeError> {
        let angle_rad = self.f64()?;
        let heading = Heading::from_rad(angle_rad);
        // What `Heading` would change was not written by us: refused, because replay promises the same bits.
        if heading.rad().to_bits() == angle_rad.to_bits() { Ok(heading) } else { Err(DecodeError::Heading(angle_rad)) }
    }

    fn pose<S>(&mut self) -> Result<Pose<S>, DecodeError> {
        Ok(Pose::new(Meters(self.f64()?), Meters(self.f64()?), self.heading()?))
    }

    fn point<S>(&mut self) -> Result<Point2<S>, DecodeError> {
        Ok(Point2::new(Meters(self.f64()?), Meters(self.f64()?)))
    }

    fn input(&mut self, version: u8) -> Result<Input, DecodeError> {
        Ok(match self.u8()? {
            tag::BYTES => Input::Bytes {
                link: LinkId(self.u16()?),
                peer: PeerId::default(),
                bytes: std::mem::take(&mut self.remaining).to_vec(),
            },
            tag::PEER_BYTES => Input::Bytes {
                link: LinkId(self.u16()?),
                peer: PeerId(self.u32()?),
                bytes: std::mem::take(&mut self.remaining).to_vec(),
            },
            tag::PORT => Input::Port { link: LinkId(self.u16()?), counts: self.counts(version)? },
            tag::LINK => Input::Link {
                link: LinkId(self.u16()?),
                state: match self.u8()? {
                    0 => LinkState::Down,
                    1 => LinkState::Up,
                    value => {
                        return Err(DecodeError::Unknown { field: "link state", value });
                    }
                },
            },
            tag::PEER_ADDRESS => {
                let (link, peer) = (LinkId(self.u16()?), PeerId(self.u32()?));
                let text = self.remaining_text("the address of a peer")?;
                let host = text.parse().map_err(|_unreadable| DecodeError::Text("the address of a peer"))?;
                Input::PeerAddress { link, peer, host }
            }
            tag::OBSERVATION => Input::Observation(self.observation()?),
            tag @ (tag::SET_POSE | tag::COMMAND | tag::SIMULATOR) => Input::Command(self.command(tag)?),
            tag::ROBOT_COMMAND => {
                let robot = self.robot()?;
                let tag = self.u8()?;
                Input::RobotCommand { robot, command: self.command(tag)? }
            }
            tag::OWNERSHIP => Input::Ownership { robot: self.robot()?, ownership: self.ownership()? },
            tag::OUTSIDE_FIX => Input::OutsideFix {
                robot: self.robot()?,
                fix: OutsideFix {
                    source: Address::new(self.u8()?, self.u8()?),
                    time: Timestamp::from_nanos(self.i64()?),
                    uncertainty: TimeDelta::from_nanos(self.i64()?),
                    fix: self.fix()?,
                },
            },
            tag::REPORT => Input::Report { severity: self.u8()?, text: self.remaining_text("a report")?.to_owned() },
            tag::TICK => Input::Tick,
            tag::OF_STATION => Input::OfStation { station: self.u16()?, input: self.station_input()? },
            value => {
                return Err(DecodeError::Unknown { field: "input tag", value });
            }
        })
    }

    fn robot(&mut self) -> Result<RobotId, DecodeError> {
        let link = LinkId(self.u16()?);
        Ok(RobotId { link, address: Address::new(self.u8()?, self.u8()?) })
    }

    fn station_input(&mut self) -> Result<StationInput, DecodeError> {
        Ok(match self.u8()? {
            tag @ (tag::SET_POSE | tag::COMMAND | tag::SIMULATOR) => StationInput::Command(self.command(tag)?),
            tag::REPORT => {
                StationInput::Report { severity: self.u8()?, text: self.remaining_text("a report")?.to_owned() }
            }
            tag::TICK => StationInput::Tick,
            value => {
                return Err(DecodeError::Unknown { field: "tag of a station's input", value });
            }
        })
    }

    fn ownership(&mut self) -> Result<Ownership, DecodeError> {
        let (owner, epoch) = (self.u8()?, self.u64()?);
        Ok(match owner {
            ownership::STANDBY => Ownership::Standby { epoch },
            ownership::OWNER => Ownership::Owner { epoch, state: None },
            ownership::OWNER_WITH_STATE => {
                let clock_offset = TimeDelta::from_nanos(self.i64()?);
                let bytes = std::mem::take(&mut self.remaining).to_vec();
                Ownership::Owner { epoch, state: Some(RobotSnapshot { bytes, clock_offset }) }
            }
            value => {
                return Err(DecodeError::Unknown { field: "ownership", value });
            }
        })
    }

    fn command(&mut self, tag: u8) -> Result<Command, DecodeError> {
        Ok(match tag {
            tag::SET_POSE => {
                Command::SetPose { pose: self.pose()?, position_sigma_m: self.f64()?, heading_sigma_rad: self.f64()? }
            }
            tag::COMMAND => self.plain_command()?,
            tag::SIMULATOR => Command::Simulator(self.simulator()?),
            value => {
                return Err(DecodeError::Unknown { field: "command tag", value });
            }
        })
    }

    fn plain_command(&mut self) -> Result<Command, DecodeError> {
        Ok(match self.u8()? {
            command::RESET_POSE => Command::ResetPose,
            command::SET_PARAMETER => {
                Command::SetParameter { value: self.f64()?, name: self.remaining_name("a parameter's name")? }
            }
            command::SAVE_PARAMETERS => Command::Parameters(ParameterStorage::Save),
            command::RELOAD_PARAMETERS => Command::Parameters(ParameterStorage::Reload),
            command::DEFAULT_PARAMETERS => Command::Parameters(ParameterStorage::Default),
            command::FREEZE => Command::OnlineCalibration(OnlineCalibration::Frozen),
            command::LEARN => Command::OnlineCalibration(OnlineCalibration::Enabled),
            command::RESET_CALIBRATION => Command::ResetCalibration,
            command::SOURCE_OFF => Command::SwitchSource { sensor: SensorId(self.u8()?), to: SensorSwitch::Off },
            command::SOURCE_ON => Command::SwitchSource { sensor: SensorId(self.u8()?), to: SensorSwitch::On },
            command::START_RECORDING => Command::StartRecording,
            command::STOP_RECORDING => Command::StopRecording,
            command::COMPARE_OFF => Command::CompareFilters(FilterComparison::Off),
            command::COMPARE_ON => Command::CompareFilters(FilterComparison::On),
            command::DRIVE => {
                Command::Drive { forward: MetersPerSecond(self.f64()?), turn: RadiansPerSecond(self.f64()?) }
            }
            value => {
                return Err(DecodeError::Unknown { field: "command", value });
            }
        })
    }

    fn remaining_text(&mut self, what: &'static str) -> Result<&'a str, DecodeError> {
        let rest = std::mem::take(&mut self.remaining);
        std::str::from_utf8(rest).map_err(|_invalid| DecodeError::Text(what))
    }

    fn remaining_name(&mut self, what: &'static str) -> Result<ChannelName, DecodeError> {
        let text = self.remaining_text(what)?;
        let name = ChannelName::from_bytes(text.as_bytes());
        // What a name would change was not written by us.
        if name.as_str() == text { Ok(name) } else { Err(DecodeError::Text(what)) }
    }

    fn observation(&mut self) -> Result<Observation, DecodeError> {
        Ok(Observation {
            sensor: SensorId(self.u8()?),
            stamp: Timestamp::from_nanos(self.i64()?),
            stamp_sigma: TimeDelta::from_nanos(self.i64()?),
            measurement: self.observation_kind()?,
        })
    }

    fn observation_kind(&mut self) -> Result<ObservationKind, DecodeError> {
        Ok(match self.u8()? {
            kind::WHEEL_ANGLES => {
                ObservationKind::WheelAngles { left: Radians(self.f64()?), right: Radians(self.f64()?) }
            }
            kind::ODOMETER_POSE => ObservationKind::OdometerPose(self.pose()?),
            kind::BODY_VELOCITY => ObservationKind::BodyVelocity {
                forward: MetersPerSecond(self.f64()?),
                turn: RadiansPerSecond(self.f64()?),
            },
            kind::TURN_RATE => ObservationKind::TurnRate(RadiansPerSecond(self.f64()?)),
            kind::WHEEL_ACCELERATIONS => ObservationKind::WheelAccelerations {
                left: MetersPerSecondSquared(self.f64()?),
                right: MetersPerSecondSquared(self.f64()?),
            },
            kind::FIX => ObservationKind::Fix(self.fix()?),
            kind::LANDMARK => ObservationKind::Landmark {
                id: LandmarkId(self.u32()?),
                range: Meters(self.f64()?),
                bearing: Radians(self.f64()?),
            },
            kind::BEACON_RANGE => {
                ObservationKind::BeaconRange { id: BeaconId(self.u32()?), range: Meters(self.f64()?) }
            }
            kind::WALL_RANGE => ObservationKind::WallRange(Meters(self.f64()?)),
            kind::COMPASS_HEADING => ObservationKind::CompassHeading(self.heading()?),
            kind::TEMPERATURE => ObservationKind::Temperature(Celsius(self.f64()?)),
            value => {
                return Err(DecodeError::Unknown { field: "observation kind", value });
            }
        })
    }

    fn fix(&mut self) -> Result<Fix, DecodeError> {
        let flags = self.u8()?;
        if flags & !fix_flag::ALL != 0 {
            return Err(DecodeError::Unknown { field: "fix flags", value: flags });
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
        Ok(Fix { position, heading, covariance, tag_in_body, reset_counter })
    }

    /// Decodes the command for the simulated brick that begins here.
    fn simulator(&mut self) -> Result<SimulatorCommand, DecodeError> {
        Ok(match self.u8()? {
            simulator::KIDNAP => {
                SimulatorCommand::Kidnap { forward_m: self.f64()?, left_m: self.f64()?, turn_rad: self.f64()? }
            }
            simulator::SLIP => SimulatorCommand::Slip {
                factor: self.f64()?,
                duration: self.duration()?,
                wheel: self.choice("slipping wheel", &SlippingWheel::ALL)?,
            },
            simulator::CAMERA_OFF => SimulatorCommand::Camera(SensorSwitch::Off),
            simulator::CAMERA_ON => SimulatorCommand::Camera(SensorSwitch::On),
            simulator::CAMERA_DELAY => SimulatorCommand::CameraDelay { delay: self.duration()? },
            simulator::GYRO_BIAS_STEP => SimulatorCommand::GyroBiasStep { rad_per_s: self.f64()? },
            simulator::LINK_PROFILE => {
                SimulatorCommand::LinkProfile(Some(self.remaining_name("a link profile's name")?))
            }
            simulator::NO_LINK_PROFILE => SimulatorCommand::LinkProfile(None),
            simulator::PULL_CABLE => SimulatorCommand::PullCable { duration: self.duration()? },
            simulator::STEERING => SimulatorCommand::Steering(self.choice("steering source", &SteeringSource::ALL)?),
            simulator::DRIVE => SimulatorCommand::Drive { forward_m_per_s: self.f64()?, turn_rad_per_s: self.f64()? },
            simulator::PATH => SimulatorCommand::Path,
            value => {
                return Err(DecodeError::Unknown { field: "command for the simulated brick", value });
            }
        })
    }

    fn duration(&mut self) -> Result<TimeDelta, DecodeError> {
        self.i64().map(TimeDelta::from_nanos)
    }

    fn choice<T: Copy>(&mut self, field: &'static str, all: &[T]) -> Result<T, DecodeError> {
        let value = self.u8()?;
        all.get(usize::from(value)).copied().ok_or(DecodeError::Unknown { field, value })
    }
}
