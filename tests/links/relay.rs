//! A relay between real links: the clean one changes nothing, a seeded one does exactly what its counters and its model say.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::Path;

use crate::support::mavlink::PATIENCE;
use crate::support::{RunningProgram, events_named, read_text, run, write_text};
use posebridge_sim::impairment::{ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkProfile};
use posebridge_telemetry::Timestamp;
use serde_json::Value;

/// Datagrams at a time: what the default receive buffer of a socket holds for sure.
const BATCH: u32 = 50;

#[test]
fn over_the_clean_link_every_byte_passes_unchanged_both_ways() {
    let folder = tempfile::tempdir().unwrap();
    let (relay, [brick, station]) = over_tcp(folder.path(), &[]);
    let up: Vec<u8> = (0..1_000_000_u32).map(|i| (i * 7 % 251) as u8).collect();
    let down: Vec<u8> = (0..700_000_u32).map(|i| (i * 13 % 241) as u8).collect();
    let ([mut brick_reads, mut station_reads], [mut brick, mut station]) =
        ([&brick, &station].map(|end| end.try_clone().unwrap()), [brick, station]);
    std::thread::scope(|scope| {
        scope.spawn(|| brick.write_all(&up).unwrap());
        scope.spawn(|| station.write_all(&down).unwrap());
        let at_station = scope.spawn(|| read_exactly(&mut station_reads, up.len()));
        assert!(read_exactly(&mut brick_reads, down.len()) == down);
        assert!(at_station.join().unwrap() == up);
    });
    let report = ended(relay);
    for (direction, bytes) in [("to_station", up.len()), ("to_brick", down.len())] {
        assert_eq!(count(&report, direction, "bytes_offered"), bytes as u64);
        assert_eq!(count(&report, direction, "bytes_delivered"), bytes as u64);
        assert_eq!(count(&report, direction, "bytes_untaken"), 0);
        assert_eq!(count(&report, direction, "chunks_dropped"), 0);
    }
}

#[test]
fn over_the_clean_link_every_datagram_passes_whole_both_ways() {
    let folder = tempfile::tempdir().unwrap();
    let ends = over_udp(folder.path(), &[]);
    for number in 0..200_u32 {
        let datagram = vec![number as u8; 1 + number as usize];
        ends.brick.send_to(&datagram, &ends.at_brick).unwrap();
        assert_eq!(receive(&ends.station), datagram);
        ends.station.send_to(&datagram, &ends.at_station).unwrap();
        assert_eq!(receive(&ends.brick), datagram);
    }
    let report = ended(ends.relay);
    assert_eq!(count(&report, "to_station", "chunks_delivered"), 200);
    assert_eq!(count(&report, "to_brick", "units_offered"), 200);
}

#[test]
fn a_damaged_stream_arrives_as_its_model_says_byte_for_byte() {
    let profile = "kind = \"stream\"\n\
        [to_station]\nbit_error_rate = 1e-3\nfragment = { most_bytes = 100, sizes = \"random\" }\n\
        [to_brick]\nbyte_loss = 0.01\ndelay = { base_ms = 3.0, jitter_mean_ms = 1.0 }\n";
    let folder = tempfile::tempdir().unwrap();
    write_text(folder.path(), "bad.toml", profile);
    let args = ["--impair", "bad.toml", "--seed", "11"];
    let (relay, [mut brick, mut station]) = over_tcp(folder.path(), &args);
    let bytes: Vec<u8> = (0..100_000_u32).map(|i| (i * 7 % 251) as u8).collect();
    // Where bits and bytes are hit does not depend on how the stream was cut on its way into the relay.
    let mut model = ImpairedLink::new(&LinkProfile::from_toml(profile).unwrap(), 11, Timestamp::ZERO);
    model.offer(LinkEnd::Brick, Timestamp::ZERO, &bytes);
    model.offer(LinkEnd::Station, Timestamp::ZERO, &bytes);
    let [to_station, to_brick] = arrived(&mut model);
    brick.write_all(&bytes).unwrap();
    assert!(read_exactly(&mut station, to_station.len()) == to_station);
    station.write_all(&bytes).unwrap();
    assert!(read_exactly(&mut brick, to_brick.len()) == to_brick);
    let report = ended(relay);
    let flipped: u32 = to_station.iter().zip(&bytes).map(|(got, sent)| (got ^ sent).count_ones()).sum();
    assert!(flipped > 500);
    assert_eq!(count(&report, "to_station", "bits_flipped"), u64::from(flipped));
    let missing = (bytes.len() - to_brick.len()) as u64;
    assert!(missing > 500);
    assert_eq!(count(&report, "to_brick", "bytes_missing"), missing);
    assert_eq!(count(&report, "to_brick", "bytes_delivered"), to_brick.len() as u64);
    // What one seed damages another does not.
    let mut other = ImpairedLink::new(&LinkProfile::from_toml(profile).unwrap(), 12, Timestamp::ZERO);
    other.offer(LinkEnd::Brick, Timestamp::ZERO, &bytes);
    assert!(arrived(&mut other)[0] != to_station);
}

