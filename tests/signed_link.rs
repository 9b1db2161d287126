//! A signed link as a whole program has it: keys in files, recordings without them, and what people are told.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Output;

use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, TimeSync, WheelTicks, WireStamp};
use posebridge_protocol::signing::{Key, LinkSigner, SigningConfig, SigningState, SigningTime, UnsignedPolicy};
use posebridge_telemetry::{Address, EncoderTicks, Timestamp};
use support::{RunningProgram, events_named, posebridge};

const BRICK: Address = Address::new(1, 1);
const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

/// A folder with a key, and the key.
fn folder_with_key() -> (tempfile::TempDir, Key) {
    let folder = tempfile::tempdir().unwrap();
    let made = finished(folder.path(), &["key", "new", "a.key"]);
    assert!(made.status.success());
    let text = std::fs::read_to_string(folder.path().join("a.key")).unwrap();
    let key: Key = text.parse().unwrap();
    assert_eq!(String::from_utf8(made.stdout).unwrap().trim(), key.name());
    (folder, key)
}

fn finished(folder: &Path, args: &[&str]) -> Output {
    posebridge(folder).args(args).output().unwrap()
}

/// Runs it, expects exit code 2, and returns what it said.
fn refused(folder: &Path, args: &[&str]) -> String {
    let output = finished(folder, args);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    String::from_utf8(output.stderr).unwrap()
}

/// A station that calls us on a signed link.
fn station(folder: &Path, name: &str) -> (RunningProgram, TcpStream) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let config =
        format!("[[link]]\nurl = \"tcp://{}\"\nsigning = {{ key_file = \"a.key\" }}\n", listener.local_addr().unwrap());
    std::fs::write(folder.join("station.toml"), config).unwrap();
    let events = format!("{name}.txt");
    let running = RunningProgram::start(posebridge(folder).args([
        "run",
        "--config",
        "station.toml",
        "--out",
        name,
        "--events",
        &events,
    ]));
    (running, listener.accept().unwrap().0)
}

/// A brick that signs, and can ask whether all that it said was handled.
struct Brick {
    link: TcpStream,
    signing: LinkSigner,
    encoder: Encoder,
    framer: Framer,
}

impl Brick {
    fn new(link: TcpStream, key: &Key) -> Self {
        // Ahead of any real date: the station takes its time from us.
        let ahead = SigningTime::from_units(60_000_000_000_000);
        let signing = LinkSigner::new(SigningConfig {
            key: key.clone(),
            link_id: 9,
            unsigned: UnsignedPolicy::Accept,
            state: SigningState { written_at: ahead, clock: ahead, ..SigningState::default() },
        });
        Self { link, signing, encoder: Encoder::new(WireVersion::V2), framer: Framer::new(FramerConfig::default()) }
    }

    fn send(&mut self, message: &Message) -> Vec<u8> {
        let seal = self.signing.next_signer(Timestamp::ZERO).unwrap();
        let mut bytes = Vec::new();
        self.encoder.encode_signed(BRICK, message, &seal, &mut bytes);
        self.link.write_all(&bytes).unwrap();
        bytes
    }

    /// Asks for the time and waits for the answer.
    fn ping(&mut self, request_nanos: i64) {
        self.send(&Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, target: None }));
        let mut is_answered = false;
        while !is_answered {
            let mut chunk = [0; 4_096];
            let read = self.link.read(&mut chunk).unwrap();
            assert!(read > 0, "the station has gone");
            self.framer.push(Timestamp::ZERO, &chunk[..read], &mut |found| {
                if let FramerOutput::Frame(frame) = found
                    && let Ok(Some(Message::TimeSync(sync))) = decode(&frame)
                {
                    is_answered |= sync.request_nanos == request_nanos && sync.answer_nanos != 0;
                }
            });
        }
    }
}

fn ticks(step: u32) -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(5_000_000 + step * 50_000),
        left: EncoderTicks(i64::from(step) * 4),
        right: EncoderTicks(i64::from(step) * 4),
    })
}

/// Drives a little with a frame that must be refused in between, and leaves a recording.
fn drive(folder: &Path, key: &Key) -> Vec<u8> {
    let (station, link) = station(folder, "run");
    let mut brick = Brick::new(link, key);
    let first = brick.send(&HEARTBEAT);
    for step in 0..10 {
        brick.send(&ticks(step));
    }
    brick.ping(77);
    brick.link.write_all(&first).unwrap();
    let mut unsigned = Vec::new();
    Encoder::new(WireVersion::V2).encode(BRICK, &ticks(90), &mut unsigned);
    brick.link.write_all(&unsigned).unwrap();
    brick.ping(78);
    station.interrupt();
    first
}

