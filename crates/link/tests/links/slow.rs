//! Links that are slower than their load: the age of estimates, the fate of commands, and fairness between peers.
//!
//! The sockets are real, the clock is paused: a reader that takes a number of bytes per virtual second has exactly that
//! speed, however busy the computer is.

use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use crate::support::{next_beside, poll_once, port, up};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, OutgoingFrame};
use posebridge_telemetry::{Priority, Recipients, TimeDelta};

const FRAME_BYTES: usize = 40;
const TICK: TimeDelta = TimeDelta::from_millis(10);
const COMMAND: u8 = 9;

/// A frame that knows what it is, its number, and when it was sent.
fn frame(kind: u8, number: u32, timer: HostTimer) -> [u8; FRAME_BYTES] {
    let mut frame = [kind; FRAME_BYTES];
    frame[1..5].copy_from_slice(&number.to_be_bytes());
    frame[5..13].copy_from_slice(&timer.now().as_nanos().to_be_bytes());
    frame
}

/// What a reader makes of the bytes.
#[derive(Default)]
struct ReceivedFrames {
    bytes: Vec<u8>,
    commands: Vec<u32>,
    /// Numbers of the estimates of each of two streams.
    estimates: [Vec<u32>; 2],
    oldest_estimate: Option<TimeDelta>,
    oldest_command: Option<TimeDelta>,
}

impl ReceivedFrames {
    fn push(&mut self, bytes: &[u8], timer: HostTimer) {
        self.bytes.extend_from_slice(bytes);
        while self.bytes.len() >= FRAME_BYTES {
            let rest = self.bytes.split_off(FRAME_BYTES);
            let frame = std::mem::replace(&mut self.bytes, rest);
            let kind = frame[0];
            assert!(frame[13..].iter().all(|byte| *byte == kind), "a torn frame: {frame:?}");
            let number = u32::from_be_bytes(frame[1..5].try_into().expect("four bytes"));
            let sent = i64::from_be_bytes(frame[5..13].try_into().expect("eight bytes"));
            let age = Some(TimeDelta::from_nanos(timer.now().as_nanos() - sent));
            if kind == COMMAND {
                self.commands.push(number);
                self.oldest_command = self.oldest_command.max(age);
            } else {
                self.estimates[usize::from(kind)].push(number);
                self.oldest_estimate = self.oldest_estimate.max(age);
            }
        }
    }
}

/// Offers two streams of estimates, ten times as much as `capacity_bytes_per_s`, and five commands per second.
struct TrafficSource {
    estimates: u32,
    commands: u32,
    per_tick: u32,
    ticks: u32,
}

impl TrafficSource {
    fn new(capacity_bytes_per_s: u32) -> Self {
        let bytes_per_tick = 10 * capacity_bytes_per_s / 100;
        Self { estimates: 0, commands: 0, per_tick: bytes_per_tick / (2 * FRAME_BYTES as u32), ticks: 0 }
    }

    fn tick(&mut self, port: &mut Link, timer: HostTimer) {
        let mut send = |priority, kind, number| {
            port.send_outgoing(&OutgoingFrame { to: Recipients::All, priority, frame: &frame(kind, number, timer) });
        };
        for _ in 0..self.per_tick {
            send(Priority::Estimate { stream: 30 }, 0, self.estimates);
            send(Priority::Estimate { stream: 32 }, 1, self.estimates);
            self.estimates += 1;
        }
        if self.ticks.is_multiple_of(20) {
            send(Priority::Command, COMMAND, self.commands);
            self.commands += 1;
        }
        self.ticks += 1;
    }
}

async fn pass_tick() {
    tokio::time::advance(Duration::from_millis(10)).await;
}

/// A TCP client with a receive buffer as small as that of a weak brick.
fn small_client(address: SocketAddr, receive_buffer_bytes: usize) -> TcpStream {
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None).expect("a socket");
    socket.set_recv_buffer_size(receive_buffer_bytes).expect("it may be small");
    socket.connect(&address.into()).expect("it listens");
    socket.set_nonblocking(true).expect("own socket");
    socket.into()
}

/// Reads what is there now, at most `limit` bytes.
fn read_now(stream: &mut TcpStream, limit: usize) -> Vec<u8> {
    let mut bytes = vec![0; limit];
    match stream.read(&mut bytes) {
        Ok(count) => bytes.truncate(count),
        Err(error) if error.kind() == ErrorKind::WouldBlock => bytes.clear(),
        Err(error) => panic!("{error}"),
    }
    bytes
}

/// Reads `count` bytes, all of which were written: the system hands them over in real time, of which none passes here.
async fn read_written(stream: &mut TcpStream, count: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    while bytes.len() < count {
        bytes.extend(read_now(stream, count - bytes.len()));
        tokio::task::yield_now().await;
    }
    bytes
}

