//! Random operations on a session, and random requests for parameters: outputs end, there is always a deadline, only peers that were
//! seen are lost, every parameter that is sent has its current value, and lists are complete and paced.

use std::collections::BTreeSet;

use posebridge_protocol::dialect::{MESSAGES, decode};
use posebridge_protocol::framing::{FrameRef, WireVersion};
use posebridge_protocol::message::{CommandResult, Heartbeat, Message};
use posebridge_protocol::session::{RequestedMessages, Session, SessionConfig, SessionOutput};
use posebridge_telemetry::{Address, BrickClock, HostClock, TimeDelta, Timestamp};

use crate::operands::Operands;

/// Outputs of one operation beyond which something feeds itself.
const MAX_OUTPUTS: usize = 1_000;
/// Bytes of one operation: kind, three operands.
const OPERATION: usize = 4;

/// Input: operations of four bytes each.
pub(crate) fn check_session(data: &[u8]) {
    let mut now = Timestamp::<BrickClock>::ZERO;
    let mut session = Session::new(config(), now);
    let mut present = BTreeSet::new();
    for operation in data.chunks_exact(OPERATION) {
        let [kind, a, b, c] = [operation[0], operation[1], operation[2], operation[3]];
        let step = TimeDelta::from_micros(i64::from(u16::from_le_bytes([a, b])) * 100);
        match kind % 5 {
            0 => now = now + step,
            1 => now = now - step,
            2 => session.peer_restarted(now, Address::new(a % 4, b % 4)),
            3 => session.tick(now),
            _ => receive(&mut session, now, [a, b, c]),
        }
        let mut outputs = 0;
        while let Some(output) = session.poll() {
            outputs += 1;
            assert!(outputs < MAX_OUTPUTS);
            match output {
                SessionOutput::PeerSeen { peer, .. } => assert!(present.insert(peer)),
                SessionOutput::PeerLost { peer, .. } => assert!(present.remove(&peer)),
                SessionOutput::CommandReceived { by, command, .. } => {
                    session.acknowledge_command(by, command.command, CommandResult::Unsupported);
                }
                SessionOutput::Send(_)
                | SessionOutput::TimeExchanged { .. }
                | SessionOutput::IntervalRequested { .. } => {}
                SessionOutput::PlanReceived { .. } => panic!("it keeps no plans"),
                SessionOutput::ParameterSetRequested { .. }
                | SessionOutput::ParameterUnsupported { .. }
                | SessionOutput::ParameterUnknown { .. } => {
                    panic!("nothing was offered")
                }
            }
        }
        assert!(session.deadline().is_some());
    }
}

fn config() -> SessionConfig {
    SessionConfig {
        own: Address::new(1, 2),
        heartbeat: Heartbeat { vehicle_type: 18, autopilot: 8, base_mode: 0, system_status: 4 },
        heartbeat_period: TimeDelta::from_millis(1_000),
        timesync_period: Some(TimeDelta::from_millis(500)),
        peer_timeout: TimeDelta::from_millis(3_000),
        requested_messages: RequestedMessages {
            of_robots: vec![(42_100, TimeDelta::from_millis(50)), (42_101, TimeDelta::ZERO)],
            ..RequestedMessages::default()
        },
        offered_messages: vec![30, 331, 42_102],
    }
}

/// A message with a payload of repeated bytes from one of sixteen addresses.
fn receive(session: &mut Session<BrickClock>, now: Timestamp<BrickClock>, [who, what, fill]: [u8; 3]) {
    let info = MESSAGES[usize::from(what) % MESSAGES.len()];
    let frame = FrameRef {
        version: WireVersion::V2,
        message_id: info.id,
        source: Address::new(who % 4, (who >> 4) % 4),
        sequence: 0,
        payload: &[fill; 40],
        raw: &[],
    };
    if let Ok(Some(message)) = decode(&frame) {
        session.handle(now, frame.source, &message);
    }
}

const OWN: Address = Address::new(1, 197);
const GCS: Address = Address::new(255, 190);
/// Two values of a list are at least this far apart.
const STEP: TimeDelta = TimeDelta::from_millis(20);
/// Outputs of one operation beyond which something feeds itself.
const MAX_PARAMETER_OUTPUTS: usize = 16;

/// A session that offers parameters, and what is known of them outside.
struct ParameterOwner {
    session: Session<HostClock>,
    now: Timestamp<HostClock>,
    /// The values that stand.
    values: Vec<f32>,
    is_requested: bool,
    /// Values of the list that must still come.
    left: usize,
    listed_at: Option<Timestamp<HostClock>>,
}

/// Input: how many parameters, then operations.
pub(crate) fn check_parameters(data: &[u8]) {
    let mut operands = Operands::new(data);
    let mut owner = ParameterOwner::new(usize::from(operands.byte() % 5));
    while !operands.is_empty() {
        owner.apply_operation(&mut operands);
    }
    // Whatever was asked, the list comes to its end.
    for _ in 0..=owner.values.len() {
        owner.wait(STEP);
    }
    assert_eq!(owner.left, 0);
}

impl ParameterOwner {
    fn new(count: usize) -> Self {
        let now = Timestamp::ZERO;
        let mut session = Session::new(parameter_config(), now);
        let values: Vec<f32> = (0..count).map(|index| index as f32).collect();
        let named = values.iter().enumerate();
        session.offer_parameters(named.map(|(index, value)| (name(index), *value)));
        Self { session, now, values, is_requested: false, left: 0, listed_at: None }
    }

