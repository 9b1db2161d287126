//! An EV3's clock of 32 bits of microseconds, through the whole engine: it stays aligned when it wraps after 71.6 minutes.
//!
//! The figures: `cargo test -p posebridge-station --test ev3_clock -- --nocapture`.
#![expect(clippy::expect_used, reason = "helpers outside #[test]")]
#![expect(dead_code, reason = "support that other tests use")]

#[path = "../../../protocol/tests/support/ev3_double.rs"]
mod ev3_double;
#[path = "support/station.rs"]
mod station;

use ev3_double::{DelayLine, Ev3Double};
use posebridge_protocol::bricks::{CodecSettings, brick_protocol};
use posebridge_station::config::BrickLink;
use posebridge_station::{OutputKind, StationConfig};
use posebridge_telemetry::{BrickClock, Event, HostClock, Output, ReceiveError, TimeDelta, Timestamp};
use station::{LINK, TestStation, at, config, link, stream};

const PERIOD_MICROS: u64 = 1 << 32;
/// The counter wraps so long after the first question, s.
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
    mailbox: Vec<(Timestamp<HostClock>, Vec<u8>)>,
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
            mailbox: vec![],
            state: 3,
        };
        session.forward_outputs();
        session
    }

    /// Brings what the station has sent to the brick.
    fn forward_outputs(&mut self) {
        let outputs = self.station.outputs.iter().skip(self.forwarded_outputs);
        let sent: Vec<_> = outputs
            .filter_map(|(_, output)| match output {
                Output::Transmit { bytes, .. } => Some(bytes.clone()),
                Output::Event(_) | Output::Request(_) => None,
            })
            .collect();
        self.forwarded_outputs = self.station.outputs.len();
        for bytes in sent {
            if bytes[4] == 0x81 {
                self.mailbox.push((self.now, bytes.clone()));
            }
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

/// The brick instants of all observations.
fn observed(station: &TestStation) -> Vec<(Timestamp<HostClock>, Timestamp<BrickClock>)> {
    let observed = station.outputs.iter().filter_map(|(now, output)| {
        if let Output::Event(Event::ObservationAligned { observation, .. }) = output {
            Some((*now, observation.stamp))
        } else {
            None
        }
    });
    observed.collect()
}

#[test]
fn the_clock_stays_aligned_across_its_wrap() {
    for skew_ppm in [0.0, 60.0, -2_000.0] {
        let mut session = Ev3Session::new(skew_ppm * 1e-6);
        session.run_until(at(60_000));
        let events: Vec<_> = session.station.events().cloned().collect();
        let is_upset = |event: &&Event| {
            matches!(
                event,
                Event::BrickRestarted { .. } | Event::ReceiveError { defect: ReceiveError::ClockNotAligned { .. }, .. }
            )
        };
        assert_eq!(events.iter().filter(is_upset).count(), 0);

        let (mut worst_ms, mut widest_ms, mut exchanges) = (0.0_f64, 0.0_f64, 0);
        for event in &events {
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

        let observed = observed(&session.station);
        assert!(observed.len() > 2_200, "{}", observed.len());
        assert!(observed.windows(2).all(|pair| pair[0].1 <= pair[1].1));
        let last = observed[observed.len() - 1];
        assert!(last.1 > Timestamp::from_micros(PERIOD_MICROS as i64 + 39_000_000));
        let lag_micros = session.true_micros(last.0) - last.1.as_micros() as f64;
        assert!((0.0..61_000.0).contains(&lag_micros), "{lag_micros}");
    }
}

#[test]
fn the_mailbox_names_the_instants_by_the_bricks_own_counter() {
    let mut session = Ev3Session::new(0.0);
    session.run_until(at(30_000));
    assert!(session.mailbox.len() > 500, "{}", session.mailbox.len());
    for (now, bytes) in &session.mailbox {
        // Behind length, counter, type, command, name and length of the payload.
        let tick_ms = u32::from_le_bytes([bytes[18], bytes[19], bytes[20], bytes[21]]);
        let shown_ms = session.brick.micros(*now) / 1_000;
        let wrap_ms = (PERIOD_MICROS / 1_000) as u32;
        let age_ms = (shown_ms + wrap_ms - tick_ms) % wrap_ms;
        assert!(age_ms <= 61, "{tick_ms} at {shown_ms}");
    }
}
