//! Dead reckoning by the wheels alone: what a brick believes without help.
//!
//! It uses the papers' midpoint rule (paper 1, equation 13) and nominal geometry, looks at no gyro and no fix, and is there to
//! be compared with. Its covariance grows by the same noise model as that of the other filters.

use std::collections::VecDeque;

use nalgebra::{Matrix2, SMatrix};
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, FusionRecord, Heading, Meters, MetersPerSecond, Observation, Pose,
    RadiansPerSecond, Span, Stamp, Validity, Verdict,
};

use super::{Filter, FilterConfig, StartPose};
use crate::models::differential_drive::{body_step, step_noise};
use crate::models::se2::{StepRule, displace};
use crate::motion::{Added, MotionReading, MotionTrack};

#[derive(Clone, Copy, Debug)]
struct Reckoned {
    stamp: Option<Stamp<BrickClock>>,
    pose: Pose<Arena>,
    covariance: SMatrix<f64, 3, 3>,
    forward_m_per_s: f64,
    turn_rad_per_s: f64,
}

impl Reckoned {
    fn at_origin() -> Self {
        Self {
            stamp: None,
            pose: Pose::default(),
            covariance: SMatrix::zeros(),
            forward_m_per_s: 0.0,
            turn_rad_per_s: 0.0,
        }
    }
}

/// Dead reckoning.
pub struct OdometryFilter {
    config: FilterConfig,
    track: MotionTrack,
    /// Oldest first, never empty: one entry per motion observation within the history.
    reckoned: VecDeque<Reckoned>,
    reset_counter: u8,
}

impl OdometryFilter {
    /// Starts at the configured pose, or at the arena's origin.
    #[must_use]
    pub fn new(config: &FilterConfig) -> Self {
        let start = config
            .start
            .map_or_else(Reckoned::at_origin, |start| reckoned_at(&start));
        Self {
            config: *config,
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            reckoned: VecDeque::from([start]),
            reset_counter: 0,
        }
    }

    fn last(&self) -> Reckoned {
        self.reckoned
            .back()
            .copied()
            .unwrap_or_else(Reckoned::at_origin)
    }

    /// Carries a belief forward over what the wheels did, and stands still where nothing is known.
    fn carried(&self, from: &Reckoned, to: Stamp<BrickClock>) -> Reckoned {
        let mut next = *from;
        next.stamp = Some(to);
        let Some(start) = from.stamp else { return next };
        let dt_s = (to - start).as_secs_f64();
        if dt_s <= 0.0 {
            return next;
        }
        let travel = self.track.travel_between(start, to);
        let step = body_step(travel, &self.config.geometry);
        let noise = step_noise(travel, &self.config.geometry, &self.config.noise);
        let moved = displace(from.pose.heading.rad(), step, StepRule::Midpoint);
        next.pose = Pose::new(
            Meters(from.pose.x.0 + moved.dx_m),
            Meters(from.pose.y.0 + moved.dy_m),
            Heading::from_rad(from.pose.heading.rad() + step.turn_rad),
        );
        let mut by_state = SMatrix::<f64, 3, 3>::identity();
        by_state[(0, 2)] = moved.by_heading[0];
        by_state[(1, 2)] = moved.by_heading[1];
        let by_noise = SMatrix::<f64, 3, 2>::new(
            moved.by_forward[0],
            moved.by_turn[0],
            moved.by_forward[1],
            moved.by_turn[1],
            0.0,
            1.0,
        );
        let q = Matrix2::new(
            noise.forward_var_m2,
            noise.forward_turn_m_rad,
            noise.forward_turn_m_rad,
            noise.turn_var_rad2,
        );
        next.covariance =
            by_state * from.covariance * by_state.transpose() + by_noise * q * by_noise.transpose();
        next.forward_m_per_s = step.forward_m / dt_s;
        next.turn_rad_per_s = step.turn_rad / dt_s;
        next
    }

