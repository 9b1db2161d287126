//! The paper's two linear filters with configurable matrices, derived from the sensors instead of tuned by hand.
//!
//! The filters `wheel-kf` and `velocity-kf` have the printed numbers. Here the same recursions take any, row by row of a table, as the
//! element-by-element version on the brick does (`brick/filters/`). With the printed numbers they equal those filters, which a test
//! checks.
//!
//! # Model
//! ```text
//! wheel:  x = [phi, phidot]'  degrees   F = [1 dt; 0 1]   C = [1 0]    Q dt/T_s    R per wheel     P0 = p0 I
//! speed:  x = [v, w]'         SI        x + dt [a, alpha]  z = x       Q dt/T_s    R               P0
//! pose by the midpoint rule: from the filtered wheels' travel, or from v and w of the row before
//! ```
//! # Sources
//! Paper 1 (Valera et al.), equations 13 to 23. White acceleration as process noise: Bar-Shalom, Li and Kirubarajan (2001),
//! section 6.2.2. Rounding as noise: a count is uniform within its tick, variance tick²/12.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::planar_speeds::Acceleration;
use posebridge_estimator::models::se2::{BodyStep, StepRule, displace};
use posebridge_estimator::papers::paper1::{SAMPLING_INTERVAL_S, UNITS};
use posebridge_telemetry::DriveGeometry;

use crate::recorded_drive::rolled_step;

/// Matrices of the filter of a wheel, in degrees; Q is that of one interval of 0.05 s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelMatrices {
    /// Q: of the angle, of angle with rate, of the rate.
    pub process: [f64; 3],
    /// R of the left and of the right counter, degrees².
    pub variances: [f64; 2],
    /// P0, the same for angle and rate.
    pub start: f64,
}

/// Matrices of the filter of the speeds v and w, SI, all diagonal; Q is that of one interval of 0.05 s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedMatrices {
    /// Q of v and of w.
    pub process: [f64; 2],
    /// R of v and of w.
    pub variances: [f64; 2],
    /// P0 of v and of w.
    pub start: [f64; 2],
}

impl WheelMatrices {
    /// Equation 19 of the paper.
    pub const PRINTED: Self = Self { process: [0.1, 0.0, 10.0], variances: [1.5, 2.5], start: 10.0 };

    /// Derived from the robot: rounding of the counters, and a random walk of the wheel rate as of the robot's speed.
    pub fn of_robot(config: &FilterConfig) -> Self {
        let geometry = &config.geometry;
        let tick_deg = geometry.tick.0.to_degrees();
        let radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
        // Density of a wheel's acceleration, degrees/s² per root hertz.
        let walk = (config.params.acceleration_m_per_s2 / radius_m).to_degrees();
        let (q, t) = (walk * walk, SAMPLING_INTERVAL_S);
        Self {
            process: [q * t.powi(3) / 3.0, q * t * t / 2.0, q * t],
            variances: [tick_deg * tick_deg / 12.0; 2],
            start: 10.0,
        }
    }
}

impl SpeedMatrices {
    /// Equation 23 of the paper.
    pub fn printed() -> Self {
        let (v, w) = (UNITS[3] * UNITS[3], UNITS[4] * UNITS[4]);
        Self { process: [2.2 * v, 2.2 * w], variances: [5.1 * v, 1.938 * w], start: [10.0 * v, 10.0 * w] }
    }

    /// Derived from the robot: rounding of two counts, and the accelerometers' noise over an interval.
    ///
    /// ```text
    /// R_v = (r tick / T_s)^2 / 12      R_w = (r tick / (b T_s))^2 / 3
    /// Q_v = (sigma_a T_s)^2 / 2        Q_w = 2 (sigma_a T_s / b)^2
    /// ```
    pub fn of_robot(config: &FilterConfig) -> Self {
        let geometry = &config.geometry;
        let b_m = geometry.track_width.0;
        let radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
        let count_m_per_s = radius_m * geometry.tick.0 / SAMPLING_INTERVAL_S;
        let felt_m_per_s = config.noise.accelerometer_m_per_s2 * SAMPLING_INTERVAL_S;
        let variances = [count_m_per_s.powi(2) / 12.0, (count_m_per_s / b_m).powi(2) / 3.0];
        Self { process: [felt_m_per_s.powi(2) / 2.0, 2.0 * (felt_m_per_s / b_m).powi(2)], variances, start: variances }
    }
}

/// x, y, heading (unwrapped), v, w; SI.
pub type DriveState = [f64; 5];

/// The filter of one wheel, in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelState {
    pub phi: f64,
    pub rate: f64,
    /// P: of the angle, of angle with rate, of the rate.
    pub covariance: [f64; 3],
}

impl WheelState {
    pub const fn at_rest(start: f64) -> Self {
        Self { phi: 0.0, rate: 0.0, covariance: [start, 0.0, start] }
    }

