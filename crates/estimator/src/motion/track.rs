//! What is known about the wheels' travel and the gyro's rate over time, apart from any filter state.
//!
//! A filter asks these tracks for the travel between any two instants; between two observations it is linear. So a fix
//! whose stamp lies inside an encoder interval is applied at its own time, and a late observation changes nothing but the
//! intervals that it belongs to.

use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, DriveGeometry, Heading, Odom, Pose, Span, Stamp};

use crate::models::differential_drive::WheelTravel;

/// A gyro that has been silent for longer is not held: the gap is not covered.
const GYRO_HOLD: Span = Span::from_millis(60);

/// Which kind of observation moves the robot; a better one takes over from a worse one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MotionSource {
    /// Commanded or foreign speeds, held.
    Velocity,
    /// Increments of a foreign odometer's pose.
    Odometer,
    /// Encoder counts.
    Wheels,
}

/// A motion observation, as its sensor gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionReading {
    /// Total rotation of each wheel, rad.
    Wheels {
        /// Left wheel.
        left_rad: f64,
        /// Right wheel.
        right_rad: f64,
    },
    /// A foreign odometer's pose.
    Odometer(Pose<Odom>),
    /// Speeds, held until the next reading.
    Velocity {
        /// Forward, m/s.
        forward_m_per_s: f64,
        /// Turn, rad/s.
        turn_rad_per_s: f64,
    },
}

impl MotionReading {
    /// The kind of this reading.
    #[must_use]
    pub const fn source(&self) -> MotionSource {
        match self {
            Self::Wheels { .. } => MotionSource::Wheels,
            Self::Odometer(_) => MotionSource::Odometer,
            Self::Velocity { .. } => MotionSource::Velocity,
        }
    }
}

/// What became of a motion reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Added {
    /// Taken; the travel after this instant is now known better.
    After(Option<Stamp<BrickClock>>),
    /// Taken as a new base, not as motion: the counters jumped.
    Rebased,
    /// A better source moves the robot.
    Outranked,
    /// A reading with this stamp is there already.
    Duplicate,
    /// Out of order, where order matters.
    TooOld,
}

#[derive(Clone, Copy, Debug)]
struct TravelSample {
    stamp: Stamp<BrickClock>,
    travel: WheelTravel,
}

/// Cumulative wheel travel over time, from whichever source is best.
#[derive(Clone, Debug)]
pub struct MotionTrack {
    geometry: DriveGeometry,
    max_wheel_rad_per_s: f64,
    source: Option<MotionSource>,
    samples: VecDeque<TravelSample>,
    /// Added to the counters' own travel so that the sum is continuous across re-basing.
    base: WheelTravel,
    last_pose: Pose<Odom>,
    held_m_per_s: WheelTravel,
}

impl MotionTrack {
    /// An empty track for a robot of this geometry whose wheels cannot turn faster than the limit.
    #[must_use]
    pub fn new(geometry: DriveGeometry, max_wheel_rad_per_s: f64) -> Self {
        Self {
            geometry,
            max_wheel_rad_per_s,
            source: None,
            samples: VecDeque::new(),
            base: WheelTravel::default(),
            last_pose: Pose::default(),
            held_m_per_s: WheelTravel::default(),
        }
    }

    /// Adds a reading.
    pub fn add(&mut self, stamp: Stamp<BrickClock>, reading: &MotionReading) -> Added {
        let source = reading.source();
        if self.source.is_some_and(|current| source < current) {
            return Added::Outranked;
        }
        if self
            .samples
            .iter()
            .rev()
            .any(|sample| sample.stamp == stamp)
        {
            return Added::Duplicate;
        }
        let takes_over = self.source != Some(source);
        self.source = Some(source);
        match *reading {
            MotionReading::Wheels {
                left_rad,
                right_rad,
            } => {
                let counters = WheelTravel {
                    left_m: self.geometry.left_wheel_radius.0 * left_rad,
                    right_m: self.geometry.right_wheel_radius.0 * right_rad,
                };
                self.add_counters(stamp, counters, takes_over)
            }
            MotionReading::Odometer(pose) => self.add_odometer(stamp, pose, takes_over),
            MotionReading::Velocity {
                forward_m_per_s,
                turn_rad_per_s,
            } => {
                let half_m_per_s = 0.5 * turn_rad_per_s * self.geometry.track_width.0;
                let speeds = WheelTravel {
                    left_m: forward_m_per_s - half_m_per_s,
                    right_m: forward_m_per_s + half_m_per_s,
                };
                self.add_speeds(stamp, speeds)
            }
        }
    }

