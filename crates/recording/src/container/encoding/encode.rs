use posebridge_telemetry::{
    Command, FilterComparison, Fix, Input, LinkCounts, LinkState, Observation, ObservationKind, OnlineCalibration,
    OutsideFix, Ownership, ParameterStorage, PeerId, Pose, RobotId, RobotSnapshot, SensorSwitch, SimulatorCommand,
    SlippingWheel, StationInput, SteeringSource, TimeDelta,
};

use super::{
    DROPPED_DATAGRAMS_VERSION, ENCODING_VERSION, OF_STATION_VERSION, OUTSIDE_FIX_VERSION, OWNERSHIP_VERSION,
    PEER_ADDRESS_VERSION, ROBOT_COMMAND_VERSION, RecordPosition, command, fix_flag, kind, ownership, put_numbers,
    simulator, tag,
};

/// `bytes` must be empty.
pub(in crate::container) fn encode(input: &Input, position: RecordPosition, bytes: &mut Vec<u8>) {
    bytes.push(match input {
        Input::Command(Command::Drive { .. })
        | Input::RobotCommand { command: Command::Drive { .. }, .. }
        | Input::OutsideFix { .. } => OUTSIDE_FIX_VERSION,
        Input::RobotCommand { .. } => ROBOT_COMMAND_VERSION,
        Input::PeerAddress { .. } => PEER_ADDRESS_VERSION,
        Input::Port { counts, .. } if has_dropped(counts) => DROPPED_DATAGRAMS_VERSION,
        Input::Ownership { .. } => OWNERSHIP_VERSION,
        Input::OfStation { .. } => OF_STATION_VERSION,
        Input::Bytes { .. }
        | Input::Port { .. }
        | Input::Link { .. }
        | Input::Observation(_)
        | Input::Command(_)
        | Input::Report { .. }
        | Input::Tick => ENCODING_VERSION,
    });
    match input {
        Input::Bytes { link, peer, bytes: payload } => {
            let is_first = *peer == PeerId::default();
            bytes.push(if is_first { tag::BYTES } else { tag::PEER_BYTES });
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
        Input::PeerAddress { link, peer, host } => {
            bytes.push(tag::PEER_ADDRESS);
            bytes.extend_from_slice(&link.0.to_le_bytes());
            bytes.extend_from_slice(&peer.0.to_le_bytes());
            bytes.extend_from_slice(host.to_string().as_bytes());
        }
        Input::Observation(observation) => {
            bytes.push(tag::OBSERVATION);
            put_observation(observation, bytes);
        }
        Input::Command(command) => put_command(command, bytes),
        Input::RobotCommand { robot, command } => {
            bytes.push(tag::ROBOT_COMMAND);
            put_robot(*robot, bytes);
            put_command(command, bytes);
        }
        Input::Ownership { robot, ownership: decided } => {
            bytes.push(tag::OWNERSHIP);
            put_robot(*robot, bytes);
            put_ownership(decided, bytes);
        }
        Input::OutsideFix { robot, fix: OutsideFix { source, time, uncertainty, fix } } => {
            bytes.push(tag::OUTSIDE_FIX);
            put_robot(*robot, bytes);
            bytes.extend_from_slice(&[source.system.0, source.component.0]);
            bytes.extend_from_slice(&time.as_nanos().to_le_bytes());
            bytes.extend_from_slice(&uncertainty.as_nanos().to_le_bytes());
            put_fix(fix, bytes);
        }
        Input::Report { severity, text } => put_report(*severity, text, bytes),
        Input::Tick => bytes.push(tag::TICK),
        Input::OfStation { station, input } => {
            bytes.push(tag::OF_STATION);
            bytes.extend_from_slice(&station.to_le_bytes());
            match input {
                StationInput::Command(command) => put_command(command, bytes),
                StationInput::Report { severity, text } => put_report(*severity, text, bytes),
                StationInput::Tick => bytes.push(tag::TICK),
            }
        }
    }
    let checksum = position.checksum(bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
}

fn put_robot(robot: RobotId, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&robot.link.0.to_le_bytes());
    bytes.extend_from_slice(&[robot.address.system.0, robot.address.component.0]);
}

fn put_report(severity: u8, text: &str, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&[tag::REPORT, severity]);
    bytes.extend_from_slice(text.as_bytes());
}

