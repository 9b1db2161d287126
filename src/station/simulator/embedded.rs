//! Simulated bricks in a thread of the station.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_link::{HostTimer, LinkOpenConfig};
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::RobotId;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::truth_tap::TruthTap;
use super::{BrickDrive, BrickPorts, ControlReceiver, SimulatedCable, SimulatorControls, controls, drive};

/// What a brick begins with.
#[derive(Clone, Debug)]
pub struct BrickStart {
    /// Its world.
    pub scenario: Scenario,
    /// Its end of the link to the station.
    pub link: LinkOpenConfig,
    /// Which robot of the station it is; `None` for the only one.
    pub robot: Option<RobotId>,
}

/// One brick, seen from the station.
pub struct EmbeddedBrick {
    /// Its world.
    pub scenario: Scenario,
    /// Which robot of the station it is; `None` for the only one.
    pub robot: Option<RobotId>,
    /// How much of the path is driven, 0 to 1.
    pub progress: watch::Receiver<f64>,
    /// Its commands and its truth.
    pub controls: SimulatorControls,
    /// The receiver of the truth from the very start, until it is taken.
    pub truth: Option<TruthTap>,
}

impl EmbeddedBrick {
    /// One more receiver of the truth, from now on.
    pub fn truth_tap(&self) -> TruthTap {
        TruthTap::new(&self.controls.truth, self.robot)
    }
}

/// Bricks in a thread of their own. Dropped, they stop and take their terminals away: a start that fails behind them leaves none.
pub struct EmbeddedBricks {
    thread: Option<JoinHandle<Result<Vec<Simulation>>>>,
    stop: CancellationToken,
    /// Cancelled when all paths are driven to their ends.
    pub finished: CancellationToken,
    /// The bricks, in the order in which they were given.
    pub bricks: Vec<EmbeddedBrick>,
}

impl EmbeddedBricks {
    /// Starts bricks, each on its link. What they show bears the stamps of `timer`.
    ///
    /// # Errors
    /// A link cannot be opened or the thread cannot be started.
    pub fn start(starts: Vec<BrickStart>, timer: HostTimer, stop: CancellationToken) -> Result<Self> {
        let finished = CancellationToken::new();
        let (ready, is_ready) = sync_channel::<Result<()>>(1);
        let mut bricks = Vec::new();
        let mut prepared = Vec::new();
        for BrickStart { scenario, link, robot } in starts {
            let (sender, progress) = watch::channel(0.0);
            let (controls, receiver) = controls();
            let truth = Some(TruthTap::new(&controls.truth, robot));
            bricks.push(EmbeddedBrick { scenario: scenario.clone(), robot, progress, controls, truth });
            prepared.push(PreparedBrick { scenario, link, progress: sender, controls: receiver });
        }
        let thread = BrickThread { bricks: prepared, timer, stop: stop.clone(), finished: finished.clone(), ready };
        let thread = std::thread::Builder::new()
            .name("brick".to_owned())
            .spawn(move || thread.run())
            .context("starting the thread of the simulated bricks")?;
        is_ready.recv().map_err(|_gone| anyhow!("the thread of the simulated bricks died"))??;
        Ok(Self { thread: Some(thread), stop, finished, bricks })
    }

    /// Waits for the thread and gives the simulations with their truth, in the order of the bricks.
    ///
    /// # Errors
    /// The thread's runtime could not be started, or a brick died.
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

/// A brick on its way into the thread.
struct PreparedBrick {
    scenario: Scenario,
    link: LinkOpenConfig,
    progress: watch::Sender<f64>,
    controls: ControlReceiver,
}

/// What the bricks' thread is given.
struct BrickThread {
    bricks: Vec<PreparedBrick>,
    timer: HostTimer,
    stop: CancellationToken,
    finished: CancellationToken,
    /// Receives whether all links are open.
    ready: SyncSender<Result<()>>,
}

impl BrickThread {
    fn run(self) -> Result<Vec<Simulation>> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .context("starting the runtime of the simulated bricks")?;
        runtime.block_on(self.drive())
    }

    async fn drive(self) -> Result<Vec<Simulation>> {
        let mut drives = Vec::new();
        for PreparedBrick { scenario, link, progress, controls } in self.bricks {
            let mut cable = SimulatedCable::pluggable(link, self.timer);
            if let Err(error) = cable.open_first().await {
                // The starter has gone only if it has failed itself.
                drop(self.ready.send(Err(error)));
                return Ok(Vec::new());
            }
            let simulation = Simulation::new(scenario);
            drives.push(BrickDrive { simulation, ports: BrickPorts::of(cable), progress, controls: Some(controls) });
        }
        drop(self.ready.send(Ok(())));
        let simulations = drive(drives, self.timer, &self.stop).await;
        self.finished.cancel();
        simulations
    }
}
