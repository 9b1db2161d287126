//! A simulated brick in a thread of the station.

use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_link::{ConnectRole, HostTimer, LinkOpenConfig, LinkUrl};
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::LinkId;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::truth_tap::TruthTap;
use super::{BrickPorts, ControlReceiver, DriveContext, SimulatedCable, SimulatorControls, controls, drive};

/// A brick in a thread of its own. Dropped, it stops and takes its terminal away: a start that fails behind it leaves none.
pub struct EmbeddedBrick {
    thread: Option<JoinHandle<Result<Simulation>>>,
    stop: CancellationToken,
    /// Cancelled when the path is driven to its end.
    pub finished: CancellationToken,
    /// How much of the path is driven, 0 to 1.
    pub progress: watch::Receiver<f64>,
    /// What can be done to it and seen of it.
    pub controls: SimulatorControls,
    /// Who hears where it really is from the very start, until somebody takes it.
    pub truth: Option<TruthTap>,
}

impl EmbeddedBrick {
    /// Starts the brick on a pseudo-terminal that `path` will point to. What it shows bears the stamps of `timer`.
    ///
    /// # Errors
    /// The pseudo-terminal cannot be made or the thread cannot be started.
    pub fn start(scenario: Scenario, path: &Path, timer: HostTimer, stop: CancellationToken) -> Result<Self> {
        let config = LinkOpenConfig { id: LinkId(0), url: LinkUrl::pty(path)?, role: ConnectRole::Listen };
        let finished = CancellationToken::new();
        let (told, progress) = watch::channel(0.0);
        let (hands, reach) = controls();
        let truth = Some(TruthTap::new(&hands.truth));
        let (ready, is_ready) = sync_channel::<Result<()>>(1);
        let life = BrickThread {
            scenario,
            cable: (config, timer),
            controls: reach,
            stop: stop.clone(),
            progress: told,
            finished: finished.clone(),
            ready,
        };
        let thread = std::thread::Builder::new()
            .name("brick".to_owned())
            .spawn(move || life.run())
            .context("starting the brick's thread")?;
        is_ready.recv().map_err(|_gone| anyhow!("the brick's thread died"))??;
        Ok(Self { thread: Some(thread), stop, finished, progress, controls: hands, truth })
    }

    /// Waits for the thread and gives the simulation with its truth.
    ///
    /// # Errors
    /// The brick's runtime could not be started.
    pub fn finish(mut self) -> Result<Simulation> {
        let ended = self.thread.take().map(JoinHandle::join);
        let ended = ended.context("the brick has ended already")?;
        ended.map_err(|_panic| anyhow!("the brick's thread died"))?
    }
}

impl Drop for EmbeddedBrick {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            self.stop.cancel();
            // Somebody else has failed, and says why.
            drop(thread.join());
        }
    }
}

/// What the brick's thread is given.
struct BrickThread {
    scenario: Scenario,
    cable: (LinkOpenConfig, HostTimer),
    controls: ControlReceiver,
    stop: CancellationToken,
    progress: watch::Sender<f64>,
    finished: CancellationToken,
    /// Told whether there is a terminal.
    ready: SyncSender<Result<()>>,
}

impl BrickThread {
    fn run(self) -> Result<Simulation> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .context("starting the brick's runtime")?;
        Ok(runtime.block_on(self.drive()))
    }

    async fn drive(self) -> Simulation {
        let (config, timer) = self.cable;
        let mut cable = SimulatedCable::pluggable(config, timer);
        let opened = cable.open_first().await;
        let failed = opened.is_err();
        // The starter has gone only if it has failed itself.
        drop(self.ready.send(opened));
        let mut simulation = Simulation::new(self.scenario);
        if !failed {
            let mut ports = BrickPorts::of(cable);
            let company = DriveContext { stop: &self.stop, progress: &self.progress, controls: Some(self.controls) };
            drive(&mut simulation, &mut ports, timer, company).await;
            self.finished.cancel();
        }
        simulation
    }
}
