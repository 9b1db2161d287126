//! Damage on the way in, through the whole engine: bytes in pieces and in virtual time, observations out.
//!
//! The framer has the same four kinds of damage in a test of its own. Here it is about what comes of them: every observation that
//! reaches the estimator is one that was sent, in its order, with its values and its stamp, and none of an intact frame is missing.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::wildcard_enum_match_arm,
    reason = "the figures are to be read, and a test picks the events that it is about and stops at the first surprise"
)]
#![expect(dead_code, reason = "the helpers are shared with tests that need others of them")]

#[path = "support/damage.rs"]
mod damage;
#[path = "support/station.rs"]
mod station;

use damage::{BRICK, Condition, DAMAGE_KINDS, DamageKind, DamagedBrick, ObservationLedger, message};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, Input, LinkState, Output, PeerId, TimeDelta, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use station::{LINK, TestStation, config};

const FRAMES: i64 = 100_000;
/// 200 frames per second.
const PERIOD_MS: i64 = 5;
/// Now and then the brick pauses for longer than a frame is waited for.
const PAUSE_EVERY: i64 = 101;
const PAUSE_MS: i64 = 80;
/// Silence after which the framer of a stream gives up a frame.
const GAP: TimeDelta = TimeDelta::from_millis(50);
/// When the brick sends its message of this number, by the clock that it shares with the host.
fn sent_ms(number: i64) -> i64 {
    1_000 + number * PERIOD_MS + number / PAUSE_EVERY * PAUSE_MS
}

/// The engine, told of every piece of bytes at its instant and of every deadline at its own.
struct StationUnderTest {
    engine: Station,
    ledger: ObservationLedger,
}

impl StationUnderTest {
    fn new() -> Self {
        let config = config();
        let ledger = ObservationLedger::new(config.robot.filter_config.geometry.left_wheel_radius.0);
        let engine = Station::new(config, Timestamp::ZERO).expect("the configuration is good");
        let mut under_test = Self { engine, ledger };
        let (link, state) = (LINK, LinkState::Up);
        under_test.handle(Timestamp::ZERO, &Input::Link { link, state });
        under_test
    }

    fn handle(&mut self, now: Timestamp<HostClock>, input: &Input) {
        self.engine.handle(now, input);
        while let Some(output) = self.engine.poll() {
            if let Output::Event(event) = output {
                self.ledger.on_event(&event);
            }
        }
    }

    fn pass_until(&mut self, until: Timestamp<HostClock>) {
        while let Some(due) = self.engine.deadline().filter(|due| *due <= until) {
            self.handle(due, &Input::Tick);
        }
    }

    fn bytes(&mut self, now: Timestamp<HostClock>, bytes: &[u8]) {
        self.pass_until(now);
        let input = Input::Bytes { link: LINK, peer: PeerId::default(), bytes: bytes.to_vec() };
        self.handle(now, &input);
    }
}

/// Drives `FRAMES` frames through the engine, each in three pieces, and returns the books after two seconds of silence.
fn drive(kind: &DamageKind) -> ObservationLedger {
    let mut rng = Pcg64::seed_from_u64(7);
    let mut brick = DamagedBrick::new(kind);
    let mut under_test = StationUnderTest::new();
    for number in 0..FRAMES {
        let bytes = brick.send(number, sent_ms(number), &mut under_test.ledger);
        let mut cuts = [0, 0].map(|_| rng.random_range(0..=bytes.len()));
        cuts.sort_unstable();
        let pieces = [&bytes[..cuts[0]], &bytes[cuts[0]..cuts[1]], &bytes[cuts[1]..]];
        for (millis, piece) in (sent_ms(number)..).zip(pieces) {
            under_test.bytes(Timestamp::from_millis(millis), piece);
        }
    }
    under_test.pass_until(Timestamp::from_millis(sent_ms(FRAMES) + 2_000));
    under_test.ledger
}