    fn apply_operation(&mut self, operands: &mut Operands<'_>) {
        let kind = operands.byte();
        let target = match operands.byte() % 4 {
            0 => Address::new(1, 0),
            1 => Address::new(operands.byte(), operands.byte()),
            _ => OWN,
        };
        let is_ours = target.system == OWN.system && (target == OWN || target == Address::new(1, 0));
        let counts = is_ours && !self.values.is_empty();
        match kind % 4 {
            0 => self.wait(TimeDelta::from_millis(i64::from(operands.byte()))),
            1 => {
                if counts {
                    self.left = self.values.len();
                    self.is_requested = true;
                }
                self.on_message(&Message::ParamRequestList { target });
            }
            2 => {
                let index = operands.number() as i16 >> (operands.byte() % 16);
                let name = spelled(operands);
                self.is_requested |= counts;
                let told = self.on_message(&Message::ParamRequestRead { target, name: name.clone(), index });
                let known = if index == -1 { self.index_of(&name) } else { usize::try_from(index).ok() };
                let is_known = known.is_some_and(|known| known < self.values.len());
                assert_eq!(told, usize::from(counts && is_known));
            }
            _ => {
                let name = spelled(operands);
                let bits = [operands.byte(), operands.byte(), operands.byte()];
                let value = f32::from_bits(u32::from_le_bytes([bits[0], bits[1], bits[2], bits[0]]));
                self.is_requested |= counts;
                // Who sets the checksum has all values.
                if counts && name == "_HASH_CHECK" {
                    self.left = 0;
                }
                self.on_message(&Message::ParamSet { target, name, value });
            }
        }
    }

    fn index_of(&self, wanted: &str) -> Option<usize> {
        (0..self.values.len()).find(|index| name(*index).eq_ignore_ascii_case(wanted))
    }

    fn wait(&mut self, span: TimeDelta) {
        let end = self.now + span;
        while let Some(due) = self.session.deadline().filter(|due| *due <= end) {
            self.now = due.max(self.now);
            self.session.tick(self.now);
            self.drain_outputs(OutputTrigger::Time);
        }
        self.now = end;
    }

    /// How many values were told at once.
    fn on_message(&mut self, message: &Message) -> usize {
        self.session.handle(self.now, GCS, message);
        self.drain_outputs(OutputTrigger::Request)
    }

    fn drain_outputs(&mut self, why: OutputTrigger) -> usize {
        let mut told = 0;
        for count in 0.. {
            let Some(output) = self.session.poll() else {
                break;
            };
            assert!(count < MAX_PARAMETER_OUTPUTS);
            match output {
                SessionOutput::Send(Message::ParamValue { name: named, value, count, index }) => {
                    told += 1;
                    let index = usize::from(index);
                    assert_eq!((named, usize::from(count)), (name(index), self.values.len()));
                    assert_eq!(value.to_bits(), self.values[index].to_bits());
                    assert!(self.is_requested);
                    if why == OutputTrigger::Time {
                        self.count_listed();
                    }
                }
                SessionOutput::ParameterSetRequested { by, index, value } => {
                    assert!(by == GCS && index < self.values.len());
                    // One in two is fulfilled.
                    if value.to_bits() % 2 == 0 {
                        self.values[index] = value;
                    }
                    let stands = self.session.report_parameter(index, self.values[index]);
                    assert!(stands.is_some(), "who sets has asked");
                }
                SessionOutput::ParameterUnsupported { by, index, .. } => {
                    assert!(by == GCS && index < self.values.len());
                    let stands = self.session.report_parameter(index, self.values[index]);
                    assert!(stands.is_some(), "who sets has asked");
                }
                SessionOutput::ParameterUnknown { by, .. } => assert_eq!(by, GCS),
                SessionOutput::Send(_) => {}
                SessionOutput::PeerSeen { .. }
                | SessionOutput::PeerLost { .. }
                | SessionOutput::TimeExchanged { .. }
                | SessionOutput::IntervalRequested { .. }
                | SessionOutput::PlanReceived { .. }
                | SessionOutput::CommandReceived { .. } => panic!("nothing of the kind was said"),
            }
        }
        told
    }

    fn count_listed(&mut self) {
        assert!(self.left > 0, "nobody asked for more");
        self.left -= 1;
        let last = self.listed_at.replace(self.now);
        assert!(last.is_none_or(|last| self.now - last >= STEP));
    }
}

/// What led to an output.
#[derive(Clone, Copy, PartialEq, Eq)]
enum OutputTrigger {
    Time,
    Request,
}

fn name(index: usize) -> String {
    format!("PARAMETER_{index}")
}

/// One of the names, or any other.
fn spelled(operands: &mut Operands<'_>) -> String {
    match operands.byte() {
        index @ 0..=7 => name(usize::from(index)),
        length => String::from_utf8_lossy(operands.take_up_to(usize::from(length % 17))).into_owned(),
    }
}

fn parameter_config() -> SessionConfig {
    SessionConfig {
        own: OWN,
        timesync_period: None,
        requested_messages: RequestedMessages::default(),
        offered_messages: vec![],
        ..config()
    }
}
