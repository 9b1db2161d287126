//! The dashboard's thread and runtime.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;

use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use posebridge_telemetry::Input;
use socket2::SockRef;
use tokio::sync::{Semaphore, mpsc};
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use crate::api::{DashboardInputs, DashboardStartError, HostClockSource, MAX_PORT_ATTEMPTS, StationInfo, TokenPolicy};
use crate::assets::Assets;
use crate::command::CommandContext;
use crate::counters::ServerCounters;
use crate::feed::EventFeed;
use crate::hub::Hub;
use crate::limits::{COMMAND_BURST, COMMANDS_PER_S, MAX_WAITING_COMMANDS, MAX_WAITING_QUERIES, TOKEN_FILE_PERIOD};
use crate::operator_tokens::OperatorTokens;
use crate::recordings::RecordingFolder;
use crate::server::{AppState, ConnectionTable, HubInputs, RateLimiter, RequestGuard, router, run_hub, serve};
use crate::taps::CommandSubmitter;
use crate::token::{AccessRole, AccessToken, TokenTable};
use crate::token_file;

/// Of the system's queue of connections that are not accepted yet.
const MAX_WAITING_CONNECTIONS: i32 = 1_024;

/// For a replay, a list of recordings and the file of tokens.
const MAX_FILE_THREADS: usize = 3;

/// A running dashboard. It ends when [`Self::finish`] is called or it is dropped.
#[derive(Debug)]
pub struct Dashboard {
    address: Option<SocketAddr>,
    /// Addresses of this computer for other clients.
    reachable: Vec<IpAddr>,
    tokens: Option<Arc<TokenTable>>,
    /// By which other stations of a fleet are known.
    operator_tokens: OperatorTokens,
    /// Whether the tokens are in a file, where people find them.
    has_token_file: bool,
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
        let tokens = tokens_for(address, &facts)?.map(Arc::new);
        let token_file = facts.token_file.clone();
        let operator_tokens = match (&tokens, &token_file, &sources.fleet) {
            (None, Some(path), Some(_)) => OperatorTokens::read_or_create(path)?,
            (Some(_), _, _) | (None, None, _) | (None, Some(_), None) => OperatorTokens::new(tokens.clone()),
        };
        let counts = Arc::new(ServerCounters::default());
        let (feed, batches) = EventFeed::pair(Arc::clone(&counts));
        let (query_sender, query_receiver) = mpsc::channel(MAX_WAITING_QUERIES);
        let (commands, command_receiver) = mpsc::channel(MAX_WAITING_COMMANDS);
        let commander = CommandSubmitter { commands, counts: Arc::clone(&counts) };
        let has_token_file = token_file.is_some();
        let stop = CancellationToken::new();
        let recordings = RecordingFolder::new(sources.recordings);
        let known = CommandContext::from_info(&facts);
        let clock: Arc<HostClockSource> = Arc::from(sources.clock);
        let connections = Arc::new(ConnectionTable::new(Arc::clone(&counts), Arc::clone(&clock)));
        let guard = address.map(|address| RequestGuard::new(address, &facts.public_names, tokens.clone()));
        let watch = token_file.zip(operator_tokens.table());
        let watch = watch.map(|(path, tokens)| TokenWatch { path, tokens, connections: Arc::clone(&connections) });
        let fleet_name = sources.fleet.as_ref().map(|fleet| fleet.name.clone());
        let hub = Hub::new(facts, tokens.as_deref(), fleet_name);
        let served = bound.zip(guard).map(|(bound, guard)| {
            let app = AppState {
                guard,
                counts: Arc::clone(&counts),
                queries: query_sender.clone(),
                commands: commander.clone(),
                command_rate: RateLimiter::new(COMMANDS_PER_S, COMMAND_BURST),
                command_context: known,
                clock: Arc::clone(&clock),
                recordings: recordings.clone(),
                assets: Assets::new(sources.ui_dir),
                cameras: sources.cameras,
                fleet: sources.fleet,
                replay: sources.replay,
                replay_slot: Arc::new(Semaphore::new(1)),
                stop: stop.clone(),
            };
            Server { listener: bound.listener, app, connections }
        });
        let inlets = HubInputs {
            batches,
            truth: sources.truth,
            clock,
            queries: query_receiver,
            recordings,
            counts,
            taps: sources.taps,
        };
        let thread_stop = stop.clone();
        let thread = std::thread::Builder::new()
            .name("dashboard".to_owned())
            .spawn(move || run(served, watch, hub, inlets, &thread_stop))
            .map_err(|source| DashboardStartError::Thread { source })?;
        let dashboard =
            Self { address, reachable, tokens, operator_tokens, has_token_file, commander, stop, thread: Some(thread) };
        Ok((dashboard, feed, command_receiver))
    }

    pub const fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// The URL for a browser of this computer, with the token if one is needed: print it once and keep it secret.
    /// `None` if it does not serve.
    pub fn url(&self) -> Option<String> {
        self.addresses_with(self.token_of(AccessRole::Operator)).pop()
    }

    /// To print, for all reachable addresses; that of this computer is last. Without the tokens of a file, which people have already.
    pub fn urls(&self) -> Vec<String> {
        self.addresses_with(self.token_of(AccessRole::Operator).filter(|_| !self.has_token_file))
    }

    /// The first of them for people who may only look; `None` if there is no such token that is new with this start.
    pub fn reader_url(&self) -> Option<String> {
        let token = self.token_of(AccessRole::Reader).filter(|_| !self.has_token_file)?;
        self.addresses_with(Some(token)).into_iter().next()
    }

    /// Whether a browser on this computer needs a token as well.
    pub const fn needs_token(&self) -> bool {
        self.tokens.is_some()
    }

    /// The operators' tokens by which other stations of the fleet are known. With a file they are there also where the page needs none.
    pub fn operator_tokens(&self) -> OperatorTokens {
        self.operator_tokens.clone()
    }

    fn token_of(&self, role: AccessRole) -> Option<AccessToken> {
        self.tokens.as_ref()?.first(role)
    }

    fn addresses_with(&self, token: Option<AccessToken>) -> Vec<String> {
        let Some(address) = self.address else {
            return Vec::new();
        };
        let query = token.map_or_else(String::new, |token| format!("?token={}", token.expose()));
        let found = self.reachable.iter();
        found.map(|ip| format!("http://{}/{query}", SocketAddr::new(*ip, address.port()))).collect()
    }

    pub fn commander(&self) -> CommandSubmitter {
        self.commander.clone()
    }

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