async fn tcp_server(timer: HostTimer) -> (Link, SocketAddr) {
    let mut server = port("tcp://127.0.0.1:0", ConnectRole::Listen, timer);
    up(&mut server).await;
    let address = server.local_address().expect("it listens");
    (server, address)
}

/// Lets the server notice its clients: the reactor has to run, which may take a turn.
async fn welcomed(server: &mut Link, clients: u32) {
    while server.port_counts().peers < clients {
        assert_eq!(poll_once(server).await, None);
        tokio::task::yield_now().await;
    }
}

#[tokio::test(start_paused = true)]
async fn over_a_slow_tcp_link_estimates_stay_young_and_no_command_is_lost() {
    const CAPACITY: usize = 4_000;
    const RECEIVE_BUFFER: usize = 4_096;
    let timer = HostTimer::start();
    let (mut server, address) = tcp_server(timer).await;
    let mut reader = small_client(address, RECEIVE_BUFFER);
    welcomed(&mut server, 1).await;

    let mut source = TrafficSource::new(CAPACITY as u32);
    let mut received = ReceivedFrames::default();
    let mut read = 0;
    for _ in 0..3_000 {
        source.tick(&mut server, timer);
        pass_tick().await;
        assert_eq!(poll_once(&mut server).await, None);
        let unread = server.counters().bytes_out - read;
        let bytes = read_written(&mut reader, (CAPACITY / 100).min(unread as usize)).await;
        read += bytes.len() as u64;
        received.push(&bytes, timer);
    }
    let counts = server.port_counts();
    // The doubled receive buffer, the unsent bytes that the system takes, a frame per stream and the waiting commands.
    let bound_bytes = 2 * RECEIVE_BUFFER + 2_048 + 3 * FRAME_BYTES;
    let bound = TimeDelta::from_secs_f64(bound_bytes as f64 / CAPACITY as f64) + TICK;
    let oldest = received.oldest_estimate.expect("some arrived");
    println!(
        "oldest estimate {oldest:?} of {bound:?}, oldest command {:?}, {} + {} of {} estimates, capacity {:?}",
        received.oldest_command,
        received.estimates[0].len(),
        received.estimates[1].len(),
        2 * source.estimates,
        counts.capacity_bytes_per_s
    );
    assert!(oldest <= bound, "{oldest:?} of {bound:?}");
    for estimates in &received.estimates {
        assert!(estimates.is_sorted_by(|a, b| a < b));
        // Both streams get their share of a tenth of the load.
        assert!(estimates.len() > source.estimates as usize / 25, "{}", estimates.len());
    }
    assert!(received.commands.iter().copied().eq(0..received.commands.len() as u32));
    let missing = source.commands as usize - received.commands.len();
    assert!(missing <= 5 * 3, "{missing} commands are still under way");
    let capacity = counts.capacity_bytes_per_s.expect("frames wait");
    assert!((capacity / CAPACITY as f64 - 1.0).abs() < 0.1, "{capacity}");
    assert!(counts.queued_frames >= 1 && counts.queued_bytes as usize >= FRAME_BYTES);
}

#[tokio::test(start_paused = true)]
async fn a_rate_on_a_pty_keeps_estimates_young_and_loses_no_command() {
    const RATE: u32 = 4_000;
    let timer = HostTimer::start();
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("brick.tty");
    let mut brick = port(&format!("pty:{}", path.display()), ConnectRole::Listen, timer);
    up(&mut brick).await;
    let mut station = port(&format!("serial:{}?rate={RATE}", path.display()), ConnectRole::Dial, timer);
    up(&mut station).await;

    let mut source = TrafficSource::new(RATE);
    let mut received = ReceivedFrames::default();
    let mut total = 0;
    for _ in 0..2_000 {
        source.tick(&mut station, timer);
        pass_tick().await;
        assert_eq!(poll_once(&mut station).await, None);
        // A pseudo-terminal hands its bytes over on a thread of the system, in real time, of which none passes here.
        while total < station.counters().bytes_out {
            match poll_once(&mut brick).await {
                Some(LinkEvent::Bytes { bytes, .. }) => {
                    total += bytes.len() as u64;
                    received.push(&bytes, timer);
                }
                Some(event) => panic!("{event:?} on a quiet line"),
                None => tokio::task::yield_now().await,
            }
        }
    }
    let secs = timer.now().as_secs_f64();
    let allowed = f64::from(RATE) * (secs + 0.05) + FRAME_BYTES as f64;
    assert!(total as f64 <= allowed, "{total} of {allowed} bytes");
    assert!(total as f64 > 0.97 * f64::from(RATE) * secs, "{total} in {secs} s");
    // Nothing lies in the line, so one frame of each kind is all that can be in front.
    let oldest = received.oldest_estimate.expect("some arrived");
    assert!(oldest <= TimeDelta::from_millis(60), "{oldest:?}");
    // The last one may have to wait for its turn.
    let commands = received.commands.len() as u32;
    assert!(source.commands - commands <= 1, "{commands} of {}", source.commands);
    assert!(received.commands.iter().copied().eq(0..commands));
    let capacity = station.port_counts().capacity_bytes_per_s.expect("frames wait");
    assert!((capacity / f64::from(RATE) - 1.0).abs() < 0.05, "{capacity}");
}

