//! The step in one log of a real car: which readings belong to it, when it began, and what they say of the drive.
//!
//! ```text
//! z(t) = z_0 - v_ss phi_a(t - t_0)        t_0 the onset: free where no command was recorded, else a dead time of the drive
//! ```
//! A recorded log holds more than a step: rest before it, a stop, a contact or a turn behind it. The step is the stretch of readings
//! that one first-order drive explains. What the readings cannot tell is left out with the reason: v_ss of a car that was still
//! speeding up, the mass of a car that reached its speed between two readings.
//!
//! # Assumptions
//! Readings independent, with one sigma, found from their third differences: these do not see a constant acceleration.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::UncertainValue;

use super::fit::{ManualStepFit, PIECE, SpeedSample, differences, fit_by_hand, overlapping_lines};
use super::log::{WallEntry, WallLog, WallReading, responses};
use super::step_error::{UndeterminedReason, WallStepError};
use super::step_evidence::{Evidence, LARGEST_SHARE, largest_descent, medians_of_three, noise, undetermined};
use crate::statistics::median;

/// Whether the log holds the command that started the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepCommand {
    Recorded,
    /// Full drive from an instant to be found.
    Unknown,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SingleStep {
    /// Steady speed under the input 1; `None` with [`Self::undetermined`].
    pub steady_m_per_s: Option<UncertainValue>,
    pub rise_90_s: Option<UncertainValue>,
    /// d.
    pub drag_s_per_m: Option<UncertainValue>,
    /// m: the inverse of the first acceleration under the input 1.
    pub mass_s2_per_m: Option<UncertainValue>,
    /// Why something is missing.
    pub undetermined: Option<UndeterminedReason>,
    /// When the car began to move; before the first reading for a log that begins on the way.
    pub onset_s: UncertainValue,
    /// First and last reading that belong to the step.
    pub window_s: (f64, f64),
    pub readings: usize,
    /// Readings of the log before and after the window.
    pub left_out: (usize, usize),
    /// Readings in the window that are beyond four sigmas of the drive, and are not used.
    pub outliers: usize,
    /// Noise of a reading: the residuals'.
    pub range_sigma_m: f64,
    /// Speed at the last reading of the step, by the fit.
    pub last_m_per_s: f64,
    /// Finite differences and lines, over the same readings.
    pub by_hand: Result<ManualStepFit, WallStepError>,
    /// Time, reading and fitted distance, in s, m and m.
    pub curve: Vec<(f64, f64, f64)>,
    /// Time and fitted speed, in s and m/s.
    pub speeds: Vec<(f64, f64)>,
    /// Speeds by finite differences of neighbouring readings, and by lines that overlap by half.
    pub differences: Vec<SpeedSample>,
    pub lines: Vec<SpeedSample>,
}

/// Distance that the car must come nearer, in sigmas of a reading: the extremes of a hundred readings at rest, smoothed over three, are
/// 3.5 sigmas apart.
const LEAST_WAY: f64 = 6.0;
/// A reading belongs to the step if its squared residual adds less than this, in variances: a true one adds 1 on average.
const COST_OUTSIDE: f64 = 4.0;
/// What a reading can add at most; four sigmas.
const MAX_COST: f64 = 16.0;
/// A drive is not of first order to better than this share of the way.
const MODEL_SHARE: f64 = 0.004;
/// A sensor has at least this noise, m: it counts in millimetres.
const LEAST_SIGMA_M: f64 = 5e-4;
/// A dead time that makes the fit better by less is taken for zero, in variances: 3.3 sigmas.
const COST_OF_DELAY: f64 = 11.0;
const LONGEST_DELAY_S: f64 = 0.6;
/// A log that begins on the way may have begun so long after the onset.
const EARLIEST_ONSET_S: f64 = -3.0;
const MIN_RATE_PER_S: f64 = 0.05;
const MAX_RATE_PER_S: f64 = 60.0;
const LEAST_READINGS: usize = 6;
/// Ends of the step that are tried at most, each with a fit.
const MOST_ENDS: usize = 40;