    pub fn predict(&mut self, dt_s: f64, process: &[f64; 3]) {
        let share = dt_s / SAMPLING_INTERVAL_S;
        let [p00, p01, p11] = self.covariance;
        self.phi += dt_s * self.rate;
        self.covariance = [
            p00 + 2.0 * dt_s * p01 + dt_s * dt_s * p11 + share * process[0],
            p01 + dt_s * p11 + share * process[1],
            p11 + share * process[2],
        ];
    }

    /// Updates with a counter reading, degrees, of variance R.
    pub fn update(&mut self, counted: f64, variance: f64) {
        let [p00, p01, p11] = self.covariance;
        let s = p00 + variance;
        let nu = counted - self.phi;
        self.phi += p00 / s * nu;
        self.rate += p01 / s * nu;
        self.covariance = [p00 * variance / s, p01 * variance / s, p11 - p01 * p01 / s];
    }
}

#[derive(Clone, Copy, Debug)]
pub struct MatchedWheels {
    matrices: WheelMatrices,
    geometry: DriveGeometry,
    wheels: [WheelState; 2],
    pose: [f64; 3],
    base: Option<[f64; 2]>,
}

#[derive(Clone, Copy, Debug)]
pub struct MatchedSpeeds {
    matrices: SpeedMatrices,
    geometry: DriveGeometry,
    state: DriveState,
    variances: [f64; 2],
    acceleration: Acceleration,
    before: Option<[f64; 2]>,
}

impl MatchedWheels {
    pub fn new(matrices: WheelMatrices, geometry: DriveGeometry, pose: [f64; 3]) -> Self {
        Self { matrices, geometry, wheels: [WheelState::at_rest(matrices.start); 2], pose, base: None }
    }

    /// Total rotation of both wheels, rad, `dt_s` after the previous step.
    pub fn step(&mut self, dt_s: f64, turned_rad: [f64; 2]) -> DriveState {
        let Some(base) = self.base else {
            self.base = Some(turned_rad);
            return self.state();
        };
        let before = self.wheels.map(|wheel| wheel.phi);
        let wheels = self.wheels.iter_mut().zip(self.matrices.variances);
        for ((wheel, variance), turned) in wheels.zip([0, 1].map(|i: usize| turned_rad[i] - base[i])) {
            wheel.predict(dt_s, &self.matrices.process);
            wheel.update(turned.to_degrees(), variance);
        }
        let rolled = [0, 1].map(|i: usize| (self.wheels[i].phi - before[i]).to_radians());
        self.pose = advance_pose(self.pose, rolled_step(rolled, &self.geometry));
        self.state()
    }

    fn state(&self) -> DriveState {
        let speeds = rolled_step(self.wheels.map(|wheel| wheel.rate.to_radians()), &self.geometry);
        let [x, y, heading] = self.pose;
        [x, y, heading, speeds.forward_m, speeds.turn_rad]
    }
}

fn advance_pose([x, y, heading]: [f64; 3], step: BodyStep) -> [f64; 3] {
    let moved = displace(heading, step, StepRule::Midpoint);
    [x + moved.dx_m, y + moved.dy_m, heading + step.turn_rad]
}

impl MatchedSpeeds {
    /// At rest at a pose (x, y, heading).
    pub fn new(matrices: SpeedMatrices, geometry: DriveGeometry, pose: [f64; 3]) -> Self {
        let [x, y, heading] = pose;
        Self {
            matrices,
            geometry,
            state: [x, y, heading, 0.0, 0.0],
            variances: matrices.start,
            acceleration: Acceleration::default(),
            before: None,
        }
    }

    /// Total rotation of both wheels, rad, `dt_s` after the previous step, and the accelerations at them since, m/s².
    pub fn step(&mut self, dt_s: f64, turned_rad: [f64; 2], accelerations: Option<[f64; 2]>) -> DriveState {
        if let Some(before) = self.before.replace(turned_rad) {
            self.predict(dt_s);
            let rolled = [0, 1].map(|i: usize| turned_rad[i] - before[i]);
            let body = rolled_step(rolled, &self.geometry);
            let measured = [body.forward_m / dt_s, body.turn_rad / dt_s];
            for (row, measured) in measured.into_iter().enumerate() {
                let gain = self.variances[row] / (self.variances[row] + self.matrices.variances[row]);
                self.state[3 + row] += gain * (measured - self.state[3 + row]);
                self.variances[row] *= 1.0 - gain;
            }
        }
        self.acceleration = accelerations
            .map_or_else(Acceleration::default, |[left, right]| Acceleration::from_wheels(left, right, &self.geometry));
        self.state
    }

