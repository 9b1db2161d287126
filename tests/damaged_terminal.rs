//! The four kinds of damage over a real pseudo-terminal: a port of the station reads it, and its engine observes what was sent whole.
//!
//! The same at a larger scale is a test of the engine (`crates/station/tests/resync.rs`); telemetry, damage and books are from
//! there. The bytes are cut as the kernel cuts them; the time is virtual here, too, so that a busy computer tears no frame.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and pick the events that they are about; the figures are to be read"
)]
#![expect(dead_code, reason = "the helpers are shared with tests that need others of them")]

#[path = "../crates/station/tests/support/damage.rs"]
mod damage;
#[path = "support/terminal.rs"]
mod terminal;

use std::io::Write as _;
use std::path::Path;

use damage::{DAMAGE_KINDS, DamageKind, DamagedBrick, ObservationLedger};
use posebridge::config::load_text;
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkUrl};
use posebridge_station::Station;
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, Output, TimeDelta, Timestamp};
use terminal::PseudoTerminal;

const FRAMES: i64 = 4_000;
/// Messages that bear one stamp: all of them go over the terminal in a moment, and no clock may leap.
const PER_MILLI: i64 = 50;
const LINK: LinkId = LinkId(0);
/// Between two chunks.
const STEP: TimeDelta = TimeDelta::from_millis(1);

/// An engine that is told what a port tells, with books that are held against what it observes.
struct TestStation {
    station: Station,
    ledger: ObservationLedger,
    now: Timestamp<HostClock>,
    /// Chunks that the kernel has made of the bytes.
    chunks: usize,
}

impl TestStation {
    fn new(device: &Path) -> Self {
        let text = format!("[[link]]\nurl = \"serial:{}\"\n", device.display());
        let config = load_text("test", &text, &[]).expect("a configuration");
        let config = config.config.station_config().expect("a configuration");
        Self {
            ledger: ObservationLedger::new(config.robot.filter_config.geometry.left_wheel_radius.0),
            station: Station::new(config, Timestamp::ZERO).expect("a configuration"),
            now: Timestamp::ZERO,
            chunks: 0,
        }
    }

    fn handle(&mut self, now: Timestamp<HostClock>, input: &Input) {
        self.station.handle(now, input);
        while let Some(output) = self.station.poll() {
            if let Output::Event(event) = output {
                self.ledger.on_event(&event);
            }
        }
    }

    fn pass(&mut self, span: TimeDelta) {
        self.now = self.now + span;
        while let Some(due) = self.station.deadline().filter(|due| *due <= self.now) {
            self.handle(due, &Input::Tick);
        }
    }

    /// Takes what the port tells until so many bytes have come, and returns them.
    async fn listen(&mut self, port: &mut Link, expected: usize) -> Vec<u8> {
        let mut heard = Vec::new();
        while heard.len() < expected {
            let LinkEvent::Bytes { peer, bytes, .. } = port.next_event().await else {
                panic!("the terminal is there");
            };
            heard.extend_from_slice(&bytes);
            self.chunks += 1;
            self.pass(STEP);
            let link = LINK;
            self.handle(self.now, &Input::Bytes { link, peer, bytes });
        }
        heard
    }
}

/// Sends damaged telemetry over a terminal of its own.
async fn drive(kind: &DamageKind) -> TestStation {
    let mut terminal = PseudoTerminal::open();
    let mut station = TestStation::new(terminal.device());
    let config =
        LinkOpenConfig { id: LINK, url: LinkUrl::serial(terminal.device()).expect("a path"), role: ConnectRole::Dial };
    let mut port = Link::new(config, HostTimer::start());
    // What was sent before is thrown away by a port that opens.
    assert!(matches!(port.next_event().await, LinkEvent::Up { .. }));
    let (link, state) = (LINK, LinkState::Up);
    station.handle(Timestamp::ZERO, &Input::Link { link, state });

    let mut brick = DamagedBrick::new(kind);
    let sent: Vec<u8> =
        (0..FRAMES).flat_map(|number| brick.send(number, 1_000 + number / PER_MILLI, &mut station.ledger)).collect();
    let (bytes, expected) = (sent.clone(), sent.len());
    let writer = std::thread::spawn(move || {
        terminal.wire.write_all(&bytes).expect("it is read");
        terminal
    });
    let heard = station.listen(&mut port, expected).await;
    assert!(heard == sent, "{}: the port has changed bytes", kind.name);
    drop(writer.join().expect("it only writes"));
    station.pass(TimeDelta::from_millis(2_000));
    station
}

#[tokio::test(flavor = "current_thread")]
async fn over_a_terminal_what_is_observed_is_what_was_sent_whole() {
    for kind in &DAMAGE_KINDS {
        let station = drive(kind).await;
        station.ledger.check(kind.name, FRAMES);
        println!("{:31} in {} chunks", kind.name, station.chunks);
        assert!(station.chunks > 20, "else nothing was cut");
    }
}
