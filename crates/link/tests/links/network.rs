//! TCP and UDP on the loopback: servers that restart, clients that leave, peers that are slow.

use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use crate::support::{bytes, down, next_beside, poll_once, port, up};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkSet, OutgoingFrame};
use posebridge_telemetry::{LinkId, PeerId, Priority, Recipients};

async fn listening(url: &str, timer: HostTimer) -> (Link, SocketAddr) {
    let mut server = port(url, ConnectRole::Listen, timer);
    server.try_open().await.expect("a free port");
    up(&mut server).await;
    let address = server.local_address().expect("it listens");
    (server, address)
}

async fn dialled(scheme: &str, address: SocketAddr, timer: HostTimer) -> Link {
    let mut client = port(&format!("{scheme}://{address}"), ConnectRole::Dial, timer);
    up(&mut client).await;
    client
}

/// A plain socket of a foreign program; it must not block the runtime for ever if a test is wrong.
fn foreign_peer() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    socket.set_read_timeout(Some(Duration::from_secs(5))).expect("a finite wait");
    socket
}

fn received_by(socket: &UdpSocket) -> Vec<u8> {
    let mut buffer = [0; 100];
    let count = socket.recv(&mut buffer).expect("a datagram");
    buffer[..count].to_vec()
}

fn send_to(port: &mut Link, peer: PeerId, frame: &[u8]) {
    port.send_outgoing(&OutgoingFrame { to: Recipients::Peer(peer), priority: Priority::Forwarded, frame });
}