    fn predict(&mut self, dt_s: f64) {
        let [x, y, heading, v, w] = self.state;
        let step = BodyStep { forward_m: v * dt_s, turn_rad: w * dt_s };
        let [x, y, heading] = advance_pose([x, y, heading], step);
        let v = v + dt_s * self.acceleration.forward_m_per_s2;
        let w = w + dt_s * self.acceleration.turn_rad_per_s2;
        self.state = [x, y, heading, v, w];
        for (variance, process) in self.variances.iter_mut().zip(self.matrices.process) {
            *variance += process * dt_s / SAMPLING_INTERVAL_S;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_estimator::find_filter;
    use posebridge_telemetry::{Heading, Meters, Pose, SensorNoise, StartPose, Timestamp, quantities::wrap_rad};

    use crate::square::table::{SensorRow, SensorTable, TableSensor};
    use crate::test_support;

    fn config() -> FilterConfig {
        let noise = SensorNoise { accelerometer_m_per_s2: 0.05, ..SensorNoise::EXACT };
        let start = StartPose {
            pose: Pose::new(Meters(1.0), Meters(-2.0), Heading::from_rad(0.4)),
            position_sigma_m: 1e-3,
            heading_sigma_rad: 1e-3,
        };
        let config = test_support::config([0.0279, 0.0282], 0.112, 1.0_f64.to_radians(), noise);
        FilterConfig { start: Some(start), ..config }
    }

    /// A winding drive of 20 s at uneven intervals.
    fn table() -> SensorTable {
        let rows = (0..400).map(|index: u32| {
            let time_s = 0.05 * f64::from(index) + 0.012 * f64::from(index * 7 % 5);
            let wheel = |phase: f64| (300.0 * time_s + 200.0 * (time_s + phase).sin()).floor();
            SensorRow {
                time_s,
                encoders: [wheel(0.0), wheel(1.0)],
                accelerations_m_per_s2: Some([0.1 * time_s.cos(), -0.1 * time_s.sin()]),
                ..SensorRow::empty(Timestamp::ZERO)
            }
        });
        SensorTable { rows: rows.collect(), ..SensorTable::default() }
    }

    /// Follows the table with a row of the table of filters and with a recursion of this file.
    fn agree(filter: &str, mut step: impl FnMut(f64, [f64; 2], Option<[f64; 2]>) -> DriveState) {
        let config = config();
        let mut known = (find_filter(filter).unwrap().build)(&config);
        let table = table();
        let tick_rad = config.geometry.tick.0;
        let mut before_s = table.rows[0].time_s;
        for row in &table.rows {
            for observation in row.observations(tick_rad, &[TableSensor::Wheels, TableSensor::Accelerometers]) {
                known.observe(&observation);
            }
            let estimate = known.estimate_at(row.stamp()).unwrap();
            let turned = row.encoders.map(|count| count * tick_rad);
            let state = step(row.time_s - before_s, turned, row.accelerations_m_per_s2);
            before_s = row.time_s;
            let differences = [
                estimate.pose.x.0 - state[0],
                estimate.pose.y.0 - state[1],
                wrap_rad(estimate.pose.heading.rad() - state[2]),
                estimate.forward_speed.0 - state[3],
                estimate.turn_rate.0 - state[4],
            ];
            for difference in differences {
                assert!(difference.abs() < 1e-9, "{filter} at {} s: {difference}", row.time_s);
            }
        }
    }

    #[test]
    fn with_the_printed_numbers_they_are_the_filters_of_the_table() {
        let start = [1.0, -2.0, 0.4];
        let geometry = config().geometry;
        let mut wheels = MatchedWheels::new(WheelMatrices::PRINTED, geometry, start);
        agree("wheel-kf", |dt_s, turned, _| wheels.step(dt_s, turned));
        let mut speeds = MatchedSpeeds::new(SpeedMatrices::printed(), geometry, start);
        agree("velocity-kf", |dt_s, turned, felt| speeds.step(dt_s, turned, felt));
    }

    #[test]
    fn matrices_of_the_robot_are_those_computed_by_hand() {
        let mut config = config();
        config.geometry.left_wheel_radius = Meters(0.028);
        config.geometry.right_wheel_radius = Meters(0.028);
        let wheels = WheelMatrices::of_robot(&config);
        assert!((wheels.variances[0] - 1.0 / 12.0).abs() < 1e-12);
        // 1 m/s per root second on a radius of 28 mm: 2046.28 degrees/s.
        assert!((wheels.process[2] - 2_046.28_f64.powi(2) * 0.05).abs() < 1.0);
        let speeds = SpeedMatrices::of_robot(&config);
        // One count in 50 ms is 9.7738 mm/s; over the track 0.08727 rad/s.
        assert!((speeds.variances[0] - 9.7738e-3_f64.powi(2) / 12.0).abs() < 1e-9);
        assert!((speeds.variances[1] - 0.087_266_f64.powi(2) / 3.0).abs() < 1e-7);
        // 2.5 mm/s from one accelerometer: half of that variance for both, twice over the track for the turn.
        assert!((speeds.process[0] - 3.125e-6).abs() < 1e-12);
        assert!((speeds.process[1] - 2.0 * (2.5e-3_f64 / 0.112).powi(2)).abs() < 1e-12);
    }
}
