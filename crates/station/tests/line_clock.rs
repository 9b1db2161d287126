//! Lines of a board through the whole engine: with a clock that wraps or is reset, and without any clock.
//!
//! The figures: `cargo test -p posebridge-station --test line_clock -- --nocapture`.
#![expect(clippy::expect_used, reason = "helpers outside #[test]")]
#![expect(dead_code, reason = "support that other tests use")]

#[path = "support/station.rs"]
mod station;

use posebridge_protocol::bricks::text_line::{Column, LineLayout, Separator, TextLineSettings};
use posebridge_protocol::bricks::{CodecSettings, brick_protocol};
use posebridge_station::StationConfig;
use posebridge_station::config::BrickLink;
use posebridge_telemetry::{BrickClock, Estimate, Event, ReceiveError, TimeDelta, Timestamp};
use station::{LINK, TestStation, at, config, link};

/// Each line is this old when it arrives, and some of them by 5 or 10 ms more.
const DELAY_MS: i64 = 12;
const PERIOD_MS: i64 = 50;
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
        let made_ms = n * PERIOD_MS;
        let arrival = at(made_ms + DELAY_MS + [0, 5, 0, 10][(n % 4) as usize]);
        station.pass_until(arrival);
        let made_s = made_ms as f64 * 1e-3;
        let text = line(made_s, (TICKS_PER_S * made_s) as i64);
        station.bytes(arrival, text.as_bytes());
    }
    station
}

fn last_estimate(station: &TestStation) -> Estimate {
    let estimates = station
        .events()
        .filter_map(|event| if let Event::EstimateUpdated { estimate, .. } = event { Some(*estimate) } else { None });
    estimates.last().expect("it is estimated")
}

fn unaligned(station: &TestStation) -> usize {
    let is_unaligned =
        |event: &&Event| matches!(event, Event::ReceiveError { defect: ReceiveError::ClockNotAligned { .. }, .. });
    station.events().filter(is_unaligned).count()
}

fn restarts(station: &TestStation) -> usize {
    let is_restart = |event: &&Event| matches!(event, Event::BrickRestarted { .. });
    station.events().filter(is_restart).count()
}

/// How far the station believes to have driven, less what the counts say.
fn travel_error_m(station: &TestStation) -> f64 {
    let travelled_m = last_estimate(station).pose.origin().x.0;
    travelled_m - SPEED_M_PER_S * 59.95
}

#[test]
fn lines_without_a_time_drive_the_filter_at_the_cost_of_the_first_ones() {
    let station = minute(&["left_ticks", "right_ticks"], |_, count| format!("{count},{count}\r\n"));
    let observations: Vec<_> = station
        .events()
        .filter_map(
            |event| if let Event::ObservationAligned { observation, .. } = event { Some(*observation) } else { None },
        )
        .collect();
    println!(
        "lines without a time: {} of 1200 observed, {} came before the clock was known; stamps {:?} ± {:?}; after 60 s {:.1} mm off",
        observations.len(),
        unaligned(&station),
        observations[600].stamp,
        observations[600].stamp_sigma,
        travel_error_m(&station) * 1e3,
    );
    // The first line is no proof of a beginning, and two more pass until the clock is known.
    assert_eq!(observations.len(), 1_197);
    assert_eq!((unaligned(&station), restarts(&station)), (2, 0));
    // In the middle of the 40 ms before the arrival, uniform over them. The truth, 12 to 22 ms before, lies within.
    let made: Timestamp<BrickClock> = Timestamp::from_millis(603 * PERIOD_MS);
    let off = observations[600].stamp - made;
    assert!(off.as_nanos().abs() <= 10_000_000, "{off:?}");
    let sigma_ms = observations[600].stamp_sigma.as_millis_f64();
    assert!((11.5..12.0).contains(&sigma_ms), "{sigma_ms}");
    // What was driven before the filter began is not in it.
    assert!((travel_error_m(&station) + SPEED_M_PER_S * 0.15).abs() < 0.01);
}

#[test]
fn a_boards_counter_of_milliseconds_or_microseconds_may_wrap() {
    for (column, steps_per_s) in [("time_ms", 1e3), ("time_us", 1e6)] {
        // Twenty seconds before the wrap.
        let start = (1_u64 << 32) as f64 - 20.0 * steps_per_s;
        let station = minute(&[column, "left_ticks", "right_ticks"], |made_s, count| {
            let time = (start + made_s * steps_per_s) as u64 as u32;
            format!("{time},{count},{count}\n")
        });
        assert_eq!((unaligned(&station), restarts(&station)), (0, 0), "{column}");
        let error_m = travel_error_m(&station);
        println!("{column} across its wrap: after 60 s {:.1} mm off", error_m * 1e3);
        // The first line is no proof of a beginning.
        assert!((error_m + SPEED_M_PER_S * 0.05).abs() < 0.01, "{error_m}");
    }
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
    assert_eq!(restarts(&station), 1);
    let lost_m = -travel_error_m(&station);
    println!("a reset of the board after 30 s: {:.1} mm of 5.9 m lost", lost_m * 1e3);
    // The way of the first line and of three around the reset at most.
    assert!((0.0..SPEED_M_PER_S * 0.21).contains(&lost_m), "{lost_m}");
    let ahead = last_estimate(&station).stamp - Timestamp::from_millis(29_950);
    assert!(ahead.as_nanos().abs() <= TimeDelta::from_millis(60).as_nanos());
}
