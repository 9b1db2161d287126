//! The drive that explains a log best, and the readings that it explains.

use std::ops::Range;

use crate::statistics::{FittedLine, golden_section, median};
use crate::wall::log::{StepCommand, WallEntry, WallLog, WallReading, responses};

/// Unknowns of the fit: distance at rest, steady speed, rate, onset.
pub(super) const UNKNOWNS: usize = 4;
/// Readings that a step needs: Student's distribution has a variance from three degrees of freedom on.
pub(super) const LEAST_USED: usize = UNKNOWNS + 3;
/// A reading belongs to the step if its squared residual adds less than this, in variances: a true one adds 1 on average.
const COST_OUTSIDE: f64 = 4.0;
/// What a reading can add at most; four sigmas.
pub(super) const MAX_COST: f64 = 16.0;
/// Longest dead time of drive and sensor together.
const LONGEST_DELAY_S: f64 = 0.6;
/// A log that begins on the way may have begun so long after the onset.
const EARLIEST_ONSET_S: f64 = -3.0;
const MIN_RATE_PER_S: f64 = 0.05;
const MAX_RATE_PER_S: f64 = 60.0;
/// Ends of the step that are tried at most, each with a fit.
const MOST_ENDS: usize = 40;
/// Start values of the rate and of the onset.
const RATES: u32 = 12;
const ONSETS: u32 = 16;
/// Sigma of the search from a grid, in sigmas: a grid's drives are up to 40 sigmas off.
const WIDE_SIGMA_FACTOR: f64 = 10.0;
/// Smallest step in ln(rate): where ends are compared, and where the drive is reported.
const COARSE_LN_RATE_STEP: f64 = 0.01;
const FINE_LN_RATE_STEP: f64 = 1e-5;

/// Nonlinear unknowns: the rate a, and the onset or its delay behind the recorded command.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive {
    pub(super) rate_per_s: f64,
    pub(super) onset_s: f64,
}

/// The best drive over some readings.
#[derive(Clone, Copy, Debug)]
pub(super) struct DriveFit {
    pub(super) drive: Drive,
    pub(super) start_m: f64,
    pub(super) steady_m_per_s: f64,
    /// Sum of capped squared residuals, in variances.
    pub(super) cost: f64,
}

pub(super) struct DriveSearch<'a> {
    pub(super) log: &'a WallLog,
    pub(super) command: StepCommand,
    pub(super) readings: &'a [(f64, f64)],
    /// Noise of a reading, as far as it decides which readings belong to the step.
    pub(super) sigma_m: f64,
}

