//! The recording's promises: the same inputs come back bit for bit, a cut or a crash costs only what was not flushed,
//! and damage is named and never replayed.

#![expect(
    clippy::unwrap_used,
    reason = "helpers outside the test functions may fail loudly as well"
)]

use std::cell::RefCell;
use std::io::{Cursor, Result as IoResult, Seek, SeekFrom, Write};
use std::rc::Rc;

use posebridge_recording::container::{
    Ending, FORMAT, Header, INPUT_ENCODING, INPUT_TOPIC, ReadError, Reader, WriteError, Writer,
};
use posebridge_telemetry::{
    BeaconId, Celsius, Command, Fix, Heading, HostClock, Input, LandmarkId, LinkId, LinkState,
    Meters, MetersPerSecond, MetersPerSecondSquared, Observation, Observed, Point2, Pose,
    PositionCovariance, Radians, RadiansPerSecond, SensorId, Span, Stamp,
};
use proptest::prelude::*;

type Recorded = (Stamp<HostClock>, Input);

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
    let covariance = PositionCovariance {
        xx_m2: 1e-4,
        xy_m2: -2e-5,
        yy_m2: 3e-4,
        heading_rad2: f64::INFINITY,
    };
    vec![
        Observed::WheelAngles {
            left: Radians(-1e6),
            right: Radians(0.5),
        },
        Observed::OdometerPose(Pose::new(
            Meters(0.0),
            Meters(-0.0),
            Heading::from_rad(-3.0),
        )),
        Observed::BodyVelocity {
            forward: MetersPerSecond(0.3),
            turn: RadiansPerSecond(-2.0),
        },
        Observed::TurnRate(RadiansPerSecond(0.01)),
        Observed::WheelAccelerations {
            left: MetersPerSecondSquared(9.81),
            right: MetersPerSecondSquared(-9.81),
        },
        Observed::Fix(fix),
        Observed::Fix(Fix {
            heading: Some(Heading::from_rad(std::f64::consts::PI)),
            covariance: Some(covariance),
            ..fix
        }),
        Observed::Landmark {
            id: LandmarkId(90),
            range: Meters(3.7),
            bearing: Radians(-0.2),
        },
        Observed::BeaconRange {
            id: BeaconId(u32::MAX),
            range: Meters(65.4),
        },
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
        Input::Bytes {
            peer: posebridge_telemetry::PeerId(0),
            link,
            bytes: vec![0xFD, 0, 0xFF],
        },
        Input::Bytes {
            peer: posebridge_telemetry::PeerId(70_000),
            link,
            bytes: Vec::new(),
        },
        Input::Link {
            link,
            state: LinkState::Up,
        },
        Input::Link {
            link,
            state: LinkState::Down,
        },
        Input::Command(Command::SetPose {
            pose: pose(),
            position_sigma_m: 0.01,
            heading_sigma_rad: 0.1,
        }),
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
    let messages: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(messages.len(), sample().len());
    for (message, (now, _)) in messages.iter().zip(sample()) {
        assert_eq!(message.log_time, now.as_nanos() as u64);
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
        assert!(
            matches!(reader.ending(), Ending::Torn { .. }),
            "cut at {cut}"
        );
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
    let whole = bytes.len() / 2;
    let zeroed = [&bytes[..whole], &[0; 4096]].concat();
    let found: Vec<_> = Reader::open(&zeroed).unwrap().collect();
    let (last, before) = found.split_last().unwrap();
    assert!(before.iter().all(Result::is_ok));
    // The record that was being written may have its length but zeros for its content.
    assert!(last.is_ok() || matches!(last, Err(ReadError::Message { .. })));
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
fn a_flipped_bit_never_becomes_another_input() {
    let items = sample();
    let bytes = write(&items);
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        let Ok(reader) = Reader::open(&damaged) else {
            continue;
        };
        let mut rest = items.iter();
        for found in reader.flatten() {
            assert!(rest.any(|item| *item == found), "byte {at} gave {found:?}");
        }
    }
}

#[test]
fn a_damaged_message_is_named_by_its_offset_and_the_next_one_follows() {
    let items: Vec<Recorded> = (0..5)
        .map(|n| (Stamp::from_millis(n), Input::Tick))
        .collect();
    let bytes = write(&items);
    let record = 9 + 22 + 6; // opcode and length, message header, version + tag + checksum
    let first = bytes
        .windows(9)
        .position(|head| head == [5, 28, 0, 0, 0, 0, 0, 0, 0])
        .unwrap();
    let mut damaged = bytes;
    damaged[first + 2 * record + 9 + 22 + 1] ^= 1;
    let found: Vec<_> = Reader::open(&damaged).unwrap().collect();
    assert_eq!(found.len(), 5);
    let Err(ReadError::Message { offset, .. }) = &found[2] else {
        panic!("{:?}", found[2]);
    };
    assert_eq!(*offset, (first + 2 * record) as u64);
    assert!(found.iter().filter(|item| item.is_ok()).count() == 4);
}

#[test]
fn a_missing_message_is_a_gap() {
    let items: Vec<Recorded> = (0..4)
        .map(|n| (Stamp::from_millis(n), Input::Tick))
        .collect();
    let mut bytes = write(&items);
    let record = 9 + 22 + 6;
    let first = bytes
        .windows(9)
        .position(|head| head == [5, 28, 0, 0, 0, 0, 0, 0, 0])
        .unwrap();
    bytes.drain(first + record..first + 2 * record);
    let found: Vec<_> = Reader::open(&bytes).unwrap().collect();
    assert_eq!(
        found[1],
        Err(ReadError::Gap {
            offset: (first + record) as u64,
            expected: 1,
            found: 2
        })
    );
    assert_eq!(found[2], Ok(items[2].clone()));
    assert_eq!(found.len(), 4);
}

#[test]
fn destroyed_framing_is_an_error_that_ends_the_iteration() {
    let mut bytes = write(&sample());
    let at = bytes.len() / 2;
    let head = (0..at)
        .rev()
        .find(|n| bytes[*n] == 5 && bytes[*n + 3..*n + 9] == [0; 6])
        .unwrap();
    bytes[head] = 0;
    let found: Vec<_> = Reader::open(&bytes).unwrap().collect();
    let Some(Err(ReadError::Damaged { offset, .. })) = found.last() else {
        panic!("{:?}", found.last());
    };
    assert_eq!(*offset, head as u64);
}

#[test]
fn without_the_record_of_the_channel_the_messages_are_not_silently_skipped() {
    let mut bytes = write(&sample());
    let topic = INPUT_TOPIC.as_bytes();
    let at = bytes
        .windows(topic.len())
        .position(|text| text == topic)
        .unwrap();
    bytes[at] ^= 1;
    let found: Vec<_> = Reader::open(&bytes).unwrap().collect();
    assert!(matches!(found.as_slice(), [Err(ReadError::Damaged { .. })]));
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
    let newer = Header {
        format: FORMAT + 1,
        ..header()
    };
    let writer = Writer::create(Cursor::new(Vec::new()), &newer).unwrap();
    let newer = writer.finish().unwrap().into_inner();
    let error = Reader::open(&newer).unwrap_err();
    assert_eq!(error, ReadError::Format { found: FORMAT + 1 });
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
}

fn any_f64() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits)
}

