//! A station with its clock, as the tests drive it; messages to bytes, and the station's bytes to messages.

mod config;
pub(crate) mod exchanges;
pub(crate) mod ground;
pub(crate) mod network;
pub(crate) mod simulation;

use posebridge_protocol::dialect::{self, Encoder};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, TimeSync, VisionFix, WheelTicks, WireStamp};
use posebridge_station::{Station, StationConfig};
use posebridge_telemetry::{
    Address, EncoderTicks, Estimate, Event, FusionOutcome, Heading, HostClock, Input, LinkHealth, LinkId, LinkState,
    Meters, Observation, Output, PeerId, Priority, ReceiveError, Recipients, RobotId, SourceHealth, TimeDelta,
    Timestamp,
};

pub(crate) use config::{LINK, STATION, at, config, link, stream};

pub(crate) const BRICK: Address = Address::new(1, 1);

/// The frame of one message, sequence number 0.
pub(crate) fn frame(from: Address, message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    Encoder::new(WireVersion::V2).encode(from, message, &mut bytes);
    bytes
}

/// The wheels' counts at an instant of the brick's clock.
pub(crate) fn ticks(millis: u32, left: i64, right: i64) -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(millis * 1_000),
        left: EncoderTicks(left),
        right: EncoderTicks(right),
    })
}

/// The heartbeat of a rover.
pub(crate) const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

/// A fix on the arena's x axis, heading along it, by the camera's own sigmas.
pub(crate) fn vision_fix(stamp_ms: i64, x_m: f64) -> VisionFix {
    VisionFix {
        stamp: WireStamp::Micros64(stamp_ms as u64 * 1_000),
        x: Meters(x_m),
        y: Meters(0.0),
        heading: Some(Heading::from_rad(0.0)),
        covariance: None,
        reset_counter: 0,
        tag: None,
    }
}

/// The answer to a time request of the station.
pub(crate) fn time_answer(answer_nanos: i64, request_nanos: i64) -> Message {
    Message::TimeSync(TimeSync { answer_nanos, request_nanos, target: Some(STATION) })
}

/// The messages in some bytes.
pub(crate) fn messages(bytes: &[u8]) -> Vec<Message> {
    let mut messages = Vec::new();
    let mut framer = Framer::new(FramerConfig::default());
    framer.push(Timestamp::ZERO, bytes, &mut |found| {
        if let FramerOutput::Frame(frame) = found {
            messages.extend(dialect::decode(&frame).expect("the station makes sense"));
        }
    });
    messages
}

/// Bytes that a station sent.
#[derive(Clone, Copy)]
pub(crate) struct SentBytes<'a> {
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) link: LinkId,
    pub(crate) to: Recipients,
    pub(crate) priority: Priority,
    pub(crate) bytes: &'a [u8],
}

/// A request for the time that a station sent.
#[derive(Clone, Copy)]
pub(crate) struct TimeRequest {
    pub(crate) sent: Timestamp<HostClock>,
    pub(crate) link: LinkId,
    pub(crate) nanos: i64,
}

/// An observation that a station has aligned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AlignedObservation {
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) arrival: Timestamp<HostClock>,
    pub(crate) robot: RobotId,
    pub(crate) source: Address,
    pub(crate) observation: Observation,
}

/// A station that remembers what it was given and what it gave, each with the instant.
pub(crate) struct TestStation {
    pub(crate) engine: Station,
    pub(crate) inputs: Vec<(Timestamp<HostClock>, Input)>,
    pub(crate) outputs: Vec<(Timestamp<HostClock>, Output)>,
}

impl TestStation {
    /// A station whose link comes up at instant zero.
    pub(crate) fn new(config: &StationConfig) -> Self {
        let mut station = Self {
            engine: Station::new(config.clone(), Timestamp::ZERO).expect("the configuration is good"),
            inputs: vec![],
            outputs: vec![],
        };
        for link in &config.links {
            station.link(Timestamp::ZERO, link.id, LinkState::Up);
        }
        station
    }

    /// Gives one input and takes everything that comes of it.
    pub(crate) fn handle(&mut self, now: Timestamp<HostClock>, input: Input) {
        self.engine.handle(now, &input);
        while let Some(output) = self.engine.poll() {
            self.outputs.push((now, output));
        }
        self.inputs.push((now, input));
    }

    pub(crate) fn link(&mut self, now: Timestamp<HostClock>, link: LinkId, state: LinkState) {
        self.handle(now, Input::Link { link, state });
    }

    /// Bytes of the first peer of the first link.
    pub(crate) fn bytes(&mut self, now: Timestamp<HostClock>, bytes: &[u8]) {
        self.bytes_from(now, LINK, PeerId::default(), bytes);
    }

    pub(crate) fn bytes_from(&mut self, now: Timestamp<HostClock>, link: LinkId, peer: PeerId, bytes: &[u8]) {
        self.handle(now, Input::Bytes { link, peer, bytes: bytes.to_vec() });
    }

    /// Gives ticks at the deadlines until an instant.
    pub(crate) fn pass_until(&mut self, until: Timestamp<HostClock>) {
        while let Some(due) = self.engine.deadline().filter(|due| *due <= until) {
            self.handle(due, Input::Tick);
        }
    }

    /// What `pick` takes of all events so far.
    pub(crate) fn select<'a, T>(&'a self, pick: impl Fn(&'a Event) -> Option<T>) -> Vec<T> {
        self.events().filter_map(pick).collect()
    }

    /// All events so far.
    pub(crate) fn events(&self) -> impl Iterator<Item = &Event> {
        self.events_since(0)
    }

