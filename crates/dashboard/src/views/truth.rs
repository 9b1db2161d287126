//! Where the simulated robot really was, and how far off odometry and estimate are.

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, Estimate, Event, HostClock, Pose, Span, Stamp};

use super::trail::{Trail, Weight};
use super::{Pace, Setting, Told, View};
use crate::feed::TruthSample;
use crate::model::{ErrorsRow, Frame, Number, TruthPoint, seconds_of};

/// So many samples wait to be compared with the estimate of their instant: at 50 Hz four seconds, and no estimate is later.
const MOST_WAITING: usize = 256;
/// A sample at most so far from the estimate's instant is compared with it: half the spacing of truth samples of 10 Hz.
const SAME_INSTANT: Span = Span::from_millis(50);

/// The truth.
pub(super) struct Truth {
    trail: Trail<TruthPoint>,
    waiting: VecDeque<TruthSample>,
    errors: Option<ErrorsRow>,
}

impl Truth {
    pub(super) const fn new(setting: &Setting) -> Self {
        Self {
            trail: Trail::new(setting.keep),
            waiting: VecDeque::new(),
            errors: None,
        }
    }

    fn nearest(&self, estimated: &Estimate) -> Option<&TruthSample> {
        let apart =
            |sample: &&TruthSample| (sample.stamp - estimated.stamp).as_nanos().unsigned_abs();
        let nearest = self.waiting.iter().min_by_key(apart)?;
        let is_near = apart(&nearest) <= SAME_INSTANT.as_nanos().unsigned_abs();
        is_near.then_some(nearest)
    }
}

impl View for Truth {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        match told {
            Told::Truth(sample) => {
                if self.waiting.len() >= MOST_WAITING {
                    self.waiting.pop_front();
                }
                self.waiting.push_back(*sample);
                self.trail.push(now, point_of(now, sample), Weight::Usual);
            }
            Told::Event(Event::Estimated { estimate, .. }) => {
                let errors = self.nearest(estimate).map(|truth| ErrorsRow {
                    odometry_m: truth
                        .odometry
                        .map_or(f64::NAN, |odometry| apart_m(odometry, truth.pose))
                        .into(),
                    estimate_m: apart_m(estimate.pose, truth.pose).into(),
                });
                self.errors = errors.or(self.errors.take());
            }
            Told::Event(_) | Told::Standing(_) => {}
        }
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        frame.truth = self.trail.take_news();
        if !frame.truth.is_empty() {
            frame.errors.clone_from(&self.errors);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        history.truth = self.trail.kept();
        history.errors.clone_from(&self.errors);
    }

    fn dropped(&self) -> u64 {
        self.trail.dropped()
    }
}

fn point_of(now: Stamp<HostClock>, sample: &TruthSample) -> TruthPoint {
    let numbers = |pose: Pose<Arena>| [pose.x.0, pose.y.0, pose.heading.rad()].map(Number::from);
    let [x_m, y_m, heading_rad] = numbers(sample.pose);
    TruthPoint {
        t_s: seconds_of(now),
        x_m,
        y_m,
        heading_rad,
        odometry: sample.odometry.map(numbers),
    }
}

fn apart_m(one: Pose<Arena>, other: Pose<Arena>) -> f64 {
    (one.x.0 - other.x.0).hypot(one.y.0 - other.y.0)
}
