//! The recording's promises: the same inputs come back bit for bit, a cut or a crash costs only what was not flushed,
//! and damage is named and never replayed.

#![expect(clippy::unwrap_used, reason = "helpers outside the test functions may fail loudly as well")]

mod damage;
mod older;
mod properties;

use std::cell::RefCell;
use std::io::{Cursor, Result as IoResult, Seek, SeekFrom, Write};
use std::rc::Rc;

use posebridge_recording::container::{
    Beginning, Ending, FORMAT, Header, INPUT_ENCODING, INPUT_TOPIC, ReadError, Reader, TruthSample, WriteError, Writer,
    truth,
};
use posebridge_telemetry::{
    BeaconId, Celsius, Command, Fix, Heading, HostClock, Input, LandmarkId, LinkId, LinkState, Meters, MetersPerSecond,
    MetersPerSecondSquared, Observation, Observed, ParameterName, Point2, Pose, PositionCovariance, Radians,
    RadiansPerSecond, SensorId, Span, Stamp, Switch,
};

type Recorded = (Stamp<HostClock>, Input);

const UTC_START_NANOS: u64 = 1_700_000_000_123_456_000;

fn header() -> Header {
    Header {
        format: FORMAT,
        program_version: "0.1.0".to_owned(),
        utc_start_micros: 1_700_000_000_123_456,
        config_toml: "[robot]\nname = \"Döner \\\"7\\\"\"\n".to_owned(),
        links: vec!["sim://square".to_owned(), "udp://:14550".to_owned()],
    }
}

fn every_observed() -> Vec<Observed> {
    let fix = Fix {
        position: Point2::new(Meters(0.1), Meters(0.2)),
        heading: None,
        covariance: None,
        tag_in_body: Point2::new(Meters(0.03), Meters(0.0)),
        reset_counter: 3,
    };
    let covariance = PositionCovariance { xx_m2: 1e-4, xy_m2: -2e-5, yy_m2: 3e-4, heading_rad2: f64::INFINITY };
    vec![
        Observed::WheelAngles { left: Radians(-1e6), right: Radians(0.5) },
        Observed::OdometerPose(Pose::new(Meters(0.0), Meters(-0.0), Heading::from_rad(-3.0))),
        Observed::BodyVelocity { forward: MetersPerSecond(0.3), turn: RadiansPerSecond(-2.0) },
        Observed::TurnRate(RadiansPerSecond(0.01)),
        Observed::WheelAccelerations { left: MetersPerSecondSquared(9.81), right: MetersPerSecondSquared(-9.81) },
        Observed::Fix(fix),
        Observed::Fix(Fix {
            heading: Some(Heading::from_rad(std::f64::consts::PI)),
            covariance: Some(covariance),
            ..fix
        }),
        Observed::Landmark { id: LandmarkId(90), range: Meters(3.7), bearing: Radians(-0.2) },
        Observed::BeaconRange { id: BeaconId(u32::MAX), range: Meters(65.4) },
        Observed::WallRange(Meters(0.443)),
        Observed::CompassHeading(Heading::from_rad(1.0)),
        Observed::Temperature(Celsius(-273.15)),
    ]
}

/// One of every kind of input.
fn every_kind() -> Vec<Input> {
    let pose = || Pose::new(Meters(1.5), Meters(-0.25), Heading::from_rad(3.0));
    let observation = |observed| {
        Input::Observation(Observation {
            sensor: SensorId(200),
            stamp: Stamp::from_nanos(i64::MIN),
            stamp_sigma: Span::from_nanos(i64::MAX),
            observed,
        })
    };
    let link = LinkId(u16::MAX);
    let mut inputs: Vec<Input> = every_observed().into_iter().map(observation).collect();
    inputs.extend([
        Input::Bytes { peer: posebridge_telemetry::PeerId(0), link, bytes: vec![0xFD, 0, 0xFF] },
        Input::Bytes { peer: posebridge_telemetry::PeerId(70_000), link, bytes: Vec::new() },
        Input::Link { link, state: LinkState::Up },
        Input::Link { link, state: LinkState::Down },
        Input::Command(Command::SetPose { pose: pose(), position_sigma_m: 0.01, heading_sigma_rad: 0.1 }),
        Input::Command(Command::SetParameter { name: ParameterName::from_bytes(b"gate_prob"), value: 0.9 }),
        Input::Command(Command::SwitchSource { sensor: SensorId::CAMERA, to: Switch::Off }),
        Input::Command(Command::ResetPose),
        Input::Report { severity: 6, text: "saved".to_owned() },
        Input::Tick,
    ]);
    inputs
}

