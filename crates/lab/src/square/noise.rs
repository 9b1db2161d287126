//! R from recordings instead of tuning by hand: a stop and a straight run, as in the paper.
//!
//! At rest a counter does not move, so a stop does not show its rounding: its R would be zero and the filter would trust every count. A
//! straight run shows it, as the residual of a straight line.
//!
//! # Model
//! ```text
//! rounding  a count is uniform within its tick: tick^2 / 12; of v (r tick / T)^2 / 12, of w (r tick / (b T))^2 / 3
//! stop      rows until a wheel counts: mean and variance of gyro, accelerometers, camera
//! straight  the longest stretch in which both wheels turn and the robot does not, five rows cut at both ends
//!           counters, th_enc, th_gyro: variance about a line of least squares    speeds, gyro: variance about their mean
//! ```
//! # Assumptions
//! A robot that is steered on its straight run really turns a little: that is common to th_enc and th_gyro, and in no R.
//!
//! # Sources
//! Paper 1 (Valera et al.): its R are "from a test at rest and from a straight run, then trimmed by hand".

use posebridge_estimator::papers::paper1::SAMPLING_INTERVAL_S;
use posebridge_telemetry::DriveGeometry;

use super::table::{SensorRow, SensorTable};
use crate::recorded_drive::rolled_step;
use crate::statistics::{FittedLine, longest_run, mean_and_variance};

/// Rows omitted at both ends of a straight run: the robot starts and stops there.
const END_ROWS: usize = 8;
const WINDOW_ROWS: usize = 5;
/// Largest mean turn within the window, rad per m of travel: 15 degrees per metre.
const MAX_TURN_RAD_PER_M: f64 = 0.26;
const MIN_ROWS: usize = 10;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanAndVariance {
    /// Mean, or slope per second for values that drift.
    pub mean: f64,
    pub variance: f64,
}

/// Noise of a record; `None` for too few readings. Units are those of the paper: degrees, cm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NoiseRecord {
    pub from: usize,
    pub rows: usize,
    /// The left and the right counter, degrees²: R of the wheels' filters.
    pub counters: Option<[MeanAndVariance; 2]>,
    /// v by the counters, (cm/s)²: R of both others.
    pub forward: Option<MeanAndVariance>,
    /// w by the counters, (degrees/s)²: R of the speeds' filter.
    pub turn: Option<MeanAndVariance>,
    /// th_enc, degrees²: R of the EKF.
    pub wheel_heading: Option<MeanAndVariance>,
    /// The gyro, (degrees/s)².
    pub gyro: Option<MeanAndVariance>,
    /// th_gyro without the gyro's mean, degrees²: R of the EKF.
    pub gyro_heading: Option<MeanAndVariance>,
    /// The accelerometers at the left and at the right wheel, (m/s²)².
    pub accelerometers: Option<[MeanAndVariance; 2]>,
    /// The camera's x and y, cm².
    pub camera: Option<[MeanAndVariance; 2]>,
}

/// R by the resolution of the counters alone, at the paper's interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoundingVariances {
    /// Degrees².
    pub counter: f64,
    /// (cm/s)².
    pub forward: f64,
    /// (degrees/s)².
    pub turn: f64,
}

pub fn rounding_variances(geometry: &DriveGeometry) -> RoundingVariances {
    let radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
    let count_m_per_s = radius_m * geometry.tick.0 / SAMPLING_INTERVAL_S;
    RoundingVariances {
        counter: geometry.tick.0.to_degrees().powi(2) / 12.0,
        forward: (100.0 * count_m_per_s).powi(2) / 12.0,
        turn: (count_m_per_s / geometry.track_width.0).to_degrees().powi(2) / 3.0,
    }
}

pub fn noise_at_stop(table: &SensorTable, geometry: &DriveGeometry) -> Option<NoiseRecord> {
    record(table, 0, table.at_rest().len(), geometry)
}

