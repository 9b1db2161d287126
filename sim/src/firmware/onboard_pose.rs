//! The brick's pose: its own odometry, placed in the arena by the station's estimates.
//!
//! An estimate holds for a past instant of the brick's clock. The brick keeps a short history of its odometry, finds
//! its odometry pose at that instant, and computes from the two where the origin of its odometry lies in the arena.
//! Composing that with the current odometry carries the estimate forward; without further estimates the same
//! composition is dead reckoning from the last one.

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, BrickClock, Heading, Meters, Odom, Pose, TimeDelta, Timestamp, Transform2};

use crate::scenario::Steering;

/// Estimates of an instant longer ago than this are not used.
pub(crate) const MAX_ESTIMATE_AGE: TimeDelta = TimeDelta::from_millis(500);
/// A predicted estimate may speak of an instant this far ahead.
const MAX_ESTIMATE_LEAD: TimeDelta = TimeDelta::from_millis(300);
/// History kept; longer than [`FRESH`], so that every fresh estimate finds its instant.
const HISTORY: TimeDelta = TimeDelta::from_millis(700);

/// The brick's idea of its own pose.
#[derive(Clone, Debug)]
pub(crate) struct OnboardPose {
    steering: Steering,
    arena_from_odom: Transform2<Arena, Odom>,
    history: VecDeque<(Timestamp<BrickClock>, Pose<Odom>)>,
    last_estimate: Option<Timestamp<BrickClock>>,
}

impl OnboardPose {
    /// The estimate of a robot that was put down at `start`.
    pub(crate) fn new(steering: Steering, start: Pose<Arena>) -> Self {
        Self {
            steering,
            arena_from_odom: odom_origin(start, Pose::default()),
            history: VecDeque::new(),
            last_estimate: None,
        }
    }

    /// Takes the odometry of this moment.
    pub(crate) fn record(&mut self, now: Timestamp<BrickClock>, pose: Pose<Odom>) {
        self.history.push_back((now, pose));
        while self.history.front().is_some_and(|(stamp, _)| now - *stamp > HISTORY) {
            self.history.pop_front();
        }
    }

    /// Takes an estimate of the instant `stamp`; one that is too old, too far ahead or
    /// overtaken changes nothing. A second one of the same instant is the station's better knowledge of it.
    pub(crate) fn apply_estimate(
        &mut self,
        now: Timestamp<BrickClock>,
        stamp: Timestamp<BrickClock>,
        pose: Pose<Arena>,
    ) {
        let is_finite = pose.x.0.is_finite() && pose.y.0.is_finite() && pose.heading.rad().is_finite();
        let is_in_reach = now - stamp <= MAX_ESTIMATE_AGE && stamp - now <= MAX_ESTIMATE_LEAD;
        let is_in_order = self.last_estimate.is_none_or(|last| stamp >= last);
        if self.steering == Steering::Odometry || !is_finite || !is_in_reach || !is_in_order {
            return;
        }
        if let Some(odom) = self.odometry_at(stamp) {
            self.arena_from_odom = odom_origin(pose, odom);
            self.last_estimate = Some(stamp);
        }
    }

    /// What it rests on from here on; it stays where it is.
    pub(crate) const fn set_steering(&mut self, steering: Steering) {
        self.steering = steering;
        self.last_estimate = None;
    }

    /// The brick's own estimate.
    pub(crate) fn pose(&self) -> Pose<Arena> {
        let odom = self.history.back().map_or_else(Pose::default, |(_, pose)| *pose);
        self.arena_from_odom * odom
    }

    /// What that estimate rests on.
    pub(crate) fn steering(&self, now: Timestamp<BrickClock>) -> Steering {
        match self.last_estimate {
            Some(stamp) if now - stamp <= MAX_ESTIMATE_AGE => Steering::Estimate,
            _ => Steering::Odometry,
        }
    }

    /// The clock fell to zero: earlier stamps are invalid, the estimate itself stays.
    pub(crate) fn clock_restarted(&mut self) {
        let newest = self.history.back().map(|(_, pose)| *pose);
        self.history.clear();
        self.history.extend(newest.map(|pose| (Timestamp::ZERO, pose)));
        self.last_estimate = None;
    }