fn any_heading() -> impl Strategy<Value = Heading> {
    any_f64().prop_map(Heading::from_rad)
}

fn any_observed() -> impl Strategy<Value = Observed> {
    let pair = || (any_f64(), any_f64());
    prop_oneof![
        pair().prop_map(|(l, r)| Observed::WheelAngles {
            left: Radians(l),
            right: Radians(r)
        }),
        (any_f64(), any_f64(), any_heading()).prop_map(|(x, y, heading)| Observed::OdometerPose(
            Pose::new(Meters(x), Meters(y), heading)
        )),
        any_f64().prop_map(|rate| Observed::TurnRate(RadiansPerSecond(rate))),
        any_heading().prop_map(Observed::CompassHeading),
        (any::<u32>(), pair()).prop_map(|(id, (range, bearing))| Observed::Landmark {
            id: LandmarkId(id),
            range: Meters(range),
            bearing: Radians(bearing)
        }),
        (
            pair(),
            proptest::option::of(any_heading()),
            proptest::option::of([any_f64(), any_f64(), any_f64(), any_f64()]),
            any::<u8>()
        )
            .prop_map(
                |((x, y), heading, covariance, reset_counter)| Observed::Fix(Fix {
                    position: Point2::new(Meters(x), Meters(y)),
                    heading,
                    covariance: covariance.map(|[xx_m2, xy_m2, yy_m2, heading_rad2]| {
                        PositionCovariance {
                            xx_m2,
                            xy_m2,
                            yy_m2,
                            heading_rad2,
                        }
                    }),
                    tag_in_body: Point2::new(Meters(y), Meters(x)),
                    reset_counter,
                })
            ),
    ]
}

fn any_input() -> impl Strategy<Value = Input> {
    prop_oneof![
        (any::<u16>(), proptest::collection::vec(any::<u8>(), 0..300)).prop_map(|(link, bytes)| {
            Input::Bytes {
                peer: posebridge_telemetry::PeerId(0),
                link: LinkId(link),
                bytes,
            }
        }),
        Just(Input::Tick),
        (any::<u8>(), any::<i64>(), any::<i64>(), any_observed()).prop_map(
            |(sensor, stamp, sigma, observed)| {
                Input::Observation(Observation {
                    sensor: SensorId(sensor),
                    stamp: Stamp::from_nanos(stamp),
                    stamp_sigma: Span::from_nanos(sigma),
                    observed,
                })
            }
        ),
        (any_f64(), any_f64(), any_heading()).prop_map(|(x, y, heading)| {
            Input::Command(Command::SetPose {
                pose: Pose::new(Meters(x), Meters(y), heading),
                position_sigma_m: y,
                heading_sigma_rad: x,
            })
        }),
    ]
}

proptest! {
    #[test]
    fn any_inputs_come_back_bit_for_bit(
        items in proptest::collection::vec((0_i64..i64::MAX, any_input()), 0..20)
    ) {
        let items: Vec<Recorded> = items
            .into_iter()
            .map(|(nanos, input)| (Stamp::from_nanos(nanos), input))
            .collect();
        let bytes = write(&items);
        let found = good(&bytes);
        prop_assert_eq!(found.len(), items.len());
        // Compared through a second file, because NaN does not equal itself.
        prop_assert_eq!(write(&found), bytes);
    }

    #[test]
    fn random_bytes_never_panic(tail in proptest::collection::vec(any::<u8>(), 0..400)) {
        let mut after_magic = mcap::MAGIC.to_vec();
        after_magic.extend_from_slice(&tail);
        let mut after_header = write(&[]);
        after_header.truncate(after_header.len() / 2);
        after_header.extend_from_slice(&tail);
        for bytes in [&tail, &after_magic, &after_header] {
            if let Ok(reader) = Reader::open(bytes) {
                let read = reader.take(1000).count();
                prop_assert!(read < 1000);
            }
        }
    }

    #[test]
    fn random_damage_never_panics(
        hits in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..8)
    ) {
        let mut bytes = write(&sample());
        for (index, value) in hits {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(reader) = Reader::open(&bytes) {
            let read = reader.take(1000).count();
            prop_assert!(read < 1000);
        }
    }
}
