//! Links that are slower than their load: the age of estimates, the fate of commands, and fairness between peers.
//!
//! The sockets are real, the clock is paused: a reader that takes a number of bytes per virtual second has exactly that
//! speed, however busy the computer is.

use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use crate::support::{next_beside, poll_once, port, up};
use crate::traffic::{FRAME_BYTES, ReceivedFrames, TrafficSource};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, OutgoingFrame};
use posebridge_telemetry::{Priority, Recipients, TimeDelta};

const TICK: TimeDelta = TimeDelta::from_millis(10);

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
    // One a second. The system opens the window of the connection in steps of kilobytes and in its own time, which moves single ones.
    let mut capacities = Vec::new();
    for tick in 0..3_000 {
        source.tick(timer.now(), |priority, frame| {
            server.send_outgoing(&OutgoingFrame { to: Recipients::All, priority, frame });
        });
        pass_tick().await;
        assert_eq!(poll_once(&mut server).await, None);
        if tick >= 1_000 && tick % 100 == 0 {
            capacities.push(server.port_counts().capacity_bytes_per_s.expect("frames wait"));
        }
        let unread = server.counters().bytes_out - read;
        let bytes = read_written(&mut reader, (CAPACITY / 100).min(unread as usize)).await;
        read += bytes.len() as u64;
        received.push(&bytes, timer.now());
    }
    let counts = server.port_counts();
    // The doubled receive buffer, the unsent bytes that the system takes, a frame per stream and the waiting commands.
    let bound_bytes = 2 * RECEIVE_BUFFER + 2_048 + 3 * FRAME_BYTES;
    let bound = TimeDelta::from_secs_f64(bound_bytes as f64 / CAPACITY as f64) + TICK;
    let oldest = received.oldest_estimate;
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
    capacities.sort_by(f64::total_cmp);
    let capacity = capacities[capacities.len() / 2];
    assert!((capacity / CAPACITY as f64 - 1.0).abs() < 0.1, "{capacities:?}");
    assert!(counts.queued_frames >= 1 && counts.queued_bytes as usize >= FRAME_BYTES);
}

#[tokio::test(start_paused = true)]
async fn a_rate_counts_every_peer_and_every_transport_keeps_it() {
    const RATE: usize = 1_000;
    let timer = HostTimer::start();
    let mut station = port(&format!("udp://127.0.0.1:0?rate={RATE}"), ConnectRole::Listen, timer);
    up(&mut station).await;
    let address = station.local_address().expect("it listens");
    let mut bricks: Vec<_> = (0..4).map(|_| port(&format!("udp://{address}"), ConnectRole::Dial, timer)).collect();
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
    let capacity = station.port_counts().capacity_bytes_per_s.expect("frames wait");
    assert!((capacity / RATE as f64 - 1.0).abs() < 0.05, "{capacity}");
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
    for _ in 0..2 {
        let priority = Priority::Estimate { stream: 30 };
        client.send_outgoing(&OutgoingFrame { to: Recipients::All, priority, frame: &[8; 10] });
    }
    assert_eq!(client.port_counts().queued_bytes, 910, "an estimate replaces the one that waits");
    assert_eq!(client.counters().drops_out, 1);
    drop(server.take());
    let LinkEvent::Down { .. } = client.next_event().await else {
        panic!("the server has gone");
    };
    assert_eq!(client.counters().drops_out, 11);
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
