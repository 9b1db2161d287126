//! The simulated brick in real time, behind a real link: its own thread when it is embedded, the whole process in `posebridge sim`.

use std::path::Path;
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_link::{HostTimer, LinkUrl, Port, PortConfig, PortEvent, Role};
use posebridge_sim::{STEP, Scenario, Simulation};
use posebridge_telemetry::{HostClock, LinkId, PeerId, Span, Stamp};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// The world is stepped in bites of this length: the host's timers are a millisecond wide, and telemetry of 200 Hz is still on time.
const BITE: Span = Span::from_millis(2);
/// After the path's end the brick still talks for this long, so that the last late fixes are used.
const AFTERGLOW: Span = Span::from_millis(600);

/// Time between two announcements.
const ANNOUNCED_EACH: Span = Span::from_millis(1_000);

/// The links of a simulated brick, open.
pub struct BrickPorts {
    /// To the station.
    pub brick: Port,
    /// Whom the brick has heard last there.
    station: Option<PeerId>,
    /// The camera's own, where it does not share the brick's. Without it nobody hears such a camera.
    pub camera: Option<Port>,
    /// Where the camera's images go, if another program looks through it.
    pub images: Option<Port>,
    /// Where the brick is announced.
    pub announcement: Option<Announcement>,
}

/// A text that is sent again and again.
pub struct Announcement {
    port: Port,
    text: Vec<u8>,
    due: Span,
}

impl Announcement {
    /// Sends `text` on `port` from now on.
    #[must_use]
    pub const fn new(port: Port, text: Vec<u8>) -> Self {
        Self {
            port,
            text,
            due: Span::ZERO,
        }
    }

    fn send_if_due(&mut self, elapsed: Span) {
        if elapsed >= self.due {
            self.due = elapsed + ANNOUNCED_EACH;
            self.port.send(&self.text);
        }
    }
}

impl BrickPorts {
    /// The brick's link alone.
    #[must_use]
    pub const fn of(brick: Port) -> Self {
        Self {
            brick,
            station: None,
            camera: None,
            images: None,
            announcement: None,
        }
    }

    /// Waits for something to happen and gives it to the simulation, which lives until then first.
    async fn serve(
        &mut self,
        simulation: &mut Simulation,
        (timer, start): (HostTimer, Stamp<HostClock>),
    ) {
        tokio::select! {
            event = self.brick.next() => {
                step_to(simulation, timer.now() - start);
                match event {
                    PortEvent::Bytes { peer, bytes, .. } => {
                        if self.station.is_some_and(|station| station != peer) {
                            simulation.reopen_link();
                        }
                        self.station = Some(peer);
                        simulation.receive(&bytes);
                    }
                    PortEvent::Up { .. } | PortEvent::Down { .. } => {
                        self.station = None;
                        simulation.reopen_link();
                    }
                    PortEvent::Finished { .. } => {}
                }
            }
            event = next_of(self.camera.as_mut()) => {
                step_to(simulation, timer.now() - start);
                if let PortEvent::Bytes { bytes, .. } = event {
                    simulation.receive_camera(&bytes);
                }
            }
            // Nobody answers an image. Polled, the port takes whoever calls.
            _ = next_of(self.images.as_mut()) => {}
            // Nobody answers an announcement there; polled, the port comes back after a loss.
            _ = next_of(self.announcement.as_mut().map(|announcement| &mut announcement.port)) => {}
        }
    }

    /// Sends what brick and camera have to say.
    fn send_all(&mut self, simulation: &mut Simulation) {
        while let Some(bytes) = simulation.poll() {
            self.brick.send(&bytes);
        }
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
async fn next_of(port: Option<&mut Port>) -> PortEvent {
    match port {
        Some(port) => port.next().await,
        None => std::future::pending().await,
    }
}

/// A brick in a thread of its own.
pub struct EmbeddedBrick {
    thread: JoinHandle<Result<Simulation>>,
    /// Cancelled when the path is driven to its end.
    pub finished: CancellationToken,
    /// How much of the path is driven, 0 to 1.
    pub progress: watch::Receiver<f64>,
}

impl EmbeddedBrick {
    /// Starts the brick on a pseudo-terminal that `path` will point to.
    ///
    /// # Errors
    /// The pseudo-terminal cannot be made or the thread cannot be started.
    pub fn start(scenario: Scenario, path: &Path, stop: CancellationToken) -> Result<Self> {
        let url = LinkUrl::pty(path)?;
        let finished = CancellationToken::new();
        let (told, progress) = watch::channel(0.0);
        let done = finished.clone();
        let (ready, is_ready) = std::sync::mpsc::sync_channel::<Result<()>>(1);
        let thread = std::thread::Builder::new()
            .name("brick".to_owned())
            .spawn(move || {
                let runtime = tokio::runtime::Builder::new_current_thread()
                    .enable_all()
                    .build()
                    .context("starting the brick's runtime")?;
                runtime.block_on(async {
                    let timer = HostTimer::start();
                    let mut port = Port::new(
                        PortConfig {
                            id: LinkId(0),
                            url,
                            role: Role::Listen,
                        },
                        timer,
                    );
                    let opened = port.open_first().await;
                    let failed = opened.is_err();
                    // The starter has gone only if it has failed itself.
                    drop(ready.send(opened.map_err(anyhow::Error::from)));
                    let mut simulation = Simulation::new(scenario);
                    if !failed {
                        let mut ports = BrickPorts::of(port);
                        drive(&mut simulation, &mut ports, timer, &stop, &told).await;
                        done.cancel();
                    }
                    Ok(simulation)
                })
            })
            .context("starting the brick's thread")?;
        is_ready
            .recv()
            .map_err(|_gone| anyhow!("the brick's thread died"))??;
        Ok(Self {
            thread,
            finished,
            progress,
        })
    }

    /// Waits for the thread and gives the simulation with its truth.
    ///
    /// # Errors
    /// The brick's runtime could not be started.
    pub fn finish(self) -> Result<Simulation> {
        self.thread
            .join()
            .map_err(|_panic| anyhow!("the brick's thread died"))?
    }
}

/// Drives a simulation in real time on its ports, until its path ends or somebody stops it.
pub async fn drive(
    simulation: &mut Simulation,
    ports: &mut BrickPorts,
    timer: HostTimer,
    stop: &CancellationToken,
    progress: &watch::Sender<f64>,
) {
    let start = timer.now();
    let mut ends_at: Option<Stamp<HostClock>> = None;
    loop {
        let bite_end = start + simulation.elapsed() + BITE;
        tokio::select! {
            () = ports.serve(simulation, (timer, start)) => {}
            () = timer.sleep_until(bite_end) => step_to(simulation, timer.now() - start),
            () = stop.cancelled() => return,
        }
        ports.send_all(simulation);
        progress.send_replace(simulation.progress());
        if simulation.is_finished() {
            let end = *ends_at.get_or_insert(timer.now() + AFTERGLOW);
            if timer.now() >= end {
                return;
            }
        }
    }
}

/// The world follows the host's clock and never runs ahead of it: nothing may be sent before it was measured.
fn step_to(simulation: &mut Simulation, elapsed: Span) {
    while simulation.elapsed() + STEP <= elapsed {
        simulation.step();
    }
}
