//! The dashboard's own thread and runtime.

use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;

use posebridge_telemetry::{Command, HostClock, Stamp};
use tokio::sync::{Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

use crate::assets::Assets;
use crate::bound::Bound;
use crate::command::Known;
use crate::commander::Commander;
use crate::counts::Counts;
use crate::feed::{Feed, TruthSample};
use crate::hub::Hub;
use crate::limits::{COMMANDS_AT_ONCE, COMMANDS_PER_S, MOST_CLIENTS, WAITING_COMMANDS, WAITING_QUESTIONS};
use crate::model::{ParameterRow, SimulatorFacts};
use crate::recordings::Recordings;
use crate::room::Room;
use crate::server::{App, Clock, Guard, Inlets, Rate, Replay, router, run_hub, serve};
use crate::taps::Taps;
use crate::token::Token;

/// What the thread has in use from its start: trails of a robot and what a stall of ten seconds adds for a moment, measured.
const ROOM_BYTES: usize = 1_500_000;

/// The next free port is looked for among so many.
pub(crate) const PORTS_TRIED: u16 = 20;

/// Who needs the token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TokenPolicy {
    /// Whoever reaches the station by another address than loopback.
    #[default]
    Elsewhere,
    /// Everybody.
    Always,
}

/// What does not change while the station runs.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// The program's version.
    pub version: String,
    /// The URL of each link, in their order.
    pub links: Vec<String>,
    /// Every tunable, as the run begins.
    pub parameters: Vec<ParameterRow>,
    /// The simulated brick, if the station has one of its own.
    pub simulator: Option<SimulatorFacts>,
    /// Who needs the token.
    pub token: TokenPolicy,
}

/// What the dashboard needs of the program around it.
pub struct Sources {
    /// The session's clock.
    pub clock: Box<dyn Fn() -> Stamp<HostClock> + Send + Sync>,
    /// Where the simulated robot was; gives samples until there is none left for now.
    pub truth: Option<Box<dyn FnMut() -> Option<TruthSample> + Send>>,
    /// The folder of this run's recordings.
    pub recordings: PathBuf,
    /// Runs a recording through the engine.
    pub replay: Box<Replay>,
    /// Serves the page from there instead of from the program.
    pub ui_dir: Option<PathBuf>,
    /// Readers in this process.
    pub taps: Taps,
}

/// Why there is no dashboard.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// Somebody listens there already.
    #[error(
        "{address} is in use, perhaps by another station; choose another port with `--dashboard IP:PORT`, or `--no-dashboard`"
    )]
    Taken {
        /// The address.
        address: SocketAddr,
    },
    /// Somebody listens at all ports that were tried.
    #[error("{address} and the {PORTS_TRIED} ports behind it are in use; choose one with `--dashboard IP:PORT`")]
    AllTaken {
        /// The first.
        address: SocketAddr,
    },
    /// The system does not let us listen there.
    #[error("cannot listen on {address}")]
    Bind {
        /// The address.
        address: SocketAddr,
        /// What it says.
        source: io::Error,
    },
    /// The system has no random bytes for a token.
    #[error("no random bytes for a token")]
    Token {
        /// What it says.
        source: getrandom::Error,
    },
    /// The thread could not be started.
    #[error("starting the dashboard's thread")]
    Thread {
        /// What the system says.
        source: io::Error,
    },
}

/// A running dashboard. It ends when [`Self::finish`] is called or it is dropped.
#[derive(Debug)]
pub struct Dashboard {
    address: Option<SocketAddr>,
    /// Where others find it.
    reachable: Vec<IpAddr>,
    token: Option<Token>,
    commander: Commander,
    stop: CancellationToken,
    thread: Option<JoinHandle<()>>,
}