/// Finds the step in a log. Refuses with what the readings show instead.
pub fn find_step(log: &WallLog, command: StepCommand) -> Result<SingleStep, WallStepError> {
    let readings: Vec<(f64, f64)> = log.readings().collect();
    if command == StepCommand::Recorded && log.drives_from_s().is_none() {
        return Err(WallStepError::NoInput);
    }
    if readings.len() < LEAST_READINGS {
        return Err(WallStepError::TooFewReadings { found: readings.len(), needed: LEAST_READINGS });
    }
    let smooth = medians_of_three(&readings);
    let (from, to) = largest_descent(&smooth);
    let noise_m = noise(&readings[from..=to.max(from + 4).min(readings.len() - 1)]).max(LEAST_SIGMA_M);
    let way_m = smooth[from] - smooth[to];
    let (low, high) = largest_descent(&smooth.iter().map(|range_m| -range_m).collect::<Vec<_>>());
    let away_m = smooth[high] - smooth[low];
    if way_m < LEAST_WAY * noise_m {
        let way_m = way_m.max(0.0);
        return Err(if away_m >= LEAST_WAY * noise_m {
            WallStepError::MovesAway { away_m }
        } else {
            WallStepError::Stands { way_m: way_m.max(away_m), noise_m }
        });
    }
    let search = Search { log, command, readings: &readings, sigma_m: noise_m.max(MODEL_SHARE * way_m) };
    search.find(from, to)
}

/// Relative step of central differences.
const STEP: f64 = 1e-3;

/// Whether the onset, or dead time, is an unknown of the fit.
#[derive(Clone, Copy, PartialEq, Eq)]
enum OnsetSearch {
    Fixed,
    Free,
}

/// Nonlinear unknowns: the rate a, and the onset or dead time.
#[derive(Clone, Copy, Debug)]
struct Drive {
    rate_per_s: f64,
    onset_s: f64,
}

/// The best drive over some readings.
#[derive(Clone, Copy, Debug)]
struct DriveFit {
    drive: Drive,
    start_m: f64,
    steady_m_per_s: f64,
    /// Sum of capped squared residuals, in variances.
    cost: f64,
}

struct Search<'a> {
    log: &'a WallLog,
    command: StepCommand,
    readings: &'a [(f64, f64)],
    sigma_m: f64,
}

