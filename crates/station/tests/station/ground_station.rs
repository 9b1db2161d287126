//! Links for ground stations: two senders, two sequences without a gap, and silence without a robot.

use std::collections::BTreeMap;

use crate::signing::{SigningBrick, signing};
use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, STATION, TestStation, at, config, link, stream, ticks};
use posebridge_protocol::dialect::{PayloadError, decode, ids};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind};
use posebridge_protocol::message::{CommandLong, Message, OdometryPose, SetMessageInterval, WireStamp};
use posebridge_station::{AnnouncedAs, OutputKind, StationConfig};
use posebridge_telemetry::{Address, HostClock, LinkId, Meters, Priority, Recipients, TimeDelta, Timestamp};

const CAMERA: Address = Address::new(1, 100);

/// A robot's link, and one for ground stations.
fn two_links() -> StationConfig {
    let mut config = config();
    let mut gcs = link(
        GCS_LINK,
        vec![
            stream(OutputKind::Attitude, 100),
            stream(OutputKind::Odometry, 100),
            stream(OutputKind::DistanceSensor, 0),
        ],
    );
    gcs.announced_as = AnnouncedAs::StationAndVehicle;
    config.links.push(gcs);
    config
}

/// The messages that a ground station receives.
#[derive(Default)]
struct ReceivedFrames {
    messages: Vec<(Timestamp<HostClock>, Address, Message)>,
    /// Frames and missing ones of each sender.
    senders: BTreeMap<Address, (u8, u32, u32)>,
    unknown: u32,
    signed: u32,
}

impl ReceivedFrames {
    fn on(station: &TestStation, id: LinkId) -> Self {
        let mut received = Self::default();
        for sent in station.sent().filter(|sent| sent.link == id) {
            assert_eq!(sent.to, Recipients::All, "or the others would miss it");
            received.push(sent.now, sent.bytes);
        }
        received
    }

    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8]) {
        self.signed += u32::from(bytes[2] & 1);
        let mut framer = Framer::new(FramerConfig { transport: TransportKind::Datagram, ..FramerConfig::default() });
        let mut found = 0;
        framer.push(Timestamp::ZERO, bytes, &mut |scanned| {
            found += 1;
            let frame = match scanned {
                FramerOutput::Frame(frame) => frame,
                FramerOutput::UnknownFrame(frame) => {
                    self.unknown += 1;
                    frame
                }
                FramerOutput::Error(defect) => panic!("{defect:?}"),
            };
            let fresh = (frame.sequence.wrapping_sub(1), 0, 0);
            let (last, frames, lost) = self.senders.entry(frame.source).or_insert(fresh);
            *lost += u32::from(frame.sequence.wrapping_sub(*last).wrapping_sub(1));
            *last = frame.sequence;
            *frames += 1;
            let message = match decode(&frame) {
                // Before the first fix an ODOMETRY is marked as none.
                Err(PayloadError::SenderFailed { .. }) => None,
                other => other.expect("the station makes sense"),
            };
            self.messages.extend(message.map(|message| (now, frame.source, message)));
        });
        assert_eq!(found, 1, "one frame at a time");
    }

    /// When a source sent a message of a kind, in milliseconds.
    fn times(&self, source: Address, is_it: impl Fn(&Message) -> bool) -> Vec<i64> {
        let received = self.messages.iter();
        let received = received.filter(|(_, from, message)| *from == source && is_it(message));
        received.map(|(now, _, _)| now.as_micros() / 1_000).collect()
    }

    /// The lines for people.
    fn texts(&self) -> Vec<&str> {
        let received = self.messages.iter();
        let texts = received.filter_map(|(_, _, message)| match message {
            Message::StatusText { text, .. } => Some(text.as_str()),
            _ => None,
        });
        texts.collect()
    }

    fn lost(&self, source: Address) -> u32 {
        self.senders[&source].2
    }
}

fn is_beat(message: &Message) -> bool {
    matches!(message, Message::Heartbeat(_))
}

fn is_attitude(message: &Message) -> bool {
    matches!(message, Message::Attitude { .. })
}

/// A frame of no dialect with CRC_EXTRA 5.
fn unknown(sequence: u8) -> Vec<u8> {
    let mut frame = vec![0xFD, 2, 0, 0, sequence, 1, 1, 0x60, 0xEA, 0x00, 7, 8];
    let sum = posebridge_protocol::framing::checksum(&frame[1..], 5);
    frame.extend_from_slice(&sum.to_le_bytes());
    frame
}

/// A brick that drives from `from_ms` on for as long, at 20 Hz, with a heartbeat and an unknown message each second.
fn drive(station: &mut TestStation, brick: &mut RemotePeer, from_ms: u32, millis: u32) {
    for now_ms in (from_ms..from_ms + millis).step_by(50) {
        let now = at(i64::from(now_ms));
        station.pass_until(now);
        if now_ms % 1_000 == 0 {
            brick.send(station, now, &HEARTBEAT);
            let sequence = brick.frame(&HEARTBEAT)[4];
            brick.send_bytes(station, now, &unknown(sequence));
        }
        let count = i64::from(now_ms / 50);
        brick.send(station, now, &ticks(now_ms, count, count));
    }
}

