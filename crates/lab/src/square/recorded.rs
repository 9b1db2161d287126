//! Converts a recorded drive to a table of sensor readings.
//!
//! # Model
//! ```text
//! row k      an instant t_k of a wheel reading
//! gyro       mean of the rates measured in (t_(k-1), t_k], each weighted by the time since the rate before it
//! accel.     mean of those measured in (t_(k-1), t_k]
//! image      a fix goes to the nearest row; wheel odometry moves it by the time difference:
//!            p + d (cos th, sin th), th + dth with d and dth the wheels' share of that time, th in the middle
//! ```
//! A fix without a heading is moved along the chord between its neighbours. Half an interval of 50 ms at 0.2 m/s is 5 mm, the error of
//! a good camera; the wheels know it to a hundredth.
//!
//! # Sources
//! docs/lab/square.md, "A recording".

use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Fix, Heading, Observation, ObservationKind, Point2, Radians, Timestamp,
};

use super::table::{EncoderUnit, MeasuredPose, SensorRow, SensorTable};
use crate::recorded_drive::{DriveEndReference, RecordedDrive, accelerations, fixes, mid_axle_position, moved, wheels};

/// With the path as reference, the last row has the start as its true position.
pub fn table_of(drive: &RecordedDrive, geometry: &DriveGeometry) -> SensorTable {
    let mut samples: Vec<(Timestamp<BrickClock>, [f64; 2])> = wheels(&drive.observations).collect();
    // Of several of one instant the last counts, as in a file.
    samples.dedup_by(|later, kept| {
        let is_same = later.0 == kept.0;
        if is_same {
            *kept = *later;
        }
        is_same
    });
    let rows = samples.iter().map(|(stamp, angles)| SensorRow {
        encoders: angles.map(|angle| angle / geometry.tick.0),
        ..SensorRow::empty(*stamp)
    });
    let mut table = SensorTable { unit: EncoderUnit::Counts, rows: rows.collect() };
    let mut before: Option<Timestamp<BrickClock>> = None;
    let rates = drive.observations.iter().filter_map(|observation| {
        let ObservationKind::TurnRate(rate) = observation.measurement else {
            return None;
        };
        // The first rate covers a time of unknown length: as good as any other.
        let since_s = before.map_or(1e-3, |before| (observation.stamp - before).as_secs_f64());
        before = Some(observation.stamp);
        (since_s > 0.0).then(|| (observation.stamp, [rate.0.to_degrees()], since_s))
    });
    let felt = drive.observations.iter();
    let felt = felt.filter_map(|observation| Some((observation.stamp, accelerations(observation)?, 1.0)));
    let means = row_means(&samples, rates).into_iter().zip(row_means(&samples, felt));
    for (row, (rate, felt)) in table.rows.iter_mut().zip(means) {
        row.gyro_deg_per_s = rate.map(|[rate]| rate);
        row.accelerations_m_per_s2 = felt;
    }
    add_images(&mut table, &samples, &drive.observations, geometry);
    if let Some(first) = table.rows.first_mut() {
        // The start is known better than by one image.
        first.camera = None;
    }
    if drive.end_reference == DriveEndReference::Start {
        let start = MeasuredPose::from_pose(drive.start.pose);
        if let Some(first) = table.rows.first_mut() {
            first.truth = Some(start);
        }
        if let Some(last) = table.rows.last_mut() {
            last.truth = Some(MeasuredPose { theta_deg: None, ..start });
        }
    }
    table
}

/// The mean of the weighted values in each row's interval.
fn row_means<const N: usize>(
    samples: &[(Timestamp<BrickClock>, [f64; 2])],
    values: impl Iterator<Item = (Timestamp<BrickClock>, [f64; N], f64)>,
) -> Vec<Option<[f64; N]>> {
    let mut sums = vec![([0.0; N], 0.0); samples.len()];
    for (stamp, value, weight) in values {
        let row = samples.partition_point(|(at, _)| *at < stamp);
        if let Some((sum, total)) = sums.get_mut(row) {
            for (sum, value) in sum.iter_mut().zip(value) {
                *sum += weight * value;
            }
            *total += weight;
        }
    }
    sums.into_iter().map(|(sum, total)| (total > 0.0).then(|| sum.map(|sum| sum / total))).collect()
}

fn add_images(
    table: &mut SensorTable,
    samples: &[(Timestamp<BrickClock>, [f64; 2])],
    observations: &[Observation],
    geometry: &DriveGeometry,
) {
    let fixes: Vec<(Timestamp<BrickClock>, &Fix)> = fixes(observations).collect();
    for (index, (stamp, fix)) in fixes.iter().enumerate() {
        let after = samples.partition_point(|(at, _)| at < stamp);
        let (Some(later), Some(earlier)) =
            (samples.get(after), after.checked_sub(1).and_then(|index| samples.get(index)))
        else {
            continue;
        };
        let interval_s = (later.0 - earlier.0).as_secs_f64();
        let until_later_s = (later.0 - *stamp).as_secs_f64();
        let is_later_near = until_later_s <= 0.5 * interval_s;
        // Time from the image to its row: negative where the row is the earlier one.
        let (row, carried_s) =
            if is_later_near { (after, until_later_s) } else { (after - 1, until_later_s - interval_s) };
        let step = moved(earlier.1, later.1, geometry);
        let share = carried_s / interval_s;
        let along = course_over_ground(&fixes, index);
        let carried = move_fix(fix, share * step.forward_m, share * step.turn_rad, fix.heading.or(along));
        if let Some(row) = table.rows.get_mut(row) {
            row.camera = Some(carried);
        }
    }
}

