//! The bytes of the format page, written by hand, and what is refused.

use posebridge_telemetry::{
    Input, LinkId, LinkState, Observation, Observed, PeerId, PortCounts, RadiansPerSecond,
    SensorId, Span, Stamp,
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
