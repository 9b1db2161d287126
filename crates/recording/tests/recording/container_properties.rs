//! Any inputs and any damage.

use posebridge_recording::container::RecordingReader;
use posebridge_telemetry::{
    Address, Command, Fix, Heading, Input, LandmarkId, LinkId, Meters, Observation, ObservationKind, Ownership,
    ParameterName, PeerId, Point2, Pose, PositionCovariance, Radians, RadiansPerSecond, RobotId, RobotSnapshot,
    SensorId, SimulatorCommand, SlippingWheel, TimeDelta, Timestamp,
};
use proptest::prelude::*;

use crate::container::{Recorded, read_all, sample, write};

fn any_f64() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits)
}

fn any_heading() -> impl Strategy<Value = Heading> {
    any_f64().prop_map(Heading::from_rad)
}

fn any_observation_kind() -> impl Strategy<Value = ObservationKind> {
    let pair = || (any_f64(), any_f64());
    prop_oneof![
        pair().prop_map(|(l, r)| ObservationKind::WheelAngles { left: Radians(l), right: Radians(r) }),
        (any_f64(), any_f64(), any_heading()).prop_map(|(x, y, heading)| ObservationKind::OdometerPose(Pose::new(
            Meters(x),
            Meters(y),
            heading
        ))),
        any_f64().prop_map(|rate| ObservationKind::TurnRate(RadiansPerSecond(rate))),
        any_heading().prop_map(ObservationKind::CompassHeading),
        (any::<u32>(), pair()).prop_map(|(id, (range, bearing))| ObservationKind::Landmark {
            id: LandmarkId(id),
            range: Meters(range),
            bearing: Radians(bearing)
        }),
        (
            pair(),
            proptest::option::of(any_heading()),
            proptest::option::of([any_f64(), any_f64(), any_f64(), any_f64()]),
            any::<u8>()
        )
            .prop_map(|((x, y), heading, covariance, reset_counter)| ObservationKind::Fix(Fix {
                position: Point2::new(Meters(x), Meters(y)),
                heading,
                covariance: covariance.map(|[xx_m2, xy_m2, yy_m2, heading_rad2]| {
                    PositionCovariance { xx_m2, xy_m2, yy_m2, heading_rad2 }
                }),
                tag_in_body: Point2::new(Meters(y), Meters(x)),
                reset_counter,
            })),
    ]
}

/// Whatever stands there, sense or not: the pipeline judges it.
fn simulator_command(number: f64, nanos: i64, kind: u8) -> SimulatorCommand {
    let duration = TimeDelta::from_nanos(nanos);
    match kind {
        0 => SimulatorCommand::Kidnap { forward_m: number, left_m: -number, turn_rad: 1.0 / number },
        1 => SimulatorCommand::Slip { wheel: SlippingWheel::Right, factor: number, duration },
        2 => SimulatorCommand::CameraDelay { delay: duration },
        3 => SimulatorCommand::GyroBiasStep { rad_per_s: number },
        4 => SimulatorCommand::LinkProfile(Some(ParameterName::from_bytes(&nanos.to_le_bytes()))),
        _ => SimulatorCommand::Drive { forward_m_per_s: number, turn_rad_per_s: -number },
    }
}

fn any_input() -> impl Strategy<Value = Input> {
    prop_oneof![
        (any::<u16>(), proptest::collection::vec(any::<u8>(), 0..300))
            .prop_map(|(link, bytes)| { Input::Bytes { peer: PeerId(0), link: LinkId(link), bytes } }),
        Just(Input::Tick),
        (any::<u8>(), any::<i64>(), any::<i64>(), any_observation_kind()).prop_map(
            |(sensor, stamp, sigma, observed)| {
                Input::Observation(Observation {
                    sensor: SensorId(sensor),
                    stamp: Timestamp::from_nanos(stamp),
                    stamp_sigma: TimeDelta::from_nanos(sigma),
                    measurement: observed,
                })
            }
        ),
        (any_f64(), prop::collection::vec(any::<u8>(), 0..20)).prop_map(|(value, name)| {
            let name = ParameterName::from_bytes(&name);
            Input::Command(Command::SetParameter { name, value })
        }),
        (any::<u8>(), ".{0,40}").prop_map(|(severity, text)| Input::Report { severity, text }),
        (any_f64(), any::<i64>(), 0_u8..6).prop_map(|(number, nanos, kind)| {
            Input::Command(Command::Simulator(simulator_command(number, nanos, kind)))
        }),
        (any::<u16>(), any::<u64>(), any::<i64>(), proptest::option::of(prop::collection::vec(any::<u8>(), 0..200)))
            .prop_map(|(link, epoch, nanos, bytes)| {
                let clock_offset = TimeDelta::from_nanos(nanos);
                let state = bytes.map(|bytes| RobotSnapshot { bytes, clock_offset });
                let is_owner = state.is_some() || epoch % 2 == 0;
                let ownership = if is_owner { Ownership::Owner { epoch, state } } else { Ownership::Standby { epoch } };
                Input::Ownership { robot: RobotId { link: LinkId(link), address: Address::new(1, 1) }, ownership }
            }),
        (any_f64(), any_f64(), any_heading(), proptest::option::of((any::<u16>(), any::<u8>()))).prop_map(
            |(x, y, heading, robot)| {
                let command = Command::SetPose {
                    pose: Pose::new(Meters(x), Meters(y), heading),
                    position_sigma_m: y,
                    heading_sigma_rad: x,
                };
                match robot {
                    None => Input::Command(command),
                    Some((link, system)) => {
                        let robot = RobotId { link: LinkId(link), address: Address::new(system, !system) };
                        Input::RobotCommand { robot, command }
                    }
                }
            }
        ),
    ]
}

proptest! {
    #[test]
    fn any_inputs_come_back_bit_for_bit(
        items in proptest::collection::vec((0_i64..i64::MAX, any_input()), 0..20)
    ) {
        let items: Vec<Recorded> = items
            .into_iter()
            .map(|(nanos, input)| (Timestamp::from_nanos(nanos), input))
            .collect();
        let bytes = write(&items);
        let found = read_all(&bytes);
        prop_assert_eq!(found.len(), items.len());
        // Compared through a second file, because NaN does not equal itself.
        prop_assert_eq!(write(&found), bytes);
    }

    #[test]
    fn random_bytes_never_panic(tail in proptest::collection::vec(any::<u8>(), 0..400)) {
        let mut after_magic = mcap::MAGIC.to_vec();
        after_magic.extend_from_slice(&tail);
        let mut after_header = write(&[]);
        after_header.truncate(after_header.len() / 2);
        after_header.extend_from_slice(&tail);
        for bytes in [&tail, &after_magic, &after_header] {
            if let Ok(reader) = RecordingReader::open(bytes) {
                let read = reader.take(1000).count();
                prop_assert!(read < 1000);
            }
        }
    }

    #[test]
    fn random_damage_never_panics(
        hits in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..8)
    ) {
        let mut bytes = write(&sample());
        for (index, value) in hits {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(reader) = RecordingReader::open(&bytes) {
            let read = reader.take(1000).count();
            prop_assert!(read < 1000);
        }
    }
}
