//! A run with a simulated brick goes on for ever, and leaves its tables when somebody ends it.

mod support;

use std::time::Duration;

use posebridge::station::simulator::{BrickStart, EmbeddedBricks};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkUrl};
use posebridge_recording::container::read_truth;
use posebridge_sim::Scenario;
use posebridge_telemetry::{LinkId, SimulatorCommand, TimeDelta};
use support::{RunningProgram, SKEWED_SQUARE, number_after, posebridge, stdout_of};
use tokio_util::sync::CancellationToken;

#[test]
fn it_says_each_second_who_is_how_far_off_and_ends_with_tables_when_it_is_interrupted() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("skewed.toml"), SKEWED_SQUARE).unwrap();
    let mut run =
        RunningProgram::start(posebridge(folder.path()).args(["run", "--link", "sim://skewed.toml", "--out", "run"]));
    // One lap takes about ten seconds: it is in its second when it is ended.
    let mut lines = Vec::new();
    for _ in 0..14 {
        lines.push(run.wait_for("odometry "));
    }
    for line in lines.iter().skip(4) {
        let odometry_m = number_after(line, "odometry ");
        assert!((0.0..2.0).contains(&odometry_m), "{line}");
        let estimate_m = number_after(line, "estimate ");
        assert!((0.0..0.1).contains(&estimate_m), "{line}");
    }
    let tables = run.interrupt();
    assert!(tables.contains("brick's own odometry") && tables.contains("path error"), "{tables}");
    assert!(tables.contains("track.svg"), "{tables}");
    let recording = folder.path().join("run/recording.mcap");
    let samples = read_truth(&std::fs::read(&recording).unwrap()).unwrap();
    assert!(samples.len() > 14 * 15, "{} samples of the truth", samples.len());
    assert!(samples.windows(2).all(|pair| pair[0].time < pair[1].time), "in order, once each");
    let replayed = stdout_of(posebridge(folder.path()).args(["replay", "run/recording.mcap"]));
    assert!(replayed.contains("pose"), "{replayed}");
}

/// Waits for something to happen on a port.
async fn wait_for(port: &mut Link, what: &str, is_it: impl Fn(&LinkEvent) -> bool) {
    let waited = tokio::time::timeout(Duration::from_secs(60), async { while !is_it(&port.next_event().await) {} });
    assert!(waited.await.is_ok(), "{what} within a minute");
}

#[tokio::test(flavor = "current_thread")]
async fn a_pulled_cable_closes_the_terminal_and_puts_it_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("brick.tty");
    let (timer, stop) = (HostTimer::start(), CancellationToken::new());
    let scenario = Scenario::default().without_end();
    let listening = LinkOpenConfig { id: LinkId(0), url: LinkUrl::pty(&path).unwrap(), role: ConnectRole::Listen };
    let start = BrickStart { scenario, link: listening, robot: None };
    let embedded = EmbeddedBricks::start(vec![start], timer, stop.clone()).unwrap();
    let brick = &embedded.bricks[0];
    let config = LinkOpenConfig { id: LinkId(0), url: LinkUrl::serial(&path).unwrap(), role: ConnectRole::Dial };
    let mut port = Link::new(config, timer);
    port.try_open().await.unwrap();
    let has_bytes = |event: &LinkEvent| matches!(event, LinkEvent::Bytes { .. });
    wait_for(&mut port, "the brick speaks", has_bytes).await;
    let duration = TimeDelta::from_millis(300);
    let pull = SimulatorCommand::PullCable { duration };
    brick.controls.commands.try_send(pull).unwrap();
    let is_down = |event: &LinkEvent| matches!(event, LinkEvent::Down { .. });
    wait_for(&mut port, "it is gone", is_down).await;
    let is_up = |event: &LinkEvent| matches!(event, LinkEvent::Up { .. });
    wait_for(&mut port, "it is back", is_up).await;
    wait_for(&mut port, "it speaks again", has_bytes).await;
    stop.cancel();
    let simulations = embedded.finish().unwrap();
    assert!(simulations.iter().all(|simulation| !simulation.is_finished()));
}
