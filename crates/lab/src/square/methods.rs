//! The compared methods: the paper's chain with its matrices and with derived ones, and those that the paper leaves as its outlook.

use posebridge_estimator::papers::ekf5::{self, FixUsage, SpeedVarianceOrder};
use posebridge_estimator::{Filter, FilterConfig, FilterEntry, find_filter};

use super::matched::{DriveState, MatchedSpeeds, MatchedWheels, SpeedMatrices, WheelMatrices};
use super::table::{SensorRow, SensorTable, TableSensor};

#[derive(Clone, Copy)]
pub struct Method {
    pub name: &'static str,
    pub sensors: &'static [TableSensor],
    kind: MethodKind,
}

#[derive(Clone, Copy)]
enum MethodKind {
    /// Odometry from the counters: pose by the row of the table of filters, speeds by differences.
    Raw(&'static FilterEntry),
    Filter(&'static FilterEntry),
    /// `ekf5` with the other interpretation of the paper's Q.
    Swapped,
    /// The wheels' filter with matrices derived from the sensors.
    Wheels,
    /// The speeds' filter with matrices derived from the sensors.
    Speeds,
}

const OWN: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro];
const GYRO: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro];
const COMPASS: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro, TableSensor::Compass];
const OWN_CAMERA: &[TableSensor] =
    &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro, TableSensor::Camera];
const CAMERA: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Gyro, TableSensor::Camera];
const ALL: &[TableSensor] =
    &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro, TableSensor::Compass, TableSensor::Camera];

fn row(name: &'static str, filter: &str, senses: &'static [TableSensor]) -> Option<Method> {
    find_filter(filter).map(|entry| Method { name, sensors: senses, kind: MethodKind::Filter(entry) })
}

fn raw() -> Option<Method> {
    find_filter("odometry").map(|entry| Method {
        name: "raw encoders",
        sensors: &[TableSensor::Wheels],
        kind: MethodKind::Raw(entry),
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
        *last = Method { name: "ekf5 (v, w swapped)", sensors: OWN, kind: MethodKind::Swapped };
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

enum MethodRunner {
    Filter(Box<dyn Filter>),
    Raw { filter: Box<dyn Filter>, config: Box<FilterConfig>, before: Option<(f64, [f64; 2])> },
    Wheels(MatchedWheels),
    Speeds(MatchedSpeeds),
}

impl Method {
    /// Runs over a table and returns the estimate after each row; NaN without an estimate. Every `camera_every`-th image is used.
    pub fn run(&self, table: &SensorTable, config: &FilterConfig, camera_every: usize) -> Vec<DriveState> {
        let mut follower = self.runner(config);
        let unit_rad = table.unit.rad_per_unit(&config.geometry);
        let mut before_s = table.rows.first().map_or(0.0, |row| row.time_s);
        let rows = table.rows.iter().zip(table.used_images(camera_every));
        rows.map(|(row, is_used)| {
            let mut row = *row;
            if !is_used {
                row.camera = None;
            }
            let dt_s = row.time_s - before_s;
            before_s = row.time_s;
            follower.step(&row, dt_s, unit_rad, self.sensors)
        })
        .collect()
    }

    fn runner(&self, config: &FilterConfig) -> MethodRunner {
        let start = config.start.map_or([0.0; 3], |start| [start.pose.x.0, start.pose.y.0, start.pose.heading.rad()]);
        let geometry = config.geometry;
        match self.kind {
            MethodKind::Filter(entry) => MethodRunner::Filter((entry.build)(config)),
            MethodKind::Swapped => {
                let order = SpeedVarianceOrder::Swapped;
                MethodRunner::Filter(ekf5::build(config, order, FixUsage::Unused))
            }
            MethodKind::Raw(entry) => {
                MethodRunner::Raw { filter: (entry.build)(config), config: Box::new(config.clone()), before: None }
            }
            MethodKind::Wheels => {
                let matrices = WheelMatrices::of_robot(config);
                MethodRunner::Wheels(MatchedWheels::new(matrices, geometry, start))
            }
            MethodKind::Speeds => {
                let matrices = SpeedMatrices::of_robot(config);
                MethodRunner::Speeds(MatchedSpeeds::new(matrices, geometry, start))
            }
        }
    }
}

impl MethodRunner {
    fn step(&mut self, row: &SensorRow, dt_s: f64, unit_rad: f64, senses: &[TableSensor]) -> DriveState {
        let turned_rad = row.encoders.map(|count| count * unit_rad);
        match self {
            Self::Wheels(wheels) => wheels.step(dt_s, turned_rad),
            Self::Speeds(speeds) => speeds.step(dt_s, turned_rad, row.accelerations_m_per_s2),
            Self::Filter(filter) => observe_row(filter.as_mut(), row, unit_rad, senses),
            Self::Raw { filter, config, before } => {
                let mut state = observe_row(filter.as_mut(), row, unit_rad, senses);
                let speeds = before.replace((row.time_s, turned_rad)).map_or([0.0, 0.0], |(before_s, before_rad)| {
                    let dt_s = row.time_s - before_s;
                    let rolled = [0, 1].map(|i: usize| (turned_rad[i] - before_rad[i]) / dt_s);
                    speeds_of(rolled, config)
                });
                [state[3], state[4]] = speeds;
                state
            }
        }
    }
}

/// v and w for these wheel rates, left and right, rad/s.
fn speeds_of([left, right]: [f64; 2], config: &FilterConfig) -> [f64; 2] {
    use posebridge_estimator::models::differential_drive::{WheelTravel, body_step};
    let travel = WheelTravel {
        left_m: config.geometry.left_wheel_radius.0 * left,
        right_m: config.geometry.right_wheel_radius.0 * right,
    };
    let body = body_step(travel, &config.geometry);
    [body.forward_m, body.turn_rad]
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
