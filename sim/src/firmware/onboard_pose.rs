//! The brick's pose: dead reckoning from encoder counts and the nominal geometry, corrected by the station's estimates.
//!
//! An estimate is valid for a past instant of the brick's clock. The brick keeps a short history of its odometry, finds its odometry
//! pose at that instant, and computes from the two poses the odometry origin in the arena. Composing that with the current odometry
//! extrapolates the estimate; without further estimates it is dead reckoning from the last one.

use std::collections::VecDeque;

use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Heading, Meters, Odom, Pose, TimeDelta, Timestamp, Transform2,
};

use crate::scenario::Steering;
use crate::wheels::PerWheel;

#[derive(Clone, Copy, Debug)]
pub(crate) struct DeadReckoning {
    metres_per_count: PerWheel<f64>,
    track_m: f64,
    last: PerWheel<i64>,
    pub(crate) pose: Pose<Odom>,
}

impl DeadReckoning {
    /// Starts at the origin, with counters at zero.
    pub(crate) fn new(geometry: &DriveGeometry) -> Self {
        Self {
            metres_per_count: PerWheel {
                left: geometry.left_wheel_radius.0 * geometry.tick.0,
                right: geometry.right_wheel_radius.0 * geometry.tick.0,
            },
            track_m: geometry.track_width.0,
            last: PerWheel::default(),
            pose: Pose::default(),
        }
    }

    pub(crate) fn update(&mut self, counts: PerWheel<i64>) -> Pose<Odom> {
        let travel = counts
            .zip(self.last)
            .zip(self.metres_per_count)
            .map(|((after, before), scale)| (after - before) as f64 * scale);
        self.last = counts;
        let forward_m = 0.5 * (travel.left + travel.right);
        let turn_rad = (travel.right - travel.left) / self.track_m;
        let heading_rad = self.pose.heading.rad();
        let (sin, cos) = (heading_rad + 0.5 * turn_rad).sin_cos();
        self.pose = Pose::new(
            Meters(self.pose.x.0 + forward_m * cos),
            Meters(self.pose.y.0 + forward_m * sin),
            Heading::from_rad(heading_rad + turn_rad),
        );
        self.pose
    }

    /// The counters were zeroed: the pose stays.
    pub(crate) fn counters_zeroed(&mut self) {
        self.last = PerWheel::default();
    }
}

pub(crate) const MAX_ESTIMATE_AGE: TimeDelta = TimeDelta::from_millis(500);
/// Limit for estimates predicted into the future.
const MAX_ESTIMATE_LEAD: TimeDelta = TimeDelta::from_millis(300);
/// History kept; longer than [`MAX_ESTIMATE_AGE`], so that every fresh estimate finds its instant.
const HISTORY: TimeDelta = TimeDelta::from_millis(700);

#[derive(Clone, Debug)]
pub(crate) struct OnboardPose {
    steering: Steering,
    arena_from_odom: Transform2<Arena, Odom>,
    history: VecDeque<(Timestamp<BrickClock>, Pose<Odom>)>,
    last_estimate: Option<Timestamp<BrickClock>>,
}

impl OnboardPose {
    /// The estimate of a robot that starts at `start`.
    pub(crate) fn new(steering: Steering, start: Pose<Arena>) -> Self {
        Self {
            steering,
            arena_from_odom: odom_origin(start, Pose::default()),
            history: VecDeque::new(),
            last_estimate: None,
        }
    }

    pub(crate) fn record(&mut self, now: Timestamp<BrickClock>, pose: Pose<Odom>) {
        self.history.push_back((now, pose));
        while self.history.front().is_some_and(|(stamp, _)| now - *stamp > HISTORY) {
            self.history.pop_front();
        }
    }

    /// Applies an estimate of the instant `stamp`. Ignores one that is too old, too far ahead or older than the last; a second one of
    /// the same instant replaces the first.
    pub(crate) fn apply_estimate(
        &mut self,
        now: Timestamp<BrickClock>,
        stamp: Timestamp<BrickClock>,
        pose: Pose<Arena>,
    ) {
        let is_finite = pose.x.0.is_finite() && pose.y.0.is_finite() && pose.heading.rad().is_finite();
        let is_recent = now - stamp <= MAX_ESTIMATE_AGE && stamp - now <= MAX_ESTIMATE_LEAD;
        let is_in_order = self.last_estimate.is_none_or(|last| stamp >= last);
        if self.steering == Steering::Odometry || !is_finite || !is_recent || !is_in_order {
            return;
        }
        if let Some(odom) = self.odometry_at(stamp) {
            self.arena_from_odom = odom_origin(pose, odom);
            self.last_estimate = Some(stamp);
        }
    }

    /// Changes the source from here on; the pose does not jump.
    pub(crate) const fn set_steering(&mut self, steering: Steering) {
        self.steering = steering;
        self.last_estimate = None;
    }

    pub(crate) fn pose(&self) -> Pose<Arena> {
        let odom = self.history.back().map_or_else(Pose::default, |(_, pose)| *pose);
        self.arena_from_odom * odom
    }