pub fn noise_on_straight(table: &SensorTable, geometry: &DriveGeometry) -> Option<NoiseRecord> {
    let (from, length) = longest_run((0..table.rows.len()).map(|row| is_straight(table, row, geometry)));
    record(table, from + END_ROWS, length.checked_sub(2 * END_ROWS)?, geometry)
}

fn is_straight(table: &SensorTable, row: usize, geometry: &DriveGeometry) -> bool {
    let Some(before) = row.checked_sub(WINDOW_ROWS).and_then(|row| table.rows.get(row)) else {
        return false;
    };
    let Some(after) = table.rows.get(row + WINDOW_ROWS) else {
        return false;
    };
    let (forward_m, turn_rad) = driven(table, before, after, geometry);
    let count_m = table.unit.rad_per_unit(geometry) * geometry.left_wheel_radius.0;
    let moves = forward_m.abs() > 2.0 * WINDOW_ROWS as f64 * count_m;
    moves && turn_rad.abs() <= MAX_TURN_RAD_PER_M * forward_m.abs() + count_m / geometry.track_width.0
}

fn driven(table: &SensorTable, from: &SensorRow, to: &SensorRow, geometry: &DriveGeometry) -> (f64, f64) {
    let unit_rad = table.unit.rad_per_unit(geometry);
    let turned = |wheel: usize| (to.encoders[wheel] - from.encoders[wheel]) * unit_rad;
    let body = rolled_step([turned(0), turned(1)], geometry);
    (body.forward_m, body.turn_rad)
}

fn record(table: &SensorTable, from: usize, count: usize, geometry: &DriveGeometry) -> Option<NoiseRecord> {
    let rows = table.rows.get(from..from + count)?;
    if rows.len() < MIN_ROWS {
        return None;
    }
    let first = rows.first()?;
    let unit_deg = table.unit.rad_per_unit(geometry).to_degrees();
    let times: Vec<f64> = rows.iter().map(|row| row.time_s).collect();
    let all = |pick: &dyn Fn(&SensorRow) -> Option<f64>| -> Vec<Option<f64>> { rows.iter().map(pick).collect() };
    let counter = |wheel: usize| spread_about_line(&times, &all(&|row| Some(row.encoders[wheel] * unit_deg)));
    let speeds: Vec<(f64, f64)> = rows
        .windows(2)
        .map(|pair| {
            let dt_s = pair[1].time_s - pair[0].time_s;
            let (forward_m, turn_rad) = driven(table, &pair[0], &pair[1], geometry);
            (100.0 * forward_m / dt_s, turn_rad.to_degrees() / dt_s)
        })
        .collect();
    let heading = |row: &SensorRow| Some(driven(table, first, row, geometry).1.to_degrees());
    let acceleration = |wheel: usize| spread_about_mean(&all(&|row| Some(row.accelerations_m_per_s2?[wheel])));
    Some(NoiseRecord {
        from,
        rows: rows.len(),
        counters: both(counter(0), counter(1)),
        forward: spread_about_mean(&speeds.iter().map(|speed| Some(speed.0)).collect::<Vec<_>>()),
        turn: spread_about_mean(&speeds.iter().map(|speed| Some(speed.1)).collect::<Vec<_>>()),
        wheel_heading: spread_about_line(&times, &all(&heading)),
        gyro: spread_about_mean(&all(&|row| row.gyro_deg_per_s)),
        gyro_heading: spread_about_line(&times, &integrated(rows)),
        accelerometers: both(acceleration(0), acceleration(1)),
        camera: both(
            spread_about_mean(&all(&|row| Some(100.0 * row.camera?.x_m))),
            spread_about_mean(&all(&|row| Some(100.0 * row.camera?.y_m))),
        ),
    })
}

fn both<T>(one: Option<T>, other: Option<T>) -> Option<[T; 2]> {
    Some([one?, other?])
}

/// Integral of the gyro, degrees.
fn integrated(rows: &[SensorRow]) -> Vec<Option<f64>> {
    let mut heading_deg = 0.0;
    let mut before_s = rows.first().map_or(0.0, |row| row.time_s);
    let sums = rows.iter().map(|row| {
        heading_deg += row.gyro_deg_per_s? * (row.time_s - before_s);
        before_s = row.time_s;
        Some(heading_deg)
    });
    sums.collect()
}