#[test]
fn what_is_observed_is_what_was_sent_whole_whatever_is_done_to_the_rest() {
    for kind in &DAMAGE_KINDS {
        let ledger = drive(kind);
        ledger.check(kind.name, FRAMES);
        // What is torn before a pause is given up at its deadline and not when the next bytes come.
        assert!(ledger.health.timeouts > 0 || !kind.tears, "{}", kind.name);
    }
}

/// How long after its last byte a heartbeat is heard that comes in these pieces, some milliseconds after a torn frame.
fn delay_behind(torn: &[u8], quiet_ms: i64, pieces: &[&[u8]]) -> TimeDelta {
    let mut station = TestStation::new(&config());
    let mut now = Timestamp::from_millis(300);
    station.pass_until(now);
    station.bytes(now, torn);
    now = now + TimeDelta::from_millis(quiet_ms);
    for piece in pieces {
        station.pass_until(now);
        station.bytes(now, piece);
        now = now + TimeDelta::from_millis(4);
    }
    let last_byte = now - TimeDelta::from_millis(4);
    station.pass_until(now + TimeDelta::from_millis(2_000));
    let heard = station.outputs.iter().find_map(|(at, output)| match output {
        Output::Event(Event::RobotDetected { robot }) if robot.address == BRICK => Some(*at),
        _ => None,
    });
    heard.expect("it is heard") - last_byte
}

fn frame_of(number: i64) -> Vec<u8> {
    let mut bytes = Vec::new();
    Encoder::new(WireVersion::V2).encode(BRICK, &message(number, sent_ms(number)).0, &mut bytes);
    bytes
}

#[test]
fn a_heartbeat_behind_a_torn_frame_is_late_by_one_gap_at_most() {
    let (odometry, heartbeat) = (frame_of(3), frame_of(0));
    let (begin, end) = heartbeat.split_at(9);
    let mut worst = TimeDelta::ZERO;
    for torn in 1..odometry.len() {
        for quiet_ms in [0, 30, 49, 50, 80] {
            for pieces in [&[&heartbeat[..]][..], &[begin, end]] {
                let delay = delay_behind(&odometry[..torn], quiet_ms, pieces);
                assert!(delay <= GAP, "{torn} bytes, {quiet_ms} ms: {delay:?}");
                worst = worst.max(delay);
            }
        }
    }
    println!("the worst of all torn lengths: {worst:?}");
    // A header of 12 bytes promises 233 more: without the time-out they would be waited for.
    assert_eq!(delay_behind(&odometry[..12], 0, &[&heartbeat]), GAP);
    // Silence before the heartbeat has already told that the header was torn.
    assert_eq!(delay_behind(&odometry[..12], 50, &[&heartbeat]), TimeDelta::ZERO);
}

/// On a line that is never silent for a gap, a torn header is found out when as many bytes have come as it promises.
#[test]
fn on_a_busy_line_a_torn_header_hides_frames_for_as_long_as_its_own_would_have_taken_and_none_is_lost() {
    let mut under_test = StationUnderTest::new();
    let torn = &frame_of(3)[..12];
    under_test.bytes(Timestamp::from_millis(sent_ms(0)), torn);
    let mut encoder = Encoder::new(WireVersion::V2);
    let mut hidden = 0;
    let mut bytes_behind = 0;
    for number in (0..400).filter(|number| number % 4 == 1) {
        let (message, expected) = message(number, sent_ms(number));
        let mut frame = Vec::new();
        encoder.encode(BRICK, &message, &mut frame);
        under_test.ledger.sent(expected, Condition::Whole);
        under_test.bytes(Timestamp::from_millis(sent_ms(number)), &frame);
        bytes_behind += frame.len();
        if under_test.ledger.pending.is_empty() {
            continue;
        }
        hidden += 1;
        assert!(bytes_behind < 245 - 12, "hidden for too long");
    }
    assert!(under_test.ledger.pending.is_empty());
    println!("{hidden} frames came together with the one that ended the promise");
    assert!(hidden > 0, "else this test is about nothing");
}
