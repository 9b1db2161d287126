//! The promises of a recording: the same inputs come back bit for bit, a cut or a crash costs only unflushed data, and
//! damage is reported and never replayed.

use std::io::Cursor;
use std::net::{Ipv4Addr, Ipv6Addr};

use posebridge_recording::container::{
    FORMAT, INPUT_ENCODING, INPUT_TOPIC, PartHeader, ReadError, RecordingEnd, RecordingHeader, RecordingReader,
    RecordingWriter, TruthSample, WriteError, read_truth,
};
use posebridge_telemetry::{
    Address, Command, Fix, Heading, HostClock, Input, LinkCounts, LinkId, LinkState, Meters, MetersPerSecond,
    Observation, ObservationKind, OutsideFix, Ownership, ParameterName, PeerId, Point2, Pose, Radians,
    RadiansPerSecond, RobotId, RobotSnapshot, SensorId, StationInput, TimeDelta, Timestamp,
};

use crate::MemoryFile;

pub(crate) type Recorded = (Timestamp<HostClock>, Input);

pub(crate) const UTC_START_NANOS: u64 = 1_700_000_000_123_456_000;

pub(crate) fn header() -> RecordingHeader {
    RecordingHeader {
        format: FORMAT,
        program_version: "0.1.0".to_owned(),
        utc_start_micros: 1_700_000_000_123_456,
        config_toml: "[robot]\nname = \"Döner \\\"7\\\"\"\n".to_owned(),
        links: vec!["sim://square".to_owned(), "udp://:14550".to_owned()],
    }
}

/// One of every kind of input; the encoding's own tests have all kinds of observations and commands.
fn every_kind() -> Vec<Input> {
    let pose = Pose::new(Meters(1.5), Meters(-0.25), Heading::from_rad(3.0));
    let set_pose = Command::SetPose { pose, position_sigma_m: 0.01, heading_sigma_rad: 0.1 };
    let observation = |measurement| {
        Input::Observation(Observation {
            sensor: SensorId(200),
            stamp: Timestamp::from_nanos(i64::MIN),
            stamp_sigma: TimeDelta::from_nanos(i64::MAX),
            measurement,
        })
    };
    let link = LinkId(u16::MAX);
    let owned = |link, ownership| Input::Ownership { robot: RobotId { link, address: Address::new(7, 1) }, ownership };
    let outside = OutsideFix {
        source: Address::new(255, 191),
        time: Timestamp::from_nanos(-7),
        uncertainty: TimeDelta::from_nanos(9),
        fix: Fix {
            position: Point2::new(Meters(1.0), Meters(-0.0)),
            heading: Some(Heading::from_rad(1.0)),
            covariance: None,
            tag_in_body: Point2::new(Meters(0.0), Meters(0.1)),
            reset_counter: 3,
        },
    };
    let snapshot = RobotSnapshot { bytes: vec![0, 255, 4], clock_offset: TimeDelta::from_nanos(-5) };
    vec![
        observation(ObservationKind::WheelAngles { left: Radians(-1e6), right: Radians(0.5) }),
        observation(ObservationKind::OdometerPose(Pose::new(Meters(0.0), Meters(-0.0), Heading::from_rad(-3.0)))),
        observation(ObservationKind::WallRange(Meters(0.443))),
        Input::Bytes { peer: PeerId(0), link, bytes: vec![0xFD, 0, 0xFF] },
        Input::Bytes { peer: PeerId(70_000), link, bytes: Vec::new() },
        Input::Link { link, state: LinkState::Up },
        Input::Link { link, state: LinkState::Down },
        Input::Port { link, counts: LinkCounts::default() },
        Input::PeerAddress { link, peer: PeerId(7), host: Ipv4Addr::new(192, 168, 4, 2).into() },
        Input::PeerAddress { link, peer: PeerId(8), host: Ipv6Addr::LOCALHOST.into() },
        Input::Command(set_pose),
        Input::Command(Command::SetParameter { name: ParameterName::from_bytes(b"gate_prob"), value: 0.9 }),
        Input::RobotCommand { robot: RobotId { link, address: Address::new(7, 1) }, command: set_pose },
        owned(link, Ownership::Standby { epoch: u64::MAX }),
        owned(link, Ownership::Owner { epoch: 1, state: None }),
        owned(link, Ownership::Owner { epoch: 2, state: Some(snapshot) }),
        Input::RobotCommand {
            robot: RobotId { link, address: Address::new(7, 1) },
            command: Command::Drive { forward: MetersPerSecond(0.25), turn: RadiansPerSecond(-0.5) },
        },
        Input::OutsideFix { robot: RobotId { link, address: Address::new(7, 1) }, fix: outside },
        Input::Report { severity: 6, text: "saved".to_owned() },
        Input::Tick,
        Input::OfStation { station: 1, input: StationInput::Command(set_pose) },
        Input::OfStation { station: 2, input: StationInput::Report { severity: 7, text: "saved".to_owned() } },
        Input::OfStation { station: u16::MAX, input: StationInput::Tick },
    ]
}