#[test]
fn the_datagrams_that_get_lost_are_those_of_the_model() {
    let profile = "kind = \"datagram\"\n[both]\nloss = 0.2\nduplicate = 0.1\n";
    let folder = tempfile::tempdir().unwrap();
    write_text(folder.path(), "lossy.toml", profile);
    let ends = over_udp(folder.path(), &["--impair", "lossy.toml", "--seed", "7"]);
    let mut model = ImpairedLink::new(&LinkProfile::from_toml(profile).unwrap(), 7, Timestamp::ZERO);
    let mut lost = 0;
    let mut repeated = 0;
    for batch in 0..20 {
        let numbers = batch * BATCH..(batch + 1) * BATCH;
        let mut expected = Vec::new();
        for number in numbers {
            let datagram = number.to_le_bytes();
            ends.brick.send_to(&datagram, &ends.at_brick).unwrap();
            model.offer(LinkEnd::Brick, Timestamp::ZERO, &datagram);
            let before = expected.len();
            while let Some(ImpairedLinkEvent::Arrived { delivery, .. }) = model.poll(Timestamp::ZERO) {
                expected.push(delivery.bytes);
            }
            lost += u64::from(expected.len() == before);
            repeated += u64::from(expected.len() == before + 2);
        }
        for datagram in expected {
            assert_eq!(receive(&ends.station), datagram);
        }
    }
    let report = ended(ends.relay);
    assert!(lost > 100 && repeated > 50, "{lost} {repeated}");
    assert_eq!(count(&report, "to_station", "units_offered"), u64::from(20 * BATCH));
    assert_eq!(count(&report, "to_station", "bytes_lost_alone"), 4 * lost);
    assert_eq!(count(&report, "to_station", "repeated"), repeated);
}

#[test]
fn a_station_behind_a_bluetooth_link_estimates_and_its_side_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut brick = RunningProgram::posebridge(folder, &["sim", "circle", "--listen", "tcp://127.0.0.1:0"]);
    let brick_link = format!("tcp://{}", brick.listening_address(""));
    let relay = ["relay", &brick_link, "--listen", "tcp://127.0.0.1:0", "--impair", "bluetooth-spp"];
    let mut relay = RunningProgram::posebridge(folder, &[&relay[..], &["--record", "link.mcap"]].concat());
    let station_link = format!("tcp://{}", relay.listening_address("station end "));
    let mut station = RunningProgram::posebridge(folder, &["run", "--link", &station_link, "--out", "run"]);
    station.wait_for("fix accepted");
    station.interrupt();
    let table = relay.interrupt();
    assert!(table.contains("link bluetooth-spp, seed 1"), "{table}");
    run(folder, &["replay", "link.mcap", "--events", "replayed.txt"]);
    assert!(!events_named(&read_text(folder, "replayed.txt"), "estimated").is_empty());
}

#[test]
fn it_ends_by_itself_when_its_time_is_over() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["relay", "pty:a.tty", "pty:b.tty", "--duration", "0.2", "--impair", "harsh"];
    let table = run(folder.path(), &args);
    assert!(table.contains("link harsh, seed 1"), "{table}");
    assert!(!folder.path().join("a.tty").exists(), "the terminal's name is gone");
}

