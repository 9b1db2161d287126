//! Fifty peers on one UDP port, of which one is silent and one sends garbage as fast as a thread can, faster than the station
//! reads. Real sockets; nothing depends on how quick the computer is.

use std::collections::BTreeMap;
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::support::{poll_once, port, up};
use posebridge_link::{
    ConnectRole, FirstContact, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkTuning, LinkUrl, OutgoingFrame,
};
use posebridge_telemetry::{LinkId, PeerId, Priority, Recipients};

const ROBOTS: u8 = 48;
const ROUNDS: u8 = 20;
/// Garbage that has to be there before the robots begin: by then its sender is known to be loud.
const HEAD_START: u64 = 5_000;
/// More garbage than this before a round was received means that a datagram is lost.
const MAXIMUM_GARBAGE: u64 = 2_000_000;
const GARBAGE: [u8; 200] = [0; 200];

fn socket() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").expect("a free port")
}

#[tokio::test(flavor = "current_thread")]
async fn of_fifty_peers_one_that_floods_costs_no_datagram_of_others() {
    let mut station = port("udp://127.0.0.1:0", ConnectRole::Listen, HostTimer::start());
    up(&mut station).await;
    let address = station.local_address().expect("it listens");
    let silent = socket();
    silent.connect(address).expect("loopback");
    let robots: Vec<_> = (0..ROBOTS).map(|_| socket()).collect();
    let stop = Arc::new(AtomicBool::new(false));
    let flooder = std::thread::spawn({
        let (stop, socket) = (Arc::clone(&stop), socket());
        move || {
            while !stop.load(Ordering::Relaxed) {
                drop(socket.send_to(&GARBAGE, address));
            }
        }
    });

    let mut received: BTreeMap<u8, Vec<u8>> = BTreeMap::new();
    let mut peers: BTreeMap<u8, PeerId> = BTreeMap::new();
    let mut garbage = 0_u64;
    for round in 0..=ROUNDS {
        // Every peer sends once per round, after a round without them.
        for (number, robot) in (0..ROBOTS).zip(&robots).filter(|_| round > 0) {
            robot.send_to(&[number, round], address).expect("loopback");
        }
        let expected = usize::from(ROBOTS) * usize::from(round);
        while received.values().map(Vec::len).sum::<usize>() < expected || garbage < HEAD_START {
            let LinkEvent::Bytes { peer, bytes, .. } = station.next_event().await else { panic!("UDP stays up") };
            if let [number, round] = bytes[..] {
                received.entry(number).or_default().push(round);
                assert_eq!(*peers.entry(number).or_insert(peer), peer, "robot {number} changed its number");
            } else {
                assert_eq!(bytes, GARBAGE);
                garbage += 1;
                assert!(garbage < MAXIMUM_GARBAGE, "in round {round} a datagram was lost");
            }
        }
    }
    stop.store(true, Ordering::Relaxed);
    flooder.join().expect("it only sends");

    let expected: Vec<u8> = (1..=ROUNDS).collect();
    assert!(received.values().all(|rounds| *rounds == expected), "{received:?}");
    let mut different: Vec<_> = peers.values().collect();
    different.sort_unstable();
    different.dedup();
    assert_eq!(different.len(), usize::from(ROBOTS), "each is a peer of its own");
    assert_eq!(station.port_counts().peers, u32::from(ROBOTS) + 1, "the silent one is not known");
}

/// A station's port, for which each peer is a stranger at first.
async fn guarded() -> (Link, std::net::SocketAddr) {
    let url = LinkUrl::parse("udp://127.0.0.1:0").expect("a link");
    let config = LinkOpenConfig { id: LinkId(0), url, role: ConnectRole::Listen };
    let tuning = LinkTuning { first_contact: FirstContact::Stranger, ..LinkTuning::default() };
    let mut station = Link::with_tuning(config, tuning, HostTimer::start());
    up(&mut station).await;
    let address = station.local_address().expect("it listens");
    (station, address)
}

async fn next_bytes(station: &mut Link) -> (PeerId, Vec<u8>) {
    let LinkEvent::Bytes { peer, bytes, .. } = station.next_event().await else { panic!("UDP stays up") };
    (peer, bytes)
}

#[tokio::test(flavor = "current_thread")]
async fn four_thousand_silent_addresses_cost_a_few_copies_of_what_is_sent_to_all() {
    let (mut station, address) = guarded().await;
    let robot = socket();
    robot.send_to(b"wheels", address).expect("loopback");
    let (peer, _) = next_bytes(&mut station).await;
    station.admit(peer);
    for first in 0..40_u8 {
        // An address of this computer each.
        for second in 1..=100_u8 {
            let silent = UdpSocket::bind((std::net::Ipv4Addr::new(127, 9, first, second), 0));
            silent.expect("a free port").send_to(b"x", address).expect("loopback");
        }
        for _ in 0..100 {
            assert_eq!(next_bytes(&mut station).await.1, b"x");
        }
    }
    robot.send_to(b"wheels", address).expect("loopback");
    assert_eq!(next_bytes(&mut station).await, (peer, b"wheels".to_vec()));
    let before = station.counters().bytes_out;
    station.send_outgoing(&OutgoingFrame { to: Recipients::All, priority: Priority::Session, frame: b"here" });
    // A few at a time, so that datagrams are read in between.
    assert_eq!(station.counters().bytes_out, before);
    while station.port_counts().queued_frames > 0 {
        assert_eq!(poll_once(&mut station).await, None);
    }
    assert_eq!(station.counters().bytes_out - before, 65 * 4);
    robot.set_read_timeout(Some(std::time::Duration::from_mins(1))).expect("own socket");
    let mut received = [0; 8];
    assert_eq!(robot.recv(&mut received).expect("it is one of them"), 4);
}

#[tokio::test(flavor = "current_thread")]
async fn of_a_stranger_a_part_is_read_and_a_robot_goes_first() {
    let (mut station, address) = guarded().await;
    let (robot, stranger) = (socket(), socket());
    robot.send_to(b"wheels", address).expect("loopback");
    let (peer, _) = next_bytes(&mut station).await;
    station.admit(peer);
    for _ in 0..1_000 {
        stranger.send_to(b"noise", address).expect("loopback");
    }
    robot.send_to(b"wheels", address).expect("loopback");
    assert_eq!(next_bytes(&mut station).await, (peer, b"wheels".to_vec()), "it came last");
    // One that comes while others wait.
    assert_eq!(next_bytes(&mut station).await.1, b"noise");
    robot.send_to(b"more", address).expect("loopback");
    assert_eq!(next_bytes(&mut station).await, (peer, b"more".to_vec()));
    let counts = station.port_counts();
    // Twenty-five of its own, five hundred that all strangers share.
    assert!((300..=360).contains(&counts.flood_drops), "{counts:?}");
    assert_eq!(counts.kernel_drops, 0);
}

#[tokio::test(flavor = "current_thread")]
async fn what_a_robot_sent_before_it_was_understood_is_not_overtaken() {
    let (mut station, address) = guarded().await;
    let (robot, other) = (socket(), socket());
    for number in 0..4_u8 {
        robot.send_to(&[number], address).expect("loopback");
        other.send_to(b"noise", address).expect("loopback");
    }
    let mut received = Vec::new();
    while received.len() < 8 {
        let (peer, bytes) = next_bytes(&mut station).await;
        if let [number] = bytes[..] {
            received.push(number);
            station.admit(peer);
            robot.send_to(&[3 + received.len() as u8], address).expect("loopback");
        }
    }
    assert_eq!(received, [0, 1, 2, 3, 4, 5, 6, 7]);
}
