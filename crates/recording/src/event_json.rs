//! Events as lines of JSON: the output of `--events`.
//!
//! The keys are a stable interface, independent of the type names. Instants are nanoseconds of the clock in the key; every number reads
//! back unchanged.

use std::fmt::Write as _;

use posebridge_telemetry::{
    Address, Estimate, Event, FusionRecord, Heading, LinkCounter, LinkHealth, LinkId, LinkState, Observation,
    ObservationKind, ReceiveError, RobotId, ScalarEstimate, SourceHealth, TimeDelta,
};
use serde_json::{Value, json};

/// Without line end.
pub fn to_json_line(event: &Event) -> String {
    let (name, fields) = match event {
        Event::RobotDetected { robot } => ("robot_seen", json!({ "robot": robot_of(*robot) })),
        Event::RobotNamed { robot, name } => ("robot_named", json!({ "robot": robot_of(*robot), "name": name })),
        Event::RobotLost { robot, silence } => {
            ("robot_lost", json!({ "robot": robot_of(*robot), "silence_ns": silence.as_nanos() }))
        }
        Event::BrickRestarted { robot } => ("robot_restarted", json!({ "robot": robot_of(*robot) })),
        Event::ObservationAligned { robot, source, arrival, observation } => {
            let mut fields = observation_of(observation);
            fields["robot"] = robot_of(*robot);
            fields["source"] = source_of(*source);
            fields["arrival_host_ns"] = json!(arrival.as_nanos());
            ("observed", fields)
        }
        Event::ObservationFused { robot, record } => ("fused", with_robot(*robot, fusion_of(record))),
        Event::EstimateUpdated { robot, estimate } => ("estimated", with_robot(*robot, estimate_of(estimate))),
        Event::ObservationCompared { robot, filter, record } => {
            ("compared_fused", with_filter(filter, with_robot(*robot, fusion_of(record))))
        }
        Event::EstimateCompared { robot, filter, estimate } => {
            ("compared_estimated", with_filter(filter, with_robot(*robot, estimate_of(estimate))))
        }
        Event::QuantityUpdated { robot, estimate } => ("quantity", with_robot(*robot, scalar_of(estimate))),
        Event::Temperature { brick, channel, arrival, stamp, shown, verdict, settled } => (
            "temperature",
            json!({
                "robot": robot_of(*brick),
                "channel": channel.to_string(),
                "arrival_host_ns": arrival.as_nanos(),
                "robot_ns": stamp.as_nanos(),
                "shown_c": shown.0,
                "outcome": verdict.reason(),
                "settled": settled.as_ref().map(scalar_of),
            }),
        ),
        Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host } => (
            "robot_clock_aligned",
            json!({
                "robot": robot_of(*robot),
                "offset_ns": offset.as_nanos(),
                "skew_ppm": skew_ppm,
                "uncertainty_ns": uncertainty.as_nanos(),
                "round_trip_ns": round_trip.map(TimeDelta::as_nanos),
                "robot_ns": brick.as_nanos(),
                "host_ns": host.as_nanos(),
            }),
        ),
        Event::CameraClockAligned { camera, offset, uncertainty, stamp, host } => (
            "camera_clock_aligned",
            json!({
                "source": source_of(*camera),
                "offset_ns": offset.as_nanos(),
                "uncertainty_ns": uncertainty.as_nanos(),
                "camera_ns": stamp.as_nanos(),
                "host_ns": host.as_nanos(),
            }),
        ),
        Event::Link { link, state } => {
            let state = match state {
                LinkState::Up => "up",
                LinkState::Down => "down",
            };
            ("link", json!({ "link": link.0, "state": state }))
        }
        Event::Health { link, health, sources } => ("link_health", health_of(*link, health, sources)),
        Event::ReceiveError { link, defect } => {
            let mut fields = defect_of(defect);
            fields["link"] = json!(link.0);
            ("receive_error", fields)
        }
        Event::Text { source, severity, text } => {
            ("status_text", json!({ "source": source_of(*source), "severity": severity, "text": text }))
        }
    };
    // The name stands first, whatever the order of the other keys.
    let fields = fields.to_string();
    format!("{{\"event\":\"{name}\",{}", fields.strip_prefix('{').unwrap_or(&fields))
}