    /// The odometry pose of an instant: between two of the history, or beyond its end at the last speed.
    fn odometry_at(&self, stamp: Timestamp<BrickClock>) -> Option<Pose<Odom>> {
        let after = self.history.partition_point(|(at, _)| *at < stamp);
        let newest = self.history.len().checked_sub(1)?;
        let after = after.clamp(1.min(newest), newest);
        let (t1, p1) = self.history.get(after)?;
        let (t0, p0) = self.history.get(after.saturating_sub(1))?;
        let gap_s = (*t1 - *t0).as_secs_f64();
        if gap_s <= 0.0 || stamp < *t0 {
            return (stamp >= *t0).then_some(*p1);
        }
        let fraction = (stamp - *t0).as_secs_f64() / gap_s;
        let turn = p1.heading - p0.heading;
        Some(Pose::new(
            Meters(p0.x.0 + fraction * (p1.x.0 - p0.x.0)),
            Meters(p0.y.0 + fraction * (p1.y.0 - p0.y.0)),
            Heading::from_rad(p0.heading.rad() + fraction * turn.0),
        ))
    }
}

/// Where the odometry's origin lies in the arena, if a robot at `odom` is really at `pose`.
fn odom_origin(pose: Pose<Arena>, odom: Pose<Odom>) -> Transform2<Arena, Odom> {
    pose * odom.inverse()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    fn pose<S>(x_m: f64, y_m: f64, heading_rad: f64) -> Pose<S> {
        Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad))
    }

    /// A brick that has driven 0.2 m/s along x for a second, recorded every 10 ms.
    fn driven(steering: Steering) -> OnboardPose {
        let mut belief = OnboardPose::new(steering, pose(0.0, 0.0, 0.0));
        for i in 0..=100 {
            belief.record(at(i * 10), pose(0.002 * i as f64, 0.0, 0.0));
        }
        belief
    }

    #[test]
    fn an_estimate_is_carried_forward_by_the_odometry_since() {
        let mut belief = driven(Steering::Estimate);
        belief.apply_estimate(at(1_000), at(905), pose(0.5, 0.3, std::f64::consts::FRAC_PI_2));
        // 95 ms at 0.2 m/s, in the direction that the estimate says.
        assert!((belief.pose().x.0 - 0.5).abs() < 1e-9);
        assert!((belief.pose().y.0 - (0.3 + 0.019)).abs() < 1e-9);
        assert_eq!(belief.steering(at(1_000)), Steering::Estimate);
    }

    #[test]
    fn a_predicted_estimate_is_carried_back() {
        let mut belief = driven(Steering::Estimate);
        belief.apply_estimate(at(1_000), at(1_100), pose(0.52, 0.0, 0.0));
        assert!((belief.pose().x.0 - 0.50).abs() < 1e-9);
    }

    #[test]
    fn old_early_and_broken_estimates_change_nothing() {
        let mut belief = driven(Steering::Estimate);
        let before = belief.pose();
        belief.apply_estimate(at(1_000), at(499), pose(9.0, 9.0, 0.0));
        belief.apply_estimate(at(1_000), at(1_301), pose(9.0, 9.0, 0.0));
        belief.apply_estimate(at(1_000), at(950), pose(f64::NAN, 9.0, 0.0));
        assert_eq!(belief.pose(), before);
    }

    #[test]
    fn an_estimate_of_half_a_second_ago_is_just_fresh_enough() {
        let mut belief = driven(Steering::Estimate);
        belief.apply_estimate(at(1_000), at(500), pose(2.0, 0.0, 0.0));
        assert!((belief.pose().x.0 - 2.1).abs() < 1e-9);
        assert_eq!(belief.steering(at(1_000)), Steering::Estimate);
        assert_eq!(belief.steering(at(1_001)), Steering::Odometry);
    }

    #[test]
    fn half_a_second_after_the_last_estimate_it_is_odometry_again_from_there() {
        let mut belief = driven(Steering::Estimate);
        belief.apply_estimate(at(1_000), at(1_000), pose(1.0, 1.0, 0.0));
        belief.record(at(1_600), pose(0.3, 0.0, 0.0));
        assert_eq!(belief.steering(at(1_600)), Steering::Odometry);
        assert!((belief.pose().x.0 - 1.1).abs() < 1e-9);
    }

    #[test]
    fn a_brick_that_steers_by_odometry_ignores_estimates() {
        let mut belief = driven(Steering::Odometry);
        belief.apply_estimate(at(1_000), at(1_000), pose(1.0, 1.0, 0.0));
        assert!((belief.pose().x.0 - 0.2).abs() < 1e-9);
    }
}
