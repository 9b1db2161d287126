//! `posebridge play`: sends a recording of a real robot over a link, as a brick would.
//! Observations are sent at their arrival times, in real time or faster, with the recording's own timestamps. The player describes the
//! robot, answers time requests and sends its heartbeat once per second. Truth and withheld fixes are not sent.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use posebridge_link::{HostTimer, Link, LinkEvent};
use posebridge_protocol::recorded_robot::RecordedRobot;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::dataset::{DataSet, RobotRun, report_bad_rows};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure, Signals};
use crate::flags::{DataFlags, StationLink, positive};
use crate::runtime::run_in_runtime;

/// Flags of `play`.
#[derive(Args, Clone, Debug)]
pub struct PlayArgs {
    /// Descriptor of a recording (config/recordings/*.toml).
    pub descriptor: PathBuf,
    /// The link to the station.
    #[command(flatten)]
    pub link: StationLink,
    /// What to read.
    #[command(flatten)]
    pub data: DataFlags,
    /// Speed relative to real time. With a value other than 1 the station cannot align clocks; a recording with one clock does
    /// not need that.
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR", value_parser = positive)]
    pub speed: f64,
    /// Start at once instead of waiting for bytes from the station.
    #[arg(long)]
    pub at_once: bool,
}

/// Maximum period of session updates.
const SESSION_PERIOD: TimeDelta = TimeDelta::from_millis(20);
/// Heartbeat period while it waits for the station.
const ANNOUNCE_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
/// Time for the last bytes to reach the station before the link closes.
const LINGER_AFTER_END: TimeDelta = TimeDelta::from_millis(300);

pub fn execute(args: &PlayArgs) -> Result<(), Failure> {
    let data = DataSet::open(&args.descriptor, &args.data).before_start()?;
    let Some(name) = data.runs.first() else {
        return Err(anyhow::anyhow!("the descriptor has no run")).before_start();
    };
    if data.runs.len() > 1 {
        print_line(&format!("{} runs match; this plays {name}, choose another with --run", data.runs.len()));
    }
    let run = data.load(name, &args.data).before_start()?;
    report_bad_rows(&run);
    run_in_runtime(async {
        let timer = HostTimer::start();
        let mut signals = Signals::listen().before_start()?;
        let (port, place) = args.link.flag().before_start()?.open(timer).await.before_start()?;
        print_line(&place);
        let mut player = Player { port, timer, speed: args.speed };
        tokio::select! {
            result = player.play(&run, args) => result.while_running(),
            () = signals.received() => Ok(()),
        }
    })
    .before_start()?
}

/// Maps host time to recording time.
#[derive(Clone, Copy)]
struct DataClock {
    start: Timestamp<HostClock>,
    speed: f64,
    total: TimeDelta,
}

impl DataClock {
    /// Recording time since the first observation; constant after the last.
    fn elapsed(&self, now: Timestamp<HostClock>) -> TimeDelta {
        TimeDelta::from_secs_f64((now - self.start).as_secs_f64() * self.speed).min(self.total)
    }
}

struct Player {
    port: Link,
    timer: HostTimer,
    speed: f64,
}

impl Player {
    async fn play(&mut self, run: &RobotRun, args: &PlayArgs) -> Result<()> {
        let Some(first) = run.run.observations.first() else { bail!("run `{}` is empty", run.run.name) };
        let mut brick = RecordedRobot::new(first.observation.stamp, run.filter_config.geometry, &run.run.name);
        if !args.at_once {
            print_line("waiting for a station");
            self.wait_for_station(&mut brick).await;
        }
        brick.send_heartbeat_now();
        print_line(&format!("playing {}: {} observations", run.run.name, run.run.observations.len()));
        let start = self.timer.now();
        let whole = run.run.observations.last().map_or(TimeDelta::ZERO, |last| last.arrival - first.arrival);
        let clock = DataClock { start, speed: self.speed, total: whole };
        let mut unsent: BTreeMap<&'static str, u64> = BTreeMap::new();
        for timed in run.run.observations.iter() {
            let due = start + TimeDelta::from_secs_f64((timed.arrival - first.arrival).as_secs_f64() / self.speed);
            self.serve_until(due, clock, &mut brick).await;
            if !brick.send(&timed.observation) {
                *unsent.entry(timed.observation.measurement.kind()).or_default() += 1;
            }
            self.flush(&mut brick);
        }
        self.linger().await;
        for (kind, count) in unsent {
            print_line(&format!("{count} observations of kind {kind} have no message and were not sent"));
        }
        match self.port.counters().drops_out {
            0 => Ok(()),
            frames => bail!("{frames} chunks were not sent because the link was down or full: play slower"),
        }
    }

    /// Waits for the first byte. A station that listens must notice the peer, so heartbeats are sent.
    async fn wait_for_station(&mut self, brick: &mut RecordedRobot) {
        loop {
            let next = self.timer.now() + ANNOUNCE_PERIOD;
            tokio::select! {
                event = self.port.next_event() => match event {
                    LinkEvent::Bytes { .. } => return,
                    // Only a link that is up can send; what a closed one refused is no loss.
                    LinkEvent::Up { .. } | LinkEvent::Down { .. } | LinkEvent::Finished { .. } => {}
                },
                () = self.timer.sleep_until(next) => {
                    brick.send_heartbeat_now();
                    if self.port.is_up() {
                        self.flush(brick);
                    }
                    drop(brick.take_bytes());
                }
            }
        }
    }

    /// Waits until the last bytes are sent. The recording's clock has stopped: time requests are no longer answered.
    async fn linger(&mut self) {
        let end = self.timer.now() + LINGER_AFTER_END;
        while self.timer.now() < end {
            tokio::select! {
                _ = self.port.next_event() => {}
                () = self.timer.sleep_until(end) => {}
            }
        }
    }

    async fn serve_until(&mut self, due: Timestamp<HostClock>, clock: DataClock, brick: &mut RecordedRobot) {
        loop {
            let now = self.timer.now();
            brick.advance_clock(clock.elapsed(now));
            self.flush(brick);
            if now >= due {
                return;
            }
            let wake = due.min(now + SESSION_PERIOD);
            tokio::select! {
                event = self.port.next_event() => {
                    if let LinkEvent::Bytes { bytes, arrival, .. } = event {
                        // The answer to a request for the time must carry the time of now.
                        brick.advance_clock(clock.elapsed(arrival));
                        brick.receive(&bytes);
                    }
                }
                () = self.timer.sleep_until(wake) => {}
            }
        }
    }

    fn flush(&mut self, brick: &mut RecordedRobot) {
        let bytes = brick.take_bytes();
        if !bytes.is_empty() {
            self.port.send(&bytes);
        }
    }
}