fn course_over_ground(fixes: &[(Timestamp<BrickClock>, &Fix)], index: usize) -> Option<Heading> {
    let position = |index: usize| fixes.get(index).map(|(_, fix)| fix.position);
    let here: Point2<Arena> = position(index)?;
    let from = index.checked_sub(1).and_then(position).unwrap_or(here);
    let to = position(index + 1).unwrap_or(here);
    let (x, y) = (to.x.0 - from.x.0, to.y.0 - from.y.0);
    (x != 0.0 || y != 0.0).then(|| Heading::from_rad(y.atan2(x)))
}

fn move_fix(fix: &Fix, forward_m: f64, turn_rad: f64, along: Option<Heading>) -> MeasuredPose {
    let position = mid_axle_position(fix);
    let theta_deg = fix.heading.map(|heading| (heading + Radians(turn_rad)).rad().to_degrees());
    let middle = along.map_or(0.0, |along| along.rad() + 0.5 * turn_rad);
    let forward_m = if along.is_some() { forward_m } else { 0.0 };
    MeasuredPose {
        x_m: position.x.0 + forward_m * middle.cos(),
        y_m: position.y.0 + forward_m * middle.sin(),
        theta_deg,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{self, observation};
    use posebridge_estimator::FilterConfig;
    use posebridge_telemetry::{Meters, MetersPerSecondSquared, RadiansPerSecond, SensorId, SensorNoise};

    fn config() -> FilterConfig {
        test_support::config([0.05; 2], 0.2, 0.01, SensorNoise::EXACT)
    }

    /// 0.2 m/s to the north, read every 100 ms, after 200 ms of rest.
    fn northwards() -> Vec<Observation> {
        let angle = |step: i64| 0.4 * (step - 2).max(0) as f64;
        (0..12).map(|step| test_support::wheels(100 * step, angle(step), angle(step))).collect()
    }

    fn fix(millis: i64, y: f64, heading: Option<f64>) -> Observation {
        test_support::fix(millis, 1.0, y, heading)
    }

    fn table(observations: &[Observation]) -> SensorTable {
        let drive = RecordedDrive::new(observations, &config(), None).unwrap();
        table_of(&drive, &config().geometry)
    }

    #[test]
    fn an_image_is_carried_to_the_nearest_row_whether_it_has_a_heading_or_not() {
        let north = Some(std::f64::consts::FRAC_PI_2);
        for heading in [north, None] {
            let mut observations = northwards();
            // y = 0.2 (t - 0.2); at 440 ms the row of 400 ms is nearer, at 770 ms that of 800 ms.
            for (millis, y) in [(0, 0.0), (440, 0.048), (770, 0.114), (1_100, 0.18)] {
                observations.push(fix(millis, y, heading));
            }
            observations.push(fix(1_050, 0.2, heading));
            let config = FilterConfig {
                start: heading.is_none().then_some(posebridge_telemetry::StartPose {
                    pose: posebridge_telemetry::Pose::new(Meters(1.0), Meters(0.0), Heading::from_rad(1.57)),
                    position_sigma_m: 0.01,
                    heading_sigma_rad: 0.01,
                }),
                ..config()
            };
            let drive = RecordedDrive::new(&observations, &config, None).unwrap();
            let table = table_of(&drive, &config.geometry);
            let y = |row: usize| table.rows[row].camera.unwrap().y_m;
            assert!((y(4) - 0.04).abs() < 1e-9, "{heading:?}: {}", y(4));
            assert!((y(8) - 0.12).abs() < 1e-9, "{heading:?}: {}", y(8));
            let with_image = table.rows.iter().filter(|row| row.camera.is_some());
            assert_eq!(with_image.count(), 3, "one reference row each, none at the start");
        }
    }

    #[test]
    fn rates_are_weighted_by_their_time_and_accelerations_are_not() {
        let mut observations = northwards();
        let rate =
            |millis, rate| observation(SensorId::WHEELS, millis, ObservationKind::TurnRate(RadiansPerSecond(rate)));
        observations.extend([rate(400, 0.0), rate(475, 1.0), rate(500, 3.0)]);
        for (millis, left) in [(410, 1.0), (450, 2.0), (500, 3.0), (501, 9.0)] {
            let felt = ObservationKind::WheelAccelerations {
                left: MetersPerSecondSquared(left),
                right: MetersPerSecondSquared(-left),
            };
            observations.push(observation(SensorId::WHEELS, millis, felt));
        }
        let row = table(&observations).rows[5];
        let rate = row.gyro_deg_per_s.unwrap().to_radians();
        assert!((rate - 1.5).abs() < 1e-12, "{rate}");
        assert_eq!(row.accelerations_m_per_s2, Some([2.0, -2.0]));
        assert_eq!(row.camera, None);
    }

    #[test]
    fn a_closed_path_has_a_reference_in_its_last_row_only() {
        let table = table(&northwards());
        let references = table.references(10);
        assert_eq!(references.iter().flatten().count(), 1);
        assert_eq!(references.last().unwrap().unwrap().theta_deg, None);
        assert!((table.rows[11].encoders[0] - 360.0).abs() < 1e-9);
    }
}