async fn next_bytes(port: &mut Link) -> (PeerId, Vec<u8>) {
    loop {
        if let LinkEvent::Bytes { peer, bytes, .. } = port.next_event().await {
            return (peer, bytes);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_link_that_was_up_for_a_while_is_opened_again_soon() {
    let timer = HostTimer::start();
    let (server, address) = listening("tcp://127.0.0.1:0", timer).await;
    let mut server = Some(server);
    let mut client = dialled("tcp", address, timer).await;
    let mut waits = Vec::new();
    for up_secs in [4, 4, 4, 6, 4] {
        tokio::time::advance(Duration::from_secs(up_secs)).await;
        drop(server.take());
        waits.push(down(&mut client).await.1.as_secs_f64());
        server = Some(listening(&format!("tcp://{address}"), timer).await.0);
        up(&mut client).await;
    }
    for (wait, nominal) in waits.iter().zip([0.25, 0.5, 0.9, 0.25, 0.5]) {
        assert!((wait / nominal - 1.0).abs() < 0.101, "{waits:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_server_that_is_not_started_yet_is_waited_for() {
    let timer = HostTimer::start();
    let (server, address) = listening("tcp://127.0.0.1:0", timer).await;
    drop(server);
    let mut client = port(&format!("tcp://{address}"), ConnectRole::Dial, timer);
    client.try_open().await.expect("the server may come");
    let (reason, _) = down(&mut client).await;
    assert!(reason.starts_with(&format!("no connection to {address}: Connection refused")), "{reason}");
    let (_server, _) = listening(&format!("tcp://{address}"), timer).await;
    up(&mut client).await;
}

#[tokio::test(start_paused = true)]
async fn every_client_of_a_server_is_a_source_of_its_own_and_receives_everything() {
    let timer = HostTimer::start();
    let (mut server, address) = listening("tcp://127.0.0.1:0", timer).await;
    let mut first = dialled("tcp", address, timer).await;
    first.send(b"first");
    assert_eq!(poll_once(&mut first).await, None);
    let (first_peer, received) = next_bytes(&mut server).await;
    assert_eq!(received, b"first");
    let mut second = dialled("tcp", address, timer).await;
    second.send(b"second");
    assert_eq!(poll_once(&mut second).await, None);
    let (second_peer, received) = next_bytes(&mut server).await;
    assert_eq!(received, b"second");
    assert_ne!(first_peer, second_peer);

    server.send(b"to all");
    assert_eq!(next_beside_bytes(&mut first, &mut server).await, b"to all");
    assert_eq!(next_beside_bytes(&mut second, &mut server).await, b"to all");
    send_to(&mut server, second_peer, b"to you");
    server.send(b"bye");
    assert_eq!(next_beside_bytes(&mut first, &mut server).await, b"bye");
    drop(first);
    assert_eq!(bytes(&mut second, 9).await, b"to youbye");
    assert_eq!(poll_once(&mut server).await, None);
    assert!(server.is_up(), "a client that leaves is no loss of the link");
    assert_eq!(server.counters().drops_out, 0);
}

async fn next_beside_bytes(port: &mut Link, other: &mut Link) -> Vec<u8> {
    match next_beside(port, other).await {
        LinkEvent::Bytes { bytes, .. } => bytes,
        event => panic!("{event:?} instead of bytes"),
    }
}

#[tokio::test(start_paused = true)]
async fn two_udp_peers_are_distinguished_and_both_answered() {
    let timer = HostTimer::start();
    let (mut station, address) = listening("udp://127.0.0.1:0", timer).await;
    assert!(station.is_datagram());
    let (left, right) = (foreign_peer(), foreign_peer());
    left.send_to(b"left", address).expect("loopback");
    let (left_peer, received) = next_bytes(&mut station).await;
    assert_eq!(received, b"left");
    right.send_to(b"right", address).expect("loopback");
    let (right_peer, received) = next_bytes(&mut station).await;
    assert_eq!(received, b"right");
    assert_ne!(left_peer, right_peer);
    station.send(b"both");
    assert_eq!(received_by(&left), b"both");
    assert_eq!(received_by(&right), b"both");
    send_to(&mut station, right_peer, b"you");
    station.send(b"end");
    assert_eq!(received_by(&left), b"end");
    assert_eq!(received_by(&right), b"you");

    // The right one falls silent for longer than ten seconds and is not written to any more.
    tokio::time::advance(Duration::from_secs(6)).await;
    left.send_to(b"here", address).expect("loopback");
    assert_eq!(next_bytes(&mut station).await, (left_peer, b"here".to_vec()));
    tokio::time::advance(Duration::from_secs(6)).await;
    let before = station.counters().bytes_out;
    station.send(b"still there?");
    assert_eq!(station.counters().bytes_out - before, 12);
    assert_eq!(received_by(&left), b"still there?");
}

#[tokio::test(start_paused = true)]
async fn a_udp_link_with_a_host_sends_first_and_survives_without_a_listener() {
    let timer = HostTimer::start();
    let brick = foreign_peer();
    let address = brick.local_addr().expect("it is bound");
    let mut station = dialled("udp", address, timer).await;
    station.send(b"hello");
    assert_eq!(poll_once(&mut station).await, None);
    assert_eq!(received_by(&brick), b"hello");
    drop(brick);
    for _ in 0..3 {
        station.send(b"anybody?");
        assert_eq!(poll_once(&mut station).await, None);
    }
    let brick = UdpSocket::bind(address).expect("it was just free");
    station.send(b"again");
    assert_eq!(poll_once(&mut station).await, None);
    assert_eq!(received_by(&brick), b"again");
    assert!(station.is_up());
}

#[tokio::test(start_paused = true)]
async fn an_address_that_is_taken_is_refused_at_the_start() {
    let timer = HostTimer::start();
    for scheme in ["tcp", "udp"] {
        let (_first, address) = listening(&format!("{scheme}://127.0.0.1:0"), timer).await;
        let mut second = port(&format!("{scheme}://{address}"), ConnectRole::Listen, timer);
        let error = second.try_open().await.expect_err("it is taken");
        assert!(!error.is_transient());
        assert_eq!(
            error.to_string(),
            format!("address {address} is already in use: stop the program that listens there or choose another port")
        );
    }
}

#[tokio::test(start_paused = true)]
async fn a_foreign_address_and_a_missing_host_are_refused_at_the_start() {
    let timer = HostTimer::start();
    // 192.0.2.0/24 is for documentation (RFC 5737): no interface has it.
    let mut foreign = port("tcp://192.0.2.1:5760", ConnectRole::Listen, timer);
    let error = foreign.try_open().await.expect_err("not ours");
    assert_eq!(
        error.to_string(),
        "address 192.0.2.1:5760 belongs to no interface of this computer: 0.0.0.0 (or [::]) listens on all of them"
    );
    let mut nowhere = port("tcp://:5760", ConnectRole::Dial, timer);
    let error = nowhere.try_open().await.expect_err("no host");
    assert_eq!(error.to_string(), "tcp://:5760 names no host to dial: put one before the port");
}

#[tokio::test(start_paused = true)]
async fn without_a_host_only_this_computer_is_let_in() {
    let timer = HostTimer::start();
    for scheme in ["tcp", "udp"] {
        for (host, expected) in [("", "127.0.0.1"), ("0.0.0.0", "0.0.0.0"), ("[::1]", "::1")] {
            let mut server = port(&format!("{scheme}://{host}:0"), ConnectRole::Listen, timer);
            server.try_open().await.expect("a free port");
            let detail = up(&mut server).await;
            let address = server.local_address().expect("it listens");
            assert_eq!(address.ip().to_string(), expected);
            let hint = format!(
                "listening on {address}, for this computer only: {scheme}://0.0.0.0:{} lets others in",
                address.port()
            );
            assert_eq!(detail.starts_with(&hint), host.is_empty(), "{detail}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_link_knows_whether_it_accepts_any_caller_for_every_spelling() {
    let timer = HostTimer::start();
    let (_server, served) = listening("tcp://127.0.0.1:0", timer).await;
    let dialled = format!("tcp://{served}");
    for (url, role, expected) in [
        ("udp://:0", ConnectRole::Dial, true),
        ("udp://0.0.0.0:0", ConnectRole::Dial, true),
        ("udp://[::]:0", ConnectRole::Dial, true),
        ("udp://127.0.0.1:0", ConnectRole::Listen, true),
        ("udp://127.0.0.1:9", ConnectRole::Dial, false),
        ("tcp://127.0.0.1:0", ConnectRole::Listen, true),
        (&dialled, ConnectRole::Dial, false),
    ] {
        let mut port = port(url, role, timer);
        assert!(!port.is_listening(), "{url} is not open yet");
        up(&mut port).await;
        assert_eq!(port.is_listening(), expected, "{url}");
    }
}

#[tokio::test(start_paused = true)]
async fn the_idle_time_of_a_udp_link_is_an_option() {
    let timer = HostTimer::start();
    let (mut station, address) = listening("udp://127.0.0.1:0?idle_s=2", timer).await;
    let brick = foreign_peer();
    brick.send_to(b"here", address).expect("loopback");
    let (first, _) = next_bytes(&mut station).await;
    assert_eq!(station.port_counts().peers, 1);
    tokio::time::advance(Duration::from_millis(2_100)).await;
    assert_eq!(station.port_counts().peers, 0);
    station.send(b"anybody?");
    assert_eq!(station.counters().bytes_out, 0);
    brick.send_to(b"again", address).expect("loopback");
    let (second, _) = next_bytes(&mut station).await;
    assert_ne!(first, second, "who comes back has a new number");
}

#[tokio::test(start_paused = true)]
async fn a_loud_peer_keeps_its_number_and_its_order_and_the_address_stays_ours() {
    let timer = HostTimer::start();
    let (mut station, address) = listening("udp://127.0.0.1:0", timer).await;
    let (loud, calm) = (foreign_peer(), foreign_peer());
    let (mut numbers, mut loud_peer) = (Vec::new(), None);
    let mut sent = 0..1_800_u32;
    // The clock stands still, so after 500 datagrams the peer is busy. What it has sent by then still lies in the common
    // socket when more comes by a socket of its own.
    for (count, read_up_to) in [(1_000, 600), (500, 1_400), (300, 1_800)] {
        for number in sent.by_ref().take(count) {
            let number = number.to_be_bytes();
            loud.send_to(&number, address).expect("loopback");
        }
        calm.send_to(b"calm!", address).expect("loopback");
        while numbers.len() < read_up_to {
            // The runtime notices the new socket only when it gets a turn.
            tokio::task::yield_now().await;
            let (peer, bytes) = next_bytes(&mut station).await;
            if bytes != b"calm!" {
                assert_eq!(*loud_peer.get_or_insert(peer), peer);
                numbers.push(u32::from_be_bytes(bytes.try_into().expect("four bytes")));
            }
        }
    }
    let expected = (0..1_800).collect::<Vec<_>>();
    assert_eq!(numbers, expected, "none lost, none out of order");
    station.send(b"to all");
    assert_eq!(received_by(&loud), b"to all");
    assert_eq!(received_by(&calm), b"to all");
    let mut rival = port(&format!("udp://{address}"), ConnectRole::Listen, timer);
    let error = rival.try_open().await.expect_err("it is ours");
    assert!(error.to_string().contains("is already in use"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_flooded_port_does_not_silence_its_neighbour() {
    let timer = HostTimer::start();
    let mut addresses = Vec::new();
    let mut set = LinkSet::default();
    for id in [3, 8] {
        let config = LinkOpenConfig {
            id: LinkId(id),
            url: "udp://127.0.0.1:0".parse().expect("a link"),
            role: ConnectRole::Listen,
        };
        let mut udp = Link::new(config, timer);
        up(&mut udp).await;
        addresses.push(udp.local_address().expect("it listens"));
        set.push(udp);
    }
    set.try_open_all().await.expect("both are open");
    let brick = foreign_peer();
    for _ in 0..200 {
        brick.send_to(b"flood", addresses[0]).expect("loopback");
    }
    for _ in 0..10 {
        brick.send_to(b"calm", addresses[1]).expect("loopback");
    }
    let mut order = Vec::new();
    while order.iter().filter(|id| **id == LinkId(8)).count() < 10 {
        let (id, event) = set.next_event().await;
        assert!(matches!(event, LinkEvent::Bytes { .. }), "{event:?}");
        order.push(id);
    }
    assert!(order.len() <= 22, "{} events before ten calm ones", order.len());
    assert!(set.get_mut(LinkId(8)).is_some_and(|port| port.counters().bytes_in == 40));
    assert!(set.get_mut(LinkId(5)).is_none());
}