pub(crate) fn sample() -> Vec<Recorded> {
    let stamps = (0..).map(|n| Timestamp::from_millis(20 * n));
    stamps.zip(every_kind()).collect()
}

pub(crate) fn write(items: &[Recorded]) -> Vec<u8> {
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header()).unwrap();
    for (now, input) in items {
        writer.record(*now, input).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

pub(crate) fn read_all(bytes: &[u8]) -> Vec<Recorded> {
    let reader = RecordingReader::open(bytes).unwrap();
    reader.map(Result::unwrap).collect()
}

/// Where the record of the input with this number begins: opcode, length, the inputs' channel, the number.
pub(crate) fn record_of(bytes: &[u8], number: u8) -> usize {
    bytes.windows(15).position(|head| head[0] == 5 && head[9..] == [1, 0, number, 0, 0, 0]).unwrap()
}

#[test]
fn every_kind_of_input_comes_back() {
    let bytes = write(&sample());
    let reader = RecordingReader::open(&bytes).unwrap();
    assert_eq!(reader.header(), &header());
    assert_eq!(reader.recording_end(), RecordingEnd::Complete);
    assert_eq!(read_all(&bytes), sample());
}

#[test]
fn another_mcap_reader_finds_the_channel_with_its_schema_and_the_times() {
    let bytes = write(&sample());
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(!summary.chunk_indexes.is_empty(), "readers cannot seek");
    let messages: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .filter(|message| message.channel.topic == INPUT_TOPIC)
        .collect();
    assert_eq!(messages.len(), sample().len());
    for (message, (now, _)) in messages.iter().zip(sample()) {
        // UTC, as in all files that viewers lay beside each other.
        assert_eq!(message.log_time, UTC_START_NANOS + now.as_nanos() as u64);
        assert_eq!(message.channel.topic, INPUT_TOPIC);
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(schema.encoding, INPUT_ENCODING);
    }
}

#[test]
fn a_cut_at_any_byte_leaves_a_prefix() {
    let items = sample();
    let bytes = write(&items);
    let mut longest = 0;
    for cut in 0..bytes.len() {
        let Ok(reader) = RecordingReader::open(&bytes[..cut]) else {
            assert_eq!(longest, 0, "cut at {cut}: the header was readable before");
            continue;
        };
        assert!(matches!(reader.recording_end(), RecordingEnd::Truncated { .. }), "cut at {cut}");
        let found = read_all(&bytes[..cut]);
        assert_eq!(found, items[..found.len()], "cut at {cut}");
        assert!(found.len() >= longest, "cut at {cut}");
        longest = found.len();
    }
    assert_eq!(longest, items.len());
}

#[test]
fn zeros_after_a_power_cut_are_a_torn_tail() {
    let bytes = write(&sample());
    let whole = record_of(&bytes, 9) + 12;
    let zeroed = [&bytes[..whole], &[0; 4096]].concat();
    let found: Vec<_> = RecordingReader::open(&zeroed).unwrap().collect();
    // The chunk that was being written has its length but zeros for its end, and the record in it as well.
    let is_expected = |item: &Result<Recorded, ReadError>| match item {
        Ok(_) | Err(ReadError::Chunk { .. } | ReadError::Message { .. }) => true,
        Err(_) => false,
    };
    assert!(found.iter().all(is_expected), "{found:?}");
    let good: Vec<Recorded> = found.into_iter().flatten().collect();
    assert_eq!(good, sample()[..9]);
    let end = RecordingReader::open(&zeroed).unwrap().recording_end();
    assert!(matches!(end, RecordingEnd::Truncated { .. }), "{end:?}");
}

#[test]
fn what_was_flushed_survives_a_kill() {
    let disk = MemoryFile::default();
    let mut writer = RecordingWriter::create(disk.clone(), &header()).unwrap();
    assert_eq!(read_all(&disk.content()), [], "the header is flushed at once");
    let items = sample();
    for (count, (now, input)) in items.iter().enumerate() {
        writer.record(*now, input).unwrap();
        writer.flush().unwrap();
        assert_eq!(read_all(&disk.content()), items[..=count]);
    }
}

#[test]
fn what_is_not_ours_is_refused_with_a_reason() {
    assert_eq!(RecordingReader::open(b"").unwrap_err(), ReadError::NotMcap);
    assert_eq!(RecordingReader::open(b"PK\x03\x04").unwrap_err(), ReadError::NotMcap);
    let mut other = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
    other.finish().unwrap();
    let other = other.into_inner().into_inner();
    let error = RecordingReader::open(&other).unwrap_err();
    assert!(matches!(error, ReadError::NoHeader { .. }), "{error}");
    let newer = RecordingHeader { format: FORMAT + 1, ..header() };
    let writer = RecordingWriter::create(Cursor::new(Vec::new()), &newer).unwrap();
    let newer = writer.finish().unwrap().into_inner();
    let error = RecordingReader::open(&newer).unwrap_err();
    assert_eq!(error, ReadError::Format { found: FORMAT + 1 });
}

#[test]
fn without_the_record_of_the_channel_the_inputs_are_read_by_its_number() {
    let mut bytes = write(&sample());
    let topic = INPUT_TOPIC.as_bytes();
    let at = bytes.windows(topic.len()).position(|text| text == topic).unwrap();
    bytes[at] ^= 1;
    let found: Vec<_> = RecordingReader::open(&bytes).unwrap().collect();
    let [Err(ReadError::Chunk { .. }), inputs @ ..] = &found[..] else {
        panic!("{found:?}");
    };
    assert_eq!(inputs.len(), sample().len());
    assert!(inputs.iter().all(Result::is_ok));
}

#[test]
fn a_later_part_says_what_it_continues_and_counts_on() {
    let begins = PartHeader { part: 2, inputs_before: 1_000_000, continues: Some("recording.mcap".to_owned()) };
    let mut writer = RecordingWriter::create_part(Cursor::new(Vec::new()), &header(), &begins).unwrap();
    for (now, input) in sample() {
        writer.record(now, &input).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!(RecordingReader::open(&bytes).unwrap().part_header(), &begins);
    assert_eq!(read_all(&bytes), sample());
    let whole = write(&sample());
    let begins = RecordingReader::open(&whole).unwrap().part_header().clone();
    assert_eq!(begins, PartHeader::default());
}

#[test]
fn chunks_that_another_program_has_compressed_are_refused_by_name() {
    let mut bytes = write(&sample());
    // The head of a chunk: opcode, length, two times, size, checksum; then the length of the name of the compression.
    let chunk = (0..bytes.len()).find(|at| bytes[*at] == 6 && bytes[at + 3..at + 9] == [0; 6]).unwrap();
    let name = chunk + 9 + 28;
    assert_eq!(bytes[name..name + 4], [0; 4]);
    // Four bytes of what stood behind the name's length become the name.
    bytes[name] = 4;
    bytes[name + 4..name + 8].copy_from_slice(b"zstd");
    let found: Vec<_> = RecordingReader::open(&bytes).unwrap().collect();
    let [Err(ReadError::Compressed { offset, compression })] = &found[..] else {
        panic!("{found:?}");
    };
    assert_eq!((*offset, compression.as_str()), (chunk as u64, "zstd"));
}

#[test]
fn an_instant_before_the_session_is_refused_and_the_next_one_is_not() {
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header()).unwrap();
    let early = Timestamp::from_nanos(-1);
    assert!(matches!(
        writer.record(early, &Input::Tick),
        Err(WriteError::NegativeTime(stamp)) if stamp == early
    ));
    writer.record(Timestamp::ZERO, &Input::Tick).unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!(read_all(&bytes), [(Timestamp::ZERO, Input::Tick)]);
    let late = RecordingHeader { utc_start_micros: u64::MAX / 1_000, ..header() };
    let refused = RecordingWriter::create(Cursor::new(Vec::new()), &late).err();
    assert!(matches!(refused, Some(WriteError::StartTime(_))));
}

const LEFT: RobotId = RobotId { link: LinkId(0), address: Address::new(1, 1) };
const RIGHT: RobotId = RobotId { link: LinkId(300), address: Address::new(2, 200) };

fn truth_sample(robot: Option<RobotId>, millis: i64) -> TruthSample {
    let pose = Pose::new(Meters(1.5), Meters(-2.0), Heading::from_rad(0.5));
    TruthSample { robot, time: Timestamp::from_millis(millis), pose, odometry: None }
}

/// A recording of the truth, and of inputs.
fn recording_with_truth(samples: &[TruthSample]) -> Vec<u8> {
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header()).unwrap();
    for (now, input) in sample() {
        writer.record(now, &input).unwrap();
    }
    writer.record_truth(Timestamp::from_millis(2_000), samples).unwrap();
    writer.finish().unwrap().into_inner()
}

