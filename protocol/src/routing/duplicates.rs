//! Recognizes frames that came before by another endpoint, and frames that the station sent itself (docs/routing.md, "Loops
//! and duplicates").
//!
//! A frame is known by the hash of its bytes; on redundant links a message with a timestamp is also known by the hash of its
//! source, id and payload, because a sender counts its frames on each link for itself. A frame from our own address is an
//! echo if its fingerprint (checksum, sequence number, lowest byte of the id) is among those of our last frames. Two frames
//! share a 64-bit hash by chance 3 times in 10^12 (10^4 frames); a foreign one is taken for an echo once in 524288 times.

#[expect(clippy::disallowed_types, reason = "see DuplicateGuard")]
use std::collections::HashMap;
use std::collections::{BTreeSet, VecDeque};
use std::hash::{DefaultHasher, Hasher};

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::endpoints::Endpoint;
use crate::dialect::ids;
use crate::framing::{FrameHeader, FrameRef};

/// Number of remembered keys per endpoint; the oldest of all are dropped first. A line of 115200 baud carries 8229 of
/// the smallest telemetry frames (21 bytes) in 15 s.
const KEYS_PER_ENDPOINT: usize = 8_192;
/// With fewer endpoints the number of keys is that for this many.
const MIN_ENDPOINTS: usize = 2;
/// With more endpoints the number of keys is that for this many: a sender may invent peers, and a key takes about 80
/// bytes.
const MAX_ENDPOINTS: usize = 32;
/// Number of preallocated keys: ten seconds of a brick, which arrive at once after a stall and should not grow a
/// station's memory.
const RESERVED_KEYS: usize = 4_096;
const MAX_WAITING: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum FrameKey {
    Frame(u64),
    Content(u64),
}

pub(super) fn frame_key(frame: &[u8]) -> FrameKey {
    FrameKey::Frame(hash([frame]))
}

/// The key of a frame's content, within a group of redundant links.
pub(super) fn content_key(group: u16, frame: &FrameRef<'_>) -> FrameKey {
    let [id0, id1, id2, _] = frame.message_id.to_le_bytes();
    let [group0, group1] = group.to_le_bytes();
    let source = frame.source;
    let head = [group0, group1, source.system.0, source.component.0, id0, id1, id2];
    // MAVLink 1 does not cut off trailing zeros.
    let zeros = frame.payload.iter().rev().take_while(|byte| **byte == 0).count();
    let payload = &frame.payload[..frame.payload.len() - zeros];
    FrameKey::Content(hash([&head, payload]))
}

/// The same in every run of the program: the hash keys are fixed.
fn hash<const N: usize>(parts: [&[u8]; N]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for part in parts {
        hasher.write(part);
    }
    hasher.finish()
}

#[derive(Clone, Copy, Debug)]
struct ReceivedFrame {
    arrival: Timestamp<HostClock>,
    endpoint: Endpoint,
}

/// The frames received within the window.
///
/// Sorting a key in takes longer than everything else that is done with a small frame, so it is deferred until no reply
/// is due ([`Self::sort_and_expire`]), and while frames come from a single endpoint, where none can be a duplicate.
/// Lookups include the unsorted keys.
#[expect(clippy::disallowed_types, reason = "keys are looked up and never walked through: no order can leak")]
#[derive(Clone, Debug)]
pub(super) struct DuplicateGuard {
    window: TimeDelta,
    recent: HashMap<FrameKey, ReceivedFrame>,
    /// Every record, oldest first; a key that was recorded again is in it twice.
    expiry_order: VecDeque<(Timestamp<HostClock>, FrameKey)>,
    /// Records that are not sorted in, oldest first.
    unsorted: VecDeque<(FrameKey, ReceivedFrame)>,
    /// The endpoints of the records, at most [`MAX_ENDPOINTS`].
    endpoints: BTreeSet<Endpoint>,
    /// The endpoint of the last record, and when a record last came from another endpoint than the one before it.
    last_endpoint: Option<Endpoint>,
    last_endpoint_change: Timestamp<HostClock>,
}

#[expect(clippy::disallowed_types, reason = "see DuplicateGuard")]
impl DuplicateGuard {
    pub(super) fn new(window: TimeDelta) -> Self {
        Self {
            window,
            recent: HashMap::with_capacity(RESERVED_KEYS),
            expiry_order: VecDeque::with_capacity(RESERVED_KEYS),
            unsorted: VecDeque::with_capacity(MAX_WAITING),
            endpoints: BTreeSet::new(),
            last_endpoint: None,
            last_endpoint_change: Timestamp::ZERO,
        }
    }

