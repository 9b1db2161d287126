//! The datagrams: one JSON object for each thing that happened, with its time.
//!
//! Nested objects of numbers, because that is what PlotJuggler makes curves of; a number that is not finite is left out. Units are SI and
//! stand in the names.

use std::collections::BTreeMap;

use posebridge_dashboard::model::{
    ClockRow, ErrorsRow, EstimatePoint, Frame, FusionPoint, LinkRow, Number, TruthPoint,
};
use serde::Serialize;

/// Components of an innovation by the observation's kind, as docs/maths/pose.md orders them; for fixes they are those of the robot's body.
const COMPONENTS: &[(&str, &[&str])] = &[
    ("fix", &["forward_m", "left_m", "heading_rad"]),
    ("wheel_angles", &["turn_rad"]),
    ("odometer_pose", &["turn_rad"]),
    ("compass_heading", &["heading_rad"]),
    ("wall_range", &["range_m"]),
    ("beacon_range", &["range_m"]),
    ("landmark", &["range_m", "bearing_rad"]),
];

/// One datagram.
#[derive(Serialize)]
struct Message {
    timestamp: f64,
    #[serde(flatten)]
    objects: BTreeMap<String, Object>,
}

/// Its values.
#[derive(Serialize)]
#[serde(untagged)]
enum Object {
    /// Of a robot: under its estimate's or a sensor's name.
    Robot(BTreeMap<String, RobotObject>),
    Place(PlaceObject),
    Errors(ErrorsObject),
    Link(LinkObject),
    Clock(ClockObject),
}

#[derive(Serialize)]
#[serde(untagged)]
enum RobotObject {
    Estimate(EstimateObject),
    Sensor(SensorObject),
}

#[derive(Serialize)]
struct EstimateObject {
    #[serde(skip_serializing_if = "is_none")]
    x_m: Number,
    #[serde(skip_serializing_if = "is_none")]
    y_m: Number,
    #[serde(skip_serializing_if = "is_none")]
    heading_rad: Number,
    #[serde(skip_serializing_if = "is_none")]
    heading_sigma_rad: Number,
    #[serde(skip_serializing_if = "is_none")]
    ellipse_major_m: Number,
    #[serde(skip_serializing_if = "is_none")]
    ellipse_minor_m: Number,
    #[serde(skip_serializing_if = "is_none")]
    forward_m_per_s: Number,
    #[serde(skip_serializing_if = "is_none")]
    turn_rad_per_s: Number,
    #[serde(skip_serializing_if = "is_none")]
    fix_age_s: Number,
    is_dead_reckoning: u8,
    reset_counter: u8,
}

#[derive(Serialize)]
struct SensorObject {
    #[serde(skip_serializing_if = "is_none")]
    nis: Number,
    degrees_of_freedom: u8,
    is_used: u8,
    #[serde(skip_serializing_if = "is_none")]
    lag_s: Number,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    innovation: BTreeMap<&'static str, Number>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    sigma: BTreeMap<&'static str, Number>,
}

#[derive(Serialize)]
struct PlaceObject {
    #[serde(skip_serializing_if = "is_none")]
    x_m: Number,
    #[serde(skip_serializing_if = "is_none")]
    y_m: Number,
    #[serde(skip_serializing_if = "is_none")]
    heading_rad: Number,
}

#[derive(Serialize)]
struct ErrorsObject {
    #[serde(skip_serializing_if = "is_none")]
    odometry_m: Number,
    #[serde(skip_serializing_if = "is_none")]
    estimate_m: Number,
}

#[derive(Serialize)]
struct LinkObject {
    is_up: u8,
    #[serde(skip_serializing_if = "is_none")]
    bytes_in_per_s: Number,
    #[serde(skip_serializing_if = "is_none")]
    frames_in_per_s: Number,
    lost: u64,
    checksum_errors: u64,
    garbage_bytes: u64,
    stalls: u64,
    queued_frames: u32,
    drops_out: u64,
    #[serde(skip_serializing_if = "is_none")]
    round_trip_s: Number,
    #[serde(skip_serializing_if = "is_none")]
    clock_uncertainty_s: Number,
}

