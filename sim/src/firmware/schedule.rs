//! The schedule of the brick's messages: its defaults, and the intervals that a station requested.

use posebridge_protocol::dialect::ids;
use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

use crate::mavlink_node::IntervalRequest;
use crate::scenario::{BrickSettings, ThermometerSettings, Wire};

/// The description comes this often, so that a station that starts late has it soon.
const DESCRIPTION_PERIOD: TimeDelta = TimeDelta::from_millis(5_000);
/// No message comes more often than the world moves.
const SHORTEST: TimeDelta = TimeDelta::from_millis(1);

/// What the brick has to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topic {
    /// The wheels.
    Wheels,
    /// Gyro and accelerometers.
    Inertial,
    /// The robot's build.
    Description,
    /// The thermometer.
    Thermometer,
}

#[derive(Clone, Copy, Debug)]
struct ScheduledMessage {
    topic: Topic,
    message_id: u32,
    default: TimeDelta,
    interval: Option<TimeDelta>,
    due: Timestamp<BrickClock>,
}

/// All messages with their intervals.
#[derive(Clone, Debug)]
pub(crate) struct Schedule {
    slots: Vec<ScheduledMessage>,
}

impl Schedule {
    /// The defaults of a brick that was powered up at `now`; everything is due at once.
    pub(crate) fn new(
        settings: &BrickSettings,
        thermometer: Option<&ThermometerSettings>,
        now: Timestamp<BrickClock>,
    ) -> Self {
        let telemetry = TimeDelta::from_secs_f64(1.0 / settings.telemetry_hz);
        let (wheels, inertial) = match settings.wire {
            Wire::Compact => (ids::PB_WHEEL_TICKS, ids::PB_INERTIAL),
            Wire::Standard => (ids::WHEEL_DISTANCE, ids::SCALED_IMU),
        };
        let slot = |topic, message_id, default| ScheduledMessage {
            topic,
            message_id,
            default,
            interval: Some(default),
            due: now,
        };
        let thermometer = thermometer.map(|settings| {
            let message_id = if settings.is_scaled_pressure() { ids::SCALED_PRESSURE } else { ids::NAMED_VALUE_FLOAT };
            let period = TimeDelta::from_secs_f64(1.0 / settings.rate_hz);
            slot(Topic::Thermometer, message_id, period)
        });
        Self {
            slots: [
                slot(Topic::Description, ids::PB_ROBOT_DESCRIPTION, DESCRIPTION_PERIOD),
                slot(Topic::Wheels, wheels, telemetry),
                slot(Topic::Inertial, inertial, telemetry),
            ]
            .into_iter()
            .chain(thermometer)
            .collect(),
        }
    }

    /// The messages that the brick has.
    pub(crate) fn message_ids(&self) -> Vec<u32> {
        self.slots.iter().map(|slot| slot.message_id).collect()
    }

    /// Follows a request; one for a message that the brick does not have changes nothing.
    pub(crate) fn apply_request(&mut self, request: IntervalRequest, now: Timestamp<BrickClock>) {
        for slot in &mut self.slots {
            if slot.message_id != request.message_id {
                continue;
            }
            slot.interval = match request.interval {
                Some(span) if span <= TimeDelta::ZERO => Some(slot.default),
                Some(span) => Some(span.max(SHORTEST)),
                None => None,
            };
            slot.due = now;
        }
    }

    /// The next topic that is due at `now`; each comes once per interval.
    pub(crate) fn next(&mut self, now: Timestamp<BrickClock>) -> Option<Topic> {
        for slot in &mut self.slots {
            let Some(interval) = slot.interval else {
                continue;
            };
            if slot.due > now {
                continue;
            }
            slot.due = slot.due + interval;
            if slot.due <= now {
                slot.due = now + interval;
            }
            return Some(slot.topic);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(schedule: &mut Schedule, topic: Topic, from_ms: i64, to_ms: i64) -> usize {
        let mut found = 0;
        for ms in from_ms..to_ms {
            while let Some(due) = schedule.next(Timestamp::from_millis(ms)) {
                found += usize::from(due == topic);
            }
        }
        found
    }

    #[test]
    fn defaults_requests_and_stops_are_kept() {
        let mut schedule = Schedule::new(&BrickSettings::default(), None, Timestamp::ZERO);
        assert_eq!(count(&mut schedule, Topic::Wheels, 0, 1_000), 20);
        let ask = |interval| IntervalRequest { message_id: ids::PB_WHEEL_TICKS, interval };
        schedule.apply_request(ask(Some(TimeDelta::from_millis(100))), Timestamp::from_millis(1_000));
        assert_eq!(count(&mut schedule, Topic::Wheels, 1_000, 2_000), 10);
        schedule.apply_request(ask(None), Timestamp::from_millis(2_000));
        assert_eq!(count(&mut schedule, Topic::Wheels, 2_000, 3_000), 0);
        schedule.apply_request(ask(Some(TimeDelta::ZERO)), Timestamp::from_millis(3_000));
        assert_eq!(count(&mut schedule, Topic::Wheels, 3_000, 4_000), 20);
    }

    #[test]
    fn a_request_for_a_foreign_message_changes_nothing() {
        let mut schedule = Schedule::new(&BrickSettings::default(), None, Timestamp::ZERO);
        schedule.apply_request(IntervalRequest { message_id: ids::HEARTBEAT, interval: None }, Timestamp::ZERO);
        assert_eq!(count(&mut schedule, Topic::Inertial, 0, 1_000), 20);
    }
}