    fn add_counters(
        &mut self,
        stamp: Stamp<BrickClock>,
        counters: WheelTravel,
        takes_over: bool,
    ) -> Added {
        let index = self.samples.partition_point(|sample| sample.stamp < stamp);
        let before = index
            .checked_sub(1)
            .and_then(|i| self.samples.get(i))
            .copied();
        let travel = sum(self.base, counters);
        let Some(before) = before else {
            if !self.samples.is_empty() {
                return Added::TooOld;
            }
            self.samples.push_back(TravelSample { stamp, travel });
            return Added::After(None);
        };
        let dt_s = (stamp - before.stamp).as_secs_f64();
        if takes_over || self.is_impossible(before.travel, travel, dt_s) {
            if index < self.samples.len() {
                return Added::TooOld;
            }
            self.base = difference(before.travel, counters);
            self.samples.push_back(TravelSample {
                stamp,
                travel: before.travel,
            });
            return Added::Rebased;
        }
        self.samples.insert(index, TravelSample { stamp, travel });
        Added::After(Some(before.stamp))
    }

    fn is_impossible(&self, from: WheelTravel, to: WheelTravel, dt_s: f64) -> bool {
        // Two counts of slack: quantisation alone must never look like a jump.
        let limit_rad = self.max_wheel_rad_per_s * dt_s + 2.0 * self.geometry.tick.0;
        let left_rad = (to.left_m - from.left_m) / self.geometry.left_wheel_radius.0;
        let right_rad = (to.right_m - from.right_m) / self.geometry.right_wheel_radius.0;
        left_rad.abs() > limit_rad || right_rad.abs() > limit_rad
    }

    fn add_odometer(
        &mut self,
        stamp: Stamp<BrickClock>,
        pose: Pose<Odom>,
        takes_over: bool,
    ) -> Added {
        let Some(before) = self.samples.back().copied() else {
            self.last_pose = pose;
            self.samples.push_back(TravelSample {
                stamp,
                travel: WheelTravel::default(),
            });
            return Added::After(None);
        };
        if stamp < before.stamp {
            return Added::TooOld;
        }
        let step = increment(self.last_pose, pose, self.geometry.track_width.0);
        self.last_pose = pose;
        let travel = sum(before.travel, step);
        let dt_s = (stamp - before.stamp).as_secs_f64();
        if takes_over || self.is_impossible(before.travel, travel, dt_s) {
            self.samples.push_back(TravelSample {
                stamp,
                travel: before.travel,
            });
            return Added::Rebased;
        }
        self.samples.push_back(TravelSample { stamp, travel });
        Added::After(Some(before.stamp))
    }

    fn add_speeds(&mut self, stamp: Stamp<BrickClock>, speeds_m_per_s: WheelTravel) -> Added {
        let Some(before) = self.samples.back().copied() else {
            self.held_m_per_s = speeds_m_per_s;
            self.samples.push_back(TravelSample {
                stamp,
                travel: WheelTravel::default(),
            });
            return Added::After(None);
        };
        if stamp < before.stamp {
            return Added::TooOld;
        }
        let dt_s = (stamp - before.stamp).as_secs_f64();
        let travel = WheelTravel {
            left_m: before.travel.left_m + self.held_m_per_s.left_m * dt_s,
            right_m: before.travel.right_m + self.held_m_per_s.right_m * dt_s,
        };
        self.held_m_per_s = speeds_m_per_s;
        self.samples.push_back(TravelSample { stamp, travel });
        Added::After(Some(before.stamp))
    }

    /// The last instant at which the travel is known.
    #[must_use]
    pub fn known_to(&self) -> Option<Stamp<BrickClock>> {
        self.samples.back().map(|sample| sample.stamp)
    }

    /// The first instant at which the travel is still known.
    #[must_use]
    pub fn known_from(&self) -> Option<Stamp<BrickClock>> {
        self.samples.front().map(|sample| sample.stamp)
    }

    /// Travel between two instants, linear inside each interval; what lies outside of the known span counts as rest.
    #[must_use]
    pub fn travel_between(&self, from: Stamp<BrickClock>, to: Stamp<BrickClock>) -> WheelTravel {
        difference(self.travel_at(to), self.travel_at(from))
    }

    fn travel_at(&self, stamp: Stamp<BrickClock>) -> WheelTravel {
        let index = self.samples.partition_point(|sample| sample.stamp < stamp);
        let after = self.samples.get(index);
        let before = index.checked_sub(1).and_then(|i| self.samples.get(i));
        match (before, after) {
            (Some(before), Some(after)) => {
                let whole = (after.stamp - before.stamp).as_nanos() as f64;
                let part = (stamp - before.stamp).as_nanos() as f64 / whole;
                WheelTravel {
                    left_m: before.travel.left_m
                        + part * (after.travel.left_m - before.travel.left_m),
                    right_m: before.travel.right_m
                        + part * (after.travel.right_m - before.travel.right_m),
                }
            }
            (Some(only), None) | (None, Some(only)) => only.travel,
            (None, None) => WheelTravel::default(),
        }
    }

