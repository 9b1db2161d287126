//! Links whose brick has a protocol of its own, with a codec that is as simple as one can be: a request is one byte and
//! answers by three, its time in hundredths of a second and both counters.

use crate::support::{AlignedObservation, HEARTBEAT, LINK, TestStation, at, config, frame, link};
use posebridge_protocol::bricks::{BrickCodec, BrickProtocol, CodecEvent, CodecSettings, DEFAULT_BRICK_ADDRESS};
use posebridge_protocol::framing::FramerCounters;
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_station::{BrickLink, StationConfig};
use posebridge_telemetry::{
    Address, BrickClock, EncoderTicks, Event, HostClock, Input, LinkId, LinkState, ObservationKind, PeerId, Priority,
    ReceiveError, SourceHealth, TimeDelta, Timestamp,
};

/// The request.
const REQUEST: u8 = b'?';
/// An answer that is none.
const REFUSAL: u8 = b'!';
/// Between two requests of the codec.
const PERIOD: TimeDelta = TimeDelta::from_millis(50);

/// Sends requests, and takes three bytes for a reply.
#[derive(Debug, Default)]
struct PollingCodec {
    requested_at: Option<Timestamp<HostClock>>,
    due: Option<Timestamp<HostClock>>,
    received: Vec<u8>,
    answers: u64,
    outgoing: Option<Vec<u8>>,
}

impl BrickCodec for PollingCodec {
    fn on_link_up(&mut self, now: Timestamp<HostClock>) {
        *self = Self { due: Some(now), ..Self::default() };
        self.request(now);
    }

    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(CodecEvent<'_>)) {
        self.received.extend(bytes);
        if self.received.first() == Some(&REFUSAL) {
            self.received.clear();
            sink(CodecEvent::Error(ReceiveError::UnframedBytes { bytes: 1 }));
            sink(CodecEvent::StatusText {
                from: DEFAULT_BRICK_ADDRESS,
                severity: 4,
                text: "the brick refuses".to_owned(),
            });
            return;
        }
        let (Some(sent), &[hundredths, left, right]) = (self.requested_at, self.received.as_slice()) else {
            return;
        };
        self.received.clear();
        self.requested_at = None;
        self.answers += 1;
        let from = DEFAULT_BRICK_ADDRESS;
        sink(CodecEvent::Message { from, message: HEARTBEAT });
        sink(CodecEvent::ClockReply { from, sent, peer_nanos: i64::from(hundredths) * 10_000_000 });
        sink(CodecEvent::Message {
            from,
            message: Message::WheelTicks(WheelTicks {
                stamp: WireStamp::HostInterval { sent, answered: now },
                left: EncoderTicks(i64::from(left)),
                right: EncoderTicks(i64::from(right)),
            }),
        });
    }

    fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.due
    }

    fn tick(&mut self, now: Timestamp<HostClock>, _sink: &mut dyn FnMut(CodecEvent<'_>)) {
        self.request(now);
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        self.outgoing.take()
    }

    fn encode(&mut self, _now: Timestamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        if !matches!(message, Message::PlanarPose(_)) {
            return 0;
        }
        out.extend(b"pose");
        4
    }

    fn counters(&self) -> FramerCounters {
        FramerCounters { frames: self.answers, ..FramerCounters::default() }
    }

    fn source_health(&self) -> Vec<SourceHealth> {
        vec![SourceHealth { source: DEFAULT_BRICK_ADDRESS, frames: self.answers, lost: 2 }]
    }
}

impl PollingCodec {
    fn request(&mut self, now: Timestamp<HostClock>) {
        self.requested_at = Some(now);
        self.due = Some(now + PERIOD);
        self.outgoing = Some(vec![REQUEST]);
    }
}

fn polling_config() -> StationConfig {
    static PROTOCOL: BrickProtocol =
        BrickProtocol { name: "asking", summary: "asks by one byte", open: |_| Box::<PollingCodec>::default() };
    let mut config = config();
    config.links[0].brick = Some(BrickLink { protocol: &PROTOCOL, settings: CodecSettings::default() });
    config
}