fn sample() -> Vec<Recorded> {
    let stamps = (0..).map(|n| Stamp::from_millis(20 * n));
    stamps.zip(every_kind()).collect()
}

fn write(items: &[Recorded]) -> Vec<u8> {
    let mut writer = Writer::create(Cursor::new(Vec::new()), &header()).unwrap();
    for (now, input) in items {
        writer.record(*now, input).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn good(bytes: &[u8]) -> Vec<Recorded> {
    let reader = Reader::open(bytes).unwrap();
    reader.map(Result::unwrap).collect()
}

/// Where the record of the input with this number begins: opcode, length, the inputs' channel, the number.
fn record_of(bytes: &[u8], number: u8) -> usize {
    bytes.windows(15).position(|head| head[0] == 5 && head[9..] == [1, 0, number, 0, 0, 0]).unwrap()
}

#[test]
fn every_kind_of_input_comes_back() {
    let bytes = write(&sample());
    let reader = Reader::open(&bytes).unwrap();
    assert_eq!(reader.header(), &header());
    assert_eq!(reader.ending(), Ending::Complete);
    assert_eq!(good(&bytes), sample());
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
        let Ok(reader) = Reader::open(&bytes[..cut]) else {
            assert_eq!(longest, 0, "cut at {cut}: the header was readable before");
            continue;
        };
        assert!(matches!(reader.ending(), Ending::Torn { .. }), "cut at {cut}");
        let found = good(&bytes[..cut]);
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
    let found: Vec<_> = Reader::open(&zeroed).unwrap().collect();
    // The chunk that was being written has its length but zeros for its end, and the record in it as well.
    let is_expected = |item: &Result<Recorded, ReadError>| match item {
        Ok(_) | Err(ReadError::Chunk { .. } | ReadError::Message { .. }) => true,
        Err(_) => false,
    };
    assert!(found.iter().all(is_expected), "{found:?}");
    let good: Vec<Recorded> = found.into_iter().flatten().collect();
    assert_eq!(good, sample()[..9]);
    let torn = Reader::open(&zeroed).unwrap().ending();
    assert!(matches!(torn, Ending::Torn { .. }), "{torn:?}");
}

/// A file that others can look into while it is written, as the kernel would after `kill -9`.
#[derive(Clone, Default)]
struct Disk(Rc<RefCell<Cursor<Vec<u8>>>>);

impl Disk {
    fn content(&self) -> Vec<u8> {
        self.0.borrow().get_ref().clone()
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
        self.0.borrow_mut().write(bytes)
    }
    fn flush(&mut self) -> IoResult<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> IoResult<u64> {
        self.0.borrow_mut().seek(to)
    }
}

#[test]
fn what_was_flushed_survives_a_kill() {
    let disk = Disk::default();
    let mut writer = Writer::create(disk.clone(), &header()).unwrap();
    assert_eq!(good(&disk.content()), [], "the header is flushed at once");
    let items = sample();
    for (count, (now, input)) in items.iter().enumerate() {
        writer.record(*now, input).unwrap();
        writer.flush().unwrap();
        assert_eq!(good(&disk.content()), items[..=count]);
    }
}

#[test]
fn what_is_not_ours_is_refused_with_a_reason() {
    assert_eq!(Reader::open(b"").unwrap_err(), ReadError::NotMcap);
    assert_eq!(Reader::open(b"PK\x03\x04").unwrap_err(), ReadError::NotMcap);
    let mut other = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
    other.finish().unwrap();
    let other = other.into_inner().into_inner();
    let error = Reader::open(&other).unwrap_err();
    assert!(matches!(error, ReadError::NoHeader { .. }), "{error}");
    let newer = Header { format: FORMAT + 1, ..header() };
    let writer = Writer::create(Cursor::new(Vec::new()), &newer).unwrap();
    let newer = writer.finish().unwrap().into_inner();
    let error = Reader::open(&newer).unwrap_err();
    assert_eq!(error, ReadError::Format { found: FORMAT + 1 });
}

#[test]
fn without_the_record_of_the_channel_the_inputs_are_read_by_its_number() {
    let mut bytes = write(&sample());
    let topic = INPUT_TOPIC.as_bytes();
    let at = bytes.windows(topic.len()).position(|text| text == topic).unwrap();
    bytes[at] ^= 1;
    let found: Vec<_> = Reader::open(&bytes).unwrap().collect();
    let [Err(ReadError::Chunk { .. }), inputs @ ..] = &found[..] else {
        panic!("{found:?}");
    };
    assert_eq!(inputs.len(), sample().len());
    assert!(inputs.iter().all(Result::is_ok));
}

#[test]
fn a_later_part_says_what_it_continues_and_counts_on() {
    let begins = Beginning { part: 2, inputs_before: 1_000_000, continues: Some("recording.mcap".to_owned()) };
    let mut writer = Writer::create_part(Cursor::new(Vec::new()), &header(), &begins).unwrap();
    for (now, input) in sample() {
        writer.record(now, &input).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!(Reader::open(&bytes).unwrap().beginning(), &begins);
    assert_eq!(good(&bytes), sample());
    let whole = write(&sample());
    let begins = Reader::open(&whole).unwrap().beginning().clone();
    assert_eq!(begins, Beginning::default());
}

#[test]
fn the_truth_of_a_run_comes_back_and_is_no_input() {
    let samples: Vec<TruthSample> = (0..100)
        .map(|n| TruthSample {
            stamp: Stamp::from_millis(20 * n),
            pose: Pose::new(Meters(0.1 * n as f64), Meters(-0.3), Heading::from_rad(0.07 * n as f64)),
            odometry: (n % 2 == 0).then(|| Pose::new(Meters(0.11), Meters(1.0 / 3.0), Heading::from_rad(-1.0))),
        })
        .collect();
    let mut writer = Writer::create(Cursor::new(Vec::new()), &header()).unwrap();
    for (now, input) in sample() {
        writer.record(now, &input).unwrap();
    }
    writer.record_truth(Stamp::from_millis(2_000), &samples).unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!(good(&bytes), sample());
    let found = truth(&bytes).unwrap();
    assert_eq!(found.len(), samples.len());
    for (found, sample) in found.iter().zip(&samples) {
        assert_eq!(found.stamp, sample.stamp);
        assert!((found.pose.x.0 - sample.pose.x.0).abs() < 1e-12);
        assert!((found.pose.heading - sample.pose.heading).0.abs() < 1e-12);
        assert_eq!(found.odometry.is_some(), sample.odometry.is_some());
    }
    assert_eq!(truth(&write(&sample())).unwrap(), []);
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
    let found: Vec<_> = Reader::open(&bytes).unwrap().collect();
    let [Err(ReadError::Compressed { offset, compression })] = &found[..] else {
        panic!("{found:?}");
    };
    assert_eq!((*offset, compression.as_str()), (chunk as u64, "zstd"));
}

#[test]
fn an_instant_before_the_session_is_refused_and_the_next_one_is_not() {
    let mut writer = Writer::create(Cursor::new(Vec::new()), &header()).unwrap();
    let early = Stamp::from_nanos(-1);
    assert!(matches!(
        writer.record(early, &Input::Tick),
        Err(WriteError::NegativeTime(stamp)) if stamp == early
    ));
    writer.record(Stamp::ZERO, &Input::Tick).unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!(good(&bytes), [(Stamp::ZERO, Input::Tick)]);
    let late = Header { utc_start_micros: u64::MAX / 1_000, ..header() };
    let refused = Writer::create(Cursor::new(Vec::new()), &late).err();
    assert!(matches!(refused, Some(WriteError::StartTime(_))));
}
