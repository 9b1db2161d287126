//! The listening side of TCP: every client is a byte source of its own, and hears what is sent to all.
//!
//! Clients come and go without the link going down; only the loss of the listening socket itself is a loss. Where the
//! system cannot give us another client (no descriptor left, no memory, a network that is away), those that are there stay,
//! and new ones wait in the system's own queue for a moment. A slow client has a queue of its own and delays nobody.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};

use nix::errno::Errno;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::Sleep;

use posebridge_telemetry::{Audience, HostClock, PeerId, Span, Stamp};

use crate::connection::{Connection, Incoming, Outgoing, Outstanding, PortCounters};
use crate::error::{LinkLoss, OpenError};
use crate::host_timer::HostTimer;
use crate::stream::{StreamConnection, StreamLabel};
use crate::transports::tcp::configure;
use crate::transports::{OpenRequest, QUEUE_BYTES, bind_error, listening_detail, resolve};

/// Most clients at a time: a class of robots with a few onlookers each. Those beyond it are turned away.
const MAX_CLIENTS: usize = 256;

/// How long nobody is welcomed after the system has failed to give us a client: a failure that lasts, as a full table of
/// descriptors does, must not keep the loop busy.
const PAUSE: Span = Span::from_millis(500);

/// A listening socket with its clients.
pub(super) struct TcpServer {
    listener: TcpListener,
    address: SocketAddr,
    detail: String,
    timer: HostTimer,
    clients: Vec<StreamConnection<TcpStream>>,
    next_peer: u32,
    /// The client that is asked first, so that a talkative one does not silence the others.
    turn: usize,
    /// The end of the pause after a failure.
    pause: Option<Pin<Box<Sleep>>>,
    /// Whether the last client could not be had; told once.
    is_short: bool,
}

impl TcpServer {
    /// Listens at the link's host and port.
    pub(super) async fn open(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
        let (host, port) = request.url.host_and_port();
        let mut failure = None;
        for address in resolve(host, port).await? {
            match TcpListener::bind(address).await {
                Ok(listener) => {
                    let address = listener.local_addr().unwrap_or(address);
                    return Ok(Box::new(Self {
                        listener,
                        address,
                        detail: listening_detail(&request.url, address),
                        timer: request.timer,
                        clients: Vec::new(),
                        next_peer: 0,
                        turn: 0,
                        pause: None,
                        is_short: false,
                    }));
                }
                Err(error) => failure = Some(bind_error(address, error)),
            }
        }
        Err(failure.unwrap_or_else(|| OpenError::UnknownHost {
            host: host.to_owned(),
            source: io::ErrorKind::NotFound.into(),
        }))
    }

    fn accept(&mut self, cx: &mut Context<'_>) -> Result<(), LinkLoss> {
        loop {
            if let Some(pause) = &mut self.pause {
                if pause.as_mut().poll(cx).is_pending() {
                    return Ok(());
                }
                self.pause = None;
            }
            match self.listener.poll_accept(cx) {
                Poll::Pending => return Ok(()),
                Poll::Ready(Ok((stream, from))) => {
                    self.is_short = false;
                    self.welcome(stream, from);
                }
                // The client left before it was greeted; that is its own business.
                Poll::Ready(Err(error)) if error.kind() == io::ErrorKind::ConnectionAborted => {}
                Poll::Ready(Err(error)) if is_loss(&error) => return Err(error.into()),
                Poll::Ready(Err(error)) => self.pause_after(&error),
            }
        }
    }

    fn pause_after(&mut self, error: &io::Error) {
        if !self.is_short {
            self.is_short = true;
            tracing::warn!(at = %self.address, %error, clients = self.clients.len(), "no further client can be had");
        }
        let end = self.timer.instant(self.timer.now() + PAUSE);
        self.pause = Some(Box::pin(tokio::time::sleep_until(end)));
    }

    fn welcome(&mut self, stream: TcpStream, from: SocketAddr) {
        if self.clients.len() >= MAX_CLIENTS {
            tracing::warn!(%from, at = %self.address, limit = MAX_CLIENTS, "too many clients, turned one away");
            return;
        }
        if let Err(error) = configure(&stream) {
            tracing::debug!(%from, %error, "a client left at once");
            return;
        }
        let label = StreamLabel {
            detail: format!("client {from}"),
            local_address: Some(self.address),
            stable_path: None,
            peer: PeerId(self.next_peer),
        };
        self.next_peer = self.next_peer.wrapping_add(1);
        tracing::debug!(%from, at = %self.address, "client came");
        let client = StreamConnection::new(stream, label, self.timer, QUEUE_BYTES);
        self.clients.push(client);
    }

    /// Asks every client once, beginning with the one whose turn it is.
    fn poll_clients(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) -> Poll<Result<Incoming, LinkLoss>> {
        let mut asked = 0;
        while asked < self.clients.len() {
            let index = self.turn % self.clients.len();
            let Some(client) = self.clients.get_mut(index) else {
                break;
            };
            match client.poll(cx, counters) {
                Poll::Ready(Ok(incoming)) => {
                    self.turn = index + 1;
                    return Poll::Ready(Ok(incoming));
                }
                Poll::Ready(Err(loss)) => {
                    tracing::debug!(client = %client.detail(), %loss, "client went");
                    counters.drops_out += client.outstanding(self.timer.now()).frames;
                    // Keeps the order of the others, whose turns are positions in it.
                    drop(self.clients.remove(index));
                    self.turn = index;
                }
                Poll::Pending => {
                    self.turn = index + 1;
                    asked += 1;
                }
            }
        }
        Poll::Pending
    }
}

impl Connection for TcpServer {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    fn local_address(&self) -> Option<SocketAddr> {
        Some(self.address)
    }

    fn is_listening(&self) -> bool {
        true
    }

    fn send(&mut self, out: &Outgoing<'_>, counters: &mut PortCounters) {
        for client in &mut self.clients {
            client.send(out, counters);
        }
    }

    fn poll(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) -> Poll<Result<Incoming, LinkLoss>> {
        if let Err(loss) = self.accept(cx) {
            return Poll::Ready(Err(loss));
        }
        self.poll_clients(cx, counters)
    }

    fn reach(&self, to: Audience) -> u32 {
        self.clients.iter().map(|client| client.reach(to)).sum()
    }

    fn outstanding(&self, now: Stamp<HostClock>) -> Outstanding {
        let mut all =
            Outstanding { capacity_bytes_per_s: (!self.clients.is_empty()).then_some(0.0), ..Outstanding::default() };
        for client in &self.clients {
            let one = client.outstanding(now);
            all.peers += one.peers;
            all.frames += one.frames;
            all.bytes += one.bytes;
            // The fastest client counts, and one that keeps up is faster than any figure.
            let fastest = all.capacity_bytes_per_s.zip(one.capacity_bytes_per_s);
            all.capacity_bytes_per_s = fastest.map(|(a, b)| a.max(b));
        }
        all
    }
}

/// Whether an error of accept(2) says that the listening socket is of no further use. All others concern one client, the
/// network or what the system has to give.
fn is_loss(error: &io::Error) -> bool {
    let code = error.raw_os_error().map(Errno::from_raw);
    matches!(code, Some(Errno::EBADF | Errno::EINVAL | Errno::ENOTSOCK | Errno::EOPNOTSUPP))
}
