//! The observations of a run, held as columns of numbers: a file of any length takes about as much memory as disk.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use posebridge_telemetry::{BeaconId, Fix, Heading, HostClock, LandmarkId, Observation, ObservationKind, Timestamp};

/// An observation and its arrival on the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedObservation {
    /// The observation's own timestamp where the recording has no arrival times.
    pub arrival: Timestamp<HostClock>,
    pub observation: Observation,
}

/// Observations in the order of their arrival; with equal arrivals in the order in which they were pushed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObservationList {
    columns: Vec<ObservationColumns>,
    bytes: u64,
}

/// Successive observations that differ in nothing but times and numbers.
#[derive(Clone, Debug, PartialEq)]
struct ObservationColumns {
    /// With zeros for its times and numbers.
    template: Observation,
    numbers_per_row: usize,
    arrivals: Vec<i64>,
    stamps: Vec<i64>,
    numbers: Vec<f64>,
}

impl ObservationColumns {
    fn row(&self, index: usize) -> TimedObservation {
        let mut observation = self.template;
        observation.stamp = Timestamp::from_nanos(self.stamps[index]);
        let mut numbers = self.numbers[index * self.numbers_per_row..].iter();
        exchange_numbers(&mut observation.measurement, &mut |zero| numbers.next().copied().unwrap_or(zero));
        TimedObservation { arrival: Timestamp::from_nanos(self.arrivals[index]), observation }
    }

    fn push(&mut self, arrival: Timestamp<HostClock>, observation: &Observation, numbers: &[f64]) {
        self.arrivals.push(arrival.as_nanos());
        self.stamps.push(observation.stamp.as_nanos());
        self.numbers.extend(numbers);
    }

    fn sort(&mut self) {
        if self.arrivals.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.arrivals.len()).collect();
        order.sort_by_key(|index| self.arrivals[*index]);
        let width = self.numbers_per_row;
        self.numbers = order.iter().flat_map(|index| self.numbers[index * width..][..width].iter().copied()).collect();
        self.stamps = order.iter().map(|index| self.stamps[*index]).collect();
        self.arrivals = order.iter().map(|index| self.arrivals[*index]).collect();
    }
}

impl ObservationList {
    pub(super) fn push(&mut self, timed: &TimedObservation) {
        let TimedObservation { arrival, observation } = *timed;
        let mut numbers = Vec::with_capacity(MAX_NUMBERS);
        let mut template = Observation { stamp: Timestamp::ZERO, ..observation };
        exchange_numbers(&mut template.measurement, &mut |number| {
            numbers.push(number);
            0.0
        });
        if self.columns.last().is_none_or(|columns| columns.template != template) {
            self.bytes += size_of::<ObservationColumns>() as u64;
            self.columns.push(ObservationColumns {
                template,
                numbers_per_row: numbers.len(),
                arrivals: Vec::new(),
                stamps: Vec::new(),
                numbers: Vec::new(),
            });
        }
        if let Some(columns) = self.columns.last_mut() {
            columns.push(arrival, &observation, &numbers);
        }
        self.bytes += 8 * (2 + numbers.len() as u64);
    }

    /// Brings them into the order of arrival, after the last one was pushed.
    pub(super) fn sort(&mut self) {
        self.columns.iter_mut().for_each(ObservationColumns::sort);
    }

    /// Memory that they take.
    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    pub fn iter(&self) -> impl Iterator<Item = TimedObservation> {
        // A heap, because a file may change between kinds of rows as often as it likes.
        let heads = self.columns.iter().enumerate();
        let heads = heads.filter_map(|(index, columns)| Some(Reverse((*columns.arrivals.first()?, index, 0))));
        let mut heads: BinaryHeap<Reverse<(i64, usize, usize)>> = heads.collect();
        std::iter::from_fn(move || {
            let Reverse((_, index, row)) = heads.pop()?;
            let columns = &self.columns[index];
            if let Some(next) = columns.arrivals.get(row + 1) {
                heads.push(Reverse((*next, index, row + 1)));
            }
            Some(columns.row(row))
        })
    }