/// `None` if no request needs a token.
fn tokens_for(address: Option<SocketAddr>, info: &StationInfo) -> Result<Option<TokenTable>, DashboardStartError> {
    let is_open = |address: SocketAddr| {
        address.ip().is_loopback() && info.token == TokenPolicy::RemoteOnly && info.public_names.is_empty()
    };
    if address.is_none_or(is_open) {
        return Ok(None);
    }
    let grants = match &info.token_file {
        Some(path) => token_file::read_or_create(path)?,
        None => token_file::random_grants().map_err(|source| DashboardStartError::Token { source })?,
    };
    Ok(Some(TokenTable::new(grants)))
}

/// The listening socket and what its handlers need.
struct Server {
    listener: TcpListener,
    app: AppState,
    connections: Arc<ConnectionTable>,
}

/// `None` with readers in this process only.
fn run(server: Option<Server>, watch: Option<TokenWatch>, hub: Hub, inputs: HubInputs, stop: &CancellationToken) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(MAX_FILE_THREADS)
        .thread_name("dashboard-file")
        .build();
    let runtime = match runtime {
        Ok(runtime) => runtime,
        Err(error) => {
            tracing::error!(%error, "the dashboard has no runtime");
            return;
        }
    };
    runtime.block_on(async {
        tokio::select! {
            () = run_hub(hub, inputs) => {}
            () = serve_if_bound(server, stop.clone()) => {}
            () = watch_tokens(watch) => {}
        }
    });
    // A replay that still runs must not keep the program alive.
    runtime.shutdown_background();
}

async fn serve_if_bound(server: Option<Server>, stop: CancellationToken) {
    let Some(Server { listener, app, connections }) = server else {
        return stop.cancelled().await;
    };
    let listener = match tokio::net::TcpListener::from_std(listener) {
        Ok(listener) => listener,
        Err(error) => {
            tracing::error!(%error, "the dashboard cannot listen");
            return;
        }
    };
    let counts = Arc::clone(&app.counts);
    serve(listener, router(Arc::new(app)), connections, counts, stop).await;
}

/// Pending forever, also without a file of tokens.
async fn watch_tokens(watch: Option<TokenWatch>) {
    match watch {
        Some(watch) => watch.run().await,
        None => std::future::pending().await,
    }
}

/// Looks at the file of tokens once a second, and ends the sessions of those that were taken away.
struct TokenWatch {
    path: PathBuf,
    tokens: Arc<TokenTable>,
    connections: Arc<ConnectionTable>,
}

impl TokenWatch {
    async fn run(self) {
        let mut ticks = interval(TOKEN_FILE_PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut reported = None;
        loop {
            ticks.tick().await;
            let path = self.path.clone();
            let Ok(read) = tokio::task::spawn_blocking(move || token_file::read(&path)).await else {
                continue;
            };
            match read {
                Ok(grants) => {
                    reported = None;
                    let revoked = self.tokens.replace(grants);
                    if !revoked.is_empty() {
                        self.connections.end_grants(&revoked);
                        tracing::info!(file = %self.path.display(), revoked = revoked.len(), "tokens of the page were revoked");
                    }
                }
                Err(error) => {
                    let why = error.to_string();
                    if reported.as_ref() != Some(&why) {
                        tracing::warn!("the page keeps the tokens that it has: {why}");
                        reported = Some(why);
                    }
                }
            }
        }
    }
}

/// The address to listen on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListenAddress {
    /// Port 0 lets the system choose.
    Exact(SocketAddr),
    /// This address, or the next free port.
    FirstFree(SocketAddr),
}

