//! Random operations on a session: its outputs end, it always has a deadline, and it loses only peers that it has seen.

use std::collections::BTreeSet;

use posebridge_protocol::dialect::{MESSAGES, decode};
use posebridge_protocol::framing::{FrameRef, WireVersion};
use posebridge_protocol::message::{CommandResult, Heartbeat};
use posebridge_protocol::session::{Session, SessionConfig, SessionOutput};
use posebridge_telemetry::{Address, BrickClock, TimeDelta, Timestamp};

/// Outputs of one operation beyond which something feeds itself.
const MAX_OUTPUTS: usize = 1_000;
/// Bytes of one operation: kind, three operands.
const OPERATION: usize = 4;

/// Input: operations of four bytes each.
pub(crate) fn check(data: &[u8]) {
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
                SessionOutput::CommandReceived { by, command } => {
                    session.acknowledge_command(by, command.command, CommandResult::Unsupported);
                }
                SessionOutput::Send(_)
                | SessionOutput::TimeExchanged { .. }
                | SessionOutput::IntervalRequested { .. } => {}
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
        requested_messages: vec![(42_100, TimeDelta::from_millis(50)), (42_101, TimeDelta::ZERO)],
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
