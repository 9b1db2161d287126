//! `posebridge play`: a recording of a real robot out of a link, as a brick would send it.
//!
//! Observations leave at the instants at which they arrived, in real time or faster, stamped by the recording's own clock. The
//! player describes the robot, answers requests for its time and tells of itself once per second. Truth and withheld fixes stay
//! here.

use std::collections::BTreeMap;

use anyhow::{Result, bail};
use posebridge_link::{HostTimer, Port, PortEvent};
use posebridge_protocol::brick_player::BrickPlayer;
use posebridge_telemetry::{HostClock, Span, Stamp};

use super::run::Signals;
use super::{Failure, Stage, station_link};
use crate::cli::PlayArgs;
use crate::data::{DataSet, RobotRun, tell_bad_rows};
use crate::stderr::say;

/// The player looks after its session at least this often.
const SESSION_PERIOD: Span = Span::from_millis(20);
/// While it waits the player tells that it is there once per second, as a heartbeat does.
const ANNOUNCE_PERIOD: Span = Span::from_millis(1_000);
/// What was sent last must reach the station before the link closes.
const AFTERGLOW: Span = Span::from_millis(300);

/// Plays.
///
/// # Errors
/// The descriptor, its files or the link make no sense.
pub fn execute(args: &PlayArgs) -> Result<(), Failure> {
    let data = DataSet::open(&args.descriptor, &args.data).at_start()?;
    let Some(name) = data.runs.first() else {
        return Err(anyhow::anyhow!("the descriptor has no run")).at_start();
    };
    if data.runs.len() > 1 {
        say(&format!("{} runs match; this plays {name}, choose another with --run", data.runs.len()));
    }
    let run = data.load(name, &args.data).at_start()?;
    tell_bad_rows(&run);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().at_start()?;
    runtime.block_on(async {
        let timer = HostTimer::start();
        let mut signals = Signals::listen().at_start()?;
        let mut port = station_link::port(&args.link, timer).at_start()?;
        say(&station_link::open(&args.link, &mut port).await.at_start()?);
        let mut player = Player { port, timer, speed: args.speed };
        tokio::select! {
            result = player.play(&run, args) => result.while_running(),
            () = signals.received() => Ok(()),
        }
    })
}

/// How the recording's time runs against the host's.
#[derive(Clone, Copy)]
struct DataClock {
    start: Stamp<HostClock>,
    speed: f64,
    whole: Span,
}

impl DataClock {
    /// Recorded time since the first observation; it stands still after the last.
    fn elapsed(&self, now: Stamp<HostClock>) -> Span {
        Span::from_secs_f64((now - self.start).as_secs_f64() * self.speed).min(self.whole)
    }
}

struct Player {
    port: Port,
    timer: HostTimer,
    speed: f64,
}

impl Player {
    async fn play(&mut self, run: &RobotRun, args: &PlayArgs) -> Result<()> {
        let Some(first) = run.run.observations.first() else { bail!("run `{}` is empty", run.run.name) };
        let mut brick = BrickPlayer::new(first.observation.stamp, run.filter_config.geometry, &run.run.name);
        if !args.at_once {
            say("waiting for a station");
            self.wait_for_station(&mut brick).await;
        }
        brick.announce();
        say(&format!("playing {}: {} observations", run.run.name, run.run.observations.len()));
        let start = self.timer.now();
        let whole = run.run.observations.last().map_or(Span::ZERO, |last| last.arrival - first.arrival);
        let clock = DataClock { start, speed: self.speed, whole };
        let mut unsent: BTreeMap<&'static str, u64> = BTreeMap::new();
        for timed in &run.run.observations {
            let due = start + self.real_span(timed.arrival - first.arrival);
            self.serve_until(due, clock, &mut brick).await;
            if !brick.send(&timed.observation) {
                *unsent.entry(timed.observation.observed.kind()).or_default() += 1;
            }
            self.flush(&mut brick);
        }
        self.fall_silent().await;
        for (kind, count) in unsent {
            say(&format!("{count} observations of kind {kind} have no message and were not sent"));
        }
        match self.port.counters().drops_out {
            0 => Ok(()),
            frames => bail!("{frames} chunks were not sent because the link was down or full: play slower"),
        }
    }

    fn real_span(&self, span: Span) -> Span {
        Span::from_secs_f64(span.as_secs_f64() / self.speed)
    }

    /// Until a byte comes. A station that was called must be told that somebody is there.
    async fn wait_for_station(&mut self, brick: &mut BrickPlayer) {
        loop {
            let next = self.timer.now() + ANNOUNCE_PERIOD;
            tokio::select! {
                event = self.port.next() => match event {
                    PortEvent::Bytes { .. } => return,
                    // Only a link that is up can be told; what a closed one refused is no loss.
                    PortEvent::Up { .. } | PortEvent::Down { .. } | PortEvent::Finished { .. } => {}
                },
                () = self.timer.sleep_until(next) => {
                    brick.announce();
                    if self.port.is_up() {
                        self.flush(brick);
                    }
                    drop(brick.take_bytes());
                }
            }
        }
    }

    /// Lets what was sent last go out. The recording's clock stands: nobody is told the time any more.
    async fn fall_silent(&mut self) {
        let end = self.timer.now() + AFTERGLOW;
        while self.timer.now() < end {
            tokio::select! {
                _ = self.port.next() => {}
                () = self.timer.sleep_until(end) => {}
            }
        }
    }

    /// Answers the station until `due`.
    async fn serve_until(&mut self, due: Stamp<HostClock>, clock: DataClock, brick: &mut BrickPlayer) {
        loop {
            let now = self.timer.now();
            brick.pass_time(clock.elapsed(now));
            self.flush(brick);
            if now >= due {
                return;
            }
            let wake = due.min(now + SESSION_PERIOD);
            tokio::select! {
                event = self.port.next() => {
                    if let PortEvent::Bytes { bytes, arrival, .. } = event {
                        // The answer to a request for the time must carry the time of now.
                        brick.pass_time(clock.elapsed(arrival));
                        brick.receive(&bytes);
                    }
                }
                () = self.timer.sleep_until(wake) => {}
            }
        }
    }

    fn flush(&mut self, brick: &mut BrickPlayer) {
        let bytes = brick.take_bytes();
        if !bytes.is_empty() {
            self.port.send(&bytes);
        }
    }
}