/// A recording of [`RIGHT`] with one text in the JSON of its sample replaced by another of the same length.
fn damaged(text: &str, by: &str) -> Vec<u8> {
    assert_eq!(text.len(), by.len());
    let mut bytes = recording_with_truth(&[truth_sample(Some(RIGHT), 20)]);
    let at = bytes.windows(text.len()).position(|found| found == text.as_bytes()).unwrap();
    bytes[at..at + by.len()].copy_from_slice(by.as_bytes());
    bytes
}

#[test]
fn the_truth_of_robots_comes_back_in_its_order_and_is_no_input() {
    let odometry = Some(truth_sample(None, 0).pose);
    let samples = [
        truth_sample(Some(LEFT), 20),
        truth_sample(Some(RIGHT), 20),
        truth_sample(None, 30),
        TruthSample { odometry, ..truth_sample(Some(RIGHT), 40) },
        truth_sample(Some(LEFT), 60),
    ];
    let bytes = recording_with_truth(&samples);
    assert_eq!(read_truth(&bytes).unwrap(), samples);
    assert_eq!(read_all(&bytes), sample());
    assert_eq!(read_truth(&write(&sample())).unwrap(), []);
}

#[test]
fn a_sample_that_names_a_robot_by_halves_or_with_no_id_is_an_error_that_says_so() {
    for (pair, other, expected) in [
        ("\"link\":300", "\"----\":300", "only all three"),
        ("\"system\":2", "\"------\":2", "only all three"),
        ("\"component\":200", "\"---------\":200", "only all three"),
        ("\"component\":200", "\"component\":256", "invalid value: integer `256`"),
    ] {
        let Err(ReadError::Truth { what, .. }) = read_truth(&damaged(pair, other)) else {
            panic!("{other} is taken");
        };
        assert!(what.contains(expected), "{what}");
    }
}