#[test]
fn the_brick_and_we_share_one_count_without_a_gap() {
    let mut station = TestStation::new(&two_links());
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    // Its count does not begin at 0, and it is known for the robot only by its telemetry.
    for _ in 0..70 {
        brick.frame(&HEARTBEAT);
    }
    drive(&mut station, &mut brick, 0, 20_000);
    let received = ReceivedFrames::on(&station, GCS_LINK);
    println!("{:?}", received.senders);
    for source in [BRICK, STATION] {
        assert_eq!(received.lost(source), 0, "{source}");
    }
    assert!(received.times(BRICK, is_attitude).len() > 150);
    assert_eq!(received.times(STATION, is_attitude), Vec::<i64>::new());
    assert_eq!(received.unknown, 20, "none was dropped");
    let wheels = |message: &Message| matches!(message, Message::WheelTicks(_));
    assert_eq!(received.times(BRICK, wheels).len(), 400);
    // The brick's heartbeat is its own; ours would double it.
    assert_eq!(received.times(BRICK, is_beat).len(), 20);
    assert!(received.times(STATION, is_beat).len() >= 18);
    let floor = received.messages.iter().filter(
        |(_, _, message)| matches!(message, Message::Odometry(odometry) if matches!(odometry.pose, OdometryPose::Odom(_))),
    );
    assert!(floor.count() > 150);
}

#[test]
fn a_lost_robot_sends_no_heartbeats_and_its_loss_is_reported() {
    let mut config = two_links();
    config.robot_system = Some(BRICK.system);
    let mut station = TestStation::new(&config);
    let mut brick = RemotePeer::new(Address::new(1, 25), LINK, 0);
    station.pass_until(at(3_000));
    drive(&mut station, &mut brick, 3_000, 4_000);
    station.pass_until(at(20_000));
    drive(&mut station, &mut brick, 20_000, 3_000);
    let received = ReceivedFrames::on(&station, GCS_LINK);
    // Last received at 6.95 s, lost 5 s later.
    for source in [BRICK, STATION] {
        let beats = received.times(source, is_beat);
        println!("{source} {beats:?}");
        assert!(beats.iter().all(|at| (3_000..12_000).contains(at) || *at >= 20_000));
        assert!(beats.iter().any(|at| *at < 5_100) && beats.iter().any(|at| *at >= 20_000));
        assert_eq!(received.lost(source), 0, "{source}");
    }
    let texts = received.texts();
    assert!(texts.contains(&"robot 3/1/25 lost: silent for 5.0 s; look at its b"), "{texts:?}");
    assert!(texts.contains(&"robot 3/1/25 detected again"), "{texts:?}");
    // On the robot's own link the station is present all the time: a peer may wait for it.
    assert!(ReceivedFrames::on(&station, LINK).times(STATION, is_beat).len() >= 22);
}

#[test]
fn a_range_is_sent_once_by_the_robot_or_for_it() {
    let range =
        |millis| Message::DistanceSensor { stamp: WireStamp::Millis32(millis), range: Meters(1.25), sigma: None };
    let is_range = |message: &Message| matches!(message, Message::DistanceSensor { .. });
    // Of component 1 the frames themselves are the vehicle's; of another component they would be ignored.
    for address in [BRICK, Address::new(1, 25)] {
        let mut station = TestStation::new(&two_links());
        let mut brick = RemotePeer::new(address, LINK, 0);
        drive(&mut station, &mut brick, 0, 1_000);
        let before = ReceivedFrames::on(&station, GCS_LINK).times(BRICK, is_range).len();
        assert_eq!(before, 0);
        for step in 0..10_u32 {
            let millis = 1_000 + step * 100;
            brick.send(&mut station, at(i64::from(millis)), &range(millis));
        }
        let received = ReceivedFrames::on(&station, GCS_LINK);
        let theirs = received.times(address, is_range).len();
        let as_vehicle = received.times(BRICK, is_range).len();
        assert!(theirs >= 10, "{address}: what the robot says is passed on");
        // The very first may leave twice: that the robot sends it is known once it has been forwarded.
        assert!((10..=11).contains(&as_vehicle), "{address}: {as_vehicle}");
        assert_eq!(received.lost(BRICK), 0, "{address}");
    }
}