impl Dashboard {
    /// Starts the thread, which answers at the address that was taken; without one it has readers in this process only. Gives the end into
    /// which the shard tells what happens, and that from which it takes commands.
    ///
    /// # Errors
    /// There are no random bytes for a token, or the thread cannot be started.
    pub fn start(
        bound: Option<Bound>,
        facts: Facts,
        sources: Sources,
    ) -> Result<(Self, Feed, mpsc::Receiver<Command>), StartError> {
        let address = bound.as_ref().map(|bound| bound.address);
        let reachable = bound.as_ref().map_or_else(Vec::new, Bound::reachable);
        let token = token_for(address, facts.token)?;
        let counts = Arc::new(Counts::default());
        let (feed, batches) = Feed::pair(Arc::clone(&counts));
        let (questions, asked) = mpsc::channel(WAITING_QUESTIONS);
        let (commands, given) = mpsc::channel(WAITING_COMMANDS);
        let stop = CancellationToken::new();
        let recordings = Recordings::new(sources.recordings);
        let known = Known::of(&facts);
        let clock: Arc<Clock> = Arc::from(sources.clock);
        let hub = Hub::new(facts, token.as_ref());
        let served = bound.map(|bound| {
            let app = App {
                guard: Guard::new(bound.address, token.clone()),
                counts: Arc::clone(&counts),
                questions: questions.clone(),
                commands: commands.clone(),
                command_rate: Rate::new(COMMANDS_PER_S, COMMANDS_AT_ONCE),
                known,
                clock: Arc::clone(&clock),
                recordings: recordings.clone(),
                assets: Assets::new(sources.ui_dir),
                replay: sources.replay,
                replaying: Arc::new(Semaphore::new(1)),
                readers: Arc::new(Semaphore::new(MOST_CLIENTS)),
                stop: stop.clone(),
            };
            (bound.listener, app)
        });
        let inlets = Inlets {
            batches,
            truth: sources.truth,
            clock,
            questions: asked,
            recordings,
            counts: Arc::clone(&counts),
            taps: sources.taps,
        };
        let work = Work { served, hub, inlets, stop: stop.clone() };
        let dashboard = Self {
            address,
            reachable,
            token,
            commander: Commander { commands, counts },
            stop,
            thread: Some(work.start()?),
        };
        Ok((dashboard, feed, given))
    }

    /// Where it listens, if it does.
    #[must_use]
    pub const fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// What to open in a browser of this computer: with the token, if one is needed, so it is to be shown once and to nobody else.
    /// `None` if it does not listen.
    #[must_use]
    pub fn url(&self) -> Option<String> {
        self.urls().pop()
    }

    /// The same for each address at which it is found; that of this computer is the last one.
    #[must_use]
    pub fn urls(&self) -> Vec<String> {
        let Some(address) = self.address else {
            return Vec::new();
        };
        let token = self.token.as_ref();
        let query = token.map_or_else(String::new, |token| format!("?token={}", token.expose()));
        let found = self.reachable.iter();
        found.map(|ip| format!("http://{}/{query}", SocketAddr::new(*ip, address.port()))).collect()
    }

    /// Gives commands for somebody in this process.
    #[must_use]
    pub fn commander(&self) -> Commander {
        self.commander.clone()
    }

    /// Ends it and waits for its thread.
    pub fn finish(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.stop.cancel();
        if let Some(Err(_panic)) = self.thread.take().map(JoinHandle::join) {
            tracing::error!("the dashboard's thread died");
        }
    }
}

impl Drop for Dashboard {
    fn drop(&mut self) {
        self.end();
    }
}

/// The token that is needed there, if one is.
fn token_for(address: Option<SocketAddr>, policy: TokenPolicy) -> Result<Option<Token>, StartError> {
    let is_open = |address: SocketAddr| address.ip().is_loopback() && policy == TokenPolicy::Elsewhere;
    if address.is_none_or(is_open) {
        return Ok(None);
    }
    let token = Token::random().map_err(|source| StartError::Token { source })?;
    Ok(Some(token))
}

/// What the thread does.
struct Work {
    /// What it serves and where; without it, it has readers in this process only.
    served: Option<(TcpListener, App)>,
    hub: Hub,
    inlets: Inlets,
    stop: CancellationToken,
}

impl Work {
    fn start(self) -> Result<JoinHandle<()>, StartError> {
        std::thread::Builder::new()
            .name("dashboard".to_owned())
            .spawn(move || self.run())
            .map_err(|source| StartError::Thread { source })
    }

    fn run(self) {
        let _room = Room::take(ROOM_BYTES);
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(2)
            .thread_name("dashboard-file")
            .build();
        let runtime = match runtime {
            Ok(runtime) => runtime,
            Err(error) => {
                tracing::error!(%error, "the dashboard has no runtime");
                return;
            }
        };
        let stop = self.stop;
        runtime.block_on(async {
            let serving = serve_if_wanted(self.served, stop.clone());
            tokio::select! {
                () = run_hub(self.hub, self.inlets) => {}
                () = serving => {}
            }
        });
        // A replay that still runs must not keep the station alive.
        runtime.shutdown_background();
    }
}

/// Serves until it is told to stop.
async fn serve_if_wanted(served: Option<(TcpListener, App)>, stop: CancellationToken) {
    let Some((socket, app)) = served else {
        return stop.cancelled().await;
    };
    let listener = match tokio::net::TcpListener::from_std(socket) {
        Ok(listener) => listener,
        Err(error) => {
            tracing::error!(%error, "the dashboard cannot listen");
            return;
        }
    };
    let counts = Arc::clone(&app.counts);
    serve(listener, router(Arc::new(app)), counts, stop).await;
}