fn put_ownership(decided: &Ownership, bytes: &mut Vec<u8>) {
    bytes.push(match decided {
        Ownership::Standby { .. } => ownership::STANDBY,
        Ownership::Owner { state: None, .. } => ownership::OWNER,
        Ownership::Owner { state: Some(_), .. } => ownership::OWNER_WITH_STATE,
    });
    bytes.extend_from_slice(&decided.epoch().to_le_bytes());
    if let Ownership::Owner { state: Some(RobotSnapshot { bytes: state, clock_offset }), .. } = decided {
        bytes.extend_from_slice(&clock_offset.as_nanos().to_le_bytes());
        bytes.extend_from_slice(state);
    }
}

fn put_command(command: &Command, bytes: &mut Vec<u8>) {
    let mut put = |kind: u8| bytes.extend_from_slice(&[tag::COMMAND, kind]);
    match command {
        Command::SetPose { pose, position_sigma_m, heading_sigma_rad } => {
            bytes.push(tag::SET_POSE);
            put_pose(*pose, bytes);
            put_numbers(&[*position_sigma_m, *heading_sigma_rad], bytes);
        }
        Command::SetParameter { name, value } => {
            put(command::SET_PARAMETER);
            put_numbers(&[*value], bytes);
            bytes.extend_from_slice(name.as_str().as_bytes());
        }
        Command::SwitchSource { sensor, to } => {
            put(match to {
                SensorSwitch::Off => command::SOURCE_OFF,
                SensorSwitch::On => command::SOURCE_ON,
            });
            bytes.push(sensor.0);
        }
        Command::ResetPose => put(command::RESET_POSE),
        Command::Parameters(ParameterStorage::Save) => put(command::SAVE_PARAMETERS),
        Command::Parameters(ParameterStorage::Reload) => put(command::RELOAD_PARAMETERS),
        Command::Parameters(ParameterStorage::Default) => put(command::DEFAULT_PARAMETERS),
        Command::OnlineCalibration(OnlineCalibration::Frozen) => put(command::FREEZE),
        Command::OnlineCalibration(OnlineCalibration::Enabled) => put(command::LEARN),
        Command::ResetCalibration => put(command::RESET_CALIBRATION),
        Command::StartRecording => put(command::START_RECORDING),
        Command::StopRecording => put(command::STOP_RECORDING),
        Command::CompareFilters(FilterComparison::Off) => put(command::COMPARE_OFF),
        Command::CompareFilters(FilterComparison::On) => put(command::COMPARE_ON),
        Command::Drive { forward, turn } => {
            put(command::DRIVE);
            put_numbers(&[forward.0, turn.0], bytes);
        }
        Command::Simulator(command) => {
            bytes.push(tag::SIMULATOR);
            put_simulator(command, bytes);
        }
    }
}

fn put_pose<S>(pose: Pose<S>, bytes: &mut Vec<u8>) {
    put_numbers(&[pose.x.0, pose.y.0, pose.heading.rad()], bytes);
}

fn put_counts(counts: &LinkCounts, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&counts.bytes_out.to_le_bytes());
    bytes.extend_from_slice(&counts.drops_out.to_le_bytes());
    for count in [counts.peers, counts.queued_frames, counts.queued_bytes] {
        bytes.extend_from_slice(&count.to_le_bytes());
    }
    // No link takes less than nothing: a negative capacity says that none was measured.
    put_numbers(&[counts.capacity_bytes_per_s.unwrap_or(-1.0)], bytes);
    if has_dropped(counts) {
        bytes.extend_from_slice(&counts.kernel_drops.to_le_bytes());
        bytes.extend_from_slice(&counts.flood_drops.to_le_bytes());
    }
}

const fn has_dropped(counts: &LinkCounts) -> bool {
    counts.kernel_drops > 0 || counts.flood_drops > 0
}

fn put_observation(observation: &Observation, bytes: &mut Vec<u8>) {
    bytes.push(observation.sensor.0);
    bytes.extend_from_slice(&observation.stamp.as_nanos().to_le_bytes());
    bytes.extend_from_slice(&observation.stamp_sigma.as_nanos().to_le_bytes());
    put_observation_kind(&observation.measurement, bytes);
}