#[test]
fn it_ends_with_a_file_though_the_other_end_still_has_something_on_the_way() {
    let profile = "kind = \"stream\"\n[to_station]\ndelay = { base_ms = 300.0, jitter_mean_ms = 0.0 }\n\
        [to_brick]\ndelay = { base_ms = 60000.0, jitter_mean_ms = 0.0 }\n";
    let folder = tempfile::tempdir().unwrap();
    write_text(folder.path(), "slow.toml", profile);
    write_text(folder.path(), "run.bin", "a short file");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let link = format!("tcp://{}", listener.local_addr().unwrap());
    let args = ["relay", "file://run.bin", &link, "--impair", "slow.toml", "--json"];
    let mut relay = RunningProgram::posebridge(folder.path(), &args);
    let (mut station, _) = listener.accept().unwrap();
    station.set_read_timeout(Some(PATIENCE)).unwrap();
    station.write_all(b"a minute away").unwrap();
    assert_eq!(read_exactly(&mut station, 12), b"a short file");
    let report: Value = serde_json::from_str(&relay.output()).unwrap();
    assert_eq!(count(&report, "to_brick", "bytes_on_the_way"), 13);
    let took_s = report["duration_s"].as_f64().unwrap();
    assert!(took_s < 30.0, "it waited for what nobody takes: {took_s} s");
}

/// A relay between two TCP links of ours, and our ends: the brick's and the station's.
fn over_tcp(folder: &Path, args: &[&str]) -> (RunningProgram, [TcpStream; 2]) {
    let listeners = [(), ()].map(|()| TcpListener::bind("127.0.0.1:0").expect("a port is free"));
    let [brick, station] = [&listeners[0], &listeners[1]]
        .map(|listener| format!("tcp://{}", listener.local_addr().expect("it has an address")));
    let mut relay = RunningProgram::posebridge(folder, &[&["relay", &brick, &station, "--json"], args].concat());
    let ends = listeners.map(|listener| listener.accept().expect("the relay calls").0);
    for end in &ends {
        end.set_read_timeout(Some(PATIENCE)).expect("it can be set");
    }
    relay.wait_for("relaying");
    (relay, ends)
}

/// A relay between two UDP sockets of ours.
struct UdpEnds {
    relay: RunningProgram,
    brick: UdpSocket,
    station: UdpSocket,
    /// Where the relay hears the brick.
    at_brick: String,
    /// Where the relay hears the station.
    at_station: String,
}

fn over_udp(folder: &Path, args: &[&str]) -> UdpEnds {
    let [brick, station] = [(), ()].map(|()| UdpSocket::bind("127.0.0.1:0").expect("a port is free"));
    let [brick_url, station_url] = [&brick, &station].map(|socket| {
        socket.set_read_timeout(Some(PATIENCE)).expect("it can be set");
        format!("udp://{}", socket.local_addr().expect("it has an address"))
    });
    let mut relay =
        RunningProgram::posebridge(folder, &[&["relay", &brick_url, &station_url, "--json"], args].concat());
    let mut heard = || {
        let line = relay.wait_for(" end up: ");
        let port = line.split("from 0.0.0.0:").nth(1).expect("it says from where");
        let digits: String = port.chars().take_while(char::is_ascii_digit).collect();
        (line.starts_with("brick"), format!("127.0.0.1:{digits}"))
    };
    let (first, second) = (heard(), heard());
    let (at_brick, at_station) = if first.0 { (first.1, second.1) } else { (second.1, first.1) };
    relay.wait_for("relaying");
    UdpEnds { relay, brick, station, at_brick, at_station }
}

/// All that a model delivers at both ends, when nothing else is offered.
fn arrived(model: &mut ImpairedLink) -> [Vec<u8>; 2] {
    let mut bytes = [Vec::new(), Vec::new()];
    while let Some(next) = model.deadline() {
        while let Some(event) = model.poll(next) {
            if let ImpairedLinkEvent::Arrived { end, delivery } = event {
                bytes[usize::from(end == LinkEnd::Brick)].extend(delivery.bytes);
            }
        }
    }
    bytes
}

fn read_exactly(from: &mut impl Read, count: usize) -> Vec<u8> {
    let mut bytes = vec![0; count];
    from.read_exact(&mut bytes).expect("they arrive");
    bytes
}

fn receive(socket: &UdpSocket) -> Vec<u8> {
    let mut buffer = [0; 2_048];
    let (length, _) = socket.recv_from(&mut buffer).expect("it arrives");
    buffer[..length].to_vec()
}

/// Ends a relay as Ctrl-C does and returns its JSON object.
fn ended(relay: RunningProgram) -> Value {
    serde_json::from_str(&relay.interrupt()).expect("it prints one object")
}

fn count(report: &Value, direction: &str, counter: &str) -> u64 {
    report[direction][counter].as_u64().expect("there is such a counter")
}
