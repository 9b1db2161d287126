//! The compared methods: the paper's chain with its matrices and with derived ones, and those that the paper leaves as its outlook.

use posebridge_estimator::papers::ekf5::{self, FixUsage, SpeedVarianceOrder};
use posebridge_estimator::{Filter, FilterConfig, find_filter};

use super::matched::{DriveState, MatchedSpeeds, MatchedWheels, SpeedMatrices, WheelMatrices};
use super::table::{SensorRow, SensorTable, TableSensor};
use crate::recorded_drive::rolled_step;

#[derive(Clone, Copy)]
pub struct Method {
    pub name: &'static str,
    pub sensors: &'static [TableSensor],
    kind: MethodKind,
}

#[derive(Clone, Copy)]
enum MethodKind {
    /// Odometry from the counters: pose by the row of the table of filters, speeds by differences.
    Raw(BuildFilter),
    Filter(BuildFilter),
    /// The wheels' filter with matrices derived from the sensors.
    Wheels,
    /// The speeds' filter with matrices derived from the sensors.
    Speeds,
}

type BuildFilter = fn(&FilterConfig) -> Box<dyn Filter>;

/// From a row, and the time since the one before it in s, to the next state.
type StepRow = Box<dyn FnMut(&SensorRow, f64) -> DriveState>;

const OWN: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro];
const GYRO: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro];
const COMPASS: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro, TableSensor::Compass];
const OWN_CAMERA: &[TableSensor] =
    &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro, TableSensor::Camera];
const CAMERA: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro, TableSensor::Camera];
const ALL: &[TableSensor] =
    &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro, TableSensor::Compass, TableSensor::Camera];

fn row(name: &'static str, filter: &str, senses: &'static [TableSensor]) -> Option<Method> {
    find_filter(filter).map(|entry| Method { name, sensors: senses, kind: MethodKind::Filter(entry.build) })
}

fn raw() -> Option<Method> {
    find_filter("odometry").map(|entry| Method {
        name: "raw encoders",
        sensors: &[TableSensor::Wheels],
        kind: MethodKind::Raw(entry.build),
    })
}

/// The four of the paper's figure 7 with its matrices, from the worst to the best as it claims.
pub fn printed_methods() -> Vec<Method> {
    let chain =
        [raw(), row("wheel-kf", "wheel-kf", OWN), row("velocity-kf", "velocity-kf", OWN), row("ekf5", "ekf5", OWN)];
    chain.into_iter().flatten().collect()
}

/// The printed chain with v and w of the paper's Q in the other order.
pub fn swapped_methods() -> Vec<Method> {
    let mut chain = printed_methods();
    if let Some(last) = chain.last_mut() {
        let build: BuildFilter = |config| ekf5::build(config, SpeedVarianceOrder::Swapped, FixUsage::Unused);
        *last = Method { name: "ekf5 (v, w swapped)", sensors: OWN, kind: MethodKind::Filter(build) };
    }
    chain
}

/// The same chain with matrices derived from the sensors, and the EKF that keeps the errors of its integrated headings.
pub fn corrected_methods() -> Vec<Method> {
    let own = |name, kind| Method { name, sensors: OWN, kind };
    let chain = [
        raw(),
        Some(own("wheel-kf, own R and Q", MethodKind::Wheels)),
        Some(own("velocity-kf, own R and Q", MethodKind::Speeds)),
        row("ekf5-corrected", "ekf5-corrected", OWN),
    ];
    chain.into_iter().flatten().collect()
}

/// The paper's outlook: sigma points, a camera, a compass, and all sensors in one filter.
pub fn extended() -> Vec<Method> {
    let methods = [
        row("ukf5", "ukf5", OWN),
        row("pose: wheels, gyro", "pose", GYRO),
        row("pose: and compass", "pose", COMPASS),
        row("ekf5-camera", "ekf5-camera", OWN_CAMERA),
        row("pose: and camera", "pose", CAMERA),
        row("pose: all sensors", "pose", ALL),
    ];
    methods.into_iter().flatten().collect()
}

impl Method {
    /// Runs over a table and returns the estimate after each row; NaN without an estimate. Every `camera_every`-th image is used.
    pub fn run(&self, table: &SensorTable, config: &FilterConfig, camera_every: usize) -> Vec<DriveState> {
        let mut step = self.start(config, table.unit.rad_per_unit(&config.geometry));
        let mut before_s = table.rows.first().map_or(0.0, |row| row.time_s);
        let rows = table.rows.iter().zip(table.used_images(camera_every));
        rows.map(|(row, is_used)| {
            let dt_s = row.time_s - before_s;
            before_s = row.time_s;
            step(&SensorRow { camera: row.camera.filter(|_| is_used), ..*row }, dt_s)
        })
        .collect()
    }

    fn start(&self, config: &FilterConfig, unit_rad: f64) -> StepRow {
        let start = config.start.map_or([0.0; 3], |start| [start.pose.x.0, start.pose.y.0, start.pose.heading.rad()]);
        let (geometry, sensors) = (config.geometry, self.sensors);
        let turned_rad = move |row: &SensorRow| row.encoders.map(|count| count * unit_rad);
        match self.kind {
            MethodKind::Filter(build) => {
                let mut filter = build(config);
                Box::new(move |row, _| observe_row(filter.as_mut(), row, unit_rad, sensors))
            }
            MethodKind::Raw(build) => {
                let (mut filter, mut before) = (build(config), None);
                Box::new(move |row, dt_s| {
                    let now = turned_rad(row);
                    let rates = before.replace(now).map_or([0.0; 2], |before: [f64; 2]| {
                        [0, 1].map(|side: usize| (now[side] - before[side]) / dt_s)
                    });
                    let speeds = rolled_step(rates, &geometry);
                    let [x, y, heading, ..] = observe_row(filter.as_mut(), row, unit_rad, sensors);
                    [x, y, heading, speeds.forward_m, speeds.turn_rad]
                })
            }
            MethodKind::Wheels => {
                let mut wheels = MatchedWheels::new(WheelMatrices::of_robot(config), geometry, start);
                Box::new(move |row, dt_s| wheels.step(dt_s, turned_rad(row)))
            }
            MethodKind::Speeds => {
                let mut speeds = MatchedSpeeds::new(SpeedMatrices::of_robot(config), geometry, start);
                Box::new(move |row, dt_s| speeds.step(dt_s, turned_rad(row), row.accelerations_m_per_s2))
            }
        }
    }
}

fn observe_row(filter: &mut dyn Filter, row: &SensorRow, unit_rad: f64, senses: &[TableSensor]) -> DriveState {
    for observation in row.observations(unit_rad, senses) {
        let _record = filter.observe(&observation);
    }
    filter.estimate_at(row.stamp()).map_or([f64::NAN; 5], |estimate| {
        let pose = estimate.pose;
        [pose.x.0, pose.y.0, pose.heading.rad(), estimate.forward_speed.0, estimate.turn_rate.0]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_method_has_its_row_in_the_table_of_filters() {
        let counts =
            [printed_methods(), swapped_methods(), corrected_methods(), extended()].map(|methods| methods.len());
        assert_eq!(counts, [4, 4, 4, 6]);
    }
}
