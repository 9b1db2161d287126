//! One stream per kind of observation.

use posebridge_telemetry::{HostClock, Observation, Observed, Stamp};

use super::{Field, Row};

/// Before the columns of the kind: stamp, arrival, how far the stamp may be off, sensor.
macro_rules! columns {
    ($kind:literal) => {
        concat!("t_s,arrival_s,stamp_sigma_s,sensor,", $kind)
    };
}

/// The line of an observation.
pub(super) fn row(arrival: Stamp<HostClock>, observation: &Observation) -> Row {
    let (header, own) = fields_of(&observation.observed);
    let mut fields = vec![
        observation.stamp.as_secs_f64().into(),
        arrival.as_secs_f64().into(),
        observation.stamp_sigma.as_secs_f64().into(),
        u64::from(observation.sensor.0).into(),
    ];
    fields.extend(own);
    Row { stream: observation.observed.kind(), header, fields }
}

fn fields_of(observed: &Observed) -> (&'static str, Vec<Field>) {
    let numbers = |numbers: &[f64]| numbers.iter().map(|number| Field::from(*number)).collect();
    match observed {
        Observed::WheelAngles { left, right } => (columns!("left_rad,right_rad"), numbers(&[left.0, right.0])),
        Observed::OdometerPose(pose) => {
            (columns!("x_m,y_m,heading_rad"), numbers(&[pose.x.0, pose.y.0, pose.heading.rad()]))
        }
        Observed::BodyVelocity { forward, turn } => {
            (columns!("forward_m_per_s,turn_rad_per_s"), numbers(&[forward.0, turn.0]))
        }
        Observed::TurnRate(turn) => (columns!("turn_rad_per_s"), numbers(&[turn.0])),
        Observed::WheelAccelerations { left, right } => {
            (columns!("left_m_per_s2,right_m_per_s2"), numbers(&[left.0, right.0]))
        }
        Observed::Fix(fix) => {
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
        Observed::Landmark { id, range, bearing } => {
            (columns!("landmark,range_m,bearing_rad"), vec![u64::from(id.0).into(), range.0.into(), bearing.0.into()])
        }
        Observed::BeaconRange { id, range } => {
            (columns!("beacon,range_m"), vec![u64::from(id.0).into(), range.0.into()])
        }
        Observed::WallRange(range) => (columns!("range_m"), numbers(&[range.0])),
        Observed::CompassHeading(heading) => (columns!("heading_rad"), numbers(&[heading.rad()])),
        Observed::Temperature(shown) => (columns!("temperature_deg_c"), numbers(&[shown.0])),
    }
}
