//! The compared methods: the paper's chain under each preset of its matrices and each reading of its odometry, and its outlook.

use posebridge_estimator::papers::ekf5::{self, FixUsage};
use posebridge_estimator::papers::paper1::{FiveStateMatrices, SpeedMatrices, WheelMatrices};
use posebridge_estimator::papers::velocity_kf;
use posebridge_estimator::papers::wheel_kf::{self, WheelOdometry};
use posebridge_estimator::{Filter, FilterConfig, find_filter};

use super::table::{SensorRow, SensorTable, TableSensor};
use super::tuned::ChainMatrices;
use crate::recorded_drive::rolled_step;

/// x, y, heading (unwrapped), v, w; SI.
pub type DriveState = [f64; 5];

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
    Wheels(WheelMatrices, WheelOdometry),
    Speeds(SpeedMatrices),
    FiveStates(FiveStateMatrices),
}

type BuildFilter = fn(&FilterConfig) -> Box<dyn Filter>;

const OWN: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro];
const GYRO: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro];
const COMPASS: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro, TableSensor::Compass];
const OWN_CAMERA: &[TableSensor] =
    &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro, TableSensor::Camera];
const CAMERA: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro, TableSensor::Camera];
const ALL: &[TableSensor] =
    &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro, TableSensor::Compass, TableSensor::Camera];

/// Methods in the order that the paper claims, from the worst to the best, or without an order.
pub struct MethodGroup {
    pub name: &'static str,
    pub methods: Vec<Method>,
}

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

fn chain(
    name: &'static str,
    matrices: &ChainMatrices,
    names: [&'static str; 3],
    odometry: WheelOdometry,
) -> MethodGroup {
    let kinds = [
        MethodKind::Wheels(matrices.wheels, odometry),
        MethodKind::Speeds(matrices.speeds),
        MethodKind::FiveStates(matrices.five),
    ];
    let filters = names.into_iter().zip(kinds).map(|(name, kind)| Method { name, sensors: OWN, kind });
    MethodGroup { name, methods: raw().into_iter().chain(filters).collect() }
}

/// Name of the setting with the matrices of the paper.
const AS_PRINTED: &str = "as-printed";
/// Name of the setting with those that are most likely by the innovations.
const TUNED: &str = "tuned";

/// The four of the paper's figure 7 with its matrices.
pub fn printed_chain() -> MethodGroup {
    let names = ["wheel-kf, angles", "velocity-kf", "ekf5"];
    chain(AS_PRINTED, &ChainMatrices::AS_PRINTED, names, WheelOdometry::Angles)
}

/// The printed chain with v and w of the paper's Q in the other order.
pub fn swapped_chain() -> MethodGroup {
    let names = ["wheel-kf, angles", "velocity-kf", "ekf5 (v, w swapped)"];
    let matrices = ChainMatrices { five: FiveStateMatrices::SWAPPED, ..ChainMatrices::AS_PRINTED };
    chain("as-printed, v and w of Q swapped", &matrices, names, WheelOdometry::Angles)
}

/// Each preset of the matrices with each reading of the odometry, and the other order of Q.
pub fn chains(tuned: &ChainMatrices) -> Vec<MethodGroup> {
    let speeds = ["wheel-kf, speeds", "velocity-kf", "ekf5"];
    let tuned_angles = ["wheel-kf, angles, tuned", "velocity-kf, tuned", "ekf5, tuned"];
    let tuned_speeds = ["wheel-kf, speeds, tuned", "velocity-kf, tuned", "ekf5, tuned"];
    vec![
        printed_chain(),
        chain("as-printed, speeds integrated", &ChainMatrices::AS_PRINTED, speeds, WheelOdometry::Speeds),
        chain(TUNED, tuned, tuned_angles, WheelOdometry::Angles),
        chain("tuned, speeds integrated", tuned, tuned_speeds, WheelOdometry::Speeds),
        swapped_chain(),
    ]
}

/// The paper's outlook: sigma points, a camera, a compass, all sensors in one filter, and beside them what corrects the paper's EKF.
pub fn outlook() -> MethodGroup {
    let methods = [
        row("ukf5", "ukf5", OWN),
        row("ekf5-corrected", "ekf5-corrected", OWN),
        row("pose: wheels, gyro", "pose", GYRO),
        row("pose: and compass", "pose", COMPASS),
        row("ekf5-camera", "ekf5-camera", OWN_CAMERA),
        row("ekf5-camera-corrected", "ekf5-camera-corrected", OWN_CAMERA),
        row("pose: and camera", "pose", CAMERA),
        row("ukf-all: all sensors", "ukf-all", ALL),
        row("pose: all sensors", "pose", ALL),
    ];
    MethodGroup { name: "outlook", methods: methods.into_iter().flatten().collect() }
}

impl Method {
    /// Runs over a table and returns the estimate after each row; NaN without an estimate. Every `camera_every`-th image is used.
    pub fn run(&self, table: &SensorTable, config: &FilterConfig, camera_every: usize) -> Vec<DriveState> {
        let unit_rad = table.unit.rad_per_unit(&config.geometry);
        let mut filter = self.build(config);
        let mut before: Option<[f64; 2]> = None;
        let mut before_s = table.rows.first().map_or(0.0, |row| row.time_s);
        let rows = table.rows.iter().zip(table.used_images(camera_every));
        rows.map(|(row, is_used)| {
            let dt_s = row.time_s - before_s;
            before_s = row.time_s;
            let row = SensorRow { camera: row.camera.filter(|_| is_used), ..*row };
            let state = observe_row(filter.as_mut(), &row, unit_rad, self.sensors);
            let MethodKind::Raw(_) = self.kind else {
                return state;
            };
            let now = row.encoders.map(|count| count * unit_rad);
            let rates = before
                .replace(now)
                .map_or([0.0; 2], |before| [0, 1].map(|side: usize| (now[side] - before[side]) / dt_s));
            let speeds = rolled_step(rates, &config.geometry);
            let [x, y, heading, ..] = state;
            [x, y, heading, speeds.forward_m, speeds.turn_rad]
        })
        .collect()
    }

    fn build(&self, config: &FilterConfig) -> Box<dyn Filter> {
        match self.kind {
            MethodKind::Raw(build) | MethodKind::Filter(build) => build(config),
            MethodKind::Wheels(matrices, odometry) => wheel_kf::build(config, &matrices, odometry),
            MethodKind::Speeds(matrices) => velocity_kf::build(config, &matrices),
            MethodKind::FiveStates(matrices) => ekf5::build(config, &matrices, FixUsage::Unused),
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
        let counts: Vec<usize> =
            chains(&ChainMatrices::AS_PRINTED).iter().chain([&outlook()]).map(|group| group.methods.len()).collect();
        assert_eq!(counts, [4, 4, 4, 4, 4, 9]);
    }
}
