//! Outstanding requests with their replies and timeouts.
//!
//! Replies have no number, and a late reply must not be matched to a later request of its kind. The brick answers in order,
//! so after every disturbance one request of another kind is sent, the barrier: its reply proves that every earlier request
//! is answered or lost.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::io_maps::{FirmwareModule, IoMapWindow, parse_reply};
use super::settings::MotorPort;
use super::telegram::{self, NxtReply, bytes_at, opcode};

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum NxtRequest {
    /// Reads the firmware's version, which nothing else does: its reply proves that every earlier request is answered
    /// or lost.
    SyncBarrier,
    IoMap(IoMapWindow),
    Motor(MotorPort),
    Analog(u8),
    Digital(u8),
    SetUp {
        port: u8,
        kind: u8,
    },
    Battery,
    /// Writes this telegram to a mailbox, to detect whether a program reads it.
    Mailbox(Vec<u8>),
}

impl NxtRequest {
    pub(super) fn telegram(&self) -> Vec<u8> {
        match self {
            Self::SyncBarrier => telegram::firmware_version(),
            Self::IoMap(window) => telegram::read_io_map(window.module.id(), window.offset, window.length),
            Self::Motor(port) => telegram::get_output_state(*port),
            Self::Analog(port) => telegram::get_input_values(*port),
            Self::Digital(port) => telegram::ls_read(*port),
            Self::SetUp { port, kind } => telegram::set_input_mode(*port, *kind),
            Self::Battery => telegram::get_battery_level(),
            Self::Mailbox(telegram) => telegram.clone(),
        }
    }

    const fn opcode(&self) -> u8 {
        match self {
            Self::SyncBarrier => opcode::FIRMWARE_VERSION,
            Self::IoMap(_) => opcode::READ_IO_MAP,
            Self::Motor(_) => opcode::GET_OUTPUT_STATE,
            Self::Analog(_) => opcode::GET_INPUT_VALUES,
            Self::Digital(_) => opcode::LS_READ,
            Self::SetUp { .. } => opcode::SET_INPUT_MODE,
            Self::Battery => opcode::GET_BATTERY_LEVEL,
            Self::Mailbox(_) => opcode::MESSAGE_WRITE,
        }
    }

    /// Whether a reply can belong to this request: by its opcode, and by the port or the map where the reply repeats
    /// it. A refusal may repeat nothing.
    pub(super) fn matches_reply(&self, reply: &NxtReply<'_>) -> bool {
        if reply.opcode != self.opcode() {
            return false;
        }
        let repeated = bytes_at::<1>(reply.values, 0);
        match self {
            _ if reply.status.0 != 0 => true,
            Self::IoMap(window) => parse_reply(reply)
                .is_some_and(|(module, length, _)| module == window.module.id() && length == window.length),
            Self::Motor(port) => repeated == Some([port.number()]),
            Self::Analog(port) => repeated == Some([*port]),
            Self::SyncBarrier | Self::Digital(_) | Self::SetUp { .. } | Self::Battery | Self::Mailbox(_) => true,
        }
    }

    /// True if it is sent in almost every round.
    pub(super) const fn is_for_data(&self) -> bool {
        match self {
            Self::IoMap(window) => !matches!(window.module, FirmwareModule::Command),
            Self::Motor(_) | Self::Analog(_) | Self::Digital(_) => true,
            Self::SyncBarrier | Self::SetUp { .. } | Self::Battery | Self::Mailbox(_) => false,
        }
    }
}

/// Most abandoned requests that are remembered; while a barrier is outstanding nothing else is sent, so there are only
/// a few.
const MAX_OVERDUE: usize = 8;