    pub(crate) fn steering(&self, now: Timestamp<BrickClock>) -> Steering {
        match self.last_estimate {
            Some(stamp) if now - stamp <= MAX_ESTIMATE_AGE => Steering::Estimate,
            _ => Steering::Odometry,
        }
    }

    /// The clock restarted at zero: earlier timestamps are invalid, the estimate itself stays.
    pub(crate) fn clock_restarted(&mut self) {
        let newest = self.history.back().map(|(_, pose)| *pose);
        self.history.clear();
        self.history.extend(newest.map(|pose| (Timestamp::ZERO, pose)));
        self.last_estimate = None;
    }

    /// The odometry pose at an instant: interpolated in the history, or extrapolated at the last speed.
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

/// The odometry origin in the arena, for a robot whose pose is `pose` and whose odometry is `odom`.
fn odom_origin(pose: Pose<Arena>, odom: Pose<Odom>) -> Transform2<Arena, Odom> {
    pose * odom.inverse()
}

#[cfg(test)]
mod tests {
    use crate::scenario::Scenario;

    use super::*;

    fn at(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    fn pose<S>(x_m: f64, y_m: f64, heading_rad: f64) -> Pose<S> {
        Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad))
    }

    #[test]
    fn one_update_over_a_bend_goes_along_the_middle_of_it_and_zeroed_counters_are_no_motion() {
        let mut reckoning = DeadReckoning::new(&Scenario::default().drive_geometry());
        // 90 degrees of the right wheel are 14 pi mm: a turn of pi/8 over 112 mm, half that way forward.
        let pose = reckoning.update(PerWheel { left: 0, right: 90 });
        let turn_rad = std::f64::consts::PI / 8.0;
        assert!((pose.heading.rad() - turn_rad).abs() < 1e-12);
        assert!((pose.y.0.atan2(pose.x.0) - 0.5 * turn_rad).abs() < 1e-12);
        assert!((pose.x.0.hypot(pose.y.0) - 0.007 * std::f64::consts::PI).abs() < 1e-12);
        reckoning.counters_zeroed();
        assert_eq!(reckoning.update(PerWheel::default()), pose);
    }

    /// A brick that has driven 0.2 m/s along x for a second, recorded every 10 ms.
    fn driven(steering: Steering) -> OnboardPose {
        let mut onboard = OnboardPose::new(steering, pose(0.0, 0.0, 0.0));
        for i in 0..=100 {
            onboard.record(at(i * 10), pose(0.002 * i as f64, 0.0, 0.0));
        }
        onboard
    }

    #[test]
    fn an_estimate_is_carried_forward_or_back_to_now_unless_it_is_too_old_too_early_or_broken() {
        const RIGHT_ANGLE: f64 = std::f64::consts::FRAC_PI_2;
        let unchanged = (0.2, 0.0);
        for (steering, stamp_ms, estimate, expected) in [
            // 95 ms at 0.2 m/s, in the direction that the estimate says.
            (Steering::Estimate, 905, pose(0.5, 0.3, RIGHT_ANGLE), (0.5, 0.319)),
            (Steering::Estimate, 1_100, pose(0.52, 0.0, 0.0), (0.5, 0.0)),
            (Steering::Estimate, 500, pose(2.0, 0.0, 0.0), (2.1, 0.0)),
            (Steering::Estimate, 499, pose(9.0, 9.0, 0.0), unchanged),
            (Steering::Estimate, 1_301, pose(9.0, 9.0, 0.0), unchanged),
            (Steering::Estimate, 950, pose(f64::NAN, 9.0, 0.0), unchanged),
            (Steering::Odometry, 1_000, pose(1.0, 1.0, 0.0), unchanged),
        ] {
            let mut onboard = driven(steering);
            onboard.apply_estimate(at(1_000), at(stamp_ms), estimate);
            let found = onboard.pose();
            assert!((found.x.0 - expected.0).hypot(found.y.0 - expected.1) < 1e-9, "{stamp_ms} ms: {found:?}");
            let is_used = expected != unchanged;
            assert_eq!(onboard.steering(at(1_000)) == Steering::Estimate, is_used, "{stamp_ms} ms");
        }
    }

    #[test]
    fn half_a_second_after_the_last_estimate_it_is_odometry_again_from_there() {
        let mut onboard = driven(Steering::Estimate);
        onboard.apply_estimate(at(1_000), at(1_000), pose(1.0, 1.0, 0.0));
        onboard.apply_estimate(at(1_000), at(990), pose(5.0, 5.0, 0.0));
        onboard.record(at(1_500), pose(0.3, 0.0, 0.0));
        assert_eq!([1_500, 1_501].map(|ms| onboard.steering(at(ms))), [Steering::Estimate, Steering::Odometry]);
        assert!((onboard.pose().x.0 - 1.1).abs() < 1e-9, "an overtaken estimate changes nothing");
    }
}