#[test]
fn a_signed_session_replays_bit_for_bit_with_its_key_and_not_without() {
    let (folder, key) = folder_with_key();
    drive(folder.path(), &key);
    let live = std::fs::read_to_string(folder.path().join("run.txt")).unwrap();
    assert_eq!(live.matches("\"reason\":\"replayed\"").count(), 1, "{live}");
    assert_eq!(live.matches("\"reason\":\"unsigned\"").count(), 1);
    assert_eq!(events_named(&live, "observed").len(), 10);

    let replay = ["replay", "run/recording.mcap", "--events", "again.txt"];
    let same = |more: &[&str]| {
        let output = finished(folder.path(), &[&replay[..], more].concat());
        assert!(output.status.success(), "{output:?}");
        let again = std::fs::read_to_string(folder.path().join("again.txt")).unwrap();
        assert!(again == live, "{more:?}");
    };
    same(&[]);
    std::fs::rename(folder.path().join("a.key"), folder.path().join("b.key")).unwrap();
    let missing = refused(folder.path(), &replay);
    assert!(missing.contains("--key FILE"), "{missing}");
    assert!(missing.contains(&key.name()), "{missing}");
    finished(folder.path(), &["key", "new", "c.key"]);
    let wrong = refused(folder.path(), &[&replay[..], &["--key", "c.key"]].concat());
    assert!(wrong.contains(&key.name()), "{wrong}");
    same(&["--key", "c.key", "--key", "b.key"]);
}

#[test]
fn the_key_stands_in_its_file_and_nowhere_else() {
    let (folder, key) = folder_with_key();
    drive(folder.path(), &key);
    let hex = key.reveal_hex();
    let raw: Vec<u8> = (0..64).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect();
    let mut looked_at = Vec::new();
    let mut folders = vec![folder.path().to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let bytes = std::fs::read(&path).unwrap();
            let holds = |needle: &[u8]| bytes.windows(needle.len()).any(|part| part == needle);
            let is_key = path.ends_with("a.key");
            assert_eq!(holds(hex.as_bytes()), is_key, "{}", path.display());
            assert!(!holds(&raw), "{}", path.display());
            looked_at.push(path);
        }
    }
    let has = |name: &str| looked_at.iter().any(|path: &PathBuf| path.ends_with(name));
    for name in ["recording.mcap", "run.txt", "a.key.link0.state"] {
        assert!(has(name), "{name}");
    }
}

#[test]
fn after_a_kill_old_frames_are_refused_and_a_date_that_fell_is_told() {
    let (folder, key) = folder_with_key();
    let (first_station, link) = station(folder.path(), "first");
    let mut brick = Brick::new(link, &key);
    let old = brick.send(&HEARTBEAT);
    brick.ping(1);
    // The stream was written down when it was heard first, and not only with the next half second.
    let state = folder.path().join("a.key.link0.state");
    while !std::fs::read_to_string(&state).unwrap().contains("link_id = 9") {
        brick.ping(2);
    }
    first_station.kill();

    let (mut second_station, mut link) = station(folder.path(), "second");
    // The brick's time, far ahead of the date, is kept.
    let told = second_station.wait_for("WARNING");
    assert!(told.contains("date stands"), "{told}");
    link.write_all(&old).unwrap();
    let mut brick = Brick::new(link, &key);
    brick.signing = LinkSigner::new(SigningConfig {
        key,
        link_id: 10,
        unsigned: UnsignedPolicy::Accept,
        state: SigningState { clock: SigningTime::from_units(60_000_100_000_000), ..SigningState::default() },
    });
    brick.ping(3);
    second_station.interrupt();
    let events = std::fs::read_to_string(folder.path().join("second.txt")).unwrap();
    assert_eq!(events.matches("\"reason\":\"replayed\"").count(), 1, "{events}");
}

#[test]
fn keys_are_refused_with_the_cure() {
    let (folder, _key) = folder_with_key();
    let path = folder.path();
    let again = refused(path, &["key", "new", "a.key"]);
    assert!(again.contains("never overwritten"), "{again}");

    let (first, _link) = station(path, "first");
    std::fs::write(path.join("other.toml"), OTHER).unwrap();
    let run = ["run", "--config", "other.toml", "--out", "other"];
    let taken = refused(path, &run);
    assert!(taken.contains("another station"), "{taken}");
    first.kill();

    let everybody = std::fs::Permissions::from_mode(0o644);
    std::fs::set_permissions(path.join("a.key"), everybody).unwrap();
    let open = refused(path, &run);
    assert!(open.contains("chmod 600 a.key"), "{open}");
    assert!(open.contains("link 0"), "{open}");
    assert!(!path.join("other").exists());
}

#[test]
fn a_listener_that_anybody_can_reach_is_warned_of_however_its_link_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let said = |flag: &str, url: &str| {
        let run = ["run", flag, url, "--duration", "0.1", "--out", "run"];
        let output = finished(folder.path(), &[&run[..], &["--no-record"]].concat());
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    for (flag, url, is_open) in [
        ("--link", "udp://0.0.0.0:0", true),
        ("--listen", "udp://0.0.0.0:0", true),
        ("--listen", "tcp://0.0.0.0:0", true),
        ("--link", "udp://:0", false),
        ("--listen", "udp://127.0.0.1:0", false),
    ] {
        let said = said(flag, url);
        assert!(said.contains("listening on"), "{flag} {url}: {said}");
        let is_warned = said.contains("can send as the robot");
        assert_eq!(is_warned, is_open, "{flag} {url}: {said}");
    }
}

const OTHER: &str = "[[link]]\nurl = \"udp://127.0.0.1:0\"\nlisten = true\nsigning = { key_file = \"a.key\" }\n";