#[derive(Clone, Debug, PartialEq)]
pub(super) struct PendingRequest {
    pub(super) request: NxtRequest,
    pub(super) sent: Timestamp<HostClock>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum ReplyMatch {
    Reply(PendingRequest),
    TooLate,
    Unexpected,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SyncBarrier {
    Clear,
    Needed,
    Pending,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RequestCounts {
    pub(super) answered: u64,
    /// Abandoned requests, barriers excluded.
    pub(super) lost: u64,
    /// Replies to abandoned requests, and to none.
    pub(super) late: u64,
}

#[derive(Debug)]
pub(super) struct RequestTracker {
    timeout: TimeDelta,
    waiting: VecDeque<PendingRequest>,
    overdue: VecDeque<NxtRequest>,
    barrier: SyncBarrier,
    tally: RequestCounts,
}

impl RequestTracker {
    pub(super) const fn new(timeout: TimeDelta) -> Self {
        Self {
            timeout,
            waiting: VecDeque::new(),
            overdue: VecDeque::new(),
            barrier: SyncBarrier::Needed,
            tally: RequestCounts { answered: 0, lost: 0, late: 0 },
        }
    }

    pub(super) fn restart(&mut self) {
        self.waiting.clear();
        self.overdue.clear();
        self.barrier = SyncBarrier::Needed;
    }

    pub(super) fn needs_barrier(&self) -> bool {
        self.barrier == SyncBarrier::Needed
    }

    /// Whether another request may be sent with at most `most` outstanding.
    pub(super) fn has_capacity(&self, most: usize) -> bool {
        match self.barrier {
            SyncBarrier::Clear => self.waiting.len() < most,
            SyncBarrier::Needed => self.waiting.is_empty(),
            SyncBarrier::Pending => false,
        }
    }

    /// Whether an equal request is outstanding. It must not be sent again before: the reply would be ambiguous.
    pub(super) fn is_waiting_for(&self, request: &NxtRequest) -> bool {
        self.waiting.iter().any(|pending| pending.request == *request)
    }

    pub(super) const fn counts(&self) -> RequestCounts {
        self.tally
    }

    pub(super) fn record_sent(&mut self, request: NxtRequest, sent: Timestamp<HostClock>) {
        if request == NxtRequest::SyncBarrier {
            self.barrier = SyncBarrier::Pending;
        }
        self.waiting.push_back(PendingRequest { request, sent });
    }

    pub(super) fn match_reply(&mut self, reply: &NxtReply<'_>) -> ReplyMatch {
        let fits = |request: &NxtRequest| request.matches_reply(reply);
        if NxtRequest::SyncBarrier.matches_reply(reply) {
            return self.match_barrier();
        }
        if let Some(at) = self.overdue.iter().position(fits) {
            self.overdue.remove(at);
            self.tally.late += 1;
            return ReplyMatch::TooLate;
        }
        let found = self.waiting.iter().position(|pending| fits(&pending.request));
        let Some(pending) = found.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return ReplyMatch::Unexpected;
        };
        self.tally.answered += 1;
        ReplyMatch::Reply(pending)
    }

    /// Any reply to a barrier settles all earlier requests.
    fn match_barrier(&mut self) -> ReplyMatch {
        let is_waited_for = self.barrier == SyncBarrier::Pending;
        let waiting = self.waiting.iter().position(|pending| pending.request == NxtRequest::SyncBarrier);
        let Some(pending) = waiting.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return if is_waited_for { ReplyMatch::TooLate } else { ReplyMatch::Unexpected };
        };
        self.overdue.clear();
        self.barrier = SyncBarrier::Clear;
        self.tally.answered += 1;
        ReplyMatch::Reply(pending)
    }

    /// Abandons the oldest request after the time-out; a barrier must follow.
    pub(super) fn expire(&mut self, now: Timestamp<HostClock>) -> Option<NxtRequest> {
        if self.deadline().is_none_or(|due| due > now) {
            return None;
        }
        let pending = self.waiting.pop_front()?;
        self.abandon(pending.request.clone());
        Some(pending.request)
    }

    /// The stream is out of step: replies to the outstanding requests will not be recognized. Returns these requests.
    pub(super) fn abort_all(&mut self) -> Vec<NxtRequest> {
        let mut lost = Vec::new();
        while let Some(pending) = self.waiting.pop_front() {
            self.abandon(pending.request.clone());
            lost.push(pending.request);
        }
        self.barrier = SyncBarrier::Needed;
        lost
    }

    fn abandon(&mut self, request: NxtRequest) {
        self.barrier = SyncBarrier::Needed;
        if request == NxtRequest::SyncBarrier {
            return;
        }
        self.tally.lost += 1;
        if self.overdue.len() >= MAX_OVERDUE {
            self.overdue.pop_front();
        }
        self.overdue.push_back(request);
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.waiting.front().map(|pending| pending.sent + self.timeout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bricks::nxt::io_maps::{ALL_INPUTS, ALL_MOTORS};

    const VERSION: [u8; 7] = [0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01];

    fn motors() -> Vec<u8> {
        let mut telegram = vec![0x02, 0x94, 0x00, 0x01, 0x00, 0x02, 0x00, 0x60, 0x00];
        telegram.resize(9 + 96, 0);
        telegram
    }

    fn begun() -> RequestTracker {
        let mut requests = RequestTracker::new(TimeDelta::from_millis(500));
        requests.record_sent(NxtRequest::SyncBarrier, Timestamp::ZERO);
        requests.match_reply(&NxtReply::parse(&VERSION).unwrap());
        requests
    }

    #[test]
    fn a_late_reply_never_matches_a_later_request() {
        let mut requests = begun();
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::ZERO);
        assert_eq!(requests.deadline(), Some(Timestamp::from_millis(500)));
        assert_eq!(requests.expire(Timestamp::from_millis(499)), None);
        let expired = requests.expire(Timestamp::from_millis(500));
        assert_eq!(expired, Some(NxtRequest::IoMap(ALL_MOTORS)));
        assert!(requests.needs_barrier() && requests.has_capacity(1));

        // Only the barrier may be sent before the fate of the reply is known.
        requests.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500));
        assert!(!requests.has_capacity(2));
        let motors = motors();
        assert_eq!(requests.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::TooLate);
        assert!(matches!(requests.match_reply(&NxtReply::parse(&VERSION).unwrap()), ReplyMatch::Reply(_)));
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(600));
        assert!(matches!(requests.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::Reply(_)));
        let tally = requests.counts();
        assert_eq!((tally.answered, tally.lost, tally.late), (4 - 1, 1, 1));
    }

    #[test]
    fn a_reply_that_never_came_is_forgotten_after_the_barrier() {
        let mut requests = begun();
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::ZERO);
        requests.expire(Timestamp::from_millis(500));
        requests.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500));
        requests.match_reply(&NxtReply::parse(&VERSION).unwrap());
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(530));
        let motors = motors();
        assert!(matches!(
            requests.match_reply(&NxtReply::parse(&motors).unwrap()),
            ReplyMatch::Reply(pending) if pending.sent == Timestamp::from_millis(530)
        ));
    }

    #[test]
    fn replies_match_their_own_request_out_of_two() {
        let mut requests = begun();
        requests.record_sent(NxtRequest::IoMap(ALL_INPUTS), Timestamp::ZERO);
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(1));
        assert!(!requests.has_capacity(2));
        let motors = motors();
        assert!(matches!(
            requests.match_reply(&NxtReply::parse(&motors).unwrap()),
            ReplyMatch::Reply(pending) if pending.request == NxtRequest::IoMap(ALL_MOTORS)
        ));
        assert_eq!(requests.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::Unexpected);
        assert_eq!(requests.abort_all(), [NxtRequest::IoMap(ALL_INPUTS)]);
        assert!(requests.needs_barrier());
    }

    #[test]
    fn late_barrier_replies_after_a_stall_do_no_harm() {
        let mut requests = RequestTracker::new(TimeDelta::from_millis(500));
        for half_second in 0..3 {
            requests.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500 * half_second));
            if half_second < 2 {
                requests.expire(Timestamp::from_millis(500 * (half_second + 1)));
            }
        }
        let version = NxtReply::parse(&VERSION).unwrap();
        assert!(matches!(requests.match_reply(&version), ReplyMatch::Reply(_)));
        assert_eq!(requests.match_reply(&version), ReplyMatch::Unexpected);
        assert!(requests.has_capacity(1));
        assert_eq!(requests.counts().lost, 0);
    }
}