/// A bound listening socket; connections are accepted later.
#[derive(Debug)]
pub struct BoundListener {
    listener: TcpListener,
    address: SocketAddr,
}

impl BoundListener {
    pub fn new(listen: ListenAddress) -> Result<Self, DashboardStartError> {
        let (first, tries) = match listen {
            ListenAddress::Exact(address) => (address, 0),
            ListenAddress::FirstFree(address) => (address, MAX_PORT_ATTEMPTS),
        };
        for step in 0..=tries {
            let mut address = first;
            address.set_port(first.port().saturating_add(step));
            match Self::bind_address(address) {
                Ok(bound) => return Ok(bound),
                Err(source) if source.kind() == io::ErrorKind::AddrInUse => {}
                Err(source) => return Err(DashboardStartError::Bind { address, source }),
            }
        }
        Err(match listen {
            ListenAddress::Exact(address) => DashboardStartError::AddressInUse { address },
            ListenAddress::FirstFree(address) => DashboardStartError::AllPortsInUse { address },
        })
    }

    fn bind_address(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        // A new listen(2) on the same socket changes how many may wait: with the usual 128 a crowd makes others try again after a second.
        SockRef::from(&listener).listen(MAX_WAITING_CONNECTIONS)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address })
    }

    /// Addresses of this computer for other clients; loopback last.
    fn reachable_addresses(&self) -> Vec<IpAddr> {
        let own = self.address.ip();
        if !own.is_unspecified() {
            return vec![own];
        }
        let families = match own {
            IpAddr::V4(_) => IpFamilies::V4,
            IpAddr::V6(_) if SockRef::from(&self.listener).only_v6().unwrap_or(true) => IpFamilies::V6,
            IpAddr::V6(_) => IpFamilies::Both,
        };
        find_local_addresses(families)
    }
}

/// The address families from which a socket accepts connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum IpFamilies {
    V4,
    V6,
    Both,
}

/// The addresses of all networks, and then the loopback.
fn find_local_addresses(families: IpFamilies) -> Vec<IpAddr> {
    // If the system does not list them, only the loopback remains.
    let interfaces = getifaddrs().into_iter().flatten();
    let up = interfaces.filter(|one| one.flags.contains(InterfaceFlags::IFF_UP));
    let found = up.filter_map(|one| {
        let address = one.address?;
        let v4 = address.as_sockaddr_in().map(|v4| IpAddr::V4(v4.ip()));
        v4.or_else(|| address.as_sockaddr_in6().map(|v6| IpAddr::V6(v6.ip())))
    });
    select_addresses(found, families)
}

/// The addresses that work in another computer's browser, IPv4 first, then one for this computer.
fn select_addresses(found: impl Iterator<Item = IpAddr>, families: IpFamilies) -> Vec<IpAddr> {
    let is_selected = |address: &IpAddr| match address {
        IpAddr::V4(v4) => families != IpFamilies::V6 && !v4.is_link_local(),
        // A browser accepts no address with a zone, and a link-local one needs it.
        IpAddr::V6(v6) => families != IpFamilies::V4 && !v6.is_unicast_link_local(),
    };
    let mut chosen: Vec<IpAddr> = found.filter(|address| is_selected(address) && !address.is_loopback()).collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen.push(match families {
        IpFamilies::V4 | IpFamilies::Both => Ipv4Addr::LOCALHOST.into(),
        IpFamilies::V6 => Ipv6Addr::LOCALHOST.into(),
    });
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_those_that_others_can_open_and_then_that_of_this_computer() {
        let found = ["fe80::1", "2001:db8::7", "::1", "127.0.0.1", "192.0.2.7", "169.254.3.4", "10.0.0.3", "192.0.2.7"];
        let chosen = |families| {
            let found = found.iter().map(|text| text.parse().unwrap());
            let chosen = select_addresses(found, families).into_iter();
            chosen.map(|ip| ip.to_string()).collect::<Vec<_>>()
        };
        assert_eq!(chosen(IpFamilies::V4), ["10.0.0.3", "192.0.2.7", "127.0.0.1"]);
        assert_eq!(chosen(IpFamilies::V6), ["2001:db8::7", "::1"]);
        assert_eq!(chosen(IpFamilies::Both), ["10.0.0.3", "192.0.2.7", "2001:db8::7", "127.0.0.1"]);
    }

    #[test]
    fn this_computer_is_always_among_them() {
        let found = find_local_addresses(IpFamilies::V4);
        assert_eq!(found.last(), Some(&Ipv4Addr::LOCALHOST.into()));
    }
}
