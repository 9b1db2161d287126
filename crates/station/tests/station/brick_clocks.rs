//! Clocks of bricks with protocols of their own, through the whole engine: an EV3's 32 bits of microseconds wrap after
//! 71.6 minutes, a board's counter may wrap or be reset, and lines may have no time at all.
//!
//! The figures: `cargo test -p posebridge-station --test station brick_clocks -- --nocapture`.

#[expect(dead_code, reason = "the tests of the protocol use all of it")]
#[path = "../../../../protocol/tests/support/ev3_double.rs"]
mod ev3_double;

use crate::support::{LINK, TestStation, at, config, link, stream};
use ev3_double::{DelayLine, Ev3Double};
use posebridge_protocol::bricks::text_line::{Column, LineLayout, Separator, TextLineSettings};
use posebridge_protocol::bricks::{CodecSettings, DEFAULT_BRICK_ADDRESS, brick_protocol};
use posebridge_station::config::BrickLink;
use posebridge_station::{OutputKind, StationConfig};
use posebridge_telemetry::{BrickClock, Event, HostClock, TimeDelta, Timestamp};

const PERIOD_MICROS: u64 = 1 << 32;
/// The counter wraps so long after the first request, s.
const WRAP_S: f64 = 20.0;

fn ev3_config() -> StationConfig {
    let mut ev3 = link(LINK, vec![stream(OutputKind::PlanarPose, 0)]);
    ev3.brick = Some(BrickLink {
        protocol: brick_protocol("ev3").expect("there is a row"),
        settings: CodecSettings::default(),
    });
    StationConfig { links: vec![ev3], ..config() }
}

/// A station and an EV3 behind a link whose turn-around varies from 30 to 60 ms.
struct Ev3Session {
    station: TestStation,
    brick: Ev3Double,
    delay_line: DelayLine,
    now: Timestamp<HostClock>,
    forwarded_outputs: usize,
    state: u64,
}

impl Ev3Session {
    fn new(skew: f64) -> Self {
        let mut session = Self {
            station: TestStation::new(&ev3_config()),
            brick: Ev3Double { start_micros: PERIOD_MICROS - (WRAP_S * 1e6) as u64, skew, ..Ev3Double::default() },
            delay_line: DelayLine::new(TimeDelta::from_millis(30)),
            now: Timestamp::ZERO,
            forwarded_outputs: 0,
            state: 3,
        };
        session.forward_outputs();
        session
    }

    /// Brings what the station has sent to the brick.
    fn forward_outputs(&mut self) {
        let sent: Vec<_> = self.station.sent_since(self.forwarded_outputs).map(|sent| sent.bytes.to_vec()).collect();
        self.forwarded_outputs = self.station.outputs.len();
        for bytes in sent {
            // Knuth's MMIX constants.
            self.state = self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            self.delay_line.latency = TimeDelta::from_micros(30_000 + (self.state >> 40) as i64 % 30_000);
            self.delay_line.send(&mut self.brick, self.now, &bytes);
        }
    }

    fn run_until(&mut self, until: Timestamp<HostClock>) {
        loop {
            let next = [self.delay_line.next(), self.station.engine.deadline()];
            let Some(next) = next.into_iter().flatten().min().filter(|next| *next <= until) else {
                return;
            };
            assert!(next >= self.now, "{next:?} is past at {:?}", self.now);
            self.now = next;
            if self.delay_line.next() == Some(next) {
                let bytes = self.delay_line.pop().expect("it is there");
                self.station.bytes(next, &bytes);
            } else {
                self.station.pass_until(next);
            }
            self.forward_outputs();
        }
    }

    /// The brick's true time, unwrapped, at a host instant, µs.
    fn true_micros(&self, host: Timestamp<HostClock>) -> f64 {
        self.brick.start_micros as f64 + host.as_secs_f64() * 1e6 * (1.0 + self.brick.skew)
    }
}

#[test]
fn the_clock_stays_aligned_across_its_wrap() {
    for skew_ppm in [0.0, 60.0, -2_000.0] {
        let mut session = Ev3Session::new(skew_ppm * 1e-6);
        session.run_until(at(60_000));
        assert_eq!(session.station.restarts(), []);
        assert_eq!(session.station.count(|event| matches!(event, Event::ReceiveError { .. })), 0);

        let (mut worst_ms, mut widest_ms, mut exchanges) = (0.0_f64, 0.0_f64, 0);
        for event in session.station.events() {
            let Event::BrickClockAligned { brick, host, uncertainty, .. } = event else {
                continue;
            };
            exchanges += 1;
            let error_ms = (session.true_micros(*host) - brick.as_micros() as f64).abs() * 1e-3;
            assert!(error_ms <= uncertainty.as_millis_f64() + 0.002, "{error_ms}");
            if *host > at(10_000) {
                worst_ms = worst_ms.max(error_ms);
                widest_ms = widest_ms.max(uncertainty.as_millis_f64());
            }
        }
        println!(
            "EV3 clock, {skew_ppm} ppm, 30 to 60 ms turn-around, wrap at {WRAP_S} s: {exchanges} exchanges in 60 s, \
             error from 10 s on at most {worst_ms:.2} ms, bound {widest_ms:.2} ms"
        );
        assert!(exchanges > 1_100, "{exchanges}");
        assert!(worst_ms < 2.0, "{worst_ms}");

        let observed = session.station.aligned();
        assert!(observed.len() > 2_200, "{}", observed.len());
        assert!(observed.is_sorted_by_key(|aligned| aligned.observation.stamp));
        let last = observed[observed.len() - 1];
        let stamp = last.observation.stamp;
        assert!(stamp > Timestamp::from_micros(PERIOD_MICROS as i64 + 39_000_000));
        let lag_micros = session.true_micros(last.now) - stamp.as_micros() as f64;
        assert!((0.0..61_000.0).contains(&lag_micros), "{lag_micros}");
    }
}