    /// Forgets what is not needed for instants from `horizon` on; the sample before it stays, for interpolation.
    pub fn forget_before(&mut self, horizon: Stamp<BrickClock>) {
        while self
            .samples
            .get(1)
            .is_some_and(|second| second.stamp <= horizon)
        {
            self.samples.pop_front();
        }
    }
}

/// Travel of two wheels that would move an odometer from one pose to the other along an arc.
fn increment(from: Pose<Odom>, to: Pose<Odom>, track_width_m: f64) -> WheelTravel {
    let turn_rad = (to.heading - from.heading).0;
    let (dx_m, dy_m) = (to.x.0 - from.x.0, to.y.0 - from.y.0);
    let mean_heading = Heading::from_rad(from.heading.rad() + 0.5 * turn_rad).rad();
    let chord_m = dx_m.hypot(dy_m);
    let along_m = dx_m * mean_heading.cos() + dy_m * mean_heading.sin();
    let half = 0.5 * turn_rad;
    let arc_over_chord = if half.abs() < 1e-6 {
        1.0
    } else {
        half / half.sin()
    };
    let forward_m = (chord_m * arc_over_chord).copysign(along_m);
    let half_turn_m = half * track_width_m;
    WheelTravel {
        left_m: forward_m - half_turn_m,
        right_m: forward_m + half_turn_m,
    }
}

fn sum(a: WheelTravel, b: WheelTravel) -> WheelTravel {
    WheelTravel {
        left_m: a.left_m + b.left_m,
        right_m: a.right_m + b.right_m,
    }
}

fn difference(a: WheelTravel, b: WheelTravel) -> WheelTravel {
    WheelTravel {
        left_m: a.left_m - b.left_m,
        right_m: a.right_m - b.right_m,
    }
}

/// The gyro's turn between two instants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroTurn {
    /// Integral of the rate, bias included, rad.
    pub turn_rad: f64,
    /// Sum of the squared lengths of the samples' parts, s²: times the variance of one sample, the variance of `turn_rad`.
    pub squared_secs: f64,
}

/// The gyro's rate over time: each sample is the mean since the one before it.
#[derive(Clone, Debug, Default)]
pub struct GyroTrack {
    samples: VecDeque<(Stamp<BrickClock>, f64)>,
}

impl GyroTrack {
    /// Adds a sample. [`Added::After`] names the sample before it.
    pub fn add(&mut self, stamp: Stamp<BrickClock>, rate_rad_per_s: f64) -> Added {
        let index = self.samples.partition_point(|sample| sample.0 < stamp);
        if self
            .samples
            .get(index)
            .is_some_and(|sample| sample.0 == stamp)
        {
            return Added::Duplicate;
        }
        let before = index
            .checked_sub(1)
            .and_then(|i| self.samples.get(i))
            .map(|sample| sample.0);
        if before.is_none() && !self.samples.is_empty() {
            return Added::TooOld;
        }
        self.samples.insert(index, (stamp, rate_rad_per_s));
        Added::After(before)
    }

    /// The last instant up to which the rate is known.
    #[must_use]
    pub fn known_to(&self) -> Option<Stamp<BrickClock>> {
        self.samples.back().map(|sample| sample.0)
    }

    /// Whether the whole span is covered, the last sample held for a moment.
    #[must_use]
    pub fn covers(&self, from: Stamp<BrickClock>, to: Stamp<BrickClock>) -> bool {
        match (self.samples.front(), self.samples.back()) {
            (Some(first), Some(last)) => first.0 <= from && to <= last.0 + GYRO_HOLD,
            _ => false,
        }
    }

    /// The turn between two instants of a covered span.
    #[must_use]
    pub fn turn_between(&self, from: Stamp<BrickClock>, to: Stamp<BrickClock>) -> GyroTurn {
        let mut turn = GyroTurn {
            turn_rad: 0.0,
            squared_secs: 0.0,
        };
        let mut at = from;
        let mut index = self.samples.partition_point(|sample| sample.0 <= from);
        let mut held = self.samples.back().map_or(0.0, |sample| sample.1);
        while at < to {
            let (until, rate) = match self.samples.get(index) {
                Some(&(stamp, rate)) => (if stamp < to { stamp } else { to }, rate),
                None => (to, held),
            };
            let secs = (until - at).as_secs_f64();
            turn.turn_rad += rate * secs;
            turn.squared_secs += secs * secs;
            held = rate;
            at = until;
            index += 1;
        }
        turn
    }