fn robot_of(robot: RobotId) -> Value {
    json!({ "link": robot.link.0, "system": robot.address.system.0, "component": robot.address.component.0 })
}

fn source_of(source: Address) -> Value {
    json!({ "system": source.system.0, "component": source.component.0 })
}

fn with_robot(robot: RobotId, mut fields: Value) -> Value {
    fields["robot"] = robot_of(robot);
    fields
}

fn with_filter(filter: &str, mut fields: Value) -> Value {
    fields["filter"] = json!(filter);
    fields
}

fn observation_of(observation: &Observation) -> Value {
    let mut fields = match observation.measurement {
        ObservationKind::WheelAngles { left, right } => json!({ "left_rad": left.0, "right_rad": right.0 }),
        ObservationKind::OdometerPose(pose) => {
            json!({ "x_m": pose.x.0, "y_m": pose.y.0, "heading_rad": pose.heading.rad() })
        }
        ObservationKind::BodyVelocity { forward, turn } => {
            json!({ "forward_m_per_s": forward.0, "turn_rad_per_s": turn.0 })
        }
        ObservationKind::TurnRate(rate) => json!({ "turn_rad_per_s": rate.0 }),
        ObservationKind::WheelAccelerations { left, right } => {
            json!({ "left_m_per_s2": left.0, "right_m_per_s2": right.0 })
        }
        ObservationKind::Fix(fix) => json!({
            "x_m": fix.position.x.0,
            "y_m": fix.position.y.0,
            "heading_rad": fix.heading.map(Heading::rad),
            "covariance": fix.covariance.map(|claimed| json!({
                "xx_m2": claimed.xx_m2,
                "xy_m2": claimed.xy_m2,
                "yy_m2": claimed.yy_m2,
                "heading_rad2": claimed.heading_rad2,
            })),
            "tag_forward_m": fix.tag_in_body.x.0,
            "tag_left_m": fix.tag_in_body.y.0,
            "reset_counter": fix.reset_counter,
        }),
        ObservationKind::Landmark { id, range, bearing } => {
            json!({ "landmark": id.0, "range_m": range.0, "bearing_rad": bearing.0 })
        }
        ObservationKind::BeaconRange { id, range } => json!({ "beacon": id.0, "range_m": range.0 }),
        ObservationKind::WallRange(range) => json!({ "range_m": range.0 }),
        ObservationKind::CompassHeading(heading) => json!({ "heading_rad": heading.rad() }),
        ObservationKind::Temperature(shown) => json!({ "shown_c": shown.0 }),
    };
    fields["kind"] = json!(observation.measurement.kind());
    fields["sensor"] = json!(observation.sensor.0);
    fields["robot_ns"] = json!(observation.stamp.as_nanos());
    fields["time_sigma_ns"] = json!(observation.stamp_sigma.as_nanos());
    fields
}

fn fusion_of(record: &FusionRecord) -> Value {
    json!({
        "sensor": record.sensor.0,
        "kind": record.kind,
        "robot_ns": record.stamp.as_nanos(),
        "lag_ns": record.lag.as_nanos(),
        "outcome": record.outcome.reason(),
        "innovation": record.innovation,
        "innovation_covariance": record.innovation_covariance,
        "nis": record.nis,
        "degrees_of_freedom": record.degrees_of_freedom,
        "log_likelihood": record.log_likelihood,
    })
}

