//! The dashboard's thread and runtime.

use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;

use posebridge_telemetry::Input;
use tokio::sync::{Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

use crate::api::{DashboardInputs, DashboardStartError, HostClockSource, StationInfo, TokenPolicy};
use crate::assets::Assets;
use crate::command::CommandContext;
use crate::counters::ServerCounters;
use crate::feed::EventFeed;
use crate::hub::Hub;
use crate::limits::{COMMAND_BURST, COMMANDS_PER_S, MAX_CLIENTS, MAX_WAITING_COMMANDS, MAX_WAITING_QUERIES};
use crate::listener::BoundListener;
use crate::recordings::RecordingFolder;
use crate::server::{AppState, HubInputs, RateLimiter, RequestGuard, router, run_hub, serve};
use crate::taps::CommandSubmitter;
use crate::token::AccessToken;

/// A running dashboard. It ends when [`Self::finish`] is called or it is dropped.
#[derive(Debug)]
pub struct Dashboard {
    address: Option<SocketAddr>,
    /// Addresses of this computer for other clients.
    reachable: Vec<IpAddr>,
    token: Option<AccessToken>,
    commander: CommandSubmitter,
    stop: CancellationToken,
    thread: Option<JoinHandle<()>>,
}

impl Dashboard {
    /// Starts the thread, which serves at the bound address; without one it has only readers in this process. Returns
    /// the dashboard, the feed for events and the receiver of commands as inputs of the station.
    pub fn start(
        bound: Option<BoundListener>,
        facts: StationInfo,
        sources: DashboardInputs,
    ) -> Result<(Self, EventFeed, mpsc::Receiver<Input>), DashboardStartError> {
        let address = bound.as_ref().map(|bound| bound.address);
        let reachable = bound.as_ref().map_or_else(Vec::new, BoundListener::reachable_addresses);
        let token = token_for(address, facts.token)?;
        let counts = Arc::new(ServerCounters::default());
        let (feed, batches) = EventFeed::pair(Arc::clone(&counts));
        let (query_sender, query_receiver) = mpsc::channel(MAX_WAITING_QUERIES);
        let (commands, command_receiver) = mpsc::channel(MAX_WAITING_COMMANDS);
        let stop = CancellationToken::new();
        let recordings = RecordingFolder::new(sources.recordings);
        let known = CommandContext::from_info(&facts);
        let clock: Arc<HostClockSource> = Arc::from(sources.clock);
        let hub = Hub::new(facts, token.as_ref());
        let served = bound.map(|bound| {
            let app = AppState {
                guard: RequestGuard::new(bound.address, token.clone()),
                counts: Arc::clone(&counts),
                queries: query_sender.clone(),
                commands: commands.clone(),
                command_rate: RateLimiter::new(COMMANDS_PER_S, COMMAND_BURST),
                command_context: known,
                clock: Arc::clone(&clock),
                recordings: recordings.clone(),
                assets: Assets::new(sources.ui_dir),
                replay: sources.replay,
                replay_slot: Arc::new(Semaphore::new(1)),
                reader_slots: Arc::new(Semaphore::new(MAX_CLIENTS)),
                stop: stop.clone(),
            };
            (bound.listener, app)
        });
        let inlets = HubInputs {
            batches,
            truth: sources.truth,
            clock,
            queries: query_receiver,
            recordings,
            counts: Arc::clone(&counts),
            taps: sources.taps,
        };
        let work = DashboardThread { server: served, hub, inputs: inlets, stop: stop.clone() };
        let dashboard = Self {
            address,
            reachable,
            token,
            commander: CommandSubmitter { commands, counts },
            stop,
            thread: Some(work.start()?),
        };
        Ok((dashboard, feed, command_receiver))
    }

    pub const fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// The URL for a browser of this computer, with the token if one is needed: print it once and keep it secret.
    /// `None` if it does not serve.
    pub fn url(&self) -> Option<String> {
        self.urls().pop()
    }

    /// For all reachable addresses; that of this computer is last.
    pub fn urls(&self) -> Vec<String> {
        let Some(address) = self.address else {
            return Vec::new();
        };
        let token = self.token.as_ref();
        let query = token.map_or_else(String::new, |token| format!("?token={}", token.expose()));
        let found = self.reachable.iter();
        found.map(|ip| format!("http://{}/{query}", SocketAddr::new(*ip, address.port()))).collect()
    }

    pub fn commander(&self) -> CommandSubmitter {
        self.commander.clone()
    }

    /// Stops the server and joins its thread.
    pub fn finish(mut self) {
        self.shut_down();
    }

    fn shut_down(&mut self) {
        self.stop.cancel();
        if let Some(Err(_panic)) = self.thread.take().map(JoinHandle::join) {
            tracing::error!("the dashboard's thread died");
        }
    }
}

impl Drop for Dashboard {
    fn drop(&mut self) {
        self.shut_down();
    }
}

/// `None` if no token is needed.
fn token_for(address: Option<SocketAddr>, policy: TokenPolicy) -> Result<Option<AccessToken>, DashboardStartError> {
    let is_open = |address: SocketAddr| address.ip().is_loopback() && policy == TokenPolicy::RemoteOnly;
    if address.is_none_or(is_open) {
        return Ok(None);
    }
    let token = AccessToken::random().map_err(|source| DashboardStartError::Token { source })?;
    Ok(Some(token))
}

struct DashboardThread {
    /// The listening socket and the state of its handlers; `None` with readers in this process only.
    server: Option<(TcpListener, AppState)>,
    hub: Hub,
    inputs: HubInputs,
    stop: CancellationToken,
}

impl DashboardThread {
    fn start(self) -> Result<JoinHandle<()>, DashboardStartError> {
        std::thread::Builder::new()
            .name("dashboard".to_owned())
            .spawn(move || self.run())
            .map_err(|source| DashboardStartError::Thread { source })
    }

    fn run(self) {
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
            let serving = serve_if_bound(self.server, stop.clone());
            tokio::select! {
                () = run_hub(self.hub, self.inputs) => {}
                () = serving => {}
            }
        });
        // A replay that still runs must not keep the program alive.
        runtime.shutdown_background();
    }
}

async fn serve_if_bound(served: Option<(TcpListener, AppState)>, stop: CancellationToken) {
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
