//! A cable that is unplugged a hundred times: the link is back within the delay, without a busy loop and without torn
//! frames.
//!
//! In real time and the only test of its process, because it measures the processor time of the process. The delays are
//! scaled down so that it takes seconds.

#![expect(clippy::expect_used, reason = "helpers outside of test functions")]
#![expect(clippy::wildcard_enum_match_arm, reason = "a test that sees any other event fails and prints it")]

use std::path::Path;

use nix::sys::resource::{UsageWho, getrusage};
use posebridge_link::{BackoffDelays, ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkTuning, LinkUrl};
use posebridge_telemetry::{HostClock, LinkId, TimeDelta, Timestamp};

const REPLUGS: u32 = 100;
const FRAME_BYTES: usize = 64;
/// How late a wait may end on a computer that has other things to do; the timers themselves are good to 2 ms.
const LATE: TimeDelta = TimeDelta::from_millis(250);
const WAITS: BackoffDelays = BackoffDelays { initial: TimeDelta::from_millis(20), maximum: TimeDelta::from_millis(80) };

fn port(url: LinkUrl, role: ConnectRole, timer: HostTimer) -> Link {
    let config = LinkOpenConfig { id: LinkId(1), url, role };
    let tuning = LinkTuning { backoff_delays: WAITS, ..LinkTuning::default() };
    Link::with_tuning(config, tuning, timer)
}

async fn plugged(path: &Path, timer: HostTimer) -> Link {
    let mut brick = port(LinkUrl::pty(path).expect("a path"), ConnectRole::Listen, timer);
    brick.try_open().await.expect("a free name");
    assert!(matches!(brick.next_event().await, LinkEvent::Up { .. }));
    brick
}

/// A mark, a number, and a sum over everything before it.
fn frame(number: u32) -> [u8; FRAME_BYTES] {
    let mut frame = [0xfd; FRAME_BYTES];
    frame[1..5].copy_from_slice(&number.to_be_bytes());
    for (at, byte) in frame.iter_mut().enumerate().take(FRAME_BYTES - 4).skip(5) {
        *byte = (number as usize * 31 + at * 7) as u8;
    }
    let sum = sum(&frame);
    frame[FRAME_BYTES - 4..].copy_from_slice(&sum.to_be_bytes());
    frame
}

/// Adler-32's second half, over everything but the sum itself.
fn sum(frame: &[u8]) -> u32 {
    let (_, sum) = frame[..FRAME_BYTES - 4].iter().fold((1_u32, 0_u32), |(a, b), byte| {
        let a = (a + u32::from(*byte)) % 65_521;
        (a, (b + a) % 65_521)
    });
    sum
}

/// What a receiver makes of a connection's bytes: the numbers of the frames that are whole. Starts afresh with each.
#[derive(Default)]
struct Scanner {
    bytes: Vec<u8>,
    garbage: usize,
}

impl Scanner {
    fn push(&mut self, bytes: &[u8]) -> Vec<u32> {
        self.bytes.extend_from_slice(bytes);
        let mut numbers = Vec::new();
        while self.bytes.len() >= FRAME_BYTES {
            let found = &self.bytes[FRAME_BYTES - 4..FRAME_BYTES];
            if self.bytes[0] == 0xfd && sum(&self.bytes).to_be_bytes() == found {
                let number: [u8; 4] = self.bytes[1..5].try_into().expect("four bytes");
                numbers.push(u32::from_be_bytes(number));
                self.bytes.drain(..FRAME_BYTES);
            } else {
                self.bytes.remove(0);
                self.garbage += 1;
            }
        }
        numbers
    }
}

fn processor_time() -> TimeDelta {
    let usage = getrusage(UsageWho::RUSAGE_SELF).expect("our own");
    [usage.user_time(), usage.system_time()]
        .map(|time| TimeDelta::from_micros(time.tv_sec() * 1_000_000 + time.tv_usec()))
        .into_iter()
        .fold(TimeDelta::ZERO, |sum, part| sum + part)
}

/// Time and processor time while the link was down.
#[derive(Default)]
struct OutageCost {
    wall: TimeDelta,
    processor: TimeDelta,
    latest: TimeDelta,
}