    /// Records a key from `endpoint`, and returns the other endpoint from which it came first within the window.
    pub(super) fn record(&mut self, now: Timestamp<HostClock>, endpoint: Endpoint, key: FrameKey) -> Option<Endpoint> {
        if self.unsorted.len() >= MAX_WAITING {
            self.sort_and_expire(now);
        }
        let first = self.first_endpoint(now, endpoint, key);
        if first.is_some() {
            return first;
        }
        if self.last_endpoint.replace(endpoint) != Some(endpoint) {
            self.last_endpoint_change = now;
        }
        self.unsorted.push_back((key, ReceivedFrame { arrival: now, endpoint }));
        None
    }

    /// The other endpoint from which a key came first within the window.
    pub(super) fn first_endpoint(
        &self,
        now: Timestamp<HostClock>,
        endpoint: Endpoint,
        key: FrameKey,
    ) -> Option<Endpoint> {
        if self.last_endpoint == Some(endpoint) && self.is_single_endpoint(now) {
            return None;
        }
        let waiting = self.unsorted.iter().rev().find(|(other, _)| *other == key);
        let note = waiting.map(|(_, note)| note).or_else(|| self.recent.get(&key))?;
        (now - note.arrival < self.window).then_some(note.endpoint).filter(|first| *first != endpoint)
    }

    /// Whether all frames within the window came from the endpoint of the last one: then none is a duplicate.
    fn is_single_endpoint(&self, now: Timestamp<HostClock>) -> bool {
        now - self.last_endpoint_change >= self.window
    }

    /// Sorts in the deferred records, and discards the expired ones.
    pub(super) fn sort_and_expire(&mut self, now: Timestamp<HostClock>) {
        if self.is_single_endpoint(now) {
            self.expire_unsorted(now);
        } else {
            for (key, note) in self.unsorted.drain(..) {
                if self.endpoints.len() < MAX_ENDPOINTS {
                    self.endpoints.insert(note.endpoint);
                }
                self.recent.insert(key, note);
                self.expiry_order.push_back((note.arrival, key));
            }
        }
        self.expire_sorted(now);
    }

    fn max_keys(&self) -> usize {
        KEYS_PER_ENDPOINT * self.endpoints.len().clamp(MIN_ENDPOINTS, MAX_ENDPOINTS)
    }

    fn expire_unsorted(&mut self, now: Timestamp<HostClock>) {
        let max_keys = self.max_keys();
        while self
            .unsorted
            .front()
            .is_some_and(|(_, note)| now - note.arrival >= self.window || self.unsorted.len() > max_keys)
        {
            self.unsorted.pop_front();
        }
    }

    fn expire_sorted(&mut self, now: Timestamp<HostClock>) {
        let max_keys = self.max_keys();
        while let Some((noted, key)) = self.expiry_order.front().copied() {
            if now - noted < self.window && self.expiry_order.len() <= max_keys {
                break;
            }
            self.expiry_order.pop_front();
            if self.recent.get(&key).is_some_and(|last| last.arrival == noted) {
                self.recent.remove(&key);
            }
        }
    }
}

/// Number of remembered sent frames. At a hundred frames per second on each of four links it is 20 s: longer than a
/// frame takes round a loop.
const MAX_SENT_FRAMES: usize = 8_192;
#[derive(Clone, Debug)]
pub(super) struct SentFrameLog(VecDeque<u32>);

impl Default for SentFrameLog {
    fn default() -> Self {
        Self(VecDeque::with_capacity(MAX_SENT_FRAMES))
    }
}

impl SentFrameLog {
    pub(super) fn record(&mut self, frame: &[u8]) {
        if self.0.len() == MAX_SENT_FRAMES {
            self.0.pop_front();
        }
        self.0.extend(fingerprint(frame));
    }

    pub(super) fn contains(&self, frame: &[u8]) -> bool {
        fingerprint(frame).is_some_and(|mark| self.0.contains(&mark))
    }
}