/// Each line is this old when it arrives, and some of them by 5 or 10 ms more.
const DELAY_MS: i64 = 12;
const LINE_PERIOD_MS: i64 = 50;
/// Straight on: 200 degrees per second of a wheel of 28 mm.
const TICKS_PER_S: f64 = 200.0;
const SPEED_M_PER_S: f64 = TICKS_PER_S * std::f64::consts::PI / 180.0 * 0.028;

fn line_config(columns: &[&str]) -> StationConfig {
    let columns = columns.iter().map(|name| Column::from_name(name));
    let mut board = link(LINK, vec![]);
    board.brick = Some(BrickLink {
        protocol: brick_protocol("line").expect("there is a row"),
        settings: CodecSettings {
            line: TextLineSettings {
                layout: LineLayout::Columns {
                    columns: columns.collect::<Option<_>>().expect("the names are known"),
                    separator: Separator::Comma,
                },
                ..TextLineSettings::default()
            },
            ..CodecSettings::default()
        },
    });
    StationConfig { links: vec![board], ..config() }
}

/// A minute of a board that prints `line(seconds, count)` each 50 ms.
fn minute(columns: &[&str], line: impl Fn(f64, i64) -> String) -> TestStation {
    let mut station = TestStation::new(&line_config(columns));
    for n in 0..1_200 {
        let made_ms = n * LINE_PERIOD_MS;
        let arrival = at(made_ms + DELAY_MS + [0, 5, 0, 10][(n % 4) as usize]);
        station.pass_until(arrival);
        let made_s = made_ms as f64 * 1e-3;
        let text = line(made_s, (TICKS_PER_S * made_s) as i64);
        station.bytes(arrival, text.as_bytes());
    }
    station
}

/// Error of the estimated distance against the counts.
fn travel_error_m(station: &TestStation) -> f64 {
    let travelled_m = station.last_estimate().pose.origin().x.0;
    travelled_m - SPEED_M_PER_S * 59.95
}

#[test]
fn lines_without_a_time_drive_the_filter_at_the_cost_of_the_first_ones() {
    let station = minute(&["left_ticks", "right_ticks"], |_, count| format!("{count},{count}\r\n"));
    let observations: Vec<_> = station.aligned().iter().map(|aligned| aligned.observation).collect();
    println!(
        "lines without a time: {} of 1200 observed; stamps {:?} ± {:?}; after 60 s {:.1} mm off",
        observations.len(),
        observations[600].stamp,
        observations[600].stamp_sigma,
        travel_error_m(&station) * 1e3,
    );
    // The first line is no proof of a beginning, and two more pass until the clock is known.
    assert_eq!(observations.len(), 1_197);
    assert_eq!((station.unaligned(DEFAULT_BRICK_ADDRESS).len(), station.restarts().len()), (2, 0));
    // In the middle of the 40 ms before the arrival, uniform over them. The truth, 12 to 22 ms before, lies within.
    let made: Timestamp<BrickClock> = Timestamp::from_millis(603 * LINE_PERIOD_MS);
    let off = observations[600].stamp - made;
    assert!(off.as_nanos().abs() <= 10_000_000, "{off:?}");
    let sigma_ms = observations[600].stamp_sigma.as_millis_f64();
    assert!((11.5..12.0).contains(&sigma_ms), "{sigma_ms}");
    // What was driven before the filter began is not in it.
    assert!((travel_error_m(&station) + SPEED_M_PER_S * 0.15).abs() < 0.01);
}

#[test]
fn a_board_that_is_reset_begins_anew_where_it_was() {
    let station = minute(&["time_ms", "left_ticks", "right_ticks"], |made_s, count| {
        if made_s < 30.0 {
            format!("{},{count},{count}\n", (made_s * 1e3) as i64)
        } else {
            let since = (TICKS_PER_S * (made_s - 30.0)) as i64;
            format!("{},{since},{since}\n", ((made_s - 30.0) * 1e3) as i64)
        }
    });
    assert_eq!(station.restarts().len(), 1);
    let lost_m = -travel_error_m(&station);
    println!("a reset of the board after 30 s: {:.1} mm of 5.9 m lost", lost_m * 1e3);
    // The way of the first line and of three around the reset at most.
    assert!((0.0..SPEED_M_PER_S * 0.21).contains(&lost_m), "{lost_m}");
    let ahead = station.last_estimate().stamp - Timestamp::from_millis(29_950);
    assert!(ahead.as_nanos().abs() <= TimeDelta::from_millis(60).as_nanos());
}