impl DriveSearch<'_> {
    /// The readings of the step, and their drive; `None` if no drive towards the wall explains them.
    ///
    /// `from` and `to` are the readings between which the distance falls most.
    pub(super) fn find(&self, from: usize, to: usize) -> Option<(Range<usize>, DriveFit)> {
        // Rest before the descent holds z_0; the descent's own end may be a stop, a contact or the next turn.
        let moving = self.moving(from, to);
        let shortest = moving.max(from + 4).min(self.readings.len() - 1);
        let last = self.last_driven(moving).max(shortest);
        let stride = (shortest..=last).count().div_ceil(MOST_ENDS);
        let mut start = self.rest_before(from);
        let first_guesses = [shortest, to.clamp(shortest, last)].map(|end| self.best_of_grid(start..end + 1));
        let mut guesses: Vec<DriveFit> = first_guesses.into_iter().flatten().collect();
        let mut best: Option<(f64, usize, DriveFit)> = None;
        for end in (shortest..=last).step_by(stride).chain([last]) {
            let Some(fit) = self.refine(&guesses, start..end + 1, COARSE_LN_RATE_STEP) else { continue };
            let cost = fit.cost + self.cost_after(end);
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, end, fit));
                guesses.push(fit);
            }
        }
        let (_, mut end, fit) = best?;
        // The stride may have stepped over the end.
        end = self.best_end(&fit, start, shortest.max(end.saturating_sub(stride)), (end + stride).min(last));
        start = self.first_explained(&fit, start.min(from));
        if end < last {
            end = self.surely_driven(&fit, end).max(shortest);
        }
        let window = start..end + 1;
        let starts = [Some(fit), self.best_of_grid(window.clone())];
        let refined =
            starts.into_iter().flatten().filter_map(|fit| self.refine(&[fit], window.clone(), FINE_LN_RATE_STEP));
        let fit = refined.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        Some((window, fit))
    }

    /// The reading at which the descent has come a third of its way: the car drives.
    fn moving(&self, from: usize, to: usize) -> usize {
        let third = self.readings[from].1 - (self.readings[from].1 - self.readings[to].1) / 3.0;
        (from..=to).find(|index| self.readings[*index].1 <= third).unwrap_or(to)
    }

    /// The last reading before the motors go off: after that the car coasts or brakes, which is another movement.
    fn last_driven(&self, moving: usize) -> usize {
        let last = self.readings.len() - 1;
        if self.command == StepCommand::Unknown {
            return last;
        }
        let moving_s = self.readings[moving].0;
        let off = self.log.inputs().find(|(at_s, input)| *at_s > moving_s && *input <= 0.0);
        off.map_or(last, |(off_s, _)| self.readings.partition_point(|(at_s, _)| *at_s < off_s).saturating_sub(1))
    }

    /// The first of the readings before the descent that lie at its beginning.
    fn rest_before(&self, from: usize) -> usize {
        let level_m = self.readings[from].1;
        let at_rest = |index: &usize| (self.readings[*index].1 - level_m).abs() < 5.0 * self.sigma_m;
        (0..=from).rev().take_while(at_rest).last().unwrap_or(from)
    }

    /// The end between two others that is best with this drive.
    fn best_end(&self, fit: &DriveFit, start: usize, earliest: usize, latest: usize) -> usize {
        let costs = self.costs(fit, start..latest + 1);
        let total = |end: &usize| costs.iter().take(end + 1 - start).sum::<f64>() + self.cost_after(*end);
        (earliest..=latest).min_by(|a, b| total(a).total_cmp(&total(b))).unwrap_or(latest)
    }

    /// The last reading at which the motors surely drive, if another movement follows the reading `end`.
    ///
    /// A car whose motors go off has the deceleration v / tau at first. For so long its distance differs from that of the drive by less
    /// than the readings show.
    fn surely_driven(&self, fit: &DriveFit, end: usize) -> usize {
        let unseen_m = COST_OUTSIDE.sqrt() * self.sigma_m;
        let unseen_s = (2.0 * unseen_m / (fit.steady_m_per_s * fit.drive.rate_per_s)).sqrt();
        let sure_s = self.readings[end].0 - unseen_s;
        self.readings.partition_point(|(at_s, _)| *at_s <= sure_s).saturating_sub(1)
    }

    /// What the readings after the step cost: those near one level are a car that stopped, others are anything.
    fn cost_after(&self, end: usize) -> f64 {
        let after = &self.readings[end + 1..];
        let Some(level_m) = median(after.iter().map(|(_, range_m)| *range_m)) else {
            return 0.0;
        };
        let costs = after.iter().map(|(_, range_m)| ((range_m - level_m) / self.sigma_m).powi(2).min(COST_OUTSIDE));
        COST_OUTSIDE + costs.sum::<f64>()
    }

    fn first_explained(&self, fit: &DriveFit, start: usize) -> usize {
        let costs = self.costs(fit, 0..start + 1);
        let mut sum = 0.0;
        let mut best = (0.0, start);
        for index in (0..start).rev() {
            sum += costs[index] - COST_OUTSIDE;
            if sum < best.0 {
                best = (sum, index);
            }
        }
        best.1
    }

    /// Travel at the readings, at a steady speed of 1 m/s per unit of input.
    pub(super) fn travel_m(&self, drive: Drive, window: Range<usize>) -> Vec<f64> {
        match self.command {
            StepCommand::Unknown => {
                let since = self.readings[window].iter().map(|(at_s, _)| (at_s - drive.onset_s).max(0.0));
                since.map(|since_s| since_s + (-drive.rate_per_s * since_s).exp_m1() / drive.rate_per_s).collect()
            }
            StepCommand::Recorded => {
                let travelled = responses(&self.log.with_delayed_inputs(drive.onset_s), drive.rate_per_s);
                let (from, count) = (window.start, window.len());
                travelled.iter().skip(from).take(count).map(|reading| reading.distance_m).collect()
            }
        }
    }

    /// Distance at rest and steady speed by least squares without the readings beyond four sigmas.
    fn linear_fit(&self, drive: Drive, window: Range<usize>) -> Option<DriveFit> {
        let travel = self.travel_m(drive, window.clone());
        let readings = &self.readings[window];
        let mut is_used = vec![true; readings.len()];
        let mut fit = None;
        for _ in 0..3 {
            let points: Vec<(f64, f64)> = travel
                .iter()
                .zip(readings)
                .zip(&is_used)
                .filter(|(_, used)| **used)
                .map(|((travel_m, (_, range_m)), _)| (*travel_m, *range_m))
                .collect();
            let line = FittedLine::through(&points)?;
            let residuals = travel.iter().zip(readings);
            let costs: Vec<f64> = residuals
                .map(|(travel_m, (_, range_m))| (line.residual((*travel_m, *range_m)) / self.sigma_m).powi(2))
                .collect();
            fit = Some(DriveFit {
                drive,
                start_m: line.centre.1 - line.slope * line.centre.0,
                steady_m_per_s: -line.slope,
                cost: costs.iter().map(|cost| cost.min(MAX_COST)).sum(),
            });
            let now_used: Vec<bool> = costs.iter().map(|cost| *cost < MAX_COST).collect();
            if now_used == is_used || now_used.iter().filter(|used| **used).count() < LEAST_USED {
                break;
            }
            is_used = now_used;
        }
        fit
    }

    pub(super) fn costs(&self, fit: &DriveFit, window: Range<usize>) -> Vec<f64> {
        let travel = self.travel_m(fit.drive, window.clone());
        let residuals = travel.iter().zip(&self.readings[window]).map(|(travel_m, (_, range_m))| {
            ((range_m - fit.start_m + fit.steady_m_per_s * travel_m) / self.sigma_m).powi(2).min(MAX_COST)
        });
        residuals.collect()
    }

    fn fit_at(&self, drive: Drive, window: &Range<usize>) -> Option<DriveFit> {
        self.linear_fit(drive, window.clone()).filter(|fit| fit.steady_m_per_s > 0.0)
    }

    /// The best drive near the best of a grid over rate and onset.
    ///
    /// Far from the minimum all readings would be beyond [`MAX_COST`] and tell no direction: the search begins with a wide sigma.
    fn best_of_grid(&self, window: Range<usize>) -> Option<DriveFit> {
        let wide = Self { sigma_m: WIDE_SIGMA_FACTOR * self.sigma_m, ..*self };
        let (low_s, high_s) = self.onset_limits(&window);
        let ratio = MAX_RATE_PER_S / MIN_RATE_PER_S;
        let drives = (0..=RATES).flat_map(|rate| {
            (0..=ONSETS).map(move |onset| Drive {
                rate_per_s: MIN_RATE_PER_S * ratio.powf(f64::from(rate) / f64::from(RATES)),
                onset_s: low_s + (high_s - low_s) * f64::from(onset) / f64::from(ONSETS),
            })
        });
        let fits = drives.filter_map(|drive| wide.fit_at(drive, &window));
        let best = fits.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        wide.refine(&[best], window, COARSE_LN_RATE_STEP)
    }

    /// Minimises over rate and onset from the best of some drives, by steps that halve when they no longer
    /// help.
    fn refine(&self, guesses: &[DriveFit], window: Range<usize>, smallest_step: f64) -> Option<DriveFit> {
        let (low_s, high_s) = self.onset_limits(&window);
        let known = guesses.iter().filter_map(|guess| self.fit_at(guess.drive, &window));
        let mut here = known.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        let mut step = [0.4, ((high_s - low_s) / f64::from(ONSETS)).min(0.2)];
        for _ in 0..120 {
            let moved = |rate_steps: f64, onset_steps: f64| Drive {
                rate_per_s: (here.drive.rate_per_s * (rate_steps * step[0]).exp())
                    .clamp(MIN_RATE_PER_S, MAX_RATE_PER_S),
                onset_s: (here.drive.onset_s + onset_steps * step[1]).clamp(low_s, high_s),
            };
            // The steady part of the drive shows onset + 1 / rate: the valley along which a car may rise later and faster.
            let along_valley = |rate_steps: f64| {
                let Drive { rate_per_s, .. } = moved(rate_steps, 0.0);
                let onset_s = here.drive.onset_s + 1.0 / here.drive.rate_per_s - 1.0 / rate_per_s;
                Drive { rate_per_s, onset_s: onset_s.clamp(low_s, high_s) }
            };
            let pairs =
                [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]];
            let drives = [1.0, -1.0].map(along_valley).into_iter().chain(pairs.map(|[rate, onset]| moved(rate, onset)));
            let mut better = drives.filter_map(|drive| self.fit_at(drive, &window).filter(|fit| fit.cost < here.cost));
            let better = better.next();
            if let Some(better) = better {
                here = better;
            } else {
                step = step.map(|step| 0.5 * step);
                if step[0] < smallest_step {
                    break;
                }
            }
        }
        Some(here)
    }

    /// How much worse the best drive with this rate is, in variances of [`Self::sigma_m`].
    pub(super) fn cost_of_rate(&self, rate_per_s: f64, fit: &DriveFit, window: &Range<usize>) -> f64 {
        let (low_s, high_s) = self.onset_limits(window);
        // A slower car has begun earlier by at most the difference of the time constants.
        let width_s = 1.0 / rate_per_s + 1.0 / fit.drive.rate_per_s;
        let limit = |onset_s: f64| onset_s.clamp(low_s, high_s);
        let cost = |onset_s| {
            let fit = self.fit_at(Drive { rate_per_s, onset_s }, window);
            fit.map_or(f64::INFINITY, |fit| fit.cost)
        };
        let centre_s = fit.drive.onset_s;
        let onset_s =
            golden_section(limit(centre_s - width_s), limit(centre_s + width_s), 30, |onset_s| -cost(onset_s));
        cost(onset_s) - fit.cost
    }

    fn onset_limits(&self, window: &Range<usize>) -> (f64, f64) {
        let (first_s, last_s) = (self.readings[window.start].0, self.readings[window.end - 1].0);
        match self.command {
            StepCommand::Recorded => (-self.log.command_gap_s(), LONGEST_DELAY_S),
            StepCommand::Unknown => (first_s + EARLIEST_ONSET_S, last_s),
        }
    }

    /// By the travel 1 ms before and after.
    pub(super) fn speed_at(&self, fit: &DriveFit, at_s: f64) -> f64 {
        const HALF_S: f64 = 1e-3;
        match self.command {
            StepCommand::Unknown => {
                let since_s = (at_s - fit.drive.onset_s).max(0.0);
                -fit.steady_m_per_s * (-fit.drive.rate_per_s * since_s).exp_m1()
            }
            StepCommand::Recorded => {
                let mut entries: Vec<WallEntry> = self.log.with_delayed_inputs(fit.drive.onset_s).entries().to_vec();
                entries.retain(|entry| matches!(entry.reading, WallReading::Input(_)));
                for probe_s in [at_s - HALF_S, at_s + HALF_S] {
                    entries.push(WallEntry { at_s: probe_s, reading: WallReading::Range(0.0) });
                }
                let travelled = responses(&WallLog::new(entries), fit.drive.rate_per_s);
                match travelled.as_slice() {
                    [before, after] => fit.steady_m_per_s * (after.distance_m - before.distance_m) / (2.0 * HALF_S),
                    _ => 0.0,
                }
            }
        }
    }
}