    /// The events after the first `first_output` outputs.
    pub(crate) fn events_since(&self, first_output: usize) -> impl Iterator<Item = &Event> {
        self.outputs[first_output..].iter().filter_map(|(_, output)| match output {
            Output::Event(event) => Some(event),
            Output::Transmit { .. } | Output::Request(_) => None,
        })
    }

    pub(crate) fn count(&self, is_it: impl Fn(&Event) -> bool) -> usize {
        self.events().filter(|event| is_it(event)).count()
    }

    /// Host instants of some events.
    pub(crate) fn when(&self, is_it: impl Fn(&Event) -> bool) -> Vec<Timestamp<HostClock>> {
        let instants = self.outputs.iter().filter_map(|(now, output)| match output {
            Output::Event(event) if is_it(event) => Some(*now),
            _ => None,
        });
        instants.collect()
    }

    pub(crate) fn restarts(&self) -> Vec<Timestamp<HostClock>> {
        self.when(|event| matches!(event, Event::BrickRestarted { .. }))
    }

    /// The observations that were aligned.
    pub(crate) fn aligned(&self) -> Vec<AlignedObservation> {
        let aligned = self.outputs.iter().filter_map(|(now, output)| match output {
            Output::Event(Event::ObservationAligned { robot, observation, source, arrival }) => {
                Some(AlignedObservation {
                    now: *now,
                    arrival: *arrival,
                    robot: *robot,
                    source: *source,
                    observation: *observation,
                })
            }
            _ => None,
        });
        aligned.collect()
    }

    /// How often bytes came from a source whose clock is not known.
    pub(crate) fn unaligned(&self, source: Address) -> Vec<Timestamp<HostClock>> {
        let expected = ReceiveError::ClockNotAligned { source };
        self.when(|event| matches!(event, Event::ReceiveError { defect, .. } if *defect == expected))
    }

    pub(crate) fn estimates(&self) -> Vec<Estimate> {
        self.select(|event| if let Event::EstimateUpdated { estimate, .. } = event { Some(*estimate) } else { None })
    }

    pub(crate) fn last_estimate(&self) -> Estimate {
        *self.estimates().last().expect("there is one")
    }

    /// The station's own status texts.
    pub(crate) fn texts(&self) -> Vec<&str> {
        self.select(|event| match event {
            Event::Text { source, text, .. } if *source == STATION => Some(text.as_str()),
            _ => None,
        })
    }

    /// The last health of a link and of its sources.
    pub(crate) fn health(&self, id: LinkId) -> (LinkHealth, Vec<SourceHealth>) {
        let mut health = self.select(|event| match event {
            Event::Health { link, health, sources, .. } if *link == id => Some((*health, sources.clone())),
            _ => None,
        });
        health.pop().expect("a second has passed")
    }

    /// The alignments of robots' clocks: offset and uncertainty.
    pub(crate) fn clock_offsets(&self) -> Vec<(TimeDelta, TimeDelta)> {
        self.select(|event| match event {
            Event::BrickClockAligned { offset, uncertainty, .. } => Some((*offset, *uncertainty)),
            _ => None,
        })
    }

    /// What became of the observations of a kind.
    pub(crate) fn verdicts(&self, kind: &str) -> Vec<FusionOutcome> {
        self.select(|event| match event {
            Event::ObservationFused { record, .. } if record.kind == kind => Some(record.outcome),
            _ => None,
        })
    }

    /// The health of a link a second after the last output.
    pub(crate) fn later_health(&mut self, id: LinkId) -> LinkHealth {
        let latest = self.outputs.iter().map(|(now, _)| *now).max();
        self.pass_until(latest.unwrap_or(at(0)) + TimeDelta::from_millis(1_000));
        self.health(id).0
    }

    /// What was sent on any link.
    pub(crate) fn sent(&self) -> impl Iterator<Item = SentBytes<'_>> {
        self.sent_since(0)
    }

    /// What was sent on any link after the first `first_output` outputs.
    pub(crate) fn sent_since(&self, first_output: usize) -> impl Iterator<Item = SentBytes<'_>> {
        self.outputs[first_output..].iter().filter_map(|(now, output)| match output {
            Output::Transmit { link, to, priority, bytes } => {
                Some(SentBytes { now: *now, link: *link, to: *to, priority: *priority, bytes })
            }
            Output::Event(_) | Output::Request(_) => None,
        })
    }

    /// The messages that were sent on a link after the first `first_output` outputs.
    pub(crate) fn messages_since(&self, first_output: usize, on: LinkId) -> Vec<Message> {
        self.sent_since(first_output).filter(|sent| sent.link == on).flat_map(|sent| messages(sent.bytes)).collect()
    }

    /// The time requests after the first `first_output` outputs.
    pub(crate) fn time_requests(&self, first_output: usize) -> Vec<TimeRequest> {
        let messages = self
            .sent_since(first_output)
            .flat_map(|sent| messages(sent.bytes).into_iter().map(move |message| (sent, message)));
        let requests = messages.filter_map(|(sent, message)| match message {
            Message::TimeSync(sync) if sync.answer_nanos == 0 => {
                Some(TimeRequest { sent: sent.now, link: sent.link, nanos: sync.request_nanos })
            }
            _ => None,
        });
        requests.collect()
    }

    /// A fresh station that is given the same inputs after those that brought its links up.
    pub(crate) fn replayed(&self, config: &StationConfig) -> Self {
        let mut again = Self::new(config);
        for (now, input) in &self.inputs[config.links.len()..] {
            again.handle(*now, input.clone());
        }
        again
    }
}
