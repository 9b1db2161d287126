//! The simulated brick in real time, behind a real link: its own thread when it is embedded, the whole process in `posebridge sim`.

use std::path::Path;
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_link::{HostTimer, LinkUrl, Port, PortConfig, PortEvent, Role};
use posebridge_sim::{STEP, Scenario, Simulation};
use posebridge_telemetry::{HostClock, LinkId, Span, Stamp};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// The world is stepped in bites of this length: the host's timers are a millisecond wide, and telemetry of 200 Hz is still on time.
const BITE: Span = Span::from_millis(2);
/// After the path's end the brick still talks for this long, so that the last late fixes are used.
const AFTERGLOW: Span = Span::from_millis(600);

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
                        drive(&mut simulation, &mut port, timer, &stop, &told).await;
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

/// Drives a simulation in real time on a port, until its path ends or somebody stops it.
pub async fn drive(
    simulation: &mut Simulation,
    port: &mut Port,
    timer: HostTimer,
    stop: &CancellationToken,
    progress: &watch::Sender<f64>,
) {
    let start = timer.now();
    let mut ends_at: Option<Stamp<HostClock>> = None;
    loop {
        let bite_end = start + simulation.elapsed() + BITE;
        tokio::select! {
            event = port.next() => {
                let now = timer.now();
                step_to(simulation, now - start);
                if let PortEvent::Bytes { bytes, .. } = event {
                    simulation.receive(&bytes);
                }
            }
            () = timer.sleep_until(bite_end) => step_to(simulation, timer.now() - start),
            () = stop.cancelled() => return,
        }
        while let Some(bytes) = simulation.poll() {
            port.send(&bytes);
        }
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