    pub fn len(&self) -> usize {
        self.columns.iter().map(|columns| columns.stamps.len()).sum()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn first(&self) -> Option<TimedObservation> {
        self.iter().next()
    }

    pub fn last(&self) -> Option<TimedObservation> {
        let ends =
            self.columns.iter().enumerate().filter_map(|(index, columns)| Some((columns.arrivals.last()?, index)));
        let (_, index) = ends.max()?;
        let last = self.columns[index].stamps.len() - 1;
        Some(self.columns[index].row(last))
    }

    /// Keeps the observations that `is_kept`.
    pub fn retain(&mut self, is_kept: impl Fn(&TimedObservation) -> bool) {
        for columns in &mut self.columns {
            let kept: Vec<bool> = (0..columns.stamps.len()).map(|row| is_kept(&columns.row(row))).collect();
            let is_kept = |row: usize| kept.get(row).copied().unwrap_or(true);
            keep_rows(&mut columns.arrivals, 1, &is_kept);
            keep_rows(&mut columns.stamps, 1, &is_kept);
            keep_rows(&mut columns.numbers, columns.numbers_per_row, &is_kept);
        }
    }
}

fn keep_rows<T>(column: &mut Vec<T>, width: usize, is_kept: &dyn Fn(usize) -> bool) {
    let mut index = 0;
    column.retain(|_| {
        index += 1;
        is_kept((index - 1) / width)
    });
}

/// Of a fix with heading and covariance.
const MAX_NUMBERS: usize = 7;

/// Passes each number of an observation to `exchange`, which returns the number that takes its place.
fn exchange_numbers(measured: &mut ObservationKind, exchange: &mut dyn FnMut(f64) -> f64) {
    let of_heading = |heading: &mut Heading, exchange: &mut dyn FnMut(f64) -> f64| {
        *heading = Heading::from_rad(exchange(heading.rad()));
    };
    match measured {
        ObservationKind::WheelAngles { left, right } => {
            left.0 = exchange(left.0);
            right.0 = exchange(right.0);
        }
        ObservationKind::OdometerPose(pose) => {
            pose.x.0 = exchange(pose.x.0);
            pose.y.0 = exchange(pose.y.0);
            of_heading(&mut pose.heading, exchange);
        }
        ObservationKind::BodyVelocity { forward, turn } => {
            forward.0 = exchange(forward.0);
            turn.0 = exchange(turn.0);
        }
        ObservationKind::TurnRate(turn) => turn.0 = exchange(turn.0),
        ObservationKind::WheelAccelerations { left, right } => {
            left.0 = exchange(left.0);
            right.0 = exchange(right.0);
        }
        ObservationKind::Fix(Fix { position, heading, covariance, .. }) => {
            position.x.0 = exchange(position.x.0);
            position.y.0 = exchange(position.y.0);
            if let Some(heading) = heading {
                of_heading(heading, exchange);
            }
            if let Some(covariance) = covariance {
                for number in
                    [&mut covariance.xx_m2, &mut covariance.xy_m2, &mut covariance.yy_m2, &mut covariance.heading_rad2]
                {
                    *number = exchange(*number);
                }
            }
        }
        ObservationKind::Landmark { id, range, bearing } => {
            *id = LandmarkId(exchange(f64::from(id.0)) as u32);
            range.0 = exchange(range.0);
            bearing.0 = exchange(bearing.0);
        }
        ObservationKind::BeaconRange { id, range } => {
            *id = BeaconId(exchange(f64::from(id.0)) as u32);
            range.0 = exchange(range.0);
        }
        ObservationKind::WallRange(range) => range.0 = exchange(range.0),
        ObservationKind::CompassHeading(heading) => of_heading(heading, exchange),
        ObservationKind::Temperature(shown) => shown.0 = exchange(shown.0),
    }
}
