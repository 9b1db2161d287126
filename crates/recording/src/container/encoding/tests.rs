//! The bytes of the format page, written by hand, and what is refused.

use posebridge_telemetry::{
    Command, Input, Learning, LinkId, LinkState, Observation, Observed, ParameterName,
    ParameterStorage, PeerId, PortCounts, RadiansPerSecond, SensorId, Span, Stamp, Switch,
};

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
        &[3, 0, 0x02, 0x01, 0xFE, 0x09],
        &Input::Bytes {
            link: LinkId(0x0102),
            peer: PeerId(0),
            bytes: vec![0xFE, 0x09],
        },
    );
    check(
        &[3, 5, 0x02, 0x01, 9, 0, 0, 1, 0xFE],
        &Input::Bytes {
            link: LinkId(0x0102),
            peer: PeerId(0x0100_0009),
            bytes: vec![0xFE],
        },
    );
    let mut counts = vec![3, 6, 7, 0];
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
        &[3, 1, 3, 0, 1],
        &Input::Link {
            link: LinkId(3),
            state: LinkState::Up,
        },
    );
    check(&[3, 4], &Input::Tick);
}

#[test]
fn commands_and_reports_stand_where_the_format_page_says() {
    let command = |body: &[u8], command| check(body, &Input::Command(command));
    command(&[3, 7, 0], Command::ResetPose);
    command(
        &[
            3, 7, 1, 0, 0, 0, 0, 0, 0, 0xE0, 0xBF, b's', b'l', b'i', b'p',
        ],
        Command::SetParameter {
            name: ParameterName::from_bytes(b"slip"),
            value: -0.5,
        },
    );
    command(&[3, 7, 2], Command::Parameters(ParameterStorage::Save));
    command(&[3, 7, 3], Command::Parameters(ParameterStorage::Reload));
    command(&[3, 7, 4], Command::Parameters(ParameterStorage::Default));
    command(&[3, 7, 5], Command::Learning(Learning::Frozen));
    command(&[3, 7, 6], Command::Learning(Learning::Free));
    command(&[3, 7, 7], Command::ResetCalibration);
    for (kind, to) in [(8, Switch::Off), (9, Switch::On)] {
        let sensor = SensorId::CAMERA;
        command(&[3, 7, kind, 3], Command::SwitchSource { sensor, to });
    }
    command(&[3, 7, 10], Command::StartRecording);
    command(&[3, 7, 11], Command::StopRecording);
    check(
        &[3, 8, 4, b'f', 0xC3, 0xBC],
        &Input::Report {
            severity: 4,
            text: "f\u{fc}".to_owned(),
        },
    );
}

#[test]
fn a_turn_rate_stands_where_the_format_page_says() {
    let mut body = vec![3, 2, 1];
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
        &[3, 9],
        DecodeError::Unknown {
            field: "input tag",
            value: 9,
        },
    );
    check(
        &[3, 7, 12],
        DecodeError::Unknown {
            field: "command",
            value: 12,
        },
    );
    check(&[3, 7, 5, 0], DecodeError::TooLong(1));
    check(&[3, 8, 6, 0xFF], DecodeError::Text("a report"));
    let name = |name: &[u8]| [&[3, 7, 1][..], &[0; 8], name].concat();
    check(&name(b"a b"), DecodeError::Text("a parameter's name"));
    check(
        &name(b"seventeen_letters"),
        DecodeError::Text("a parameter's name"),
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
fn the_layouts_before_this_one_are_still_read() {
    assert_eq!(decode(&sealed(&[1, 4], PLACE), PLACE), Ok(Input::Tick));
    assert_eq!(decode(&sealed(&[2, 4], PLACE), PLACE), Ok(Input::Tick));
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