#[derive(Serialize)]
struct ClockObject {
    offset_s: f64,
    #[serde(skip_serializing_if = "is_none")]
    skew_ppm: Number,
    #[serde(skip_serializing_if = "is_none")]
    uncertainty_s: Number,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands a reference to the field")]
fn is_none(number: &Number) -> bool {
    number.get().is_none()
}

/// The datagrams of a message of the station.
pub fn messages(frame: &Frame) -> Vec<String> {
    let mut all = Vec::new();
    for robot in &frame.robots {
        let name = format!("robot_{}", robot.id.replace('/', "_"));
        let of_robot = |t_s: f64, part: String, object: RobotObject| {
            let object = Object::Robot(BTreeMap::from([(part, object)]));
            text(t_s, &name, object)
        };
        for estimate in &robot.estimates {
            let object = RobotObject::Estimate(estimate_object(estimate));
            all.push(of_robot(estimate.t_s, "estimate".to_owned(), object));
        }
        for record in &robot.fusion {
            let object = RobotObject::Sensor(sensor_object(record));
            all.push(of_robot(record.t_s, record.sensor.clone(), object));
        }
    }
    for point in &frame.truth {
        all.extend(truth_messages(point));
    }
    let now_s = frame.now_s;
    if let Some(errors) = &frame.errors {
        all.push(text(now_s, "errors", Object::Errors(errors_object(errors))));
    }
    for link in frame.links.iter().flatten() {
        let name = format!("link_{}", link.id);
        all.push(text(now_s, &name, Object::Link(link_object(link))));
    }
    if let Some(clock) = &frame.clock {
        all.push(text(now_s, "clock", Object::Clock(clock_object(clock))));
    }
    all
}

/// Plain structs of numbers can always be written.
fn text(timestamp: f64, name: &str, object: Object) -> String {
    let objects = BTreeMap::from([(name.to_owned(), object)]);
    serde_json::to_string(&Message { timestamp, objects }).unwrap_or_default()
}

fn truth_messages(point: &TruthPoint) -> Vec<String> {
    let place = |[x_m, y_m, heading_rad]: [Number; 3]| Object::Place(PlaceObject { x_m, y_m, heading_rad });
    let really = place([point.x_m, point.y_m, point.heading_rad]);
    // One of several robots has series of its own.
    let suffix = point.robot.as_ref().map_or_else(String::new, |id| format!("_{}", id.replace('/', "_")));
    let odometry = point.odometry.map(|odometry| text(point.t_s, &format!("odometry{suffix}"), place(odometry)));
    let truth = text(point.t_s, &format!("truth{suffix}"), really);
    std::iter::once(truth).chain(odometry).collect()
}

fn estimate_object(estimate: &EstimatePoint) -> EstimateObject {
    EstimateObject {
        x_m: estimate.x_m,
        y_m: estimate.y_m,
        heading_rad: estimate.heading_rad,
        heading_sigma_rad: estimate.heading_sigma_rad,
        ellipse_major_m: estimate.major_m,
        ellipse_minor_m: estimate.minor_m,
        forward_m_per_s: estimate.forward_m_per_s,
        turn_rad_per_s: estimate.turn_rad_per_s,
        fix_age_s: estimate.fix_age_s,
        is_dead_reckoning: estimate.is_dead_reckoning.into(),
        reset_counter: estimate.reset_counter,
    }
}

fn sensor_object(record: &FusionPoint) -> SensorObject {
    let known = COMPONENTS.iter().find(|(kind, _)| *kind == record.kind);
    let names = known.map_or(&[][..], |(_, names)| names);
    let named = |numbers: &[Number]| {
        let finite = names.iter().copied().zip(numbers.iter().copied());
        finite.filter(|(_, number)| !is_none(number)).collect()
    };
    let is_used = matches!(record.verdict.as_str(), "accepted" | "slip" | "reset to");
    SensorObject {
        nis: record.nis,
        degrees_of_freedom: record.dof,
        is_used: is_used.into(),
        lag_s: record.lag_s,
        innovation: named(&record.innovation),
        sigma: named(&record.sigma),
    }
}

const fn errors_object(errors: &ErrorsRow) -> ErrorsObject {
    ErrorsObject { odometry_m: errors.odometry_m, estimate_m: errors.estimate_m }
}

fn link_object(link: &LinkRow) -> LinkObject {
    LinkObject {
        is_up: (link.state == "up").into(),
        bytes_in_per_s: link.bytes_in_per_s,
        frames_in_per_s: link.frames_in_per_s,
        lost: link.lost,
        checksum_errors: link.checksum_errors,
        garbage_bytes: link.garbage_bytes,
        stalls: link.stalls,
        queued_frames: link.queued_frames,
        drops_out: link.drops_out,
        round_trip_s: seconds(link.round_trip_ms),
        clock_uncertainty_s: seconds(link.clock_uncertainty_ms),
    }
}

fn clock_object(clock: &ClockRow) -> ClockObject {
    ClockObject { offset_s: clock.offset_s, skew_ppm: clock.skew_ppm, uncertainty_s: seconds(clock.uncertainty_ms) }
}

fn seconds(millis: Number) -> Number {
    millis.get().map_or(f64::NAN, |millis| millis / 1e3).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_dashboard::model::RobotFrame;

    #[test]
    fn each_thing_that_happened_is_one_object_with_its_time() {
        let frame = Frame {
            now_s: 2.0,
            robots: vec![RobotFrame {
                id: "0/1/1".to_owned(),
                estimates: vec![EstimatePoint {
                    t_s: 1.5,
                    x_m: 0.1.into(),
                    y_m: f64::NAN.into(),
                    is_dead_reckoning: true,
                    reset_counter: 3,
                    ..EstimatePoint::default()
                }],
                fusion: vec![FusionPoint {
                    t_s: 1.25,
                    sensor: "camera".to_owned(),
                    kind: "fix".to_owned(),
                    verdict: "gated".to_owned(),
                    nis: 20.0.into(),
                    dof: 2,
                    innovation: vec![0.5.into(), (-0.25).into()],
                    sigma: vec![0.125.into(), f64::INFINITY.into()],
                    ..FusionPoint::default()
                }],
                ..RobotFrame::default()
            }],
            clock: Some(ClockRow { offset_s: -1.0, uncertainty_ms: 2.0.into(), ..ClockRow::default() }),
            ..Frame::default()
        };
        assert_eq!(
            messages(&frame),
            [
                r#"{"timestamp":1.5,"robot_0_1_1":{"estimate":{"x_m":0.1,"is_dead_reckoning":1,"reset_counter":3}}}"#,
                r#"{"timestamp":1.25,"robot_0_1_1":{"camera":{"nis":20.0,"degrees_of_freedom":2,"is_used":0,"innovation":{"forward_m":0.5,"left_m":-0.25},"sigma":{"forward_m":0.125}}}}"#,
                r#"{"timestamp":2.0,"clock":{"offset_s":-1.0,"uncertainty_s":0.002}}"#,
            ]
        );
    }
}