fn spread_about_mean(values: &[Option<f64>]) -> Option<MeanAndVariance> {
    let values: Vec<f64> = values.iter().flatten().copied().collect();
    if values.len() < MIN_ROWS {
        return None;
    }
    let (mean, variance) = mean_and_variance(&values)?;
    Some(MeanAndVariance { mean, variance })
}

fn spread_about_line(times: &[f64], values: &[Option<f64>]) -> Option<MeanAndVariance> {
    let points: Vec<(f64, f64)> =
        times.iter().zip(values).filter_map(|(time, value)| Some((*time, (*value)?))).collect();
    if points.len() < MIN_ROWS {
        return None;
    }
    let line = FittedLine::through(&points)?;
    let squares: f64 = points.iter().map(|point| line.residual(*point).powi(2)).sum();
    Some(MeanAndVariance { mean: line.slope, variance: squares / (points.len() as f64 - 2.0) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support;
    use posebridge_telemetry::{SensorNoise, Timestamp};

    fn geometry() -> DriveGeometry {
        test_support::config([0.028; 2], 0.112, 0.017_453_292_519_943_295, SensorNoise::EXACT).geometry
    }

    /// Two seconds at rest, four at a speed that is no whole number of counts per row, one of turning in place.
    fn drive() -> SensorTable {
        let rows = (0..140).map(|index| {
            let moving = f64::from((index - 40).clamp(0, 80));
            let turning = f64::from((index - 120).max(0));
            let counted = |sign: f64| (20.317 * moving + sign * 4.0 * turning).floor();
            SensorRow {
                encoders: [counted(-1.0), counted(1.0)],
                gyro_deg_per_s: Some(if index % 2 == 0 { 2.0 } else { 0.0 }),
                ..SensorRow::empty(Timestamp::from_millis(50 * i64::from(index)))
            }
        });
        SensorTable { rows: rows.collect(), ..SensorTable::default() }
    }

    #[test]
    fn a_stop_says_nothing_of_rounding_and_a_straight_run_a_twelfth() {
        let rest = noise_at_stop(&drive(), &geometry()).unwrap();
        assert_eq!((rest.from, rest.rows), (0, 41));
        assert_eq!(rest.counters.unwrap()[0].variance, 0.0);
        let gyro = rest.gyro.unwrap();
        assert!((gyro.mean - 1.0).abs() < 0.05 && (gyro.variance - 1.0).abs() < 0.05);
        let straight = noise_on_straight(&drive(), &geometry()).unwrap();
        assert!(straight.from > 40 && straight.from + straight.rows < 121, "{straight:?}");
        let [left, right] = straight.counters.unwrap();
        assert!((left.variance - 1.0 / 12.0).abs() < 0.02, "{left:?}");
        assert!((left.mean - 20.317 / 0.05).abs() < 1.0);
        assert_eq!(left, right);
        assert!(straight.wheel_heading.unwrap().variance < 1e-20);
        assert_eq!(straight.camera, None);
    }

    #[test]
    fn variances_of_rounding_are_those_computed_by_hand() {
        let found = rounding_variances(&geometry());
        assert!((found.counter - 1.0 / 12.0).abs() < 1e-12);
        // One count in 50 ms is 0.97738 cm/s; over the track 5 degrees/s.
        assert!((found.forward - 0.977_38_f64.powi(2) / 12.0).abs() < 1e-6);
        assert!((found.turn - 25.0 / 3.0).abs() < 1e-3);
    }

    #[test]
    fn without_a_straight_run_there_is_no_record() {
        let mut table = drive();
        table.rows.truncate(40);
        assert_eq!(noise_on_straight(&table, &geometry()), None);
        table.rows.truncate(5);
        assert_eq!(noise_at_stop(&table, &geometry()), None);
    }
}