impl Search<'_> {
    fn find(&self, from: usize, to: usize) -> Result<SingleStep, WallStepError> {
        // Rest before the descent holds z_0; the descent's own end may be a stop, a contact or the next turn.
        let mut onset = if self.command == StepCommand::Unknown { OnsetSearch::Free } else { OnsetSearch::Fixed };
        let last = self.readings.len() - 1;
        let shortest = self.shortest_end(from, to);
        let ends = shortest..=last;
        let stride = ends.clone().count().div_ceil(MOST_ENDS);
        let mut start = self.rest_before(from);
        let mut best: Option<(f64, usize, DriveFit)> = None;
        for end in ends.step_by(stride).chain([last]) {
            let window = start..end + 1;
            let known = best.map(|(_, _, fit)| fit.drive);
            let Some(fit) = self.best_drive(window.clone(), onset, known) else { continue };
            let cost = fit.cost + self.cost_after(end);
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, end, fit));
            }
        }
        let (_, mut end, fit) = best.ok_or(WallStepError::NoMotion)?;
        // The stride may have stepped over the end.
        end = self.best_end(&fit, start, shortest.max(end.saturating_sub(stride)), (end + stride).min(last));
        start = self.first_explained(&fit, start.min(from));
        let window = start..end + 1;
        let mut fit = self.best_drive(window.clone(), onset, Some(fit.drive)).ok_or(WallStepError::NoMotion)?;
        if onset == OnsetSearch::Fixed {
            let delayed = self.best_drive(window.clone(), OnsetSearch::Free, None);
            if let Some(delayed) = delayed.filter(|delayed| delayed.cost + COST_OF_DELAY < fit.cost) {
                fit = delayed;
                onset = OnsetSearch::Free;
            }
        }
        self.report(window, &fit, onset)
    }

    /// The descent must have come a third of its way before the step can end.
    fn shortest_end(&self, from: usize, to: usize) -> usize {
        let third = self.readings[from].1 - (self.readings[from].1 - self.readings[to].1) / 3.0;
        let reached = (from..=to).find(|index| self.readings[*index].1 <= third);
        reached.unwrap_or(to).max(from + 4).min(self.readings.len() - 1)
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
    fn travel_m(&self, drive: Drive, window: std::ops::Range<usize>) -> Vec<f64> {
        match self.command {
            StepCommand::Unknown => {
                let since = self.readings[window].iter().map(|(at_s, _)| (at_s - drive.onset_s).max(0.0));
                since.map(|since_s| since_s + (-drive.rate_per_s * since_s).exp_m1() / drive.rate_per_s).collect()
            }
            StepCommand::Recorded => {
                let travelled = if drive.onset_s == 0.0 {
                    responses(self.log, drive.rate_per_s)
                } else {
                    responses(&self.log.with_delayed_inputs(drive.onset_s), drive.rate_per_s)
                };
                let (from, count) = (window.start, window.len());
                travelled.iter().skip(from).take(count).map(|reading| reading.distance_m).collect()
            }
        }
    }

    /// Distance at rest and steady speed by least squares without the readings beyond four sigmas.
    fn linear_fit(&self, drive: Drive, window: std::ops::Range<usize>) -> Option<DriveFit> {
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
            let line = crate::statistics::FittedLine::through(&points)?;
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
            if now_used == is_used || now_used.iter().filter(|used| **used).count() < LEAST_READINGS - 1 {
                break;
            }
            is_used = now_used;
        }
        fit
    }

    fn costs(&self, fit: &DriveFit, window: std::ops::Range<usize>) -> Vec<f64> {
        let travel = self.travel_m(fit.drive, window.clone());
        let residuals = travel.iter().zip(&self.readings[window]).map(|(travel_m, (_, range_m))| {
            ((range_m - fit.start_m + fit.steady_m_per_s * travel_m) / self.sigma_m).powi(2).min(MAX_COST)
        });
        residuals.collect()
    }

    /// Minimises over rate and onset: from a grid, or from a known drive, by steps that halve when they no longer help.
    fn best_drive(&self, window: std::ops::Range<usize>, onset: OnsetSearch, known: Option<Drive>) -> Option<DriveFit> {
        let (low_s, high_s) = self.onset_limits(&window, onset);
        let fit_at = |drive: Drive| self.linear_fit(drive, window.clone()).filter(|fit| fit.steady_m_per_s > 0.0);
        let mut best: Option<DriveFit> = None;
        let mut improve = |drive: Drive| {
            let fit = fit_at(drive)?;
            let is_better = best.is_none_or(|best| fit.cost < best.cost);
            if is_better {
                best = Some(fit);
            }
            is_better.then_some(fit)
        };
        let onsets = if high_s > low_s { 16 } else { 0 };
        let span_s = high_s - low_s;
        if let Some(drive) = known {
            improve(drive);
        }
        for rate in (0..=12).filter(|_| known.is_none()) {
            for onset in 0..=onsets {
                let share = if onsets == 0 { 0.0 } else { f64::from(onset) / f64::from(onsets) };
                improve(Drive {
                    rate_per_s: MIN_RATE_PER_S * (MAX_RATE_PER_S / MIN_RATE_PER_S).powf(f64::from(rate) / 12.0),
                    onset_s: low_s + share * span_s,
                });
            }
        }
        let mut here = best?;
        let mut step = [0.4, (span_s / 16.0).min(0.2)];
        for _ in 0..120 {
            let mut is_moved = false;
            for direction in
                [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]]
            {
                if direction[1] != 0.0 && onsets == 0 {
                    continue;
                }
                let drive = Drive {
                    rate_per_s: (here.drive.rate_per_s * (direction[0] * step[0]).exp())
                        .clamp(MIN_RATE_PER_S, MAX_RATE_PER_S),
                    onset_s: (here.drive.onset_s + direction[1] * step[1]).clamp(low_s, high_s),
                };
                if let Some(fit) = fit_at(drive).filter(|fit| fit.cost < here.cost) {
                    here = fit;
                    is_moved = true;
                    break;
                }
            }
            if !is_moved {
                step = step.map(|step| 0.5 * step);
                if step[0] < 1e-5 {
                    break;
                }
            }
        }
        Some(here)
    }

    fn onset_limits(&self, window: &std::ops::Range<usize>, onset: OnsetSearch) -> (f64, f64) {
        if onset == OnsetSearch::Fixed {
            return (0.0, 0.0);
        }
        let (first_s, last_s) = (self.readings[window.start].0, self.readings[window.end - 1].0);
        match self.command {
            StepCommand::Recorded => (0.0, LONGEST_DELAY_S),
            StepCommand::Unknown => (first_s + EARLIEST_ONSET_S, last_s),
        }
    }

    fn report(
        &self,
        window: std::ops::Range<usize>,
        fit: &DriveFit,
        onset: OnsetSearch,
    ) -> Result<SingleStep, WallStepError> {
        let is_used: Vec<bool> = self.costs(fit, window.clone()).iter().map(|cost| *cost < MAX_COST).collect();
        let used = is_used.iter().filter(|used| **used).count();
        let unknowns = if onset == OnsetSearch::Free { 4 } else { 3 };
        if used <= unknowns + 1 {
            return Err(WallStepError::TooFewReadings { found: used, needed: unknowns + 2 });
        }
        let uncertainty = self.uncertainty(&window, fit, &is_used, onset);
        let readings = &self.readings[window.clone()];
        let (first_s, last_s) = (readings[0].0, readings[readings.len() - 1].0);
        let (steady, rate) = (fit.steady_m_per_s, fit.drive.rate_per_s);
        let commanded_s = match self.command {
            StepCommand::Recorded => self.log.drives_from_s().unwrap_or_default(),
            StepCommand::Unknown => 0.0,
        };
        let onset_s = commanded_s + fit.drive.onset_s;
        let travel = self.travel_m(fit.drive, window.clone());
        let curve: Vec<(f64, f64, f64)> = readings
            .iter()
            .zip(&travel)
            .map(|((at_s, range_m), travel_m)| (*at_s, *range_m, fit.start_m - steady * travel_m))
            .collect();
        let rise = std::f64::consts::LN_10 / rate;
        let known = [
            UncertainValue { value: steady, sigma: uncertainty.steady },
            UncertainValue { value: rise, sigma: rise * uncertainty.log_rate },
            UncertainValue { value: 1.0 / steady, sigma: uncertainty.steady / (steady * steady) },
            UncertainValue { value: 1.0 / (steady * rate), sigma: uncertainty.log_mass / (steady * rate) },
        ];
        let last_m_per_s = self.speed_at(fit, last_s);
        let period_s = median(readings.windows(2).map(|pair| pair[1].0 - pair[0].0)).unwrap_or_default();
        let undetermined = undetermined(&Evidence {
            known,
            log_rate_sigma: uncertainty.log_rate,
            driven_s: last_s - onset_s,
            begins_on_the_way: onset_s < first_s - 0.5 * period_s,
            rate_per_s: rate,
            period_s,
            last_m_per_s,
            noise_m: uncertainty.range_sigma_m,
        });
        let is_sure = |known: &UncertainValue| known.sigma <= LARGEST_SHARE * known.value;
        if let Some(reason) = undetermined.filter(|_| !is_sure(&known[2]) && !is_sure(&known[3])) {
            return Err(WallStepError::Undetermined(reason));
        }
        let [steady_m_per_s, rise_90_s, drag_s_per_m, mass_s2_per_m] = known.map(|known| Some(known).filter(is_sure));
        let piece = (readings.len() / 8).max(PIECE);
        let log = self.window_log(&window, &is_used, onset_s, fit.drive.onset_s);
        let speeds = readings.iter().map(|(at_s, _)| (*at_s, self.speed_at(fit, *at_s)));
        Ok(SingleStep {
            steady_m_per_s,
            rise_90_s,
            drag_s_per_m,
            mass_s2_per_m,
            undetermined,
            onset_s: UncertainValue { value: onset_s, sigma: uncertainty.onset_s },
            window_s: (first_s, last_s),
            readings: used,
            left_out: (window.start, self.readings.len() - window.end),
            outliers: readings.len() - used,
            range_sigma_m: uncertainty.range_sigma_m,
            last_m_per_s,
            by_hand: fit_by_hand(&log, piece),
            curve,
            speeds: speeds.collect(),
            differences: differences(&log),
            lines: overlapping_lines(&log, piece),
        })
    }

    /// The readings of the step with the input that drove it.
    fn window_log(&self, window: &std::ops::Range<usize>, is_used: &[bool], onset_s: f64, delay_s: f64) -> WallLog {
        let readings = self.readings[window.clone()].iter().zip(is_used).filter(|(_, used)| **used);
        let readings =
            readings.map(|((at_s, range_m), _)| WallEntry { at_s: *at_s, reading: WallReading::Range(*range_m) });
        let mut entries: Vec<WallEntry> = readings.collect();
        match self.command {
            StepCommand::Unknown => entries.push(WallEntry { at_s: onset_s, reading: WallReading::Input(1.0) }),
            StepCommand::Recorded => entries.extend(
                self.log
                    .inputs()
                    .map(|(at_s, input)| WallEntry { at_s: at_s + delay_s, reading: WallReading::Input(input) }),
            ),
        }
        WallLog::new(entries)
    }

    /// By the travel 1 ms before and after.
    fn speed_at(&self, fit: &DriveFit, at_s: f64) -> f64 {
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

    /// By least squares about the minimum, with the noise of the residuals.
    fn uncertainty(
        &self,
        window: &std::ops::Range<usize>,
        fit: &DriveFit,
        is_used: &[bool],
        onset: OnsetSearch,
    ) -> Uncertainty {
        let travel = |drive| self.travel_m(drive, window.clone());
        let drive = fit.drive;
        // Central differences; their relative error is the square of the step.
        let by = |ahead: Drive, behind: Drive, width: f64| -> Vec<f64> {
            let (ahead, behind) = (travel(ahead), travel(behind));
            ahead.iter().zip(behind).map(|(ahead, behind)| (ahead - behind) / width).collect()
        };
        let rate = |factor: f64| Drive { rate_per_s: drive.rate_per_s * f64::exp(factor), ..drive };
        let delayed = |shift_s: f64| Drive { onset_s: drive.onset_s + shift_s, ..drive };
        let (here, by_rate) = (travel(drive), by(rate(STEP), rate(-STEP), 2.0 * STEP));
        let by_onset = by(delayed(STEP), delayed(-STEP), 2.0 * STEP);
        let mut normal = SMatrix::<f64, 4, 4>::zeros();
        let mut squares = 0.0;
        for (index, (_, range_m)) in self.readings[window.clone()].iter().enumerate() {
            if !is_used[index] {
                continue;
            }
            let v = fit.steady_m_per_s;
            let onset_share = if onset == OnsetSearch::Free { -v * by_onset[index] } else { 0.0 };
            let row = SVector::<f64, 4>::new(1.0, -here[index], -v * by_rate[index], onset_share);
            normal += row * row.transpose();
            squares += (range_m - fit.start_m + v * here[index]).powi(2);
        }
        let unknowns = if onset == OnsetSearch::Free { 4 } else { 3 };
        if onset == OnsetSearch::Fixed {
            normal[(3, 3)] = 1.0;
        }
        let used = is_used.iter().filter(|used| **used).count();
        let variance_m2 = squares / (used - unknowns) as f64;
        let range_sigma_m = variance_m2.sqrt();
        // Readings that do not depend on a rate (a jump of the speed) make the matrix singular: the rate is then unknown.
        let scale = SMatrix::<f64, 4, 4>::from_diagonal(&normal.diagonal().map(|entry| 1.0 / entry.max(1e-18).sqrt()));
        let inverse = (scale * normal * scale).try_inverse().map(|inverse| scale * inverse * scale * variance_m2);
        let Some(covariance) = inverse.filter(|found| found.diagonal().iter().all(|entry| *entry >= 0.0)) else {
            return Uncertainty {
                steady: f64::INFINITY,
                log_rate: f64::INFINITY,
                log_mass: f64::INFINITY,
                onset_s: f64::INFINITY,
                range_sigma_m,
            };
        };
        let v = fit.steady_m_per_s;
        let log_mass = covariance[(1, 1)] / (v * v) + covariance[(2, 2)] + 2.0 * covariance[(1, 2)] / v;
        Uncertainty {
            steady: covariance[(1, 1)].sqrt(),
            log_rate: covariance[(2, 2)].sqrt(),
            log_mass: log_mass.max(0.0).sqrt(),
            onset_s: if onset == OnsetSearch::Free { covariance[(3, 3)].sqrt() } else { 0.0 },
            range_sigma_m,
        }
    }
}

/// One standard deviation each; infinite where the readings tell nothing.
struct Uncertainty {
    steady: f64,
    /// Of the logarithm of the rate.
    log_rate: f64,
    log_mass: f64,
    onset_s: f64,
    range_sigma_m: f64,
}

#[cfg(test)]
mod tests;
