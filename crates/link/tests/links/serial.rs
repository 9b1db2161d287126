//! Serial ports and pseudo-terminals: unplugged cables, busy ports, full buffers.

use std::future::poll_fn;
use std::path::PathBuf;
use std::task::Poll;

use crate::support::{bytes, down, poll_once, port, up};
use nix::fcntl::OFlag;
use nix::sys::stat::Mode;
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, OpenError};
use posebridge_telemetry::TimeDelta;

/// A directory with room for one device name.
pub(crate) struct Bench {
    pub(crate) directory: tempfile::TempDir,
    pub(crate) timer: HostTimer,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self { directory: tempfile::tempdir().expect("a temporary directory"), timer: HostTimer::start() }
    }

    pub(crate) fn path(&self) -> PathBuf {
        self.directory.path().join("brick.tty")
    }

    pub(crate) fn serial(&self) -> Link {
        port(&format!("serial:{}", self.path().display()), ConnectRole::Dial, self.timer)
    }

    pub(crate) fn pty(&self) -> Link {
        port(&format!("pty:{}", self.path().display()), ConnectRole::Listen, self.timer)
    }

    /// The error about the port while another program holds it.
    pub(crate) fn in_use(&self) -> String {
        let path = self.path();
        let path = path.display();
        format!("port {path} is in use by another program: close it there (`fuser -v {path}` names it)")
    }

    pub(crate) async fn plugged_pty(&self) -> Link {
        let mut pty = self.pty();
        pty.try_open().await.expect("a fresh name");
        up(&mut pty).await;
        pty
    }
}

/// Waits for the next event and counts how often the port was polled for it.
async fn next_counted(port: &mut Link) -> (LinkEvent, usize) {
    let mut polls = 0;
    let event = poll_fn(|cx| {
        polls += 1;
        port.poll_event(cx)
    })
    .await;
    (event, polls)
}

#[tokio::test(start_paused = true)]
async fn twenty_replugs_are_survived_without_a_busy_loop() {
    let bench = Bench::new();
    let mut cable = Some(bench.plugged_pty().await);
    let mut station = bench.serial();
    up(&mut station).await;
    for replug in 1..=20 {
        // The cable goes in the middle of a frame, in both directions.
        let mut pty = cable.take().expect("it is plugged in");
        pty.send(b"half a fr");
        station.send(b"another ha");
        drop(pty);
        let (mut event, mut polls) = next_counted(&mut station).await;
        if let LinkEvent::Bytes { bytes, .. } = &event {
            assert_eq!(bytes, b"half a fr");
            (event, polls) = next_counted(&mut station).await;
        }
        let LinkEvent::Down { mut retry_in, mut at, .. } = event else {
            panic!("{event:?} instead of a loss");
        };
        assert!(polls <= 3, "{polls} polls to notice a loss");
        assert!(!station.is_up());
        if replug % 10 == 0 {
            // Away for longer than one wait: an attempt finds nothing.
            (event, polls) = next_counted(&mut station).await;
            let LinkEvent::Down { retry_in: next, at: then, .. } = event else {
                panic!("{event:?} instead of another wait");
            };
            assert!(polls <= 5, "{polls} polls to find nothing");
            (retry_in, at) = (next, then);
        }

        let mut pty = bench.plugged_pty().await;
        let (event, polls) = next_counted(&mut station).await;
        let LinkEvent::Up { at: back, .. } = event else {
            panic!("{event:?} instead of the link");
        };
        // One poll finds the wait not over, one starts to open, one has it open.
        assert!(polls <= 5, "{polls} polls to come back");
        let away = back - at;
        assert!(retry_in < TimeDelta::from_millis(1_000), "{retry_in:?}");
        // A timer is up to two milliseconds late.
        assert!(away <= retry_in + TimeDelta::from_millis(3), "{away:?} for {retry_in:?}");

        pty.send(b"here again");
        station.send(b"and back");
        // What is sent before the first turn of the reactor waits for the next poll.
        assert_eq!(poll_once(&mut pty).await, None);
        assert_eq!(bytes(&mut station, 10).await, b"here again");
        assert_eq!(bytes(&mut pty, 8).await, b"and back");
        assert_eq!(station.counters().reconnects, replug);
        cable = Some(pty);
    }
}

#[tokio::test(start_paused = true)]
async fn an_idle_link_is_not_polled_again_and_again() {
    let bench = Bench::new();
    let mut pty = bench.plugged_pty().await;
    let mut station = bench.serial();
    up(&mut station).await;
    // The writer comes a minute later; the clock is paused, so nothing but the reader's own wake-ups is counted.
    let timer = bench.timer;
    let writer = async {
        timer.sleep_until(timer.now() + TimeDelta::from_millis(60_000)).await;
        pty.send(b"x");
        poll_once(&mut pty).await
    };
    let (received, written) = tokio::join!(next_counted(&mut station), writer);
    assert!(matches!(received.0, LinkEvent::Bytes { .. }), "{received:?}");
    assert_eq!(written, None);
    assert!(received.1 <= 5, "{} polls for one byte", received.1);
}

