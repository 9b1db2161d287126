//! An EV3 in the network, imitated as a foreign program: it announces itself, and accepts only its serial number.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};

use crate::support::{down, next_beside, port, up};
use posebridge_link::{ConnectRole, HostTimer, LinkEvent, LinkUrl};

/// As the developer kit and ev3-dc 0.9.10.2 write it.
const OPENING: &[u8] = b"GET /target?sn=0016533f0c1eVMTP1.0\nProtocol: EV3";

fn announcement(address: SocketAddr, serial: &str) -> String {
    format!("Serial-Number: {serial}\r\nPort: {}\r\nName: Gero\r\nProtocol: EV3\r\n", address.port())
}

/// Accepts one host, and sends the parts of the answer.
fn opened(listener: &TcpListener, answer: &[&[u8]]) -> TcpStream {
    let (mut host, _) = listener.accept().expect("a host calls");
    let mut received = [0; OPENING.len()];
    host.read_exact(&mut received).expect("the whole opening");
    assert_eq!(received, OPENING);
    for part in answer {
        host.write_all(part).expect("the host listens");
    }
    host
}

fn listener() -> (TcpListener, SocketAddr) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("it is bound");
    (listener, address)
}

#[tokio::test]
async fn a_brick_that_announces_itself_is_answered_and_opened() {
    let beside = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let announced = beside.local_addr().expect("it is bound");
    drop(beside);
    let url = format!("ev3://{announced}?serial=0016533F0C1E");
    let mut station = port(&url, ConnectRole::Listen, HostTimer::start());
    let (listener, address) = listener();
    let brick = std::thread::spawn(move || {
        let announcer = UdpSocket::bind("127.0.0.1:0").expect("a free port");
        let pause = std::time::Duration::from_millis(50);
        announcer.set_read_timeout(Some(pause)).expect("a finite wait");
        // The station may not listen yet; another brick is none of its business.
        let mut answer = [0; 10];
        loop {
            for text in ["noise", &announcement(address, "0016533f0c1d")] {
                announcer.send_to(text.as_bytes(), announced).ok();
            }
            assert!(announcer.recv(&mut answer).is_err(), "the wrong one is answered");
            let text = announcement(address, "0016533f0c1e");
            announcer.send_to(text.as_bytes(), announced).ok();
            if announcer.recv(&mut answer).is_ok() {
                break;
            }
        }
        let mut host = opened(&listener, &[b"Accept:EV340\r\n\r\n", b"first"]);
        let mut received = [0; 4];
        host.read_exact(&mut received).expect("what the station says");
        (host, received)
    });
    let detail = up(&mut station).await;
    assert!(detail.contains("`Gero` (0016533f0c1e)"), "{detail}");
    station.send(b"ping");
    let mut received = Vec::new();
    while received.len() < 5 {
        if let LinkEvent::Bytes { bytes, .. } = station.next_event().await {
            received.extend(bytes);
        }
    }
    assert_eq!(received, b"first");
    let (host, ping) = brick.join().expect("the brick lives");
    assert_eq!(&ping, b"ping");
    // Switched off: it is waited for again.
    drop(host);
    let (reason, _) = down(&mut station).await;
    assert!(reason.contains("other end is gone"), "{reason}");
}

#[tokio::test]
async fn a_brick_is_dialled_and_its_answer_may_come_in_pieces() {
    for answer in [
        &[&b"Acc"[..], b"ept:EV340", b"\n", b"\n"][..],
        &[b"Accept:EV340\r\n\r", b"\n"],
        // No line ends at all: they are not waited for long.
        &[b"Accept:EV340"],
    ] {
        let (listener, address) = listener();
        let answer: Vec<Vec<u8>> = answer.iter().map(|part| part.to_vec()).collect();
        let brick = std::thread::spawn(move || {
            let parts: Vec<&[u8]> = answer.iter().map(Vec::as_slice).collect();
            opened(&listener, &parts)
        });
        let url = format!("ev3://{address}?serial=0016533f0c1e");
        let mut station = port(&url, ConnectRole::Dial, HostTimer::start());
        up(&mut station).await;
        let mut host = brick.join().expect("the brick lives");
        host.write_all(b"reply").expect("the station listens");
        let mut other = port("file:/dev/null/nowhere", ConnectRole::Dial, HostTimer::start());
        let event = next_beside(&mut station, &mut other).await;
        assert!(matches!(&event, LinkEvent::Bytes { bytes, .. } if bytes == b"reply"), "{event:?}");
    }
}

#[tokio::test]
async fn a_failed_open_is_reported_with_the_serial_number() {
    let (listener, address) = listener();
    let brick = std::thread::spawn(move || opened(&listener, &[&[b'x'; 64]]));
    let url = format!("ev3://{address}?serial=0016533f0c1e");
    let mut station = port(&url, ConnectRole::Dial, HostTimer::start());
    let (reason, _) = down(&mut station).await;
    assert!(reason.contains("does not accept the serial number 0016533f0c1e"), "{reason}");
    brick.join().expect("the brick lives");
}

#[tokio::test]
async fn a_brick_is_not_dialled_without_its_serial_number() {
    let mut station = port("ev3://127.0.0.1:5555", ConnectRole::Dial, HostTimer::start());
    let error = station.try_open().await.expect_err("it cannot be opened");
    assert!(error.to_string().contains("?serial="), "{error}");
    let error = LinkUrl::parse("ev3://127.0.0.1:5555?serial=12").expect_err("too short");
    assert!(error.to_string().contains("12 hexadecimal digits"), "{error}");
}
