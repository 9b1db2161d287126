//! A process without a free descriptor: connected peers stay connected, and accepting is not retried with every packet.
//!
//! The only test of its process, because the limit belongs to the process.

#![expect(clippy::expect_used, reason = "helpers outside of test functions")]
#![expect(clippy::wildcard_enum_match_arm, reason = "a test that sees any other event fails and prints it")]

use std::future::poll_fn;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::task::Poll;
use std::time::Duration;

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig};
use posebridge_telemetry::LinkId;

/// What makes a UDP peer loud: more than 500 datagrams within a tenth of a second.
const LOUD: u32 = 700;

async fn listening(url: &str, timer: HostTimer) -> (Link, SocketAddr) {
    let config = LinkOpenConfig { id: LinkId(1), url: url.parse().expect("a link"), role: ConnectRole::Listen };
    let mut port = Link::new(config, timer);
    port.try_open().await.expect("a free port");
    assert!(matches!(port.next_event().await, LinkEvent::Up { .. }));
    let address = port.local_address().expect("it listens");
    (port, address)
}

fn client(address: SocketAddr) -> TcpStream {
    let client = TcpStream::connect(address).expect("loopback");
    client.set_read_timeout(Some(Duration::from_secs(5))).expect("a finite wait");
    client
}

async fn received_bytes(port: &mut Link) -> Vec<u8> {
    match port.next_event().await {
        LinkEvent::Bytes { bytes, .. } => bytes,
        event => panic!("{event:?} instead of bytes"),
    }
}

async fn is_quiet(port: &mut Link) -> bool {
    tokio::task::yield_now().await;
    poll_fn(|cx| Poll::Ready(port.poll_event(cx).is_pending())).await
}

fn open_descriptors() -> usize {
    let listing = std::fs::read_dir("/proc/self/fd").expect("Linux has it");
    listing.count()
}

/// Takes every descriptor that is not in use away while `work` runs.
async fn without_descriptors(work: impl Future<Output = ()>) {
    let (soft, hard) = getrlimit(Resource::RLIMIT_NOFILE).expect("our own limit");
    setrlimit(Resource::RLIMIT_NOFILE, 0, hard).expect("it may fall");
    work.await;
    setrlimit(Resource::RLIMIT_NOFILE, soft, hard).expect("it may rise to where it was");
}

#[tokio::test(start_paused = true)]
async fn without_a_free_descriptor_no_peer_is_dropped_and_not_every_packet_retries() {
    let timer = HostTimer::start();
    let (mut server, address) = listening("tcp://127.0.0.1:0", timer).await;
    let mut first = client(address);
    first.write_all(b"first").expect("loopback");
    assert_eq!(received_bytes(&mut server).await, b"first");
    // The system greets it, and we cannot take it.
    let mut second = client(address);
    second.write_all(b"second").expect("loopback");
    without_descriptors(async {
        first.write_all(b"still").expect("loopback");
        assert_eq!(received_bytes(&mut server).await, b"still");
        assert!(is_quiet(&mut server).await);
        assert!(server.is_up());
        assert_eq!(server.port_counts().peers, 1);
        server.send(b"hello");
        let mut hello = [0; 5];
        first.read_exact(&mut hello).expect("it is sent at once");
        assert_eq!(&hello, b"hello");
    })
    .await;
    assert_eq!(received_bytes(&mut server).await, b"second");
    assert_eq!(server.port_counts().peers, 2);
    assert_eq!(server.counters().reconnects, 0);

    let (mut station, address) = listening("udp://127.0.0.1:0", timer).await;
    let loud = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    without_descriptors(flood(&loud, address, &mut station)).await;
    let before = open_descriptors();
    flood(&loud, address, &mut station).await;
    let tried = open_descriptors() - before;
    assert_eq!(tried, 0, "it was just refused: not with the next datagram");
    tokio::time::advance(Duration::from_millis(1_100)).await;
    flood(&loud, address, &mut station).await;
    assert_eq!(open_descriptors() - before, 1, "now it is read apart");
}

/// Sends what makes a peer busy, and receives it.
async fn flood(loud: &UdpSocket, address: SocketAddr, station: &mut Link) {
    for number in 0..LOUD {
        loud.send_to(&number.to_be_bytes(), address).expect("loopback");
        if number % 100 == 99 {
            for _ in 0..100 {
                received_bytes(station).await;
            }
        }
    }
}