struct Bench {
    station: Link,
    timer: HostTimer,
    sent: u32,
    heard: Vec<u32>,
}

impl Bench {
    /// Both sides send a few frames and hear them; nothing but whole ones arrive.
    async fn talk(&mut self, brick: &mut Link) {
        let wanted: Vec<u32> = (self.sent..self.sent + 3).collect();
        for number in &wanted {
            brick.send(&frame(*number));
            self.station.send(&frame(*number));
        }
        self.sent += 3;
        let (mut here, mut there) = (Scanner::default(), Scanner::default());
        let (mut heard, mut answered) = (Vec::new(), Vec::new());
        while heard.len() < 3 || answered.len() < 3 {
            tokio::select! {
                event = self.station.next_event() => heard.extend(here.push(&bytes_of(event))),
                event = brick.next_event() => answered.extend(there.push(&bytes_of(event))),
            }
        }
        assert_eq!((&heard, here.garbage), (&wanted, 0));
        assert_eq!((&answered, there.garbage), (&wanted, 0));
        self.heard.extend(heard);
    }

    /// Reads to the loss; returns when it was noticed and how long the station wants to wait.
    async fn lose(&mut self, scanner: &mut Scanner) -> (Timestamp<HostClock>, TimeDelta) {
        loop {
            match self.station.next_event().await {
                LinkEvent::Bytes { bytes, .. } => self.heard.extend(scanner.push(&bytes)),
                LinkEvent::Down { at, retry_in, .. } => return (at, retry_in),
                LinkEvent::Up { .. } | LinkEvent::Finished { .. } => panic!("it was up"),
            }
        }
    }
}

fn bytes_of(event: LinkEvent) -> Vec<u8> {
    match event {
        LinkEvent::Bytes { bytes, .. } => bytes,
        event => panic!("{event:?} on a quiet line"),
    }
}

#[tokio::test(flavor = "current_thread")]
async fn a_hundred_replugs_leave_no_busy_loop_and_no_torn_frame() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("brick.tty");
    let timer = HostTimer::start();
    let mut brick = plugged(&path, timer).await;
    let station = port(LinkUrl::serial(&path).expect("a path"), ConnectRole::Dial, timer);
    let mut bench = Bench { station, timer, sent: 0, heard: Vec::new() };
    assert!(matches!(bench.station.next_event().await, LinkEvent::Up { .. }));
    let mut away = OutageCost::default();
    for replug in 1..=REPLUGS {
        bench.talk(&mut brick).await;
        // The cable goes in the middle of a frame, in both directions.
        brick.send(&frame(u32::MAX)[..FRAME_BYTES / 2]);
        bench.station.send(&frame(u32::MAX)[..FRAME_BYTES / 3]);
        drop(brick);
        let (mut down_at, mut retry_in) = bench.lose(&mut Scanner::default()).await;
        let processor = processor_time();
        let begun = bench.timer.now();
        if replug % 10 == 0 {
            // Away for longer than one wait: an attempt finds nothing.
            (down_at, retry_in) = bench.lose(&mut Scanner::default()).await;
        }
        brick = plugged(&path, timer).await;
        let LinkEvent::Up { at, .. } = bench.station.next_event().await else {
            panic!("not back");
        };
        away.wall += bench.timer.now() - begun;
        away.processor += processor_time() - processor;
        let late = at - (down_at + retry_in);
        away.latest = away.latest.max(late);
        assert!(late <= LATE, "back {late:?} after the wait of {retry_in:?}");
        assert_eq!(bench.station.counters().reconnects, u64::from(replug));
    }
    bench.talk(&mut brick).await;
    assert!(bench.heard.iter().copied().eq(0..bench.sent), "a frame was made up");
    let share = away.processor.as_secs_f64() / away.wall.as_secs_f64();
    println!("down for {:?} in all, {:.2} % of it busy, at most {:?} late", away.wall, 100.0 * share, away.latest);
    assert!(share < 0.05, "{:.1} % busy while down", 100.0 * share);
}