    fn add(&mut self, stamp: Stamp<BrickClock>, reading: &MotionReading) -> Verdict {
        let verdict = match self.track.add(stamp, reading) {
            Added::Outranked => return Verdict::Unused,
            Added::Duplicate => return Verdict::Malformed,
            Added::TooOld => return Verdict::TooOld,
            Added::Rebased => Verdict::Rebased,
            Added::After(_) => Verdict::Accepted,
        };
        self.reckon_anew_from(stamp);
        verdict
    }

    /// A late reading changes only what lies behind it: reckons again from the last belief before it.
    fn reckon_anew_from(&mut self, stamp: Stamp<BrickClock>) {
        let mut later = Vec::new();
        while self.reckoned.len() > 1 && self.last().stamp > Some(stamp) {
            later.extend(self.reckoned.pop_back().and_then(|belief| belief.stamp));
        }
        for at in std::iter::once(stamp).chain(later.into_iter().rev()) {
            let next = self.carried(&self.last(), at);
            self.reckoned.push_back(next);
        }
        let horizon =
            self.last().stamp.unwrap_or(stamp) - Span::from_secs_f64(self.config.params.history_s);
        while self
            .reckoned
            .get(1)
            .is_some_and(|second| second.stamp <= Some(horizon))
        {
            self.reckoned.pop_front();
        }
        self.track.forget_before(horizon);
    }
}

fn reckoned_at(start: &StartPose) -> Reckoned {
    let position_m2 = start.position_sigma_m.powi(2);
    let heading_rad2 = start.heading_sigma_rad.powi(2);
    Reckoned {
        stamp: None,
        pose: start.pose,
        covariance: SMatrix::from_diagonal(&nalgebra::Vector3::new(
            position_m2,
            position_m2,
            heading_rad2,
        )),
        forward_m_per_s: 0.0,
        turn_rad_per_s: 0.0,
    }
}

impl Filter for OdometryFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let lag = self
            .latest()
            .map_or(Span::ZERO, |latest| latest - observation.stamp);
        let verdict = match super::pose::motion_reading(&observation.observed) {
            Some(reading) if super::pose::is_finite(&observation.observed) => {
                self.add(observation.stamp, &reading)
            }
            Some(_) => Verdict::Malformed,
            None => Verdict::Unused,
        };
        super::pose::bare_record(observation, lag, verdict)
    }

    fn set_pose(&mut self, start: &StartPose) {
        let stamp = self.last().stamp;
        self.reckoned.clear();
        self.reckoned.push_back(Reckoned {
            stamp,
            ..reckoned_at(start)
        });
        self.reset_counter = self.reset_counter.wrapping_add(1);
    }

    fn restart_clock(&mut self) {
        let last = self.last();
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.reckoned = VecDeque::from([Reckoned {
            stamp: None,
            ..last
        }]);
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.last().stamp
    }

    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        let index = self
            .reckoned
            .partition_point(|belief| belief.stamp <= Some(stamp));
        let from = self.reckoned.get(index.checked_sub(1)?)?;
        from.stamp?;
        let belief = self.carried(from, stamp);
        let mut covariance = [[0.0; 5]; 5];
        for (row, values) in covariance.iter_mut().enumerate().take(3) {
            for (column, value) in values.iter_mut().enumerate().take(3) {
                *value = belief.covariance[(row, column)];
            }
        }
        Some(Estimate {
            stamp,
            pose: belief.pose,
            forward_speed: MetersPerSecond(belief.forward_m_per_s),
            turn_rate: RadiansPerSecond(belief.turn_rad_per_s),
            covariance,
            validity: Validity {
                position: self.config.start.is_some(),
                heading: self.config.start.is_some(),
                speeds: true,
            },
            is_dead_reckoning: true,
            fix_age: None,
            reset_counter: self.reset_counter,
            last_jump: None,
        })
    }
}
