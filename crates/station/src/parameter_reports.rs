//! Which changed parameters are still to be reported on a link, at a bounded rate: one set may change the list of hundreds of vehicles.

use std::collections::BTreeSet;
use std::ops::Bound::{Excluded, Unbounded};

use posebridge_telemetry::{HostClock, RobotId, TimeDelta, Timestamp};

/// Time between two reports on one link, as between the values of a list.
const REPORT_INTERVAL: TimeDelta = TimeDelta::from_millis(20);

/// A robot as a vehicle; `None` for the station itself.
type Participant = Option<RobotId>;

/// The participants of a link whose parameter has changed, by its index.
#[derive(Debug, Default)]
pub(crate) struct ParameterReports {
    pending: BTreeSet<(Participant, usize)>,
    last: Option<((Participant, usize), Timestamp<HostClock>)>,
}

impl ParameterReports {
    pub(crate) fn add(&mut self, participant: Participant, index: usize) {
        self.pending.insert((participant, index));
    }

    pub(crate) fn remove(&mut self, participant: Participant, index: usize) {
        self.pending.remove(&(participant, index));
    }

    pub(crate) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let earliest = self.last.map_or(Timestamp::ZERO, |(_, at)| at + REPORT_INTERVAL);
        (!self.pending.is_empty()).then_some(earliest)
    }

    pub(crate) fn is_due(&self, now: Timestamp<HostClock>) -> bool {
        self.deadline().is_some_and(|due| due <= now)
    }

    /// The next report, if it is due. They take turns, so that one that changes without end does not keep the others waiting.
    pub(crate) fn take_due(&mut self, now: Timestamp<HostClock>) -> Option<(Participant, usize)> {
        if !self.is_due(now) {
            return None;
        }
        let after = self.last.map_or(Unbounded, |(last, _)| Excluded(last));
        let next = *self.pending.range((after, Unbounded)).next().or_else(|| self.pending.first())?;
        self.pending.remove(&next);
        self.last = Some((next, now));
        Some(next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, LinkId};

    #[test]
    fn one_report_each_twenty_milliseconds_in_turn() {
        let vehicle = Some(RobotId { link: LinkId(0), address: Address::new(1, 1) });
        let mut reports = ParameterReports::default();
        let mut sent = Vec::new();
        for millis in 0..61 {
            // The station's changes all the time, the vehicle's once.
            reports.add(None, 3);
            if millis == 0 {
                reports.add(vehicle, 3);
            }
            let now = Timestamp::from_millis(millis);
            sent.extend(reports.take_due(now).map(|(participant, _)| (millis, participant)));
        }
        assert_eq!(sent, [(0, None), (20, vehicle), (40, None), (60, None)]);
    }
}