/// Lets the station poll for so many milliseconds; the brick, whose clock began 1 s before the host's, reads 10 ms after each request
/// and answers after 20 ms. Both wheels roll by a count each 10 ms.
fn exchange(station: &mut TestStation, millis: i64) {
    let mut answers: Vec<(i64, [u8; 3])> = Vec::new();
    let mut first_output = 0;
    for now_ms in 0..millis {
        if station.engine.deadline().is_some_and(|due| due <= at(now_ms)) {
            station.handle(at(now_ms), Input::Tick);
        }
        for request in station.sent_since(first_output).filter(|sent| sent.bytes == [REQUEST]) {
            let sent_ms = request.now.as_nanos() / 1_000_000;
            let clock = u8::try_from((sent_ms + 10 + 1_000) / 10 % 256).unwrap_or(0);
            let count = u8::try_from((sent_ms + 10) / 10).unwrap_or(u8::MAX);
            answers.push((sent_ms + 20, [clock, count, count]));
        }
        first_output = station.outputs.len();
        while answers.first().is_some_and(|(due, _)| *due <= now_ms) {
            let (_, answer) = answers.remove(0);
            station.bytes(at(now_ms), &answer);
        }
    }
}

#[test]
fn a_polled_brick_is_a_robot_whose_readings_lie_between_request_and_reply() {
    let mut station = TestStation::new(&polling_config());
    exchange(&mut station, 1_400);
    let observed = station.aligned();
    // Two replies do not determine the clock rates yet; the third one does.
    assert_eq!(observed.len(), 28 - 2);
    assert_eq!(station.unaligned(DEFAULT_BRICK_ADDRESS).len(), 2);
    for (index, AlignedObservation { robot, observation, .. }) in observed.iter().enumerate() {
        assert_eq!((robot.link, robot.address), (LINK, DEFAULT_BRICK_ADDRESS));
        // It read 10 ms after the request; its clock counts full hundredths.
        let read_at = Timestamp::<BrickClock>::from_millis(1_110 + 50 * index as i64);
        let off = (observation.stamp - read_at).as_secs_f64().abs();
        assert!(off < 0.010, "answer {index}: {off} s off");
        // Half of 20 ms, uniform, and what is not known of the clock: half a round trip more, and what it may have drifted since.
        let sigma_s = observation.stamp_sigma.as_secs_f64();
        assert!((0.0057..0.02).contains(&sigma_s), "{sigma_s}");
        assert!(matches!(observation.measurement, ObservationKind::WheelAngles { .. }));
    }
    assert_eq!(station.count(|event| matches!(event, Event::RobotDetected { .. })), 1);
    let (health, _) = station.health(LINK);
    assert_eq!((health.frames_in, health.frames_lost), (20, 2));
    // Messages of the session without a recipient are no loss.
    assert_eq!(health.drops_out, 0);
}

#[test]
fn requests_have_command_priority_and_only_estimates_leave_by_the_codec() {
    let mut station = TestStation::new(&polling_config());
    exchange(&mut station, 1_400);
    let sent: Vec<_> = station.sent().collect();
    let requests = sent.iter().filter(|sent| sent.bytes == [REQUEST]).count();
    let estimates = sent.iter().filter(|sent| sent.bytes == b"pose").count();
    assert_eq!((requests, estimates), (28, 26));
    assert_eq!(sent.len(), requests + estimates);
    for sent in sent {
        assert_eq!(sent.priority == Priority::Command, sent.bytes == [REQUEST]);
    }
}

#[test]
fn a_lost_link_is_silent_and_begins_anew_when_it_is_back() {
    let mut station = TestStation::new(&polling_config());
    let requests = |station: &TestStation| station.sent().filter(|sent| sent.bytes == [REQUEST]).count();
    assert_eq!(requests(&station), 1);
    station.link(at(10), LINK, LinkState::Down);
    for millis in [60, 110, 500] {
        station.handle(at(millis), Input::Tick);
    }
    assert_eq!(requests(&station), 1);
    // Nobody is woken for a brick that is not there.
    let due = station.engine.deadline();
    assert!(due.is_none_or(|due| due > at(500)), "{due:?}");
    station.link(at(600), LINK, LinkState::Up);
    assert_eq!(requests(&station), 2);
}

#[test]
fn the_frames_of_others_are_not_passed_on_to_it() {
    let mut config = polling_config();
    let other = LinkId(8);
    config.links.push(link(other, vec![]));
    let mut station = TestStation::new(&config);
    station.bytes_from(at(5), other, PeerId::default(), &frame(Address::new(1, 100), &HEARTBEAT));
    station.handle(at(6), Input::Tick);
    assert_eq!(station.sent().filter(|sent| sent.link == LINK).count(), 1, "the first question alone");
}

#[test]
fn a_refusal_is_reported_and_counted() {
    let mut station = TestStation::new(&polling_config());
    station.bytes(at(5), &[REFUSAL]);
    assert!(station.events().any(|event| matches!(
        event,
        Event::Text { severity: 4, text, .. } if text == "the brick refuses"
    )));
    assert!(station.events().any(|event| matches!(event, Event::ReceiveError { .. })));
}