#[test]
fn commands_about_messages_that_we_send_for_the_robot_are_ours_and_all_others_its_own() {
    let mut station = TestStation::new(&two_links());
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    drive(&mut station, &mut brick, 0, 2_000);
    let interval = |message_id| {
        Message::SetMessageInterval(SetMessageInterval {
            target: BRICK,
            message_id,
            interval: Some(TimeDelta::from_millis(500)),
        })
    };
    let to_brick = |passed: &[(LinkId, Recipients, Priority)]| passed.iter().any(|(link, _, _)| *link == LINK);
    let passed = gcs.send(&mut station, at(2_000), &interval(ids::ATTITUDE));
    assert!(!to_brick(&passed), "the brick would refuse it");
    let passed = gcs.send(&mut station, at(2_001), &interval(ids::PB_WHEEL_TICKS));
    assert!(to_brick(&passed));
    let any = Message::Command(CommandLong { target: BRICK, command: 400, params: [0.0; 7] });
    let passed = gcs.send(&mut station, at(2_002), &any);
    assert!(to_brick(&passed));
    let received = ReceivedFrames::on(&station, GCS_LINK);
    let acks = received.times(BRICK, |message| matches!(message, Message::CommandAck(_)));
    assert_eq!(acks, [2_000], "one answer, to what was ours");
    drive(&mut station, &mut brick, 2_050, 3_000);
    let attitudes = ReceivedFrames::on(&station, GCS_LINK).times(BRICK, is_attitude);
    assert_eq!(attitudes.iter().filter(|at| **at > 2_000).count(), 6);
}

/// A frame of the robot that went out on a ground station's link and comes back by a third one goes nowhere.
#[test]
fn a_ring_brings_nothing_round_twice() {
    let mut config = two_links();
    config.links.push(link(LinkId(7), vec![]));
    let mut station = TestStation::new(&config);
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    drive(&mut station, &mut brick, 0, 2_000);
    let on_link = station.sent().filter(|sent| sent.link == GCS_LINK);
    let sent: Vec<Vec<u8>> = on_link.map(|sent| sent.bytes.to_vec()).collect();
    assert!(sent.len() > 50);
    let first_output = station.outputs.len();
    let stranger = RemotePeer::new(BRICK, LinkId(7), 0);
    for bytes in &sent {
        stranger.send_bytes(&mut station, at(2_010), bytes);
    }
    let again = station
        .sent_since(first_output)
        .filter(|again| again.bytes[6] == 1 && sent.iter().any(|sent| sent == again.bytes));
    assert_eq!(again.count(), 0);
}

/// Not all messages of a robot and the camera beside it are for ground stations; what is missing there must not look like a loss, with a key
/// on the link or without.
#[test]
fn frames_for_the_station_alone_are_no_loss_to_others() {
    for key in [None, Some(signing(7, 1))] {
        let mut config = two_links();
        let has_key = key.is_some();
        config.links[1].signing = key;
        let mut station = TestStation::new(&config);
        let mut brick = RemotePeer::new(BRICK, LINK, 0);
        let mut camera = RemotePeer::new(CAMERA, LINK, 0);
        let for_us = Message::Command(CommandLong { target: STATION, command: 400, params: [0.0; 7] });
        for second in 0..8 {
            drive(&mut station, &mut brick, 1_000 * second, 1_000);
            let now = at(i64::from(1_000 * second) + 970);
            assert_eq!(brick.send(&mut station, now, &for_us), []);
            camera.send(&mut station, now, &for_us);
            camera.send(&mut station, now, &HEARTBEAT);
        }
        let received = ReceivedFrames::on(&station, GCS_LINK);
        println!("{:?}", received.senders);
        for (source, frames) in [(BRICK, 160), (STATION, 50), (CAMERA, 7)] {
            let (_, found, lost) = received.senders[&source];
            assert_eq!(lost, 0, "{source}");
            assert!(found >= frames, "{source}: {found}");
        }
        // Beside frames that the robot does not sign nothing is signed as the robot.
        let attitudes = |source| received.times(source, is_attitude).len();
        let (of_brick, of_station) = (attitudes(BRICK), attitudes(STATION));
        assert_eq!(of_brick > 50, !has_key, "{of_brick}");
        assert_eq!(of_station > 50, has_key, "{of_station}");
        let ours = received.senders[&STATION].1;
        assert_eq!(received.signed, if has_key { ours } else { 0 });
    }
}

#[test]
fn signed_frames_are_never_touched_and_silence_us() {
    let mut station = TestStation::new(&two_links());
    let mut brick = SigningBrick::with_key(7);
    let voice = RemotePeer::new(BRICK, LINK, 0);
    let mut sent = Vec::new();
    for step in 0..60_u32 {
        let now = at(i64::from(step * 50));
        station.pass_until(now);
        let message = if step % 20 == 0 { HEARTBEAT } else { ticks(step * 50, 0, 0) };
        let bytes = brick.frame(now, &message);
        voice.send_bytes(&mut station, now, &bytes);
        sent.push(bytes);
    }
    let passed = station.sent().filter(|sent| sent.link == GCS_LINK && sent.bytes[6] == 1);
    let passed: Vec<&[u8]> = passed.map(|sent| sent.bytes).collect();
    assert!(passed == sent, "byte for byte, and nothing of ours between");
}
