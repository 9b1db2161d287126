//! The estimate in a mailbox of the brick, and whether a program reads it there.
//!
//! Messages are sent without a reply, because a reply costs a turn-around of the radio chip. Without a program on the
//! brick they are not read; to detect that, one every few seconds requires a reply. It waits for its turn like other
//! requests.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::telegram::{NxtStatus, ReplyRequest, message_write};
use crate::bricks::codec::estimate_bytes;
use crate::message::PlanarPose;

/// Interval of estimates to a program that pushes: each turns the radio around, which cannot send and receive at once,
/// and delays the frames.
pub(super) const PUSHED_INTERVAL: TimeDelta = TimeDelta::from_millis(200);
/// Interval of the probes, because a program may be started at any time.
const PROBE_PERIOD: TimeDelta = TimeDelta::from_millis(5_000);

#[derive(Debug)]
pub(super) struct EstimateMailbox {
    number: u8,
    interval: TimeDelta,
    last: Option<Timestamp<HostClock>>,
    /// A program reads the mailbox, as far as is known.
    is_read: bool,
    next_probe: Option<Timestamp<HostClock>>,
    /// The probe, while it waits for its turn.
    probe: Option<Vec<u8>>,
    sequence: u16,
}

impl EstimateMailbox {
    pub(super) const fn new(number: u8, interval: TimeDelta) -> Self {
        Self { number, interval, last: None, is_read: false, next_probe: None, probe: None, sequence: 0 }
    }

    pub(super) fn reset(&mut self) {
        *self = Self { sequence: self.sequence, ..Self::new(self.number, self.interval) };
    }

    /// The telegram that sends an estimate at once, if allowed; otherwise the next probe carries it, or it is dropped.
    pub(super) fn publish(
        &mut self,
        now: Timestamp<HostClock>,
        pose: &PlanarPose,
        brick_millis: u32,
    ) -> Option<Vec<u8>> {
        let is_probe = self.probe.is_some() || self.next_probe.is_none_or(|due| now >= due);
        if !is_probe && !self.is_read {
            return None;
        }
        if self.last.is_some_and(|last| now - last < self.interval) {
            return None;
        }
        self.last = Some(now);
        let message = estimate_bytes(brick_millis, pose, sigma_m(pose), self.sequence);
        self.sequence = self.sequence.wrapping_add(1);
        if is_probe {
            self.probe = message_write(self.number, &message, ReplyRequest::Required);
            return None;
        }
        message_write(self.number, &message, ReplyRequest::NotRequired)
    }

    pub(super) fn take_probe(&mut self, now: Timestamp<HostClock>) -> Option<Vec<u8>> {
        let probe = self.probe.take()?;
        self.next_probe = Some(now + PROBE_PERIOD);
        Some(probe)
    }

    pub(super) fn record_probe_reply(&mut self, status: NxtStatus) {
        // A full mailbox drops its oldest message: a program will read it, or one runs that does not.
        self.is_read = status == NxtStatus::OK;
    }
}

/// Infinite when there is none.
fn sigma_m(pose: &PlanarPose) -> f64 {
    let sigma_m = pose.position_sigma_m();
    if sigma_m.is_nan() { f64::INFINITY } else { sigma_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{PoseFlags, WireStamp};
    use posebridge_telemetry::{Heading, Meters, MetersPerSecond, Pose, RadiansPerSecond};

    fn pose() -> PlanarPose {
        PlanarPose {
            stamp: WireStamp::Micros32(0),
            pose: Pose::new(Meters(1.5), Meters(-2.0), Heading::from_rad(0.5)),
            forward_speed: MetersPerSecond(0.0),
            turn_rate: RadiansPerSecond(0.0),
            covariance: [1e-4, 0.0, 0.0, 0.0625, 0.0, 1e-4],
            fix_age: None,
            reset_counter: 3,
            flags: PoseFlags { position_valid: true, heading_valid: true, ..PoseFlags::default() },
            epoch: 0,
        }
    }

    /// IEEE 754: 1.5 is 3fc00000, -2 is c0000000, 0.5 is 3f000000, 0.25 is 3e800000.
    #[test]
    fn an_estimate_is_these_bytes() {
        let expected = [
            0x78, 0x56, 0x34, 0x12, 0x00, 0x00, 0xC0, 0x3F, 0x00, 0x00, 0x00, 0xC0, 0x00, 0x00, 0x00, 0x3F, 0x00, 0x00,
            0x80, 0x3E, 0x03, 0x03, 0x02, 0x01,
        ];
        assert_eq!(estimate_bytes(0x1234_5678, &pose(), sigma_m(&pose()), 0x0102), expected);
        let mut lost = pose();
        lost.covariance[0] = f64::NAN;
        lost.covariance[3] = f64::NAN;
        lost.flags = PoseFlags::default();
        let bytes = estimate_bytes(0, &lost, sigma_m(&lost), 0);
        assert_eq!(bytes[16..21], [0x00, 0x00, 0x80, 0x7F, 0x00]);
    }

    #[test]
    fn the_first_and_one_every_five_seconds_request_a_reply_and_the_others_do_not() {
        let mut mailbox = EstimateMailbox::new(4, TimeDelta::ZERO);
        let start = Timestamp::from_millis(100);
        assert_eq!(mailbox.publish(start, &pose(), 0), None);
        let probe = mailbox.take_probe(start).unwrap();
        assert_eq!(probe[..4], [0x00, 0x09, 0x04, 25]);
        assert_eq!((probe.len(), probe[28]), (29, 0));
        // Until the answer is there nothing more leaves.
        assert_eq!(mailbox.publish(Timestamp::from_millis(150), &pose(), 0), None);
        assert_eq!(mailbox.take_probe(Timestamp::from_millis(150)), None);
        mailbox.record_probe_reply(NxtStatus::OK);
        let plain = mailbox.publish(Timestamp::from_millis(200), &pose(), 0).unwrap();
        assert_eq!(plain[..4], [0x80, 0x09, 0x04, 25]);
        assert!(mailbox.publish(Timestamp::from_millis(5_099), &pose(), 0).is_some());
        assert_eq!(mailbox.publish(Timestamp::from_millis(5_100), &pose(), 0), None);
        assert!(mailbox.take_probe(Timestamp::from_millis(5_100)).is_some());
    }

    #[test]
    fn estimates_keep_their_distance() {
        let mut mailbox = EstimateMailbox::new(0, PUSHED_INTERVAL);
        mailbox.publish(Timestamp::ZERO, &pose(), 0);
        mailbox.take_probe(Timestamp::ZERO);
        mailbox.record_probe_reply(NxtStatus::OK);
        let left = (1..=100).filter(|step| {
            let now = Timestamp::from_millis(40 * step);
            mailbox.publish(now, &pose(), 0).is_some()
        });
        assert_eq!(left.count(), 20);
    }
}
