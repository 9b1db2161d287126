//! The step in one log of a real car: which readings belong to it, when it began, and what they say of the drive.
//!
//! ```text
//! z(t) = z_0 - v_ss phi_a(t - t_0)        t_0 the onset, which is always free
//! ```
//! A recorded command limits the onset and does not fix it: a log of samples shows only between which two rows the command came, and
//! drive and sensor have a dead time. An onset that is wrong by half a row of 80 ms makes t90 wrong by a fifth.
//!
//! A recorded log holds more than a step: rest before it, a stop, a contact or a turn behind it. The step is the stretch of readings
//! that one first-order drive explains. What the readings cannot tell is left out with the reason: v_ss of a car that may still
//! be speeding up, the mass of a car that reached its speed between two readings.
//!
//! # Assumptions
//! Readings have one sigma. Which of them belong to the step is decided with that of their third differences, which do not see a constant
//! acceleration.

use std::ops::Range;

use posebridge_telemetry::UncertainValue;

mod drive_search;
#[cfg(test)]
mod population;
#[cfg(test)]
mod tests;
mod uncertainty;

use self::drive_search::{DriveFit, DriveSearch, LEAST_USED, MAX_COST};
use self::uncertainty::drive_uncertainty;
use super::fit::{ManualStepFit, PIECE, SpeedSample, differences, fit_by_hand, overlapping_lines};
use super::log::{StepCommand, WallEntry, WallLog, WallReading};
use super::step_error::{UndeterminedReason, WallStepError};
use super::step_evidence::{Evidence, LARGEST_SHARE, largest_descent, medians_of_three, noise, undetermined};
use crate::statistics::median;

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
const MIN_TRAVEL_SIGMAS: f64 = 6.0;
/// A drive is not of first order to better than this share of the way.
const MODEL_SHARE: f64 = 0.004;
/// A sensor has at least this noise, m: it counts in millimetres.
const LEAST_SIGMA_M: f64 = 5e-4;
/// After so many time constants a car has 86 % of its steady speed.
const TIME_CONSTANTS: f64 = 2.0;
/// At this rate, times the interval of the readings, a car has half its speed after one reading.
const RATE_BETWEEN_READINGS: f64 = 0.7;
/// A rate that costs more is excluded, in variances: two sigmas.
const EXCLUDED_COST: f64 = 4.0;

/// Finds the step in a log. Refuses with what the readings show instead.
pub fn find_step(log: &WallLog, command: StepCommand) -> Result<SingleStep, WallStepError> {
    let readings: Vec<(f64, f64)> = log.readings().collect();
    if command == StepCommand::Recorded && log.drives_from_s().is_none() {
        return Err(WallStepError::NoInput);
    }
    if readings.len() < LEAST_USED {
        return Err(WallStepError::TooFewReadings { found: readings.len(), needed: LEAST_USED });
    }
    let smooth = medians_of_three(&readings);
    let (from, to) = largest_descent(&smooth);
    let noise_m = noise(&readings[from..=to.max(from + 4).min(readings.len() - 1)]).max(LEAST_SIGMA_M);
    let way_m = smooth[from] - smooth[to];
    let (low, high) = largest_descent(&smooth.iter().map(|range_m| -range_m).collect::<Vec<_>>());
    let away_m = smooth[high] - smooth[low];
    if way_m < MIN_TRAVEL_SIGMAS * noise_m {
        let way_m = way_m.max(0.0);
        return Err(if away_m >= MIN_TRAVEL_SIGMAS * noise_m {
            WallStepError::MovesAway { away_m }
        } else {
            WallStepError::Stands { way_m: way_m.max(away_m), noise_m }
        });
    }
    let search = DriveSearch { log, command, readings: &readings, sigma_m: noise_m.max(MODEL_SHARE * way_m) };
    let (window, fit) = search.find(from, to).ok_or(WallStepError::NoMotion)?;
    report(&search, &window, &fit)
}

fn report(search: &DriveSearch<'_>, window: &Range<usize>, fit: &DriveFit) -> Result<SingleStep, WallStepError> {
    let is_used: Vec<bool> = search.costs(fit, window.clone()).iter().map(|cost| *cost < MAX_COST).collect();
    let used = is_used.iter().filter(|used| **used).count();
    if used < LEAST_USED {
        return Err(WallStepError::TooFewReadings { found: used, needed: LEAST_USED });
    }
    let uncertainty = drive_uncertainty(search, window, fit, &is_used);
    let readings = &search.readings[window.clone()];
    let (first_s, last_s) = (readings[0].0, readings[readings.len() - 1].0);
    let (steady, rate) = (fit.steady_m_per_s, fit.drive.rate_per_s);
    let commanded_s = match search.command {
        StepCommand::Recorded => search.log.drives_from_s().unwrap_or_default(),
        StepCommand::Unknown => 0.0,
    };
    let onset_s = commanded_s + fit.drive.onset_s;
    let travel = search.travel_m(fit.drive, window.clone());
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
    let last_m_per_s = search.speed_at(fit, last_s);
    let period_s = median(readings.windows(2).map(|pair| pair[1].0 - pair[0].0)).unwrap_or_default();
    let excludes = |rate_per_s: f64| {
        let variances = (search.sigma_m / uncertainty.range_sigma_m).powi(2);
        variances * search.cost_of_rate(rate_per_s, fit, window) > EXCLUDED_COST
    };
    let (least_rate, most_rate) = (TIME_CONSTANTS / (last_s - onset_s), RATE_BETWEEN_READINGS / period_s);
    let undetermined = undetermined(&Evidence {
        known,
        log_rate_sigma: uncertainty.log_rate,
        begins_on_the_way: onset_s < first_s - 0.5 * period_s,
        may_still_speed_up: rate < least_rate || !excludes(least_rate),
        rises_between_readings: rate > most_rate && excludes(most_rate),
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
    let log = window_log(search, window, &is_used, onset_s, fit.drive.onset_s);
    let speeds = readings.iter().map(|(at_s, _)| (*at_s, search.speed_at(fit, *at_s)));
    Ok(SingleStep {
        steady_m_per_s,
        rise_90_s,
        drag_s_per_m,
        mass_s2_per_m,
        undetermined,
        onset_s: UncertainValue { value: onset_s, sigma: uncertainty.onset_s },
        window_s: (first_s, last_s),
        readings: used,
        left_out: (window.start, search.readings.len() - window.end),
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
fn window_log(
    search: &DriveSearch<'_>,
    window: &Range<usize>,
    is_used: &[bool],
    onset_s: f64,
    delay_s: f64,
) -> WallLog {
    let readings = search.readings[window.clone()].iter().zip(is_used).filter(|(_, used)| **used);
    let readings =
        readings.map(|((at_s, range_m), _)| WallEntry { at_s: *at_s, reading: WallReading::Range(*range_m) });
    let mut entries: Vec<WallEntry> = readings.collect();
    match search.command {
        StepCommand::Unknown => entries.push(WallEntry { at_s: onset_s, reading: WallReading::Input(1.0) }),
        StepCommand::Recorded => entries.extend(
            search
                .log
                .inputs()
                .map(|(at_s, input)| WallEntry { at_s: at_s + delay_s, reading: WallReading::Input(input) }),
        ),
    }
    WallLog::new(entries)
}
