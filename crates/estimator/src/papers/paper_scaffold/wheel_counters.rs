//! The travel between two neighbouring readings of the wheels' counters, in the order in which they come.

use posebridge_telemetry::{BrickClock, DriveGeometry, FusionOutcome, TimeDelta, Timestamp};

use crate::filter::FilterConfig;
use crate::models::differential_drive::{WheelTravel, body_step};
use crate::models::se2::BodyStep;
use crate::validation::reject_repeated;

/// A longer interval between two readings is a gap: five lost readings in a row at the papers' 20 Hz are still bridged.
pub(in crate::papers) const MAX_STEP: TimeDelta = TimeDelta::from_millis(300);

/// The wheels' rotation between two readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::papers) struct WheelStep {
    /// Length of the interval, more than zero.
    pub(in crate::papers) interval: TimeDelta,
    /// The left wheel's rotation, rad.
    pub(in crate::papers) left_rad: f64,
    /// The right wheel's rotation, rad.
    pub(in crate::papers) right_rad: f64,
}

impl WheelStep {
    /// Distance and turn that go with the rotation.
    pub(in crate::papers) fn body_step(&self, geometry: &DriveGeometry) -> BodyStep {
        let travel = WheelTravel {
            left_m: geometry.left_wheel_radius.0 * self.left_rad,
            right_m: geometry.right_wheel_radius.0 * self.right_rad,
        };
        body_step(travel, geometry)
    }

    /// Whether the interval is so long that its mean speed is no speed.
    pub(in crate::papers) fn is_gap(&self) -> bool {
        self.interval > MAX_STEP
    }
}

/// What a reading of the counters means beside the one before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum CounterOutcome {
    /// It is the first: the base from which the wheels turn.
    First,
    /// The wheels turned so far since the reading before.
    Step(WheelStep),
    /// No wheel turns that fast: the counters were zeroed or have leapt, and this is their new base.
    Rebased,
    /// It comes twice or from the past; the reading before stays the last one.
    Rejected(FusionOutcome),
}

/// The last reading of both counters.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WheelCounters {
    last: Option<(Timestamp<BrickClock>, [f64; 2])>,
}

impl WheelCounters {
    /// Takes a reading of both wheels' total rotation, in rad.
    pub(super) fn observe(
        &mut self,
        stamp: Timestamp<BrickClock>,
        angles_rad: [f64; 2],
        config: &FilterConfig,
    ) -> CounterOutcome {
        let before = self.last;
        if let Some(verdict) = reject_repeated(before.map(|(stamp, _)| stamp), stamp) {
            return CounterOutcome::Rejected(verdict);
        }
        self.last = Some((stamp, angles_rad));
        let Some((before_stamp, before_rad)) = before else {
            return CounterOutcome::First;
        };
        let step = WheelStep {
            interval: stamp - before_stamp,
            left_rad: angles_rad[0] - before_rad[0],
            right_rad: angles_rad[1] - before_rad[1],
        };
        // Two counts of slack: quantisation alone must never look like a jump.
        let limit_rad = config.params.max_wheel_rad_per_s * step.interval.as_secs_f64() + 2.0 * config.geometry.tick.0;
        if step.left_rad.abs() <= limit_rad && step.right_rad.abs() <= limit_rad {
            CounterOutcome::Step(step)
        } else {
            CounterOutcome::Rebased
        }
    }
}