    /// Forgets what is not needed for instants from `horizon` on.
    pub fn forget_before(&mut self, horizon: Stamp<BrickClock>) {
        while self
            .samples
            .get(1)
            .is_some_and(|second| second.0 <= horizon)
        {
            self.samples.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Meters, Radians};

    const GEOMETRY: DriveGeometry = DriveGeometry {
        left_wheel_radius: Meters(0.03),
        right_wheel_radius: Meters(0.03),
        track_width: Meters(0.1),
        tick: Radians(0.017_453_3),
    };

    fn ms(millis: i64) -> Stamp<BrickClock> {
        Stamp::from_millis(millis)
    }

    fn wheels(left_rad: f64, right_rad: f64) -> MotionReading {
        MotionReading::Wheels {
            left_rad,
            right_rad,
        }
    }

    #[test]
    fn travel_is_linear_inside_an_interval_and_does_not_depend_on_the_order_of_arrival() {
        let mut in_order = MotionTrack::new(GEOMETRY, 100.0);
        let mut late = MotionTrack::new(GEOMETRY, 100.0);
        assert_eq!(in_order.add(ms(0), &wheels(0.0, 0.0)), Added::After(None));
        in_order.add(ms(100), &wheels(1.0, 2.0));
        assert_eq!(
            in_order.add(ms(200), &wheels(4.0, 2.0)),
            Added::After(Some(ms(100)))
        );
        late.add(ms(0), &wheels(0.0, 0.0));
        late.add(ms(200), &wheels(4.0, 2.0));
        late.add(ms(100), &wheels(1.0, 2.0));
        for (from, to) in [(0, 200), (50, 150), (20, 70)] {
            assert_eq!(
                in_order.travel_between(ms(from), ms(to)),
                late.travel_between(ms(from), ms(to))
            );
        }
        let half = in_order.travel_between(ms(0), ms(50));
        assert!((half.left_m - 0.015).abs() < 1e-12 && (half.right_m - 0.03).abs() < 1e-12);
    }

    #[test]
    fn counters_that_jump_are_a_new_base_and_not_motion() {
        let mut track = MotionTrack::new(GEOMETRY, 100.0);
        track.add(ms(0), &wheels(500.0, 500.0));
        track.add(ms(50), &wheels(501.0, 501.0));
        assert_eq!(track.add(ms(100), &wheels(0.0, 0.0)), Added::Rebased);
        track.add(ms(150), &wheels(1.0, 1.0));
        assert!((track.travel_between(ms(0), ms(150)).left_m - 0.06).abs() < 1e-12);
    }

    #[test]
    fn an_odometer_pose_gives_the_arc_between_two_poses() {
        let mut track = MotionTrack::new(GEOMETRY, 1e6);
        let quarter = std::f64::consts::FRAC_PI_2;
        track.add(ms(0), &MotionReading::Odometer(Pose::default()));
        let there = Pose::new(Meters(-1.0), Meters(-1.0), Heading::from_rad(quarter));
        track.add(ms(1000), &MotionReading::Odometer(there));
        let travel = track.travel_between(ms(0), ms(1000));
        assert!(
            (0.5 * (travel.left_m + travel.right_m) + quarter).abs() < 1e-9,
            "backwards along the arc"
        );
        assert!(((travel.right_m - travel.left_m) / 0.1 - quarter).abs() < 1e-9);
    }

    #[test]
    fn wheels_take_over_from_held_speeds_without_a_jump() {
        let mut track = MotionTrack::new(GEOMETRY, 100.0);
        let slow = MotionReading::Velocity {
            forward_m_per_s: 0.1,
            turn_rad_per_s: 0.0,
        };
        track.add(ms(0), &slow);
        track.add(ms(1000), &slow);
        assert_eq!(track.add(ms(1100), &wheels(77.0, 77.0)), Added::Rebased);
        assert_eq!(track.add(ms(1150), &slow), Added::Outranked);
        track.add(ms(1200), &wheels(78.0, 78.0));
        assert!((track.travel_between(ms(0), ms(1200)).left_m - 0.13).abs() < 1e-12);
    }

    #[test]
    fn the_gyro_is_held_for_a_moment_and_no_longer() {
        let mut gyro = GyroTrack::default();
        for (stamp, rate) in [(0, 9.0), (20, 1.0), (40, 2.0)] {
            gyro.add(ms(stamp), rate);
        }
        assert!(
            gyro.covers(ms(0), ms(100))
                && !gyro.covers(ms(0), ms(101))
                && !gyro.covers(ms(-1), ms(40))
        );
        let turn = gyro.turn_between(ms(10), ms(50));
        assert!((turn.turn_rad - (0.01 + 0.04 + 0.02)).abs() < 1e-12);
        assert!((turn.squared_secs - (1e-4 + 4e-4 + 1e-4)).abs() < 1e-12);
    }
}
