//! A station with a robot and two ground stations, as the tests of commands drive it.

use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{CommandLong, Message, VisionFix};
use posebridge_station::StationConfig;
use posebridge_telemetry::{Address, Event, FusionOutcome, LinkId, Output, PeerId, Request, SensorId};

use super::{BRICK, HEARTBEAT, STATION, TestStation, at, config, frame, link, ticks, vision_fix};

pub(crate) const GCS_LINK: LinkId = LinkId(5);
pub(crate) const OTHER_GCS_LINK: LinkId = LinkId(6);
pub(crate) const GCS: Address = Address::new(254, 190);

/// A station with a robot on one link and a ground station on each of two others.
pub(crate) struct Ground {
    pub(crate) station: TestStation,
    pub(crate) encoder: Encoder,
}

impl Ground {
    pub(crate) fn new(change: impl Fn(&mut StationConfig)) -> Self {
        let mut config = config();
        config.links.push(link(GCS_LINK, vec![]));
        config.links.push(link(OTHER_GCS_LINK, vec![]));
        change(&mut config);
        let mut ground = Self { station: TestStation::new(&config), encoder: Encoder::new(WireVersion::V2) };
        ground.station.bytes(at(10), &frame(BRICK, &HEARTBEAT));
        ground
    }

    /// The ground station sends a message; the station's replies on its link, beside heartbeats and time requests.
    pub(crate) fn send(&mut self, millis: i64, message: &Message) -> Vec<Message> {
        self.send_on(GCS_LINK, millis, message)
    }

    pub(crate) fn send_on(&mut self, link: LinkId, millis: i64, message: &Message) -> Vec<Message> {
        let mut bytes = Vec::new();
        self.encoder.encode(GCS, message, &mut bytes);
        let first_output = self.station.outputs.len();
        self.station.bytes_from(at(millis), link, PeerId::default(), &bytes);
        self.received_since(first_output, link)
    }

    pub(crate) fn set(&mut self, millis: i64, name: &str, value: f32) -> Vec<Message> {
        let set = Message::ParamSet { target: STATION, name: name.to_owned(), value };
        self.send(millis, &set)
    }

    pub(crate) fn command(&mut self, millis: i64, command: u16, params: &[f32]) -> Vec<Message> {
        let mut seven = [0.0; 7];
        seven[..params.len()].copy_from_slice(params);
        self.send(millis, &Message::Command(CommandLong { target: STATION, command, params: seven }))
    }

    /// What a command is answered with.
    pub(crate) fn result(&mut self, millis: i64, command: u16, params: &[f32]) -> u8 {
        let answers = self.command(millis, command, params);
        let result = answers.iter().find_map(|answer| match answer {
            Message::CommandAck(ack) if ack.command == command && ack.target == Some(GCS) => Some(ack.result),
            _ => None,
        });
        result.expect("an answer")
    }

    pub(crate) fn received_since(&self, first_output: usize, on: LinkId) -> Vec<Message> {
        let mut messages = self.station.messages_since(first_output, on);
        messages.retain(|message| !matches!(message, Message::Heartbeat(_) | Message::TimeSync(_)));
        messages
    }

    /// The robot drives straight on at 0.2 m/s for a while, seen each 200 ms from outside where it is.
    pub(crate) fn drive(&mut self, from_ms: u32, until_ms: u32) {
        for millis in (from_ms..until_ms).step_by(50) {
            let counts = i64::from(millis) * 360 / 880;
            let now = at(i64::from(millis) + 5);
            self.station.bytes(now, &frame(BRICK, &ticks(millis, counts, counts)));
            if millis % 200 == 0 {
                let x_m = 0.2e-3 * f64::from(millis);
                self.station.bytes(now, &frame(BRICK, &fix(millis, x_m)));
            }
            self.station.pass_until(now);
        }
    }

    pub(crate) fn requests(&self) -> Vec<&Request> {
        let outputs = self.station.outputs.iter();
        let requests = outputs.filter_map(|(_, output)| match output {
            Output::Request(request) => Some(request),
            Output::Event(_) | Output::Transmit { .. } => None,
        });
        requests.collect()
    }

    pub(crate) fn last_verdict(&self, sensor: SensorId) -> FusionOutcome {
        let mut verdicts = self.station.select(|event| match event {
            Event::ObservationFused { record, .. } if record.sensor == sensor => Some(record.outcome),
            _ => None,
        });
        verdicts.pop().expect("there is one")
    }

    pub(crate) fn value_of(&mut self, millis: i64, name: &str) -> f32 {
        let read = Message::ParamRequestRead { target: STATION, name: name.to_owned(), index: -1 };
        match self.send(millis, &read).as_slice() {
            [Message::ParamValue { value, .. }] => *value,
            other => panic!("{other:?}"),
        }
    }
}

/// Relayed by the robot, so that its stamp is that of the robot's own clock.
pub(crate) fn fix(millis: u32, x_m: f64) -> Message {
    Message::VisionPosition(VisionFix { heading: None, ..vision_fix(i64::from(millis), x_m) })
}
