//! What happens, as JSON datagrams for PlotJuggler's UDP server (docs/dashboard.md).
//!
//! Fed with the messages of the page through a channel that drops and counts ([`FrameTap`]). Sending a datagram never blocks, and
//! needs no listener.

mod fields;
mod messages;

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_dashboard::FrameTap;
use posebridge_dashboard::model::Frame;

pub use fields::{FIELDS, Field, pattern_of};
pub use messages::messages;

/// Most messages that wait for the sender, a bit more than a second of them.
pub const WAITING_FRAMES: usize = 64;

/// A running sender; it ends when the station does.
pub struct PlotJuggler {
    thread: JoinHandle<SendCounts>,
}

/// What became of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SendCounts {
    /// Datagrams that were sent.
    pub datagrams: u64,
    /// Datagrams that the system did not take: its buffer was full, or there is no way to the address.
    pub dropped: u64,
    /// Messages of the station that were missed because this sender was slow.
    pub missed: u64,
}

impl PlotJuggler {
    /// Starts to send to an address.
    ///
    /// # Errors
    /// There is no socket to be had, or no thread.
    pub fn start(address: SocketAddr, frames: FrameTap) -> Result<Self> {
        let socket =
            socket_for(address).with_context(|| format!("plotjuggler: opening a UDP socket to send to {address}"))?;
        let thread = std::thread::Builder::new()
            .name("plotjuggler".to_owned())
            .spawn(move || send_all(&socket, address, &frames))
            .context("starting PlotJuggler's thread")?;
        Ok(Self { thread })
    }

    /// Waits for the last datagram; to be called when the station has ended.
    ///
    /// # Errors
    /// The thread has died.
    pub fn finish(self) -> Result<SendCounts> {
        let joined = self.thread.join();
        joined.map_err(|_panic| anyhow!("PlotJuggler's thread died"))
    }
}

/// A socket that never waits. Where the other side is on this computer, ours is as well.
fn socket_for(address: SocketAddr) -> std::io::Result<UdpSocket> {
    let any: IpAddr = match (address.ip().is_loopback(), address.is_ipv4()) {
        (true, true) => Ipv4Addr::LOCALHOST.into(),
        (true, false) => Ipv6Addr::LOCALHOST.into(),
        (false, true) => Ipv4Addr::UNSPECIFIED.into(),
        (false, false) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = UdpSocket::bind((any, 0))?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

fn send_all(socket: &UdpSocket, address: SocketAddr, frames: &FrameTap) -> SendCounts {
    let mut sent = SendCounts::default();
    while let Some(frame) = frames.recv() {
        send(socket, address, &frame, &mut sent);
    }
    sent.missed = frames.missed();
    sent
}

fn send(socket: &UdpSocket, address: SocketAddr, frame: &Frame, sent: &mut SendCounts) {
    for message in messages(frame) {
        // Not connected, so that a missing listener is no error.
        match socket.send_to(message.as_bytes(), address) {
            Ok(_) => sent.datagrams += 1,
            Err(_full_or_unreachable) => sent.dropped += 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use posebridge_dashboard::model::ClockRow;

    use super::*;

    #[test]
    fn what_cannot_be_sent_is_counted_and_what_can_comes() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let here = receiver.local_addr().unwrap();
        let socket = socket_for(here).unwrap();
        assert!(socket.local_addr().unwrap().ip().is_loopback());
        let frame = Frame { clock: Some(ClockRow::default()), ..Frame::default() };
        let mut sent = SendCounts::default();
        send(&socket, here, &frame, &mut sent);
        // No system sends to port 0.
        send(&socket, "127.0.0.1:0".parse().unwrap(), &frame, &mut sent);
        assert_eq!((sent.datagrams, sent.dropped), (1, 1));
        let mut bytes = [0; 1_000];
        let read = receiver.recv(&mut bytes).unwrap();
        assert_eq!(&bytes[..read], messages(&frame)[0].as_bytes());
    }

    #[test]
    fn it_ends_when_nothing_more_can_come() {
        let mut taps = posebridge_dashboard::FrameTaps::default();
        let frames = taps.add(1);
        let sender = PlotJuggler::start("127.0.0.1:9".parse().unwrap(), frames).unwrap();
        drop(taps);
        assert_eq!(sender.finish().unwrap(), SendCounts::default());
    }
}