/// `None` for bytes that are no complete frame.
fn fingerprint(frame: &[u8]) -> Option<u32> {
    let header = FrameHeader::parse(frame).filter(|header| header.total <= frame.len())?;
    let (_, sum) = header.covered(frame);
    let [low, high] = sum.to_le_bytes();
    Some(u32::from_le_bytes([low, high, header.sequence, header.message_id as u8]))
}

/// Messages whose payload contains the sender's time: all telemetry that is fused here, and the most common others.
/// Source: common.xml (fields time_usec and time_boot_ms), our own dialect (time_us). By rising id.
const TIMESTAMPED_MESSAGES: &[u32] = &[
    ids::SYSTEM_TIME,
    24, // GPS_RAW_INT
    ids::SCALED_IMU,
    27, // RAW_IMU
    28, // RAW_PRESSURE
    ids::SCALED_PRESSURE,
    ids::ATTITUDE,
    31, // ATTITUDE_QUATERNION
    ids::LOCAL_POSITION_NED,
    33,  // GLOBAL_POSITION_INT
    36,  // SERVO_OUTPUT_RAW
    65,  // RC_CHANNELS
    85,  // POSITION_TARGET_LOCAL_NED
    101, // GLOBAL_VISION_POSITION_ESTIMATE
    ids::VISION_POSITION_ESTIMATE,
    103, // VISION_SPEED_ESTIMATE
    104, // VICON_POSITION_ESTIMATE
    ids::HIGHRES_IMU,
    106, // OPTICAL_FLOW_RAD
    116, // SCALED_IMU2
    129, // SCALED_IMU3
    ids::DISTANCE_SENSOR,
    ids::ATT_POS_MOCAP,
    ids::ESTIMATOR_STATUS,
    ids::NAMED_VALUE_FLOAT,
    ids::ODOMETRY,
    ids::DEBUG_FLOAT_ARRAY,
    ids::WHEEL_DISTANCE,
    ids::PB_WHEEL_TICKS,
    ids::PB_INERTIAL,
    ids::PB_PLANAR_POSE,
    ids::PB_FUSION_HEALTH,
];