fn estimate_of(estimate: &Estimate) -> Value {
    json!({
        "robot_ns": estimate.stamp.as_nanos(),
        "x_m": estimate.pose.x.0,
        "y_m": estimate.pose.y.0,
        "heading_rad": estimate.pose.heading.rad(),
        "forward_m_per_s": estimate.forward_speed.0,
        "turn_rad_per_s": estimate.turn_rate.0,
        "covariance": estimate.covariance,
        "is_position_valid": estimate.validity.position,
        "is_heading_valid": estimate.validity.heading,
        "are_speeds_valid": estimate.validity.speeds,
        "is_dead_reckoning": estimate.is_dead_reckoning,
        "fix_age_ns": estimate.fix_age.map(TimeDelta::as_nanos),
        "reset_counter": estimate.reset_counter,
        "last_correction": estimate.last_correction.map(|jump| json!({
            "dx_m": jump.dx_m,
            "dy_m": jump.dy_m,
            "turn_rad": jump.turn.0,
            "cause": jump.cause.name(),
        })),
    })
}

fn scalar_of(estimate: &ScalarEstimate) -> Value {
    json!({
        "robot_ns": estimate.stamp.as_nanos(),
        "value": estimate.value,
        "sigma": estimate.sigma,
        "rate_per_s": estimate.rate_per_s,
        "unit": estimate.unit,
    })
}

fn health_of(link: LinkId, health: &LinkHealth, sources: &[SourceHealth]) -> Value {
    let sources: Vec<Value> = sources
        .iter()
        .map(|one| json!({ "source": source_of(one.source), "frames": one.frames, "lost": one.lost }))
        .collect();
    let mut fields = json!({
        "link": link.0,
        "port_bytes_out": health.port.bytes_out,
        "port_drops_out": health.port.drops_out,
        "port_peers": health.port.peers,
        "port_queued_frames": health.port.queued_frames,
        "port_queued_bytes": health.port.queued_bytes,
        "port_capacity_bytes_per_s": health.port.capacity_bytes_per_s,
        "round_trip_ns": health.round_trip.map(TimeDelta::as_nanos),
        "clock_uncertainty_ns": health.clock_uncertainty.map(TimeDelta::as_nanos),
        "sources": sources,
    });
    for counter in LinkCounter::ALL {
        fields[counter.key] = json!((counter.read)(health));
    }
    fields
}

fn defect_of(defect: &ReceiveError) -> Value {
    let mut fields = match defect {
        ReceiveError::Checksum { message_id, found, expected } => {
            json!({ "message_id": message_id, "found": found, "expected": expected })
        }
        ReceiveError::UnframedBytes { bytes } | ReceiveError::Timeout { bytes } => json!({ "bytes": bytes }),
        ReceiveError::ImpossibleHeader { message_id, length } => json!({ "message_id": message_id, "length": length }),
        ReceiveError::Payload { message_id } | ReceiveError::AddressConflict { message_id } => {
            json!({ "message_id": message_id })
        }
        ReceiveError::SequenceGap { source, frames } => json!({ "source": source_of(*source), "frames": frames }),
        ReceiveError::SignatureRejected { source, reason } => {
            json!({ "source": source_of(*source), "reason": reason.name() })
        }
        ReceiveError::ClockNotAligned { source } => json!({ "source": source_of(*source) }),
    };
    fields["error"] = json!(defect.name());
    fields
}

/// Details of a receive error besides its name, as `key value` pairs.
pub(crate) fn details_of(defect: &ReceiveError) -> String {
    let Value::Object(fields) = defect_of(defect) else {
        return String::new();
    };
    let mut text = defect.name().to_owned();
    for (key, value) in fields.iter().filter(|(key, _)| *key != "error") {
        let _ = write!(text, " {key} {}", text_of_value(value));
    }
    text
}

fn text_of_value(value: &Value) -> String {
    match value {
        Value::Object(source) => format!("{}/{}", source["system"], source["component"]),
        Value::String(text) => text.clone(),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::Array(_) => value.to_string(),
    }
}
