//! Dead reckoning by the wheels alone: what a brick believes without help.
//!
//! It uses the papers' midpoint rule (paper 1, equation 13) and nominal geometry, looks at no gyro and no fix, and is there to
//! be compared with. Its covariance grows by the same noise model as that of the other filters.

use std::collections::VecDeque;

use nalgebra::{Matrix2, SMatrix};
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, FusionRecord, Heading, Meters, MetersPerSecond, Observation, Pose, PoseJump,
    RadiansPerSecond, Span, Stamp, Validity, Verdict,
};

use super::intake::{self, RESTART_HEADING_RAD, RESTART_POSITION_M};
use super::{Adjustment, Filter, FilterConfig, StartPose};
use crate::models::differential_drive::{body_step, step_noise};
use crate::models::se2::{StepRule, displace};
use crate::motion::{Added, MotionReading, MotionTrack};
use crate::update::symmetrise;

/// Speeds are stale when no motion was observed for this long.
const SPEEDS_VALID: Span = Span::from_millis(500);

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
    /// The pose was given, by the configuration or by a person.
    is_placed: bool,
    reset_counter: u8,
    last_jump: Option<PoseJump>,
}

impl OdometryFilter {
    /// Starts at the configured pose, or at the arena's origin.
    #[must_use]
    pub fn new(config: &FilterConfig) -> Self {
        let start = config.start.map_or_else(Reckoned::at_origin, |start| reckoned_at(&start));
        Self {
            config: config.clone(),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            reckoned: VecDeque::from([start]),
            is_placed: config.start.is_some(),
            reset_counter: 0,
            last_jump: None,
        }
    }

    fn last(&self) -> Reckoned {
        self.reckoned.back().copied().unwrap_or_else(Reckoned::at_origin)
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
        let q =
            Matrix2::new(noise.forward_var_m2, noise.forward_turn_m_rad, noise.forward_turn_m_rad, noise.turn_var_rad2);
        next.covariance = by_state * from.covariance * by_state.transpose() + by_noise * q * by_noise.transpose();
        symmetrise(&mut next.covariance);
        next.forward_m_per_s = step.forward_m / dt_s;
        next.turn_rad_per_s = step.turn_rad / dt_s;
        next
    }

    fn add(&mut self, stamp: Stamp<BrickClock>, reading: &MotionReading) -> Verdict {
        // What lies before a pose that was set cannot change it.
        let oldest = self.reckoned.front().and_then(|belief| belief.stamp);
        if oldest.is_some_and(|oldest| stamp < oldest) {
            return Verdict::TooOld;
        }
        let added = self.track.add(stamp, reading);
        if let Added::After(_) | Added::Rebased(_) = added {
            self.reckon_anew_from(stamp);
        }
        intake::verdict_of(added)
    }

    /// A late reading changes only what lies behind it: reckons again from the last belief before it.
    ///
    /// In place, because a step must not allocate: the queue has grown to the length of the history by then.
    fn reckon_anew_from(&mut self, stamp: Stamp<BrickClock>) {
        // The oldest belief is where everything starts, and stays.
        let first_later = self.reckoned.partition_point(|belief| belief.stamp <= Some(stamp)).max(1);
        let mut belief = self.reckoned[first_later - 1];
        let slot = Reckoned { stamp: Some(stamp), ..belief };
        self.reckoned.insert(first_later, slot);
        for index in first_later..self.reckoned.len() {
            let at = self.reckoned[index].stamp.unwrap_or(stamp);
            belief = self.carried(&belief, at);
            self.reckoned[index] = belief;
        }
        let horizon = self.last().stamp.unwrap_or(stamp) - Span::from_secs_f64(self.config.params.history_s);
        while self.reckoned.get(1).is_some_and(|second| second.stamp <= Some(horizon)) {
            self.reckoned.pop_front();
        }
        self.track.forget_before(horizon);
    }
}

fn reckoned_at(start: &StartPose) -> Reckoned {
    Reckoned {
        stamp: None,
        pose: start.pose,
        covariance: doubt(start.position_sigma_m, start.heading_sigma_rad),
        forward_m_per_s: 0.0,
        turn_rad_per_s: 0.0,
    }
}

/// The covariance of a pose whose coordinates are known so well.
fn doubt(position_sigma_m: f64, heading_sigma_rad: f64) -> SMatrix<f64, 3, 3> {
    let position_m2 = position_sigma_m.powi(2);
    let heading_rad2 = heading_sigma_rad.powi(2);
    SMatrix::from_diagonal(&nalgebra::Vector3::new(position_m2, position_m2, heading_rad2))
}

impl Filter for OdometryFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let latest = self.latest();
        let refused = intake::refuse_outright(observation, latest, self.config.params.history_s);
        let verdict = match (refused, MotionReading::of(&observation.observed)) {
            (Some(verdict), _) => verdict,
            (None, Some(reading)) => self.add(observation.stamp, &reading),
            (None, None) => Verdict::Unused,
        };
        intake::bare_record(observation, intake::lag_of(observation, latest), verdict)
    }

    fn set_pose(&mut self, start: &StartPose) -> Verdict {
        if !intake::is_usable(start) {
            return Verdict::Malformed;
        }
        let last = self.last();
        self.reckoned.clear();
        self.reckoned.push_back(Reckoned { stamp: last.stamp, ..reckoned_at(start) });
        self.is_placed = true;
        self.reset_counter = self.reset_counter.wrapping_add(1);
        self.last_jump = Some(intake::jump_between(last.pose, start.pose));
        Verdict::ResetTo
    }

    fn adjust(&mut self, adjustment: &Adjustment) -> Verdict {
        match adjustment {
            Adjustment::Params(params) => {
                self.config.params = *params;
                self.track.set_max_wheel_rad_per_s(params.max_wheel_rad_per_s);
            }
            Adjustment::ForgetPose => {
                let _ =
                    self.set_pose(&StartPose { pose: Pose::default(), position_sigma_m: 0.0, heading_sigma_rad: 0.0 });
                self.is_placed = false;
            }
            // It learns nothing.
            Adjustment::Learning(_) | Adjustment::ForgetCalibration => return Verdict::Unused,
        }
        Verdict::Accepted
    }

    fn restart_clock(&mut self) {
        let mut last = self.last();
        last.covariance += doubt(RESTART_POSITION_M, RESTART_HEADING_RAD);
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.reckoned = VecDeque::from([Reckoned { stamp: None, forward_m_per_s: 0.0, turn_rad_per_s: 0.0, ..last }]);
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.last().stamp
    }

    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        let index = self.reckoned.partition_point(|belief| belief.stamp <= Some(stamp));
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
                position: self.is_placed,
                heading: self.is_placed,
                speeds: self.latest().is_some_and(|latest| stamp - latest <= SPEEDS_VALID),
            },
            is_dead_reckoning: true,
            fix_age: None,
            reset_counter: self.reset_counter,
            last_jump: self.last_jump,
        })
    }
}
