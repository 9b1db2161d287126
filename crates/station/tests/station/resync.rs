//! Torn frames on the way in: how long they hide what comes behind them, and what is counted.

use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, ticks};
use posebridge_protocol::message::{Message, Odometry, OdometryPose, WireStamp};
use posebridge_telemetry::{Event, MetersPerSecond, Pose, RadiansPerSecond, TimeDelta};

/// Silence after which the framer of a stream gives up a frame.
const GAP: TimeDelta = TimeDelta::from_millis(50);

/// A frame of 245 bytes.
fn odometry() -> Vec<u8> {
    let odometry = Odometry {
        stamp: WireStamp::Micros64(1_015_000),
        pose: OdometryPose::Odom(Pose::default()),
        forward_speed: MetersPerSecond(0.2),
        turn_rate: RadiansPerSecond(0.0),
        covariance: Some([1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-3]),
        reset_counter: 0,
        quality: 90,
    };
    let frame = frame(BRICK, &Message::Odometry(odometry));
    assert_eq!(frame.len(), 245);
    frame
}

/// How long after its last byte a heartbeat is received that comes in these pieces, some milliseconds after a truncated frame.
fn delay_behind(truncated: &[u8], quiet_ms: i64, pieces: &[&[u8]]) -> TimeDelta {
    let mut station = TestStation::new(&config());
    let mut now = at(300);
    station.pass_until(now);
    station.bytes(now, truncated);
    now = now + TimeDelta::from_millis(quiet_ms);
    for piece in pieces {
        station.pass_until(now);
        station.bytes(now, piece);
        now = now + TimeDelta::from_millis(4);
    }
    let last_byte = now - TimeDelta::from_millis(4);
    station.pass_until(now + TimeDelta::from_millis(2_000));
    station.when(|event| matches!(event, Event::RobotDetected { .. }))[0] - last_byte
}

#[test]
fn a_heartbeat_after_a_truncated_frame_is_late_by_one_gap_at_most() {
    let (odometry, heartbeat) = (odometry(), frame(BRICK, &HEARTBEAT));
    let (begin, end) = heartbeat.split_at(9);
    for truncated in 1..odometry.len() {
        for quiet_ms in [0, 30, 49, 50, 80] {
            for pieces in [&[&heartbeat[..]][..], &[begin, end]] {
                let delay = delay_behind(&odometry[..truncated], quiet_ms, pieces);
                assert!(delay <= GAP, "{truncated} bytes, {quiet_ms} ms: {delay:?}");
            }
        }
    }
    // A header of 12 bytes promises 233 more: without the time-out they would be waited for.
    assert_eq!(delay_behind(&odometry[..12], 0, &[&heartbeat]), GAP);
    // Silence before the heartbeat has already shown that the header was truncated.
    assert_eq!(delay_behind(&odometry[..12], 50, &[&heartbeat]), TimeDelta::ZERO);
}

/// On a link that is never silent for a gap, a truncated header is detected when as many bytes have come as it promises.
#[test]
fn on_a_busy_link_a_truncated_header_hides_frames_for_its_own_length_and_none_is_lost() {
    let mut station = TestStation::new(&config());
    let truncated = &odometry()[..12];
    station.bytes(at(1_000), truncated);
    let mut bytes_behind = 0;
    let mut hidden = 0;
    for number in 1..=100_u32 {
        let wheels = frame(BRICK, &ticks(1_000 + 20 * number, i64::from(number), 0));
        station.bytes(at(i64::from(1_000 + 20 * number)), &wheels);
        bytes_behind += wheels.len();
        if station.aligned().len() < number as usize {
            hidden += 1;
            assert!(bytes_behind < 245 - 12, "hidden for too long");
        }
    }
    assert!(hidden > 0, "else this test is about nothing");
    assert_eq!(station.aligned().len(), 100);
    // The truncated header was one checksum error, a flipped bit is another, and in the id it makes an unknown message.
    for (index, bit) in [(12, 1), (9, 0x40)] {
        let mut flipped = frame(BRICK, &HEARTBEAT);
        flipped[index] ^= bit;
        station.bytes(at(3_100), &[flipped, frame(BRICK, &HEARTBEAT)].concat());
    }
    let health = station.later_health(LINK);
    assert_eq!((health.checksum_errors, health.unknown_ids), (2, 1));
}
