//! A plug that comes and goes ten thousand times.
//!
//! The only test of its process, because the descriptors belong to the process.

#![expect(clippy::expect_used, reason = "helpers outside of test functions")]

use std::time::Duration;

use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig};
use posebridge_telemetry::{LinkId, TimeDelta};

const CYCLES: u64 = 10_000;
/// How long the plug is in, and out.
const HALF_CYCLE: Duration = Duration::from_millis(300);

fn link(url: &str, role: ConnectRole, timer: HostTimer) -> Link {
    Link::new(LinkOpenConfig { id: LinkId(1), url: url.parse().expect("a link"), role }, timer)
}

/// The number of events of a link within a time.
async fn events_within(link: &mut Link, time: Duration) -> u64 {
    let mut events = 0;
    let forever = async {
        loop {
            link.next_event().await;
            events += 1;
        }
    };
    drop(tokio::time::timeout(time, forever).await);
    events
}

fn open_descriptors() -> usize {
    std::fs::read_dir("/proc/self/fd").expect("Linux has it").count()
}

#[tokio::test(start_paused = true)]
async fn a_plug_that_comes_and_goes_leaks_nothing_and_is_found_within_a_second() {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let path = folder.path().join("brick.tty");
    let path = path.display();
    let timer = HostTimer::start();
    let mut station = link(&format!("serial:{path}"), ConnectRole::Dial, timer);
    let mut descriptors = 0;
    let mut events = 0;
    for cycle in 0..CYCLES {
        let mut plug = link(&format!("pty:{path}"), ConnectRole::Listen, timer);
        plug.try_open().await.expect("the name is free");
        // Every third opens and fails at once.
        let inside = if cycle % 3 == 0 { Duration::ZERO } else { HALF_CYCLE };
        events += events_within(&mut station, inside).await;
        drop(plug);
        events += events_within(&mut station, HALF_CYCLE).await;
        if cycle == 10 {
            descriptors = open_descriptors();
        }
    }
    let reconnects = station.counters().reconnects;
    // An attempt each 0.9 s finds it inside two times in five.
    assert!(reconnects > CYCLES / 10, "{reconnects} of {CYCLES} times back");
    // Up, down, and once the reason why it is not there.
    assert!(events <= 3 * (reconnects + 1), "{events} events of {reconnects} returns");

    let mut plug = link(&format!("pty:{path}"), ConnectRole::Listen, timer);
    plug.try_open().await.expect("the name is free");
    let plugged = timer.now();
    while !matches!(station.next_event().await, LinkEvent::Up { .. }) {}
    let waited = timer.now() - plugged;
    assert!(waited < TimeDelta::from_millis(1_000), "{waited:?}");
    drop(plug);
    while station.is_up() {
        station.next_event().await;
    }
    assert_eq!(open_descriptors(), descriptors);
}