fn put_observation_kind(observed: &ObservationKind, bytes: &mut Vec<u8>) {
    let mut put = |kind: u8, values: &[f64]| {
        bytes.push(kind);
        put_numbers(values, bytes);
    };
    match observed {
        ObservationKind::WheelAngles { left, right } => put(kind::WHEEL_ANGLES, &[left.0, right.0]),
        ObservationKind::OdometerPose(pose) => put(kind::ODOMETER_POSE, &[pose.x.0, pose.y.0, pose.heading.rad()]),
        ObservationKind::BodyVelocity { forward, turn } => put(kind::BODY_VELOCITY, &[forward.0, turn.0]),
        ObservationKind::TurnRate(rate) => put(kind::TURN_RATE, &[rate.0]),
        ObservationKind::WheelAccelerations { left, right } => {
            put(kind::WHEEL_ACCELERATIONS, &[left.0, right.0]);
        }
        ObservationKind::WallRange(range) => put(kind::WALL_RANGE, &[range.0]),
        ObservationKind::CompassHeading(heading) => put(kind::COMPASS_HEADING, &[heading.rad()]),
        ObservationKind::Temperature(temperature) => put(kind::TEMPERATURE, &[temperature.0]),
        ObservationKind::Fix(fix) => {
            bytes.push(kind::FIX);
            put_fix(fix, bytes);
        }
        ObservationKind::Landmark { id, range, bearing } => {
            bytes.push(kind::LANDMARK);
            bytes.extend_from_slice(&id.0.to_le_bytes());
            put_numbers(&[range.0, bearing.0], bytes);
        }
        ObservationKind::BeaconRange { id, range } => {
            bytes.push(kind::BEACON_RANGE);
            bytes.extend_from_slice(&id.0.to_le_bytes());
            put_numbers(&[range.0], bytes);
        }
    }
}

fn put_fix(fix: &Fix, bytes: &mut Vec<u8>) {
    let heading = if fix.heading.is_some() { fix_flag::HEADING } else { 0 };
    let covariance = if fix.covariance.is_some() { fix_flag::COVARIANCE } else { 0 };
    bytes.push(heading | covariance);
    bytes.push(fix.reset_counter);
    put_numbers(&[fix.position.x.0, fix.position.y.0, fix.tag_in_body.x.0, fix.tag_in_body.y.0], bytes);
    if let Some(heading) = fix.heading {
        put_numbers(&[heading.rad()], bytes);
    }
    if let Some(c) = fix.covariance {
        put_numbers(&[c.xx_m2, c.xy_m2, c.yy_m2, c.heading_rad2], bytes);
    }
}

fn put_simulator(command: &SimulatorCommand, bytes: &mut Vec<u8>) {
    let mut put = |kind: u8, values: &[f64]| {
        bytes.push(kind);
        put_numbers(values, bytes);
    };
    match command {
        SimulatorCommand::Kidnap { forward_m, left_m, turn_rad } => {
            put(simulator::KIDNAP, &[*forward_m, *left_m, *turn_rad]);
        }
        SimulatorCommand::Slip { wheel, factor, duration } => {
            put(simulator::SLIP, &[*factor]);
            put_duration(*duration, bytes);
            bytes.push(index_of(&SlippingWheel::ALL, wheel));
        }
        SimulatorCommand::Camera(SensorSwitch::Off) => put(simulator::CAMERA_OFF, &[]),
        SimulatorCommand::Camera(SensorSwitch::On) => put(simulator::CAMERA_ON, &[]),
        SimulatorCommand::CameraDelay { delay } => {
            put(simulator::CAMERA_DELAY, &[]);
            put_duration(*delay, bytes);
        }
        SimulatorCommand::GyroBiasStep { rad_per_s } => {
            put(simulator::GYRO_BIAS_STEP, &[*rad_per_s]);
        }
        SimulatorCommand::LinkProfile(Some(name)) => {
            put(simulator::LINK_PROFILE, &[]);
            bytes.extend_from_slice(name.as_str().as_bytes());
        }
        SimulatorCommand::LinkProfile(None) => put(simulator::NO_LINK_PROFILE, &[]),
        SimulatorCommand::PullCable { duration } => {
            put(simulator::PULL_CABLE, &[]);
            put_duration(*duration, bytes);
        }
        SimulatorCommand::Steering(source) => {
            bytes.extend_from_slice(&[simulator::STEERING, index_of(&SteeringSource::ALL, source)]);
        }
        SimulatorCommand::Drive { forward_m_per_s, turn_rad_per_s } => {
            put(simulator::DRIVE, &[*forward_m_per_s, *turn_rad_per_s]);
        }
        SimulatorCommand::Path => put(simulator::PATH, &[]),
    }
}

fn put_duration(duration: TimeDelta, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&duration.as_nanos().to_le_bytes());
}

/// Index of `one` in `all`, which must contain it.
fn index_of<T: PartialEq>(all: &[T], one: &T) -> u8 {
    all.iter().take_while(|other| *other != one).count() as u8
}
