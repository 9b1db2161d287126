//! Where a sensor was at the instant of its measurement: the one place for lever arms, yaw and delay.
//!
//! ```text
//! S      = X U^-1 M       X the body at the timestamp, U its motion since the exposure, M the mounting (l, yaw)
//! S_true = S exp(zeta)    zeta = Ad(M^-1 U) xi - Ad(M^-1) (v, 0, w) dtau + (R(yaw)' dl, dyaw)
//! ```
//! The motion itself may be reported late by tau_o ([`StateTerm::OdometryDelay`]): U is the motion since tau - tau_o before the timestamp.
//!
//! An observation model derives its prediction by zeta, which [`SensorFrame::row`] turns into derivatives by the pose's error xi, the
//! delay tau and the mounting. v and w are the speeds at the exposure.
//!
//! Source: docs/maths/pose.md section 4; Sola, Deray and Atchuthan (2018) for the adjoint.

use posebridge_telemetry::MountedSensor;

use super::{JacobianRow, MountingAxis, PoseView, StateTerm};
use crate::models::lie::Se2;

/// The body's motion at an exposure. By default it is at rest and the timestamp is that of the exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exposure {
    /// The body's motion between the exposure and the timestamp.
    pub moved_since: Se2,
    pub forward_m_per_s: f64,
    pub turn_rad_per_s: f64,
}

impl Exposure {
    /// At the timestamp.
    pub fn at_speeds(forward_m_per_s: f64, turn_rad_per_s: f64) -> Self {
        Self { moved_since: Se2::default(), forward_m_per_s, turn_rad_per_s }
    }
}

/// The pose of a sensor at its exposure, with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct SensorFrame {
    /// In the arena.
    pub pose: Se2,
    /// Ad(M^-1 U), row by row.
    by_body: [[f64; 3]; 3],
    by_delay: [f64; 3],
    /// cos and sin of the yaw.
    yaw: [f64; 2],
    sensor: FrameSensor,
}

/// The states that a frame depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FrameSensor {
    /// The tag that fixes report.
    Tag,
    Mounted(MountedSensor),
}

impl SensorFrame {
    /// The frame of a sensor whose mounting consists of states.
    pub fn of_sensor(view: &impl PoseView, sensor: MountedSensor, exposure: &Exposure) -> Self {
        let [x_m, y_m, heading_rad] = MountingAxis::ALL.map(|axis| view.term(StateTerm::Mounting(sensor, axis)));
        Self::new(view.pose(), Se2 { x_m, y_m, heading_rad }, exposure, FrameSensor::Mounted(sensor))
    }

    /// The frame of a tag at this configured position, which points forward.
    pub fn of_tag(view: &impl PoseView, [x_m, y_m]: [f64; 2], exposure: &Exposure) -> Self {
        let mounting = Se2 {
            x_m: x_m + view.term(StateTerm::TagForward),
            y_m: y_m + view.term(StateTerm::TagLeft),
            heading_rad: 0.0,
        };
        Self::new(view.pose(), mounting, exposure, FrameSensor::Tag)
    }

    fn new(body: Se2, mounting: Se2, exposure: &Exposure, sensor: FrameSensor) -> Self {
        let to_mount = mounting.inverse();
        let moved = to_mount.compose(exposure.moved_since);
        let twist = [exposure.forward_m_per_s, 0.0, exposure.turn_rad_per_s];
        let (sin, cos) = mounting.heading_rad.sin_cos();
        Self {
            pose: body.compose(moved.inverse()),
            by_body: moved.adjoint(),
            by_delay: to_mount.adjoint().map(|row| -row.iter().zip(&twist).map(|(a, t)| a * t).sum::<f64>()),
            yaw: [cos, sin],
            sensor,
        }
    }

    /// A row of H from the derivatives of a component's prediction by zeta: forward, left and turn of the sensor.
    pub fn row(&self, by_sensor: [f64; 3]) -> JacobianRow {
        let along = |column: usize| (0..3).map(|i| by_sensor[i] * self.by_body[i][column]).sum();
        let by_delay = (0..3).map(|i| by_sensor[i] * self.by_delay[i]).sum::<f64>();
        let [cos, sin] = self.yaw;
        let by_x = by_sensor[0] * cos - by_sensor[1] * sin;
        let by_y = by_sensor[0] * sin + by_sensor[1] * cos;
        let mut row = JacobianRow { forward: along(0), left: along(1), heading: along(2), ..JacobianRow::default() };
        row.push(StateTerm::OdometryDelay, -by_delay);
        match self.sensor {
            FrameSensor::Tag => {
                row.push(StateTerm::FixDelay, by_delay);
                row.push(StateTerm::TagForward, by_x);
                row.push(StateTerm::TagLeft, by_y);
            }
            FrameSensor::Mounted(sensor) => {
                row.push(StateTerm::Delay(sensor), by_delay);
                row.push(StateTerm::Mounting(sensor, MountingAxis::Forward), by_x);
                row.push(StateTerm::Mounting(sensor, MountingAxis::Left), by_y);
                row.push(StateTerm::Mounting(sensor, MountingAxis::Yaw), by_sensor[2]);
            }
        }
        row
    }

    /// Rotates a vector of the sensor's frame into the arena.
    pub fn rotate_out(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.pose.heading_rad.sin_cos();
        [cos * x - sin * y, sin * x + cos * y]
    }
}
