//! A link with a key: frames with it are received, others are counted, and the station's frames can be verified.

use std::collections::BTreeSet;

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, frame, link, messages, ticks};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{CommandLong, Message};
use posebridge_protocol::signing::{
    Key, LinkSigner, RADIO_STATUS, SigningConfig, SigningState, SigningTime, UnsignedPolicy,
};
use posebridge_station::StationConfig;
use posebridge_telemetry::{
    Address, Event, HostClock, PeerId, Priority, ReceiveError, SignatureError, SourceHealth, Timestamp,
};

/// Some instant in 2025.
const DATE: SigningTime = SigningTime::from_units(34_000_000_000_000);

/// The configuration of a link with a key.
pub(crate) fn signing(key: u8, link_id: u8) -> SigningConfig {
    SigningConfig {
        key: Key::from_bytes([key; 32]),
        link_id,
        unsigned: UnsignedPolicy::RejectExcept(BTreeSet::from([RADIO_STATUS])),
        state: SigningState { written_at: DATE, clock: DATE, ..SigningState::default() },
    }
}

fn config() -> StationConfig {
    let mut config = crate::support::config();
    config.links[0].signing = Some(signing(7, 3));
    config
}

/// A brick that signs.
pub(crate) struct SigningBrick {
    signing: LinkSigner,
    encoder: Encoder,
}

impl SigningBrick {
    pub(crate) fn with_key(key: u8) -> Self {
        Self { signing: LinkSigner::new(signing(key, 0)), encoder: Encoder::new(WireVersion::V2) }
    }

    pub(crate) fn frame(&mut self, now: Timestamp<HostClock>, message: &Message) -> Vec<u8> {
        let seal = self.signing.next_signer(now).expect("it has a time");
        let mut bytes = Vec::new();
        self.encoder.encode_signed(BRICK, message, &seal, &mut bytes);
        bytes
    }
}

fn refusals(station: &TestStation) -> Vec<(Address, SignatureError)> {
    station.select(|event| match event {
        Event::ReceiveError { link: LINK, defect: ReceiveError::SignatureRejected { source, reason } } => {
            Some((*source, *reason))
        }
        _ => None,
    })
}

#[test]
fn signed_telemetry_is_used_and_the_rest_is_counted_and_nothing_else() {
    let mut station = TestStation::new(&config());
    let mut brick = SigningBrick::with_key(7);
    let mut stranger = SigningBrick::with_key(8);
    let first = brick.frame(at(100), &ticks(5_000, 0, 0));
    station.bytes(at(100), &first);
    station.bytes(at(150), &brick.frame(at(150), &ticks(5_050, 4, 4)));
    assert_eq!(station.aligned().len(), 2);
    assert_eq!(refusals(&station), []);

    station.bytes(at(160), &frame(BRICK, &ticks(5_060, 900, 0)));
    station.bytes(at(170), &stranger.frame(at(170), &ticks(5_070, 900, 0)));
    station.bytes(at(180), &first);
    let past = Timestamp::from_millis(-61_000);
    let mut late = SigningBrick::with_key(7);
    late.signing = LinkSigner::new(SigningConfig { link_id: 9, state: SigningState::default(), ..signing(7, 9) });
    station.bytes(at(190), &late.frame(past, &ticks(5_080, 900, 0)));
    assert_eq!(
        refusals(&station).iter().map(|(_, why)| *why).collect::<Vec<_>>(),
        [SignatureError::Unsigned, SignatureError::Invalid, SignatureError::Replayed, SignatureError::Stale]
    );
    assert!(refusals(&station).iter().all(|(source, _)| *source == BRICK));
    assert_eq!(station.aligned().len(), 2);

    station.bytes(at(200), &brick.frame(at(200), &ticks(5_100, 8, 8)));
    assert_eq!(station.aligned().len(), 3);
    station.pass_until(at(1_000));
    let (health, sources) = station.health(LINK);
    assert_eq!(health.rejected_frames, 4);
    assert_eq!(health.frames_in, 7);
    assert_eq!(health.frames_lost, 0);
    let expected = SourceHealth { source: BRICK, frames: 3, lost: 0 };
    assert_eq!(sources, [expected]);
}

#[test]
fn the_stations_frames_are_signed_with_rising_stamps() {
    let mut station = TestStation::new(&config());
    let mut brick = SigningBrick::with_key(7);
    for k in 0..20_u32 {
        let now = at(100 + i64::from(k) * 50);
        station.bytes(now, &brick.frame(now, &ticks(5_000 + k * 50, 0, 0)));
    }
    assert!(station.sent().count() > 20);
    let mut receiver =
        LinkSigner::new(SigningConfig { unsigned: UnsignedPolicy::RejectExcept(BTreeSet::new()), ..signing(7, 0) });
    let mut estimates = 0;
    for sent in station.sent() {
        let mut verdict = None;
        Framer::new(FramerConfig::default()).push(sent.now, sent.bytes, &mut |found| {
            if let FramerOutput::Frame(frame) = found {
                // Rising stamps: none is refused as replayed.
                verdict = Some(receiver.verify(sent.now, &frame));
            }
        });
        assert_eq!(verdict, Some(Ok(())));
        let is_estimate = |message: &Message| matches!(message, Message::PlanarPose(_));
        estimates += usize::from(messages(sent.bytes).iter().any(is_estimate));
    }
    assert_eq!(estimates, 20);
    let last = station.sent().last().expect("it spoke");
    assert_eq!(receiver.state(last.now).streams.len(), 1);
}

#[test]
fn an_allowed_unsigned_frame_teaches_nothing_about_its_claimed_sender() {
    let mut config = config();
    config.links.push(link(GCS_LINK, vec![]));
    let heartbeats = UnsignedPolicy::RejectExcept(BTreeSet::from([0]));
    config.links[0].signing.as_mut().unwrap().unsigned = heartbeats;
    let mut station = TestStation::new(&config);
    let mut brick = SigningBrick::with_key(7);
    station.bytes(at(10), &brick.frame(at(10), &HEARTBEAT));
    for number in 0..5_000_u16 {
        let [system, component] = (number + 0x0200).to_be_bytes();
        let unsigned = frame(Address::new(system, component), &HEARTBEAT);
        station.bytes(at(20), &unsigned);
    }
    // In the robot's name, too, with a number far ahead.
    let mut forger = Encoder::new(WireVersion::V2);
    let mut unsigned = Vec::new();
    for _ in 0..90 {
        unsigned.clear();
        forger.encode(BRICK, &HEARTBEAT, &mut unsigned);
    }
    station.bytes(at(30), &unsigned);
    station.bytes(at(40), &brick.frame(at(40), &ticks(5_000, 0, 0)));
    assert_eq!(refusals(&station), []);
    let mut links_reached = |target: Address| {
        let command = Message::Command(CommandLong { target, command: 400, params: [1.0; 7] });
        let first_output = station.outputs.len();
        station.bytes_from(at(50), GCS_LINK, PeerId::default(), &frame(GCS, &command));
        let commands = station.sent_since(first_output).filter(|sent| sent.priority == Priority::Command);
        commands.map(|sent| sent.link).collect::<Vec<_>>()
    };
    assert_eq!(links_reached(BRICK), [LINK]);
    assert_eq!(links_reached(Address::new(2, 0)), []);
    assert_eq!(links_reached(Address::new(9, 9)), []);
    station.pass_until(at(1_000));
    let (health, sources) = station.health(LINK);
    assert_eq!((health.frames_lost, sources.len()), (0, 1));
}
