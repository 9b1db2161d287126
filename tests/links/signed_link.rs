//! A signed link as a whole program has it: keys in files, recordings without them, and what people are told.

use std::io::Write as _;
use std::net::{TcpListener, TcpStream};
use std::path::Path;

use crate::support::mavlink::{HEARTBEAT, MavlinkPeer, wheel_ticks};
use crate::support::{RunningProgram, assert_refused, assert_replays, events_named, read_text, run, write_text};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{Message, TimeSync};
use posebridge_protocol::signing::{Key, LinkSigner, SigningConfig, SigningState, SigningTime, UnsignedPolicy};
use posebridge_telemetry::{Address, Timestamp};

const BRICK: Address = Address::new(1, 1);

/// A folder with a key, and the key.
fn folder_with_key() -> (tempfile::TempDir, Key) {
    let folder = tempfile::tempdir().unwrap();
    let printed = run(folder.path(), &["key", "new", "a.key"]);
    let key: Key = read_text(folder.path(), "a.key").parse().unwrap();
    assert_eq!(printed.trim(), key.name());
    (folder, key)
}

/// A station that calls us on a signed link.
fn station(folder: &Path) -> (RunningProgram, TcpStream) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let config = format!("[[link]]\nurl = \"tcp://{address}\"\nsigning = {{ key_file = \"a.key\" }}\n");
    write_text(folder, "station.toml", &config);
    let args = ["run", "--config", "station.toml", "--out", "run", "--events", "live.txt"];
    (RunningProgram::posebridge(folder, &args), listener.accept().unwrap().0)
}

/// A brick that signs, and can ask whether all that it said was handled.
struct SigningBrick {
    link: TcpStream,
    signing: LinkSigner,
    encoder: Encoder,
    hearing: MavlinkPeer,
}

impl SigningBrick {
    fn new(link: TcpStream, key: &Key) -> Self {
        // Ahead of any real date: the station takes its time from us.
        let ahead = SigningTime::from_units(60_000_000_000_000);
        let signing = LinkSigner::new(SigningConfig {
            key: key.clone(),
            link_id: 9,
            unsigned: UnsignedPolicy::Accept,
            state: SigningState { written_at: ahead, clock: ahead, ..SigningState::default() },
        });
        Self { link, signing, encoder: Encoder::new(WireVersion::V2), hearing: MavlinkPeer::new(BRICK) }
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
        self.hearing.wait_for(&mut self.link, |message| match message {
            Message::TimeSync(sync) if sync.request_nanos == request_nanos && sync.answer_nanos != 0 => Some(()),
            _ => None,
        });
    }

    /// The station asks for the time five times a second.
    fn wait_for_request(&mut self) {
        self.hearing.wait_for(&mut self.link, |message| match message {
            Message::TimeSync(sync) if sync.answer_nanos == 0 => Some(()),
            _ => None,
        });
    }
}

/// Drives a little, with a replayed and an unsigned frame in between, which must be refused, and leaves a recording.
fn drive(folder: &Path, key: &Key) {
    let (station, link) = station(folder);
    let mut brick = SigningBrick::new(link, key);
    let first = brick.send(&HEARTBEAT);
    for step in 0..10 {
        brick.send(&wheel_ticks(step));
    }
    brick.ping(77);
    brick.link.write_all(&first).unwrap();
    brick.link.write_all(&MavlinkPeer::new(BRICK).frame(&wheel_ticks(90))).unwrap();
    brick.ping(78);
    station.interrupt();
}

#[test]
fn a_signed_session_replays_bit_for_bit_with_its_key_which_stands_nowhere_else() {
    let (folder, key) = folder_with_key();
    let folder = folder.path();
    drive(folder, &key);
    let live = assert_replays(folder, "run/recording.mcap", "live.txt");
    for reason in ["replayed", "unsigned"] {
        assert_eq!(live.matches(&format!("\"reason\":\"{reason}\"")).count(), 1, "{live}");
    }
    assert_eq!(events_named(&live, "observed").len(), 10);

    // No file but that of the key holds it, in letters or in bytes.
    let hex = key.reveal_hex();
    let raw: Vec<u8> = (0..64).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect();
    let in_folder = |folder: &Path| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let files: Vec<_> = in_folder(folder).chain(in_folder(&folder.join("run"))).filter(|path| path.is_file()).collect();
    for path in &files {
        let bytes = std::fs::read(path).unwrap();
        let holds = |needle: &[u8]| bytes.windows(needle.len()).any(|part| part == needle);
        assert_eq!(holds(hex.as_bytes()), path.ends_with("a.key"), "{}", path.display());
        assert!(!holds(&raw), "{}", path.display());
    }
    for name in ["recording.mcap", "live.txt", "a.key.link0.state"] {
        assert!(files.iter().any(|path| path.ends_with(name)), "{name}");
    }

    // Without the key the replay is refused, and the missing key is named; among other keys it is found.
    std::fs::rename(folder.join("a.key"), folder.join("b.key")).unwrap();
    run(folder, &["key", "new", "c.key"]);
    let name = key.name();
    assert_refused(
        folder,
        &[
            ("replay run/recording.mcap", 2, &["--key FILE", &name]),
            ("replay run/recording.mcap --key c.key", 2, &[&name]),
        ],
    );
    run(folder, &["replay", "run/recording.mcap", "--key", "c.key", "--key", "b.key", "--events", "again.txt"]);
    assert!(read_text(folder, "again.txt") == live);
}

/// What was accepted before a kill is refused after it, because the state is written when a stream is heard first.
#[test]
fn after_a_kill_old_frames_are_refused_and_a_date_that_fell_is_told() {
    let (folder, key) = folder_with_key();
    let folder = folder.path();
    let (first_station, link) = station(folder);
    let mut brick = SigningBrick::new(link, &key);
    let old = brick.send(&HEARTBEAT);
    brick.ping(1);
    while !read_text(folder, "a.key.link0.state").contains("link_id = 9") {
        // A disk can be slow, and a peer that asks without a pause gets no answer.
        brick.wait_for_request();
    }
    first_station.kill();
    std::fs::remove_dir_all(folder.join("run")).unwrap();

    let (mut second_station, mut link) = station(folder);
    // The brick's time, far ahead of the date, is kept.
    let warning = second_station.wait_for("WARNING");
    assert!(warning.contains("date stands"), "{warning}");
    link.write_all(&old).unwrap();
    let mut brick = SigningBrick::new(link, &key);
    brick.signing = LinkSigner::new(SigningConfig {
        key,
        link_id: 10,
        unsigned: UnsignedPolicy::Accept,
        state: SigningState { clock: SigningTime::from_units(60_000_100_000_000), ..SigningState::default() },
    });
    brick.ping(3);
    second_station.interrupt();
    assert_eq!(read_text(folder, "live.txt").matches("\"reason\":\"replayed\"").count(), 1);
}
