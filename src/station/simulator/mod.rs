//! Simulated bricks in real time, behind real links: a thread of their own when they are embedded, the whole process in `posebridge sim`.

mod cable;
mod controls;
mod embedded;
pub mod truth_tap;

use anyhow::{Context, Result};
use posebridge_link::{HostTimer, Link, LinkEvent};
use posebridge_sim::{STEP, Simulation};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use tokio::sync::watch;
use tokio::task::LocalSet;
use tokio_util::sync::CancellationToken;

pub use self::cable::SimulatedCable;
pub use self::controls::{
    COMMAND_CAPACITY, CommandSender, ControlReceiver, SimulatorControls, TimedTruthSample, controls,
};
pub use self::embedded::{BrickStart, EmbeddedBrick, EmbeddedBricks};

/// The world is stepped in chunks of this length: the host's timers are a millisecond wide, and telemetry of 200 Hz is still on time.
const STEP_CHUNK: TimeDelta = TimeDelta::from_millis(2);
/// After the path's end the brick still sends for this long, so that the last late fixes are used.
const LINGER_AFTER_END: TimeDelta = TimeDelta::from_millis(600);

/// Time between two announcements.
const ANNOUNCE_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// The links of a simulated brick, open.
pub struct BrickPorts {
    /// To the station.
    pub brick: SimulatedCable,
    /// The camera's own, where it does not share the brick's. Without it such a camera is not received.
    pub camera: Option<Link>,
    /// Where the camera's images go, if another program looks through it.
    pub images: Option<Link>,
    /// Where the brick is announced.
    pub announcement: Option<Announcement>,
}

/// A text that is sent again and again.
pub struct Announcement {
    port: Link,
    text: Vec<u8>,
    due: TimeDelta,
}

impl Announcement {
    /// Sends `text` on `port` from now on.
    pub const fn new(port: Link, text: Vec<u8>) -> Self {
        Self { port, text, due: TimeDelta::ZERO }
    }

    fn send_if_due(&mut self, elapsed: TimeDelta) {
        if elapsed >= self.due {
            self.due = elapsed + ANNOUNCE_PERIOD;
            self.port.send(&self.text);
        }
    }
}

impl BrickPorts {
    /// The brick's link alone.
    pub const fn of(brick: SimulatedCable) -> Self {
        Self { brick, camera: None, images: None, announcement: None }
    }

    /// Waits for something to happen and gives it to the simulation, which lives until then first.
    async fn serve(&mut self, simulation: &mut Simulation, timer: HostTimer, start: Timestamp<HostClock>) {
        tokio::select! {
            event = self.brick.next_event() => {
                let now = timer.now();
                step_to(simulation, now - start);
                self.brick.on_link_event(now, event, simulation);
            }
            event = next_of(self.camera.as_mut()) => {
                step_to(simulation, timer.now() - start);
                if let LinkEvent::Bytes { bytes, .. } = event {
                    simulation.receive_camera(&bytes);
                }
            }
            // Images get no answer. Polling lets the port accept connections.
            _ = next_of(self.images.as_mut()) => {}
            // An announcement gets no answer there; polled, the port comes back after a loss.
            _ = next_of(self.announcement.as_mut().map(|announcement| &mut announcement.port)) => {}
        }
    }

    /// Sends what brick and camera have to say.
    fn send_all(&mut self, now: Timestamp<HostClock>, simulation: &mut Simulation) {
        self.brick.transfer(now, simulation);
        while let Some(bytes) = simulation.poll_camera() {
            if let Some(camera) = &mut self.camera {
                camera.send(&bytes);
            }
        }
        while let Some(image) = simulation.poll_image() {
            if let Some(port) = &mut self.images {
                port.send(format!("{image}\n").as_bytes());
            }
        }
        if let Some(announcement) = &mut self.announcement {
            announcement.send_if_due(simulation.elapsed());
        }
    }
}

/// The next event of a port; never, without one.
async fn next_of(port: Option<&mut Link>) -> LinkEvent {
    match port {
        Some(port) => port.next_event().await,
        None => std::future::pending().await,
    }
}

/// A simulated brick that is ready to drive.
pub struct BrickDrive {
    /// Its world.
    pub simulation: Simulation,
    /// Its links, open.
    pub ports: BrickPorts,
    /// Receives how much of the path is driven, 0 to 1.
    pub progress: watch::Sender<f64>,
    /// Through which people reach it, if they can.
    pub controls: Option<ControlReceiver>,
}

impl BrickDrive {
    /// A brick without a progress display and without controls.
    pub fn unattended(simulation: Simulation, ports: BrickPorts) -> Self {
        Self { simulation, ports, progress: watch::channel(0.0).0, controls: None }
    }

    /// Drives in real time until the path ends or it is stopped; gives the simulation back.
    async fn run(self, timer: HostTimer, stop: CancellationToken) -> Simulation {
        let Self { mut simulation, mut ports, progress, mut controls } = self;
        let start = timer.now();
        let mut ends_at: Option<Timestamp<HostClock>> = None;
        loop {
            let chunk_end = start + simulation.elapsed() + STEP_CHUNK;
            tokio::select! {
                () = ports.serve(&mut simulation, timer, start) => {}
                () = timer.sleep_until(chunk_end) => step_to(&mut simulation, timer.now() - start),
                () = stop.cancelled() => break,
            }
            let now = timer.now();
            if let Some(controls) = &mut controls {
                controls.execute_commands(now, &mut simulation, &mut ports.brick);
                controls.publish_truth(start, &simulation);
            }
            ports.send_all(now, &mut simulation);
            progress.send_replace(simulation.progress());
            if simulation.is_finished() {
                let end = *ends_at.get_or_insert(now + LINGER_AFTER_END);
                if now >= end {
                    break;
                }
            }
        }
        simulation
    }
}

/// Drives bricks in real time on this thread until all of their paths end or `stop` is cancelled; gives their simulations back in
/// the same order.
///
/// # Errors
/// A brick's task died.
pub async fn drive(bricks: Vec<BrickDrive>, timer: HostTimer, stop: &CancellationToken) -> Result<Vec<Simulation>> {
    let tasks = LocalSet::new();
    let running: Vec<_> = bricks.into_iter().map(|brick| tasks.spawn_local(brick.run(timer, stop.clone()))).collect();
    tasks
        .run_until(async {
            let mut simulations = Vec::new();
            for brick in running {
                simulations.push(brick.await.context("a brick's task died")?);
            }
            Ok(simulations)
        })
        .await
}

/// The world follows the host's clock and never runs ahead of it: nothing may be sent before it was measured.
fn step_to(simulation: &mut Simulation, elapsed: TimeDelta) {
    while simulation.elapsed() + STEP <= elapsed {
        simulation.step();
    }
}