/// Whether equal payloads of this message mean the same message.
pub fn has_timestamp(message_id: u32) -> bool {
    TIMESTAMPED_MESSAGES.binary_search(&message_id).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::Encoder;
    use crate::framing::{START_BYTE_V1, START_BYTE_V2, WireVersion};
    use mavlink::dialects::common;
    use mavlink_core::Message as _;
    use posebridge_telemetry::Address;
    use posebridge_telemetry::{LinkId, PeerId};

    const WINDOW: TimeDelta = TimeDelta::from_millis(1_000);

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    fn endpoint(link: u16) -> Endpoint {
        Endpoint { link: LinkId(link), peer: PeerId(0) }
    }

    #[test]
    fn a_copy_from_another_endpoint_within_the_window_is_a_duplicate() {
        let mut guard = DuplicateGuard::new(WINDOW);
        let key = FrameKey::Frame(7);
        assert_eq!(guard.record(at(0), endpoint(0), key), None);
        assert_eq!(guard.record(at(10), endpoint(1), key), Some(endpoint(0)));
        assert_eq!(guard.record(at(20), endpoint(1), key), Some(endpoint(0)));
        assert_eq!(guard.record(at(500), endpoint(0), key), None, "said again");
        assert_eq!(guard.record(at(1_499), endpoint(1), key), Some(endpoint(0)));
        assert_eq!(guard.record(at(1_500), endpoint(1), key), None, "forgotten");
        assert_eq!(guard.record(at(1_501), endpoint(0), key), Some(endpoint(1)));
        assert_eq!(guard.record(at(1_502), endpoint(0), FrameKey::Content(7)), None);
    }

    #[test]
    fn when_keys_are_sorted_in_makes_no_difference() {
        // Two endpoints that bring many of the same frames, at times one alone for longer than the window.
        let brought = (0..40_000_u64).map(|i| {
            let is_alone = (i / 5_000).is_multiple_of(2);
            let source = endpoint(if is_alone { 0 } else { (i * 7 % 3) as u16 % 2 });
            (at(i as i64), source, FrameKey::Frame(i * 31 % 997))
        });
        let run = |settles_every: usize| -> Vec<Option<Endpoint>> {
            let mut guard = DuplicateGuard::new(WINDOW);
            let steps = brought.clone().enumerate();
            steps
                .map(|(index, (now, source, key))| {
                    if index.is_multiple_of(settles_every) {
                        guard.sort_and_expire(now);
                    }
                    guard.record(now, source, key)
                })
                .collect()
        };
        let at_once = run(1);
        assert!(at_once.iter().flatten().count() > 1_000);
        assert_eq!(run(50), at_once);
        assert_eq!(run(usize::MAX), at_once);
    }

    #[test]
    fn without_a_window_nothing_is_a_duplicate_and_a_waiting_key_is_found() {
        let mut off = DuplicateGuard::new(TimeDelta::ZERO);
        assert_eq!(off.record(at(0), endpoint(0), FrameKey::Frame(1)), None);
        assert_eq!(off.record(at(0), endpoint(1), FrameKey::Frame(1)), None);
        let mut guard = DuplicateGuard::new(WINDOW);
        for key in 0..100_000 {
            guard.record(at(0), endpoint(0), FrameKey::Frame(key));
        }
        assert!(guard.unsorted.len() <= MAX_WAITING);
        assert_eq!(guard.record(at(0), endpoint(1), FrameKey::Frame(0)), None);
        assert_eq!(guard.record(at(0), endpoint(1), FrameKey::Frame(99_999)), Some(endpoint(0)));
    }

    #[test]
    fn the_memory_grows_with_the_endpoints_and_is_bounded() {
        for (links, expected) in [(1, 16_384), (2, 16_384), (4, 32_768), (200, 262_144)] {
            let mut guard = DuplicateGuard::new(WINDOW);
            for key in 0..300_000 {
                guard.record(at(0), endpoint((key % links) as u16), FrameKey::Frame(key));
            }
            guard.sort_and_expire(at(0));
            assert_eq!((guard.recent.len(), guard.expiry_order.len()), (expected, expected), "{links} links");
        }
    }

    use crate::message::{Heartbeat, Message};

    fn heartbeat(system_status: u8) -> Message {
        Message::Heartbeat(Heartbeat { vehicle_type: 18, autopilot: 8, base_mode: 0, system_status })
    }

    #[test]
    fn only_sent_frames_are_recognized_in_both_versions() {
        for version in [WireVersion::V1, WireVersion::V2] {
            let mut encoder = Encoder::new(version);
            let mut log = SentFrameLog::default();
            let mut next = |status| {
                let mut bytes = Vec::new();
                encoder.encode(Address::new(1, 197), &heartbeat(status), &mut bytes);
                bytes
            };
            let (first, second) = (next(4), next(4));
            log.record(&first);
            assert!(log.contains(&first), "{version:?}");
            assert!(!log.contains(&second), "{version:?}: never said");
            let other = {
                let mut bytes = Vec::new();
                let source = Address::new(1, 197);
                Encoder::new(version).encode(source, &heartbeat(3), &mut bytes);
                bytes
            };
            assert!(!log.contains(&other), "{version:?}: the same number");
        }
    }

    #[test]
    fn invalid_frames_are_not_recorded_and_the_memory_is_bounded() {
        let mut log = SentFrameLog::default();
        for invalid in [&[][..], &[START_BYTE_V2; 4], &[START_BYTE_V2; 20], &[START_BYTE_V1; 7], &[0; 40]] {
            log.record(invalid);
            assert!(!log.contains(invalid), "{invalid:?}");
        }
        let mut frame = [START_BYTE_V1, 0, 0, 1, 197, 0, 0, 0];
        for k in 0..20_000_u16 {
            [frame[6], frame[7]] = k.to_le_bytes();
            log.record(&frame);
        }
        assert!(log.contains(&frame) && log.0.len() == MAX_SENT_FRAMES);
        [frame[6], frame[7]] = [0, 0];
        assert!(!log.contains(&frame));
    }

    #[test]
    fn the_list_can_be_searched() {
        assert!(TIMESTAMPED_MESSAGES.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn every_standard_message_of_the_list_has_a_field_for_the_time() {
        let standard = TIMESTAMPED_MESSAGES.iter().filter(|id| **id < 42_000);
        for id in standard {
            let message = common::MavMessage::default_message_from_id(*id).unwrap();
            let fields = format!("{message:?}");
            let is_stamped = ["time_usec:", "time_boot_ms:", "usec:"].iter().any(|field| fields.contains(field));
            assert!(is_stamped, "{id}: {fields}");
        }
    }
}
