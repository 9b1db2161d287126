//! Five hundred robots on one UDP port; one is silent and one sends far too much.
//!
//! With real sockets in real time, the only test of its process: the flooding robot sends as fast as a thread can,
//! faster than the station reads, which works a little on each datagram. The other robots send in rounds and wait for
//! the end of each, so that they are never too fast. The printed figures (`--nocapture`) are those of this computer.

#![expect(clippy::expect_used, reason = "helpers outside of test functions")]

use std::collections::BTreeMap;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig};
use posebridge_telemetry::{LinkId, PeerId};

const ROBOTS: u32 = 498;
const ROUNDS: u32 = 20;
/// Garbage that has to be there before the robots begin.
const HEAD_START: u64 = 5_000;
const MARK: u8 = 0xfd;

fn socket() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").expect("a free port")
}

fn datagram(robot: u32, round: u32) -> [u8; 24] {
    let mut datagram = [MARK; 24];
    datagram[1..5].copy_from_slice(&robot.to_be_bytes());
    datagram[5..9].copy_from_slice(&round.to_be_bytes());
    datagram
}

/// About as much work as a pipeline has with a message: some ten microseconds.
fn work(bytes: &[u8]) -> u32 {
    (0..5_000_u32).fold(u32::from(bytes[0]), |sum, step| std::hint::black_box(sum.rotate_left(5) ^ step))
}

fn number(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

/// Sends as fast as it can until told to stop, and counts.
fn rave(to: SocketAddr, stop: &AtomicBool, sent: &AtomicU64) {
    let mad = socket();
    let mut garbage = [0_u8; 200];
    while !stop.load(Ordering::Relaxed) {
        garbage[0] = garbage[0].wrapping_add(1) & 0x7f;
        if mad.send_to(&garbage, to).is_ok() {
            sent.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Each robot sends once per round; the next round begins when all of this one were heard.
fn speak(robots: &[UdpSocket], to: SocketAddr, stop: &AtomicBool, received: &AtomicU64) {
    for round in 0..ROUNDS {
        for (number, robot) in (0..ROBOTS).zip(robots) {
            let sent = robot.send_to(&datagram(number, round), to);
            sent.expect("loopback");
        }
        let wanted = u64::from(ROBOTS) * u64::from(round + 1);
        while received.load(Ordering::Relaxed) < wanted && !stop.load(Ordering::Relaxed) {
            std::thread::yield_now();
        }
    }
}

/// What the station has heard of the robots.
#[derive(Default)]
struct ReceivedRounds {
    rounds: BTreeMap<u32, Vec<u32>>,
    peers: BTreeMap<u32, PeerId>,
    garbage: u64,
    /// Datagrams of robots, for the thread that sends them.
    good: Arc<AtomicU64>,
}

impl ReceivedRounds {
    fn push(&mut self, peer: PeerId, bytes: &[u8]) {
        std::hint::black_box(work(bytes));
        if bytes[0] != MARK {
            self.garbage += 1;
            return;
        }
        let robot = number(bytes, 1);
        self.rounds.entry(robot).or_default().push(number(bytes, 5));
        let known = *self.peers.entry(robot).or_insert(peer);
        assert_eq!(known, peer, "robot {robot} changed its number");
        self.good.fetch_add(1, Ordering::Relaxed);
    }

    /// Listens until enough has been heard; gives up after 20 seconds.
    async fn listen(&mut self, station: &mut Link, is_enough: impl Fn(&Self) -> bool) {
        let all = async {
            while !is_enough(self) {
                if let LinkEvent::Bytes { peer, bytes, .. } = station.next_event().await {
                    self.push(peer, &bytes);
                }
            }
        };
        // What is missing then is told by the assertions.
        drop(tokio::time::timeout(Duration::from_secs(20), all).await);
    }
}

#[tokio::test(flavor = "current_thread")]
async fn of_five_hundred_peers_a_mad_one_costs_nobody_a_datagram() {
    let timer = HostTimer::start();
    let config =
        LinkOpenConfig { id: LinkId(1), url: "udp://127.0.0.1:0".parse().expect("a link"), role: ConnectRole::Listen };
    let mut station = Link::new(config, timer);
    station.try_open().await.expect("a free port");
    let address = station.local_address().expect("it listens");
    let silent = socket();
    silent.connect(address).expect("loopback");
    let robots: Vec<_> = (0..ROBOTS).map(|_| socket()).collect();

    let stop = Arc::new(AtomicBool::new(false));
    let raved = Arc::new(AtomicU64::new(0));
    let mad = std::thread::spawn({
        let (stop, raved) = (Arc::clone(&stop), Arc::clone(&raved));
        move || rave(address, &stop, &raved)
    });
    let mut received = ReceivedRounds::default();
    received.listen(&mut station, |received| received.garbage >= HEAD_START).await;
    let begun = timer.now();
    let raved_before = raved.load(Ordering::Relaxed);
    let good = Arc::clone(&received.good);
    let senders = std::thread::spawn({
        let (stop, good) = (Arc::clone(&stop), Arc::clone(&good));
        move || speak(&robots, address, &stop, &good)
    });
    let all = u64::from(ROBOTS * ROUNDS);
    received.listen(&mut station, |_| good.load(Ordering::Relaxed) >= all).await;
    let secs = (timer.now() - begun).as_secs_f64();
    let raved = raved.load(Ordering::Relaxed) - raved_before;
    stop.store(true, Ordering::Relaxed);
    mad.join().expect("it only sends");
    senders.join().expect("they only send");

    println!(
        "{} datagrams of {ROBOTS} robots in {secs:.3} s ({:.0} /s) beside {raved} of garbage ({:.0} /s, {} heard)",
        good.load(Ordering::Relaxed),
        good.load(Ordering::Relaxed) as f64 / secs,
        raved as f64 / secs,
        received.garbage
    );
    let expected: Vec<u32> = (0..ROUNDS).collect();
    for robot in 0..ROBOTS {
        let rounds = received.rounds.get(&robot);
        assert_eq!(rounds, Some(&expected), "robot {robot} lost something");
    }
    let mut peers: Vec<_> = received.peers.values().collect();
    peers.sort_unstable();
    peers.dedup();
    assert_eq!(peers.len(), ROBOTS as usize, "each is a peer of its own");
    assert_eq!(station.port_counts().peers, ROBOTS + 1, "the silent one is not known");
}
