//! More clients at a TCP server than it has room for, over real sockets and with a paused clock.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use crate::support::{poll_once, port, up};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, OutgoingFrame};
use posebridge_telemetry::{PeerId, Priority, Recipients};

async fn server() -> (Link, SocketAddr) {
    let mut server = port("tcp://127.0.0.1:0", ConnectRole::Listen, HostTimer::start());
    up(&mut server).await;
    let address = server.local_address().expect("it listens");
    (server, address)
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).expect("it listens");
    // Only a test that fails waits so long.
    stream.set_read_timeout(Some(Duration::from_mins(1))).expect("own socket");
    stream
}

/// Polls until bytes come.
async fn next_bytes(server: &mut Link) -> (PeerId, Vec<u8>) {
    loop {
        if let Some(LinkEvent::Bytes { peer, bytes, .. }) = poll_once(server).await {
            return (peer, bytes);
        }
        tokio::task::yield_now().await;
    }
}

/// Sends bytes and lets the server read them.
async fn say(client: &mut TcpStream, bytes: &[u8], server: &mut Link) -> PeerId {
    client.write_all(bytes).expect("it is connected");
    let (peer, received) = next_bytes(server).await;
    assert_eq!(received, bytes);
    peer
}

/// Connects; every hundredth says something, so that it and those before it are known to be accepted: the system lets few wait.
async fn crowd(count: usize, address: SocketAddr, server: &mut Link) -> Vec<TcpStream> {
    let mut clients: Vec<TcpStream> = Vec::new();
    while clients.len() < count {
        clients.extend((0..99).map(|_| connect(address)));
        let mut last = connect(address);
        say(&mut last, b"here", server).await;
        clients.push(last);
    }
    clients
}

fn answer(server: &mut Link, peer: PeerId) {
    let priority = Priority::Estimate { stream: 1 };
    server.send_outgoing(&OutgoingFrame { to: Recipients::Peer(peer), priority, frame: b"estimate" });
}

fn is_answered(client: &mut TcpStream) -> bool {
    let mut received = [0; 8];
    client.read_exact(&mut received).is_ok() && &received == b"estimate"
}

#[tokio::test(start_paused = true)]
async fn a_robot_gets_in_and_keeps_its_place_however_many_idle_clients_come() {
    let (mut server, address) = server().await;
    let _before = crowd(300, address, &mut server).await;
    let mut robot = connect(address);
    let peer = say(&mut robot, b"wheels", &mut server).await;
    answer(&mut server, peer);
    assert!(is_answered(&mut robot));
    let _after = crowd(600, address, &mut server).await;
    assert_eq!(say(&mut robot, b"wheels", &mut server).await, peer, "it is the same connection");
    answer(&mut server, peer);
    assert!(is_answered(&mut robot));
    assert_eq!(server.port_counts().peers, 192, "one address has no more places");
}

#[tokio::test(start_paused = true)]
async fn of_clients_that_all_say_something_the_longest_silent_goes_and_no_robot_that_is_answered() {
    let (mut server, address) = server().await;
    let mut robot = connect(address);
    let peer = say(&mut robot, b"wheels", &mut server).await;
    answer(&mut server, peer);
    assert!(is_answered(&mut robot));
    let mut noisy = Vec::new();
    for _ in 0..191 {
        tokio::time::advance(Duration::from_millis(1)).await;
        let mut client = connect(address);
        let peer = say(&mut client, b"noise", &mut server).await;
        noisy.push((client, peer));
    }
    let mut newcomer = connect(address);
    say(&mut newcomer, b"here", &mut server).await;
    let (first, _) = &mut noisy[0];
    assert_eq!(first.read(&mut [0]).expect("closed in order"), 0, "the longest silent one went");
    for (client, peer) in &mut noisy[1..] {
        assert_eq!(say(client, b"noise", &mut server).await, *peer);
    }
    // A robot that fell silent for long is a client like the others.
    tokio::time::advance(Duration::from_secs(11)).await;
    say(&mut newcomer, b"here", &mut server).await;
    for (client, _) in &mut noisy[1..] {
        say(client, b"noise", &mut server).await;
    }
    let mut second = connect(address);
    say(&mut second, b"here", &mut server).await;
    answer(&mut server, peer);
    assert!(!is_answered(&mut robot));
}

#[tokio::test(start_paused = true)]
async fn a_robot_is_read_before_a_flood_of_new_clients_is_let_in() {
    let (mut server, address) = server().await;
    let mut robot = connect(address);
    say(&mut robot, b"wheels", &mut server).await;
    robot.write_all(b"wheels").expect("it is connected");
    let _flood: Vec<TcpStream> = (0..100).map(|_| connect(address)).collect();
    let (_, bytes) = next_bytes(&mut server).await;
    assert_eq!(bytes, b"wheels");
    let peers = server.port_counts().peers;
    assert!(peers < 50, "{peers} clients were let in first");
}