#[tokio::test(start_paused = true)]
async fn a_device_that_is_not_there_yet_is_waited_for() {
    let bench = Bench::new();
    let mut station = bench.serial();
    station.try_open().await.expect("a missing device may come");
    let (reason, retry_in) = down(&mut station).await;
    assert_eq!(reason, format!("{} is not there: plug the device in or check the name", bench.path().display()));
    assert!((TimeDelta::from_millis(225)..=TimeDelta::from_millis(275)).contains(&retry_in));
    // Half a minute of waiting: nothing is reported twice, and the waits get longer.
    let before = bench.timer.now();
    let mut polls = 0;
    let quiet = tokio::time::timeout(
        std::time::Duration::from_secs(30),
        poll_fn(|cx| {
            polls += 1;
            station.poll_event(cx)
        }),
    );
    assert!(quiet.await.is_err(), "the same reason was told again");
    // 0.25 + 0.5 s and then every 0.9 s are 36 attempts at the most, each polled two or three times.
    assert!(polls <= 110, "{polls} polls in {:?}", bench.timer.now() - before);

    let pty = bench.plugged_pty().await;
    let detail = up(&mut station).await;
    assert_eq!(detail, format!("{} at 115200 baud", bench.path().display()));
    assert_eq!(station.counters().reconnects, 0);
    drop(pty);
}

#[tokio::test(start_paused = true)]
async fn what_was_written_before_the_port_was_opened_is_stale() {
    let bench = Bench::new();
    let mut pty = bench.plugged_pty().await;
    // Once through the reactor, so that the terminal is known to be writable.
    assert_eq!(poll_once(&mut pty).await, None);
    tokio::task::yield_now().await;
    for _ in 0..1_000 {
        pty.send(&[b'o'; 100]);
    }
    let counters = pty.counters();
    assert!(counters.drops_out > 500, "{counters:?}");
    assert!(counters.bytes_out > 4_000 && counters.bytes_out < 66_000, "{counters:?}");

    let mut station = bench.serial();
    up(&mut station).await;
    // The frame that was cut when the buffer became full is finished first; everything else is lost.
    pty.send(b"new!");
    let mut received = Vec::new();
    while !received.ends_with(b"new!") {
        assert!(received.len() < 100 + 4, "{} stale bytes", received.len());
        pty.send(b"new!");
        assert_eq!(poll_once(&mut pty).await, None);
        received.extend(bytes(&mut station, 1).await);
    }
}

#[tokio::test(start_paused = true)]
async fn a_pty_without_a_reader_recovers_when_one_comes() {
    let bench = Bench::new();
    let mut station = bench.serial();
    let mut pty = bench.plugged_pty().await;
    up(&mut station).await;
    let frame = [7; 64];
    for _ in 0..2_000 {
        pty.send(&frame);
    }
    assert_eq!(poll_once(&mut pty).await, None);
    let dropped = pty.counters().drops_out;
    assert!(dropped > 0, "the buffer took everything");
    // Both run: the reader takes what is there, the writer finishes the frame that was cut.
    let expected = usize::try_from((2_000 - dropped) * 64).expect("small");
    let received = tokio::select! {
        received = bytes(&mut station, expected) => received,
        event = pty.next_event() => panic!("{event:?} on an idle terminal"),
    };
    assert_eq!(received.len(), expected, "frames arrive whole");
    assert_eq!(pty.counters().bytes_out, expected as u64);
}

#[tokio::test(start_paused = true)]
async fn a_second_program_gets_an_error_that_the_port_is_in_use() {
    let bench = Bench::new();
    let _pty = bench.plugged_pty().await;
    let mut first = bench.serial();
    up(&mut first).await;
    let mut second = bench.serial();
    let error = second.try_open().await.expect_err("the port is taken");
    assert!(matches!(error, OpenError::PortInUse { .. }), "{error:?}");
    assert_eq!(error.to_string(), bench.in_use());
    // A program that goes on gets the error, and the port when it is free.
    assert_eq!(down(&mut second).await.0, bench.in_use());
    drop(first);
    up(&mut second).await;
}

#[tokio::test(start_paused = true)]
async fn a_port_that_is_taken_while_the_cable_is_out_is_waited_for() {
    let bench = Bench::new();
    let pty = bench.plugged_pty().await;
    let mut station = bench.serial();
    station.try_open().await.expect("nobody else is there");
    up(&mut station).await;
    drop(pty);
    down(&mut station).await;

    let _pty = bench.plugged_pty().await;
    let mut rival = bench.serial();
    up(&mut rival).await;
    assert_eq!(down(&mut station).await.0, bench.in_use());
    drop(rival);
    up(&mut station).await;
}

#[tokio::test(start_paused = true)]
async fn a_terminal_is_raw_before_anybody_can_open_it() {
    let bench = Bench::new();
    let mut pty = bench.plugged_pty().await;
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK;
    let reader = nix::fcntl::open(&bench.path(), flags, Mode::empty()).expect("a foreign reader");
    // In cooked mode these would be echoed, translated, or end the reader.
    let awkward = [b'\r', b'\n', 0x03, 0x04, 0x11, 0x13, 0x1a, 0x7f, 0xff, 0x00];
    assert_eq!(nix::unistd::write(&reader, &awkward).expect("room"), awkward.len());
    assert_eq!(bytes(&mut pty, awkward.len()).await, awkward);
    let echoed = poll_fn(|cx| Poll::Ready(pty.poll_event(cx).is_ready())).await;
    assert!(!echoed, "the terminal echoes");
}
