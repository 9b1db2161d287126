//! Simulated bricks in real time behind real links: on a thread in `run`, as the whole process in `posebridge sim`.

mod controls;
#[cfg(feature = "camera")]
mod rendered_pictures;

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_link::{HostTimer, Link, LinkEvent, LinkOpenConfig};
use posebridge_sim::{STEP, Scenario, Simulation};
use posebridge_telemetry::{HostClock, LinkId, RobotId, TimeDelta, Timestamp};
use tokio::sync::watch;
use tokio::task::LocalSet;
use tokio_util::sync::CancellationToken;

use crate::runtime::run_in_runtime;

pub use self::controls::{
    COMMAND_CAPACITY, CommandSender, ControlReceiver, SimulatedCable, SimulatorControls, TimedTruthSample, TruthTap,
    controls,
};
#[cfg(feature = "camera")]
pub use self::rendered_pictures::RenderedPictures;

/// Step of the real-time loop: host timers have a resolution of a millisecond, and telemetry of 200 Hz is still on time.
const STEP_CHUNK: TimeDelta = TimeDelta::from_millis(2);
/// Time for which the brick still sends after the path's end, so that the last late fixes are used.
const LINGER_AFTER_END: TimeDelta = TimeDelta::from_millis(600);

const ANNOUNCE_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

pub struct BrickPorts {
    pub brick: SimulatedCable,
    /// The camera's own link, if it does not share the brick's. Without it the camera is not received.
    pub camera: Option<Link>,
    /// Output of the camera's images for another program.
    pub images: Option<Link>,
    /// The camera renders, and another program finds the tags.
    #[cfg(feature = "camera")]
    pub pictures: Option<RenderedPictures>,
    pub announcement: Option<Announcement>,
}

pub struct Announcement {
    port: Link,
    text: Vec<u8>,
    due: TimeDelta,
}

impl Announcement {
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
    pub const fn of(brick: SimulatedCable) -> Self {
        Self {
            brick,
            camera: None,
            images: None,
            #[cfg(feature = "camera")]
            pictures: None,
            announcement: None,
        }
    }

    /// Waits for the next event, advances the simulation to its time and handles it.
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

/// The next event of a port; pending forever without one.
async fn next_of(port: Option<&mut Link>) -> LinkEvent {
    match port {
        Some(port) => port.next_event().await,
        None => std::future::pending().await,
    }
}

pub struct BrickDrive {
    pub simulation: Simulation,
    pub ports: BrickPorts,
    /// Driven share of the path, 0 to 1.
    pub progress: watch::Sender<f64>,
    /// Commands and truth output, if enabled.
    pub controls: Option<ControlReceiver>,
}

impl BrickDrive {
    /// A brick without a progress display and without controls.
    pub fn unattended(simulation: Simulation, ports: BrickPorts) -> Self {
        Self { simulation, ports, progress: watch::channel(0.0).0, controls: None }
    }

    /// Drives in real time until the path ends or it is stopped; returns the simulation.
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
            #[cfg(feature = "camera")]
            if let Some(pictures) = &mut ports.pictures {
                pictures.take_from(&mut simulation, start);
            }
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

/// Drives bricks in real time on this thread until all of their paths end or `stop` is cancelled; returns their simulations in the same
/// order.
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

pub struct BrickStart {
    pub scenario: Scenario,
    /// Its end of the link to the station.
    pub link: LinkOpenConfig,
    /// `None` for the only one.
    pub robot: Option<RobotId>,
    /// Its camera renders pictures for the station.
    #[cfg(feature = "camera")]
    pub pictures: Option<RenderedPictures>,
}

pub struct EmbeddedBrick {
    pub scenario: Scenario,
    /// `None` for the only one.
    pub robot: Option<RobotId>,
    /// Driven share of the path, 0 to 1.
    pub progress: watch::Receiver<f64>,
    pub controls: SimulatorControls,
    /// Receives the truth from the start; taken once.
    pub truth: Option<TruthTap>,
}

impl EmbeddedBrick {
    pub fn truth_tap(&self) -> TruthTap {
        TruthTap::new(&self.controls.truth, self.robot)
    }
}

/// Bricks on a thread. Dropping stops them and removes their terminals, so that a failed start leaves none.
pub struct EmbeddedBricks {
    thread: Option<JoinHandle<Result<Vec<Simulation>>>>,
    stop: CancellationToken,
    /// Cancelled when all paths are complete.
    pub finished: CancellationToken,
    /// Of their scenario.
    pub name: String,
    /// The station's link to them.
    pub link: LinkId,
    /// Never empty; in the order of `starts`.
    pub bricks: Vec<EmbeddedBrick>,
}

impl EmbeddedBricks {
    /// Starts each brick on its link. `timer` timestamps their outputs.
    pub fn start(
        name: String,
        link: LinkId,
        starts: Vec<BrickStart>,
        timer: HostTimer,
        stop: CancellationToken,
    ) -> Result<Self> {
        let finished = CancellationToken::new();
        let (ready, is_ready) = sync_channel::<Result<()>>(1);
        let mut bricks = Vec::new();
        let mut drives = Vec::new();
        for start in starts {
            let BrickStart { scenario, link: config, robot, .. } = start;
            let (sender, progress) = watch::channel(0.0);
            let (controls, receiver) = controls();
            let truth = Some(TruthTap::new(&controls.truth, robot));
            drives.push(BrickDrive {
                simulation: Simulation::new(scenario.clone()),
                ports: BrickPorts {
                    #[cfg(feature = "camera")]
                    pictures: start.pictures,
                    ..BrickPorts::of(SimulatedCable::pluggable(config, timer))
                },
                progress: sender,
                controls: Some(receiver),
            });
            bricks.push(EmbeddedBrick { scenario, robot, progress, controls, truth });
        }
        let (stopped, all_driven) = (stop.clone(), finished.clone());
        let thread = std::thread::Builder::new()
            .name("brick".to_owned())
            .spawn(move || {
                let driven = run_in_runtime(open_and_drive(drives, timer, &stopped, &ready));
                all_driven.cancel();
                driven.context("starting the runtime of the simulated bricks")?
            })
            .context("starting the thread of the simulated bricks")?;
        is_ready.recv().map_err(|_closed| anyhow!("the thread of the simulated bricks died"))??;
        Ok(Self { thread: Some(thread), stop, finished, name, link, bricks })
    }

    /// Joins the thread and returns the simulations with their truth, in the order of the bricks.
    pub fn finish(mut self) -> Result<Vec<Simulation>> {
        let ended = self.thread.take().map(JoinHandle::join);
        let ended = ended.context("the simulated bricks have ended already")?;
        ended.map_err(|_panic| anyhow!("the thread of the simulated bricks died"))?
    }
}

impl Drop for EmbeddedBricks {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            self.stop.cancel();
            // Another task has failed, and reports why.
            drop(thread.join());
        }
    }
}

/// Reports to `ready` when all links are open, or the first error.
async fn open_and_drive(
    mut bricks: Vec<BrickDrive>,
    timer: HostTimer,
    stop: &CancellationToken,
    ready: &SyncSender<Result<()>>,
) -> Result<Vec<Simulation>> {
    for brick in &mut bricks {
        if let Err(error) = brick.ports.brick.open_first().await {
            // The starter has gone only if it has failed itself.
            drop(ready.send(Err(error)));
            return Ok(Vec::new());
        }
    }
    drop(ready.send(Ok(())));
    drive(bricks, timer, stop).await
}
