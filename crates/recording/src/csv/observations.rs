//! One stream per kind of observation.

use posebridge_telemetry::{HostClock, Observation, ObservationKind, RobotId, Timestamp};

use super::row::{CsvField, CsvRow};

/// Before the columns of the kind: stamp, arrival, how far the stamp may be off, sensor.
macro_rules! columns {
    ($kind:literal) => {
        concat!("t_s,arrival_s,stamp_sigma_s,sensor,", $kind)
    };
}

/// The line of an observation of a robot.
pub(super) fn row(robot: RobotId, arrival: Timestamp<HostClock>, observation: &Observation) -> CsvRow {
    let (header, own) = kind_fields(&observation.measurement);
    let mut fields = vec![
        observation.stamp.as_secs_f64().into(),
        arrival.as_secs_f64().into(),
        observation.stamp_sigma.as_secs_f64().into(),
        u64::from(observation.sensor.0).into(),
    ];
    fields.extend(own);
    CsvRow { stream: observation.measurement.kind(), header, fields, robot: Some(robot) }
}

fn kind_fields(observed: &ObservationKind) -> (&'static str, Vec<CsvField>) {
    let numbers = |numbers: &[f64]| numbers.iter().map(|number| CsvField::from(*number)).collect();
    match observed {
        ObservationKind::WheelAngles { left, right } => (columns!("left_rad,right_rad"), numbers(&[left.0, right.0])),
        ObservationKind::OdometerPose(pose) => {
            (columns!("x_m,y_m,heading_rad"), numbers(&[pose.x.0, pose.y.0, pose.heading.rad()]))
        }
        ObservationKind::BodyVelocity { forward, turn } => {
            (columns!("forward_m_per_s,turn_rad_per_s"), numbers(&[forward.0, turn.0]))
        }
        ObservationKind::TurnRate(turn) => (columns!("turn_rad_per_s"), numbers(&[turn.0])),
        ObservationKind::WheelAccelerations { left, right } => {
            (columns!("left_m_per_s2,right_m_per_s2"), numbers(&[left.0, right.0]))
        }
        ObservationKind::Fix(fix) => {
            let covariance = fix.covariance;
            let fields = vec![
                fix.position.x.0.into(),
                fix.position.y.0.into(),
                fix.heading.map(posebridge_telemetry::Heading::rad).into(),
                covariance.map(|covariance| covariance.xx_m2).into(),
                covariance.map(|covariance| covariance.xy_m2).into(),
                covariance.map(|covariance| covariance.yy_m2).into(),
                covariance.map(|covariance| covariance.heading_rad2).into(),
                fix.tag_in_body.x.0.into(),
                fix.tag_in_body.y.0.into(),
                u64::from(fix.reset_counter).into(),
            ];
            let header = columns!(
                "x_m,y_m,heading_rad,var_x_m2,cov_x_y_m2,var_y_m2,var_heading_rad2,tag_x_m,tag_y_m,reset_counter"
            );
            (header, fields)
        }
        ObservationKind::Landmark { id, range, bearing } => {
            (columns!("landmark,range_m,bearing_rad"), vec![u64::from(id.0).into(), range.0.into(), bearing.0.into()])
        }
        ObservationKind::BeaconRange { id, range } => {
            (columns!("beacon,range_m"), vec![u64::from(id.0).into(), range.0.into()])
        }
        ObservationKind::WallRange(range) => (columns!("range_m"), numbers(&[range.0])),
        ObservationKind::CompassHeading(heading) => (columns!("heading_rad"), numbers(&[heading.rad()])),
        ObservationKind::Temperature(shown) => (columns!("temperature_deg_c"), numbers(&[shown.0])),
    }
}