#[tokio::test(start_paused = true)]
async fn a_rate_counts_every_peer_and_every_transport_keeps_it() {
    const RATE: usize = 1_000;
    let timer = HostTimer::start();
    let mut station = port(&format!("udp://127.0.0.1:0?rate={RATE}"), ConnectRole::Listen, timer);
    up(&mut station).await;
    let address = station.local_address().expect("it listens");
    let bricks: Vec<_> = (0..4).map(|_| port(&format!("udp://{address}"), ConnectRole::Dial, timer)).collect();
    let mut bricks = bricks;
    for brick in &mut bricks {
        up(brick).await;
        brick.send(b"here");
        assert!(matches!(next_beside(&mut station, brick).await, LinkEvent::Bytes { .. }));
    }
    assert_eq!(station.port_counts().peers, 4);
    for _ in 0..800 {
        station.send(&[0; 50]);
        pass_tick().await;
        assert_eq!(poll_once(&mut station).await, None);
    }
    let sent = station.counters().bytes_out;
    // Eight seconds, the burst of 50 ms, and one frame to four peers.
    assert!((7_800..=8_000 + 50 + 200).contains(&sent), "{sent} bytes");

    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("out.bin");
    let url = format!("file:{}?mode=append&rate={RATE}", path.display());
    let mut file = port(&url, ConnectRole::Dial, timer);
    up(&mut file).await;
    for _ in 0..200 {
        file.send(&[0; 50]);
        pass_tick().await;
        assert_eq!(poll_once(&mut file).await, None);
    }
    let written = std::fs::metadata(&path).expect("it was made").len();
    assert!((1_950..=2_100).contains(&written), "{written} bytes");
}

#[tokio::test(start_paused = true)]
async fn frames_that_wait_for_the_rate_are_counted_when_the_link_goes() {
    let timer = HostTimer::start();
    let (server, address) = tcp_server(timer).await;
    let mut server = Some(server);
    let mut client = port(&format!("tcp://{address}?rate=100"), ConnectRole::Dial, timer);
    up(&mut client).await;
    for _ in 0..10 {
        client.send(&[7; 100]);
    }
    let counts = client.port_counts();
    assert_eq!((counts.queued_frames, counts.queued_bytes), (9, 900));
    drop(server.take());
    let LinkEvent::Down { .. } = client.next_event().await else {
        panic!("the server has gone");
    };
    assert_eq!(client.counters().drops_out, 9);
    let counts = client.port_counts();
    assert_eq!((counts.queued_frames, counts.peers), (0, 0));
}

#[tokio::test(start_paused = true)]
async fn a_client_that_hangs_does_not_block_another() {
    const FRAMES: u32 = 5_000;
    let timer = HostTimer::start();
    let (mut server, address) = tcp_server(timer).await;
    let _hung = small_client(address, 4_096);
    let mut alive = small_client(address, 64 * 1024);
    welcomed(&mut server, 2).await;
    let mut received = Vec::new();
    for number in 0..FRAMES {
        let mut frame = [0; 1_000];
        frame[..4].copy_from_slice(&number.to_be_bytes());
        server.send_outgoing(&OutgoingFrame { to: Recipients::All, priority: Priority::Forwarded, frame: &frame });
        // Until this one is there: the other has five megabytes to choke on.
        while received.len() < 1_000 * (number as usize + 1) {
            assert_eq!(poll_once(&mut server).await, None);
            tokio::task::yield_now().await;
            received.extend(read_now(&mut alive, 4_096));
        }
    }
    for (number, frame) in (0..FRAMES).zip(received.chunks(1_000)) {
        assert_eq!(frame[..4], number.to_be_bytes(), "in order and none missing");
    }
    let counts = server.port_counts();
    assert!(counts.drops_out > u64::from(FRAMES) * 9 / 10, "{counts:?}");
    assert!(counts.queued_frames >= 60, "{counts:?}");
    assert_eq!(counts.peers, 2);
    assert_eq!(counts.capacity_bytes_per_s, None, "a client that hangs does not make the link look slow");
}
