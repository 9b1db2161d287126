//! A table of sensor readings, logged by a brick or simulated.
//!
//! Recorded and simulated drives both use it, so that an exported drive reads back as the same drive to the last bit. Units are those
//! of the file and of the paper's brick (counts, degrees); [`SensorTable::observations`] converts them to SI.

use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Fix, Heading, Meters, MetersPerSecondSquared, Observation, ObservationKind,
    Point2, Pose, Radians, RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::statistics::normal_pair;

const NANOS_PER_S: f64 = 1e9;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EncoderUnit {
    #[default]
    Counts,
    Degrees,
}

impl EncoderUnit {
    pub fn rad_per_unit(self, geometry: &DriveGeometry) -> f64 {
        match self {
            Self::Counts => geometry.tick.0,
            Self::Degrees => 1.0_f64.to_radians(),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPose {
    pub x_m: f64,
    pub y_m: f64,
    /// Against the arena's x axis, counter-clockwise; `None` if not measured.
    pub theta_deg: Option<f64>,
}

/// The sensor readings of one instant; `None` for no reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorRow {
    /// Since any zero.
    pub time_s: f64,
    /// Rotation of the left and the right wheel since the counters were zeroed, forward positive, in the table's unit.
    pub encoders: [f64; 2],
    /// Mean since the previous row, bias included, counter-clockwise positive.
    pub gyro_deg_per_s: Option<f64>,
    /// Forward, at the left and at the right wheel.
    pub accelerations_m_per_s2: Option<[f64; 2]>,
    pub camera: Option<MeasuredPose>,
    pub compass_deg: Option<f64>,
    pub truth: Option<MeasuredPose>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorTable {
    pub unit: EncoderUnit,
    /// Each is later than the previous one.
    pub rows: Vec<SensorRow>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableSensor {
    Wheels,
    Gyro,
    Accelerometers,
    Camera,
    Compass,
}

impl SensorRow {
    pub fn empty(stamp: Timestamp<BrickClock>) -> Self {
        Self {
            time_s: stamp.as_nanos() as f64 / NANOS_PER_S,
            encoders: [0.0; 2],
            gyro_deg_per_s: None,
            accelerations_m_per_s2: None,
            camera: None,
            compass_deg: None,
            truth: None,
        }
    }

    /// Stores a sensor reading, the inverse of [`SensorRow::observations`]; ignores kinds without a column. `unit_rad` is the encoder
    /// unit, to which a counter is rounded.
    pub fn record(&mut self, observed: &ObservationKind, unit_rad: f64) {
        match observed {
            ObservationKind::WheelAngles { left, right } => {
                self.encoders = [left, right].map(|angle| (angle.0 / unit_rad).round());
            }
            ObservationKind::TurnRate(rate) => self.gyro_deg_per_s = Some(rate.0.to_degrees()),
            ObservationKind::WheelAccelerations { left, right } => {
                self.accelerations_m_per_s2 = Some([left.0, right.0]);
            }
            ObservationKind::Fix(fix) => {
                self.camera = Some(MeasuredPose {
                    x_m: fix.position.x.0,
                    y_m: fix.position.y.0,
                    theta_deg: fix.heading.map(|heading| heading.rad().to_degrees()),
                });
            }
            ObservationKind::CompassHeading(heading) => {
                self.compass_deg = Some(heading.rad().to_degrees());
            }
            ObservationKind::OdometerPose(_)
            | ObservationKind::BodyVelocity { .. }
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::Temperature(_) => {}
        }
    }

    /// Observations of the sensors in `senses`, wheels first. `unit_rad` is the encoder unit.
    pub fn observations(&self, unit_rad: f64, senses: &[TableSensor]) -> impl Iterator<Item = Observation> {
        let stamp = self.stamp();
        let observed_kinds = senses.iter().filter_map(move |sense| {
            let (sensor, observed) = self.observation(*sense, unit_rad)?;
            Some(Observation { sensor, stamp, stamp_sigma: TimeDelta::ZERO, measurement: observed })
        });
        observed_kinds.collect::<Vec<_>>().into_iter()
    }

    pub fn stamp(&self) -> Timestamp<BrickClock> {
        Timestamp::from_nanos(TimeDelta::from_secs_f64(self.time_s).as_nanos())
    }

    fn observation(&self, sense: TableSensor, unit_rad: f64) -> Option<(SensorId, ObservationKind)> {
        match sense {
            TableSensor::Wheels => {
                let [left, right] = self.encoders.map(|count| Radians(count * unit_rad));
                Some((SensorId::WHEELS, ObservationKind::WheelAngles { left, right }))
            }
            TableSensor::Gyro => {
                let rate = RadiansPerSecond(self.gyro_deg_per_s?.to_radians());
                Some((SensorId::GYRO, ObservationKind::TurnRate(rate)))
            }
            TableSensor::Accelerometers => {
                let [left, right] = self.accelerations_m_per_s2?.map(MetersPerSecondSquared);
                let observed = ObservationKind::WheelAccelerations { left, right };
                Some((SensorId::ACCELEROMETER, observed))
            }
            TableSensor::Camera => Some((SensorId::CAMERA, ObservationKind::Fix(self.camera?.fix()))),
            TableSensor::Compass => {
                let heading = Heading::from_rad(self.compass_deg?.to_radians());
                Some((SensorId::COMPASS, ObservationKind::CompassHeading(heading)))
            }
        }
    }
}

impl MeasuredPose {
    pub fn from_pose(pose: Pose<Arena>) -> Self {
        Self { x_m: pose.x.0, y_m: pose.y.0, theta_deg: Some(pose.heading.rad().to_degrees()) }
    }

    /// As a pose of the arena; a missing heading becomes zero.
    pub fn pose(&self) -> Pose<Arena> {
        let heading = Heading::from_rad(self.theta_deg.unwrap_or(0.0).to_radians());
        Pose::new(Meters(self.x_m), Meters(self.y_m), heading)
    }

    fn fix(&self) -> Fix {
        Fix {
            position: Point2::<Arena>::new(Meters(self.x_m), Meters(self.y_m)),
            heading: self.theta_deg.map(|theta_deg| Heading::from_rad(theta_deg.to_radians())),
            covariance: None,
            tag_in_body: Point2::ORIGIN,
            reset_counter: 0,
        }
    }
}

impl SensorTable {
    /// The initial rows until a wheel counts: the stop before a drive.
    pub fn at_rest(&self) -> &[SensorRow] {
        let Some(first) = self.rows.first() else {
            return &self.rows;
        };
        let still = |row: &&SensorRow| row.encoders == first.encoders;
        let count = self.rows.iter().take_while(still).count();
        &self.rows[..count]
    }

    /// Whether each row's image is passed to the filters that use a camera: every `every`-th one. The first row's is excluded, because
    /// it is the start.
    pub fn used_images(&self, every: usize) -> Vec<bool> {
        let mut images = 0_usize;
        let rows = self.rows.iter().enumerate();
        rows.map(|(index, row)| {
            let has_image = index > 0 && row.camera.is_some();
            images += usize::from(has_image);
            has_image && images.is_multiple_of(every)
        })
        .collect()
    }

    /// The reference in each row: the truth, or, if the whole table has none, an image that no filter got. Excludes the first row,
    /// which is the start.
    pub fn references(&self, every: usize) -> Vec<Option<MeasuredPose>> {
        let has_truth = self.has_truth();
        let rows = self.rows.iter().zip(self.used_images(every)).enumerate();
        rows.map(|(index, (row, is_used))| match (index, has_truth) {
            (0, _) => None,
            (_, true) => row.truth,
            (_, false) => row.camera.filter(|_| !is_used),
        })
        .collect()
    }

    pub fn has_truth(&self) -> bool {
        self.rows.first().is_some_and(|row| row.truth.is_some())
    }
}

// What is done to a table of a drive before anything follows it: a compass, and other readings of the paper's measurements.
//
// # Model
// ```text
// compass   z = round(th + a sin(th - phi) + sigma n)      a, phi drawn once per drive; n standard normal
// jitter    count + sigma_i n, on each reading anew
// late      the reference of row k is that of row k - d: a camera with an uncorrected delay
// interval  the accelerations of row k are those of row k + 1
// ```
// The deviation of iron that turns with the robot is one period per turn, to first order (the "semicircular" deviation of
// a ship's compass). Sources: National Geospatial-Intelligence Agency, Handbook of Magnetic Compass Adjustment (2004), chapter 3;
// one degree of resolution: data sheet of the HiTechnic compass.

const COMPASS_SIGMA_DEG: f64 = 3.0;
/// Of the amplitude of the compass deviation: motors distort the field by some degrees.
const DEVIATION_SIGMA_DEG: f64 = 3.0;

fn normal(random: &mut Pcg64) -> f64 {
    normal_pair(random.random(), random.random())[0]
}

/// Fills the compass column of every row that has a true heading.
pub fn add_compass(table: &mut SensorTable, seed: u64) {
    let mut random = Pcg64::seed_from_u64(seed ^ 0xc0_4a55);
    let amplitude_deg = DEVIATION_SIGMA_DEG * normal(&mut random);
    let phase_rad = std::f64::consts::PI * normal(&mut random);
    for row in &mut table.rows {
        let Some(theta_deg) = row.truth.and_then(|truth| truth.theta_deg) else {
            continue;
        };
        let bent_deg = amplitude_deg * (theta_deg.to_radians() - phase_rad).sin();
        let noise_deg = COMPASS_SIGMA_DEG * normal(&mut random);
        row.compass_deg = Some((theta_deg + bent_deg + noise_deg).round());
    }
}

/// Adds white noise to every reading of both counters but the first; variances of the left and the right one, in the table's unit
/// squared.
pub fn add_jitter(table: &mut SensorTable, variances: [f64; 2], seed: u64) {
    let mut random = Pcg64::seed_from_u64(seed ^ 0x71_77e2);
    for row in table.rows.iter_mut().skip(1) {
        for (count, variance) in row.encoders.iter_mut().zip(variances) {
            *count = (*count + variance.sqrt() * normal(&mut random)).round();
        }
    }
}

/// Delays the reference by `rows`, like a camera with an uncorrected delay.
pub fn delay_reference(table: &mut SensorTable, rows: usize) {
    let truths: Vec<_> = table.rows.iter().map(|row| row.truth).collect();
    for (index, row) in table.rows.iter_mut().enumerate() {
        row.truth = truths.get(index.saturating_sub(rows)).copied().flatten();
    }
}

/// Gives each row the accelerations of the next: an accelerometer measures the change of speed over the interval that ends with its
/// reading, and the paper's equation 20 applies the reading of the row before.
pub fn align_accelerations(table: &mut SensorTable) {
    let mut next = None;
    for row in table.rows.iter_mut().rev() {
        next = std::mem::replace(&mut row.accelerations_m_per_s2, next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_heard_is_said_again() {
        let stamp = Timestamp::from_nanos(1_050_000_000);
        let tick_rad = 1.0_f64.to_radians();
        let observed_kinds = [
            ObservationKind::WheelAngles { left: Radians(3.0 * tick_rad), right: Radians(-4.0 * tick_rad) },
            ObservationKind::WheelAccelerations {
                left: MetersPerSecondSquared(0.1),
                right: MetersPerSecondSquared(-0.2),
            },
            ObservationKind::TurnRate(RadiansPerSecond(2.0_f64.to_radians())),
        ];
        let mut row = SensorRow::empty(stamp);
        for observed in &observed_kinds {
            row.record(observed, tick_rad);
        }
        row.record(&ObservationKind::WallRange(Meters(1.0)), tick_rad);
        assert_eq!((row.time_s, row.encoders), (1.05, [3.0, -4.0]));
        let all = [TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro, TableSensor::Camera];
        let again: Vec<Observation> = row.observations(tick_rad, &all).collect();
        assert_eq!(again.len(), 3, "the camera said nothing");
        for (observation, observed) in again.iter().zip(observed_kinds) {
            assert_eq!((observation.stamp, observation.measurement), (stamp, observed));
        }
    }

    #[test]
    fn an_image_either_helps_or_judges() {
        let measured = MeasuredPose { x_m: 1.0, y_m: 2.0, theta_deg: None };
        let rows = (0..9).map(|step| {
            let mut row = SensorRow::empty(Timestamp::from_nanos(50_000_000 * step));
            row.camera = Some(measured);
            row
        });
        let table = SensorTable { rows: rows.collect(), ..SensorTable::default() };
        let helps = |table: &SensorTable, every| -> Vec<usize> {
            let used = table.used_images(every).into_iter().enumerate();
            used.filter(|(_, used)| *used).map(|(row, _)| row).collect()
        };
        let reference_rows = |table: &SensorTable| -> Vec<usize> {
            let references = table.references(4).into_iter().enumerate();
            references.filter(|(_, reference)| reference.is_some()).map(|(row, _)| row).collect()
        };
        assert_eq!(helps(&table, 4), [4, 8]);
        assert_eq!(reference_rows(&table), [1, 2, 3, 5, 6, 7]);
        let mut sparse = table.clone();
        for row in [1, 4, 6] {
            sparse.rows[row].camera = None;
        }
        assert_eq!(helps(&sparse, 4), [7], "the fourth image, not the fourth row");
        assert_eq!(reference_rows(&sparse), [2, 3, 5, 8]);
        let mut known = table;
        known.rows[0].truth = Some(measured);
        known.rows[4].truth = Some(measured);
        let reference_rows = reference_rows(&known);
        assert_eq!(reference_rows, [4], "the truth alone judges where there is one");
    }
}
