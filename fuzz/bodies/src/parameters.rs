//! Random requests for parameters: every value that is told is the one that stands, lists are whole and paced, and nobody is answered
//! who did not ask.

use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_protocol::session::{Session, SessionConfig, SessionOutput};
use posebridge_telemetry::{Address, HostClock, Span, Stamp};

use crate::operands::Operands;

const OWN: Address = Address::new(1, 197);
const GCS: Address = Address::new(255, 190);
/// Two values of a list are at least this far apart.
const PACE: Span = Span::from_millis(20);
/// Outputs of one operation beyond which something feeds itself.
const MOST_OUTPUTS: usize = 16;

/// A session that offers parameters, and what is known of them outside.
struct Owner {
    session: Session<HostClock>,
    now: Stamp<HostClock>,
    /// The values that stand.
    values: Vec<f32>,
    is_asked: bool,
    /// Values of the list that must still come.
    left: usize,
    listed_at: Option<Stamp<HostClock>>,
}

/// Input: how many parameters, then operations.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    let mut owner = Owner::new(usize::from(operands.byte() % 5));
    while !operands.is_empty() {
        owner.operate(&mut operands);
    }
    // Whatever was asked, the list comes to its end.
    for _ in 0..=owner.values.len() {
        owner.wait(PACE);
    }
    assert_eq!(owner.left, 0);
}

impl Owner {
    fn new(count: usize) -> Self {
        let now = Stamp::ZERO;
        let mut session = Session::new(config(), now);
        let values: Vec<f32> = (0..count).map(|index| index as f32).collect();
        let named = values.iter().enumerate();
        session.offer_parameters(named.map(|(index, value)| (name(index), *value)));
        Self { session, now, values, is_asked: false, left: 0, listed_at: None }
    }

    fn operate(&mut self, operands: &mut Operands<'_>) {
        let kind = operands.byte();
        let target = match operands.byte() % 4 {
            0 => Address::new(1, 0),
            1 => Address::new(operands.byte(), operands.byte()),
            _ => OWN,
        };
        let is_ours = target.system == OWN.system && (target == OWN || target == Address::new(1, 0));
        let counts = is_ours && !self.values.is_empty();
        match kind % 4 {
            0 => self.wait(Span::from_millis(i64::from(operands.byte()))),
            1 => {
                if counts {
                    self.left = self.values.len();
                    self.is_asked = true;
                }
                self.hear(&Message::ParamRequestList { target });
            }
            2 => {
                let index = operands.number() as i16 >> (operands.byte() % 16);
                let name = spelled(operands);
                self.is_asked |= counts;
                let told = self.hear(&Message::ParamRequestRead { target, name: name.clone(), index });
                let known = if index == -1 { self.index_of(&name) } else { usize::try_from(index).ok() };
                let is_known = known.is_some_and(|known| known < self.values.len());
                assert_eq!(told, usize::from(counts && is_known));
            }
            _ => {
                let name = spelled(operands);
                let bits = [operands.byte(), operands.byte(), operands.byte()];
                let value = f32::from_bits(u32::from_le_bytes([bits[0], bits[1], bits[2], bits[0]]));
                self.is_asked |= counts;
                self.hear(&Message::ParamSet { target, name, value });
            }
        }
    }

    fn index_of(&self, wanted: &str) -> Option<usize> {
        (0..self.values.len()).find(|index| name(*index).eq_ignore_ascii_case(wanted))
    }

    fn wait(&mut self, span: Span) {
        let end = self.now + span;
        while let Some(due) = self.session.deadline().filter(|due| *due <= end) {
            self.now = due.max(self.now);
            self.session.tick(self.now);
            self.take(Why::Time);
        }
        self.now = end;
    }

    /// How many values were told at once.
    fn hear(&mut self, message: &Message) -> usize {
        self.session.handle(self.now, GCS, message);
        self.take(Why::Asked)
    }

    fn take(&mut self, why: Why) -> usize {
        let mut told = 0;
        for count in 0.. {
            let Some(output) = self.session.poll() else {
                break;
            };
            assert!(count < MOST_OUTPUTS);
            match output {
                SessionOutput::Send(Message::ParamValue { name: named, value, count, index }) => {
                    told += 1;
                    let index = usize::from(index);
                    assert_eq!((named, usize::from(count)), (name(index), self.values.len()));
                    assert_eq!(value.to_bits(), self.values[index].to_bits());
                    assert!(self.is_asked);
                    if why == Why::Time {
                        self.count_listed();
                    }
                }
                SessionOutput::ParameterWish { by, index, value } => {
                    assert!(by == GCS && index < self.values.len());
                    // One in two is fulfilled.
                    if value.to_bits() % 2 == 0 {
                        self.values[index] = value;
                    }
                    let stands = self.session.parameter_stands(index, self.values[index]);
                    assert!(stands.is_some(), "who sets has asked");
                }
                SessionOutput::ParameterUnsupported { by, index, .. } => {
                    assert!(by == GCS && index < self.values.len());
                    let stands = self.session.parameter_stands(index, self.values[index]);
                    assert!(stands.is_some(), "who sets has asked");
                }
                SessionOutput::ParameterUnknown { by, .. } => assert_eq!(by, GCS),
                SessionOutput::Send(_) => {}
                SessionOutput::PeerSeen { .. }
                | SessionOutput::PeerLost { .. }
                | SessionOutput::TimeExchanged { .. }
                | SessionOutput::IntervalRequested { .. }
                | SessionOutput::Commanded { .. } => panic!("nothing of the kind was said"),
            }
        }
        told
    }

    fn count_listed(&mut self) {
        assert!(self.left > 0, "nobody asked for more");
        self.left -= 1;
        let last = self.listed_at.replace(self.now);
        assert!(last.is_none_or(|last| self.now - last >= PACE));
    }
}

/// What led to an output.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Why {
    Time,
    Asked,
}

fn name(index: usize) -> String {
    format!("PARAMETER_{index}")
}

/// One of the names, or any other.
fn spelled(operands: &mut Operands<'_>) -> String {
    match operands.byte() {
        index @ 0..=7 => name(usize::from(index)),
        length => String::from_utf8_lossy(operands.part(usize::from(length % 17))).into_owned(),
    }
}

fn config() -> SessionConfig {
    SessionConfig {
        own: OWN,
        heartbeat: Heartbeat { vehicle_type: 18, autopilot: 8, base_mode: 0, system_status: 4 },
        heartbeat_period: Span::from_millis(1_000),
        timesync_period: None,
        peer_timeout: Span::from_millis(3_000),
        wanted: vec![],
        offered: vec![],
    }
}
