//! Two robots with the same ids behind one port: ground stations see the second under another system, in all that it says, and what they
//! say to that system reaches it.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the frames that they are about"
)]
#![expect(dead_code, reason = "the helpers are shared with tests that need others of them")]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/network.rs"]
mod network;
#[path = "support/station.rs"]
mod station;

use brick::{BRICK, HEARTBEAT, ticks};
use network::{RemotePeer, passed_on};
use posebridge_protocol::dialect;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, checksum};
use posebridge_protocol::message::{Message, TextPart};
use posebridge_station::{AnnouncedAs, LinkConfig, OutputKind};
use posebridge_telemetry::{Address, Event, LinkId, Output, PeerId, Recipients, TimeDelta, Timestamp};
use station::{LINK, TestStation, at, config, link, stream};

const GCS_LINK: LinkId = LinkId(5);
const GCS: Address = Address::new(254, 190);
/// How ground stations see the second robot.
const SECOND: Address = Address::new(2, 1);
const SIGNED: u8 = 1;

struct TwoRobotSetup {
    station: TestStation,
    robots: [RemotePeer; 2],
    gcs: RemotePeer,
    now_ms: u32,
}

impl TwoRobotSetup {
    /// Both robots are known.
    fn new() -> Self {
        let mut config = config();
        config.links.push(LinkConfig {
            announced_as: AnnouncedAs::StationAndVehicle,
            ..link(GCS_LINK, vec![stream(OutputKind::Attitude, 0)])
        });
        let robots = [0, 1].map(|peer| RemotePeer::new(BRICK, LINK, peer));
        let gcs = RemotePeer::new(GCS, GCS_LINK, 0);
        let mut setup = Self { station: TestStation::new(&config), robots, gcs, now_ms: 100 };
        setup.gcs.send(&mut setup.station, at(50), &HEARTBEAT);
        for _ in 0..5 {
            setup.drive();
        }
        assert_eq!(setup.station.engine.robots().len(), 2);
        setup
    }

    /// Both robots tell their wheels, one after the other.
    fn drive(&mut self) {
        for robot in 0..2 {
            let counts = i64::from(1_000 * robot as u32 + self.now_ms);
            self.send(robot, &ticks(self.now_ms, counts, counts));
        }
        self.now_ms += 50;
    }

    fn send(&mut self, robot: usize, message: &Message) {
        let now = at(i64::from(self.now_ms) + 10 * robot as i64);
        self.robots[robot].send(&mut self.station, now, message);
    }

    /// The frames that were sent on a link since `seen` outputs: recipients, sender, message and target.
    fn frames_since(&self, seen: usize, on: LinkId) -> Vec<(Recipients, Address, Message)> {
        let mut frames = Vec::new();
        for (now, output) in &self.station.outputs[seen..] {
            if let Output::Transmit { link, to, bytes, .. } = output
                && *link == on
            {
                Framer::new(FramerConfig::default()).push(*now, bytes, &mut |found| match found {
                    FramerOutput::Frame(frame) => {
                        let message = dialect::decode(&frame).expect("it makes sense");
                        frames.extend(message.map(|message| (*to, frame.source, message)));
                    }
                    _ => panic!("a frame is damaged"),
                });
            }
        }
        frames
    }

    fn drops(&mut self) -> u64 {
        let until: Timestamp<_> = at(i64::from(self.now_ms)) + TimeDelta::from_millis(1_500);
        self.station.pass_until(until);
        let dropped = self.station.events().filter_map(|event| match event {
            Event::Health { link: GCS_LINK, health, .. } => Some(health.drops_out),
            _ => None,
        });
        dropped.last().expect("a second has passed")
    }
}

#[test]
fn every_frame_of_the_second_robot_bears_the_system_that_is_announced() {
    let mut setup = TwoRobotSetup::new();
    let seen = setup.station.outputs.len();
    let text = |words: &str| Message::StatusText { severity: 4, text: words.to_owned(), part: TextPart::default() };
    setup.send(0, &text("first"));
    setup.send(1, &text("second"));
    setup.drive();
    let frames = setup.frames_since(seen, GCS_LINK);
    let sent = |wanted: Message| {
        frames.iter().filter(|(_, _, message)| *message == wanted).map(|(_, from, _)| *from).collect::<Vec<_>>()
    };
    assert_eq!(sent(text("first")), [BRICK]);
    assert_eq!(sent(text("second")), [SECOND]);
    let wheels = frames.iter().filter(|(_, _, message)| matches!(message, Message::WheelTicks(_)));
    assert_eq!(wheels.map(|(_, from, _)| *from).collect::<Vec<_>>(), [BRICK, SECOND]);
}

#[test]
fn what_is_said_to_one_of_two_robots_with_the_same_ids_reaches_that_one_under_its_own_ids() {
    let mut setup = TwoRobotSetup::new();
    for (target, peer) in [(BRICK, 0), (SECOND, 1)] {
        let seen = setup.station.outputs.len();
        setup.gcs.send(&mut setup.station, at(400), &Message::ParamRequestList { target });
        let expected = (Recipients::Peer(PeerId(peer)), GCS, Message::ParamRequestList { target: BRICK });
        let frames = setup.frames_since(seen, LINK).into_iter().filter(|(_, from, _)| *from == GCS);
        assert_eq!(frames.collect::<Vec<_>>(), [expected], "{target}");
    }
}

#[test]
fn a_signed_frame_that_would_have_to_be_changed_is_dropped_and_counted() {
    let mut setup = TwoRobotSetup::new();
    let before = setup.drops();
    let seen = setup.station.outputs.len();
    let mut bytes = setup.robots[1].frame(&HEARTBEAT);
    let end = bytes.len() - 2;
    bytes[2] |= SIGNED;
    // 50 is HEARTBEAT's CRC_EXTRA in minimal.xml.
    let sum = checksum(&bytes[1..end], 50);
    bytes[end..].copy_from_slice(&sum.to_le_bytes());
    bytes.extend([7; 13]);
    setup.now_ms += 2_000;
    let now = at(i64::from(setup.now_ms));
    setup.robots[1].send_bytes(&mut setup.station, now, &bytes);
    // Ground stations would take it for another robot's, and other robots have no use for it.
    assert_eq!(passed_on(&setup.station, seen, &bytes), []);
    assert_eq!(setup.drops(), before + 1);
}
