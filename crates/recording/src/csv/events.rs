//! Events as CSV lines.

use posebridge_telemetry::{
    Address, Estimate, Event, FusionRecord, HostClock, LinkHealth, LinkId, LinkState, RobotId, SourceHealth, TimeDelta,
    Timestamp,
};

use super::row::{CsvField, CsvRow};
use super::{columns, observations};
use crate::event_json;

/// The lines of an event that happened at `now`.
pub(super) fn rows(now: Timestamp<HostClock>, event: &Event) -> Vec<CsvRow> {
    match event {
        Event::ObservationAligned { robot, arrival, observation, .. } => {
            vec![observations::row(*robot, *arrival, observation)]
        }
        Event::ObservationFused { robot, record } => vec![fusion(*robot, now, record)],
        Event::EstimateUpdated { robot, estimate } => vec![self::estimate(*robot, now, estimate)],
        Event::Temperature { .. } => temperature(event).into_iter().collect(),
        Event::BrickClockAligned { .. } => clock(event).into_iter().collect(),
        Event::Health { link, health, sources } => std::iter::once(self::link(now, *link, health))
            .chain(sources.iter().map(|one| source(now, *link, one)))
            .collect(),
        Event::RobotDetected { .. }
        | Event::RobotNamed { .. }
        | Event::RobotLost { .. }
        | Event::BrickRestarted { .. }
        | Event::CameraClockAligned { .. }
        | Event::Link { .. }
        | Event::ReceiveError { .. }
        | Event::Text { .. } => vec![event_row(now, event)],
    }
}

fn seconds(span: TimeDelta) -> CsvField {
    span.as_secs_f64().into()
}

fn estimate(robot: RobotId, now: Timestamp<HostClock>, estimate: &Estimate) -> CsvRow {
    let mut fields: Vec<CsvField> = vec![
        estimate.stamp.as_secs_f64().into(),
        estimate.pose.x.0.into(),
        estimate.pose.y.0.into(),
        estimate.pose.heading.rad().into(),
        estimate.forward_speed.0.into(),
        estimate.turn_rate.0.into(),
    ];
    for (index, row) in estimate.covariance.iter().enumerate() {
        fields.extend(row.iter().skip(index).map(|entry| CsvField::from(*entry)));
    }
    let validity = estimate.validity;
    fields.extend([
        validity.position.into(),
        validity.heading.into(),
        validity.speeds.into(),
        estimate.is_dead_reckoning.into(),
        estimate.fix_age.map(TimeDelta::as_secs_f64).into(),
        u64::from(estimate.reset_counter).into(),
        now.as_secs_f64().into(),
    ]);
    CsvRow { stream: "estimates", header: columns::ESTIMATES, fields, robot: Some(robot) }
}

fn fusion(robot: RobotId, now: Timestamp<HostClock>, record: &FusionRecord) -> CsvRow {
    let mut fields: Vec<CsvField> = vec![
        record.stamp.as_secs_f64().into(),
        u64::from(record.sensor.0).into(),
        record.sensor.name().into(),
        record.kind.into(),
        record.outcome.reason().into(),
        seconds(record.lag),
        u64::from(record.degrees_of_freedom).into(),
        record.nis.into(),
        record.log_likelihood.into(),
    ];
    fields.extend(record.innovation.map(CsvField::from));
    for (index, row) in record.innovation_covariance.iter().enumerate() {
        fields.extend(row.iter().skip(index).map(|entry| CsvField::from(*entry)));
    }
    fields.push(now.as_secs_f64().into());
    CsvRow { stream: "fusion", header: columns::FUSION, fields, robot: Some(robot) }
}

fn temperature(event: &Event) -> Option<CsvRow> {
    let Event::Temperature { brick, channel, arrival, stamp, shown, verdict, settled } = event else {
        return None;
    };
    Some(CsvRow {
        stream: "temperature",
        header: columns::TEMPERATURE,
        robot: Some(*brick),
        fields: vec![
            stamp.as_secs_f64().into(),
            arrival.as_secs_f64().into(),
            channel.to_string().into(),
            shown.0.into(),
            verdict.reason().into(),
            settled.map(|settled| settled.value).into(),
            settled.map(|settled| settled.sigma).into(),
            system(brick.address),
            component(brick.address),
        ],
    })
}

fn clock(event: &Event) -> Option<CsvRow> {
    let Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host } = event else {
        return None;
    };
    Some(CsvRow {
        stream: "clock",
        header: columns::CLOCK,
        robot: Some(*robot),
        fields: vec![
            host.as_secs_f64().into(),
            brick.as_secs_f64().into(),
            seconds(*offset),
            (*skew_ppm).into(),
            seconds(*uncertainty),
            round_trip.map(TimeDelta::as_secs_f64).into(),
            system(robot.address),
            component(robot.address),
        ],
    })
}

fn link(now: Timestamp<HostClock>, link: LinkId, health: &LinkHealth) -> CsvRow {
    let counts = [
        health.bytes_in,
        health.bytes_out,
        health.frames_in,
        health.frames_out,
        health.frames_lost,
        health.checksum_errors,
        health.garbage_bytes,
        health.unknown_ids,
        health.timeouts,
        health.reconnects,
        health.drops_out + health.port.drops_out,
        health.rejected_frames,
        health.duplicates,
        health.forwarded,
        health.filtered,
        health.rate_limited,
    ];
    let mut fields: Vec<CsvField> = vec![now.as_secs_f64().into(), u64::from(link.0).into()];
    fields.extend(counts.map(CsvField::from));
    fields.extend([
        health.round_trip.map(TimeDelta::as_secs_f64).into(),
        health.clock_uncertainty.map(TimeDelta::as_secs_f64).into(),
        u64::from(health.port.queued_frames).into(),
        u64::from(health.port.queued_bytes).into(),
    ]);
    CsvRow { stream: "links", header: columns::LINKS, fields, robot: None }
}

fn source(now: Timestamp<HostClock>, link: LinkId, source: &SourceHealth) -> CsvRow {
    CsvRow {
        stream: "sources",
        header: columns::SOURCES,
        robot: None,
        fields: vec![
            now.as_secs_f64().into(),
            u64::from(link.0).into(),
            system(source.source),
            component(source.source),
            source.frames.into(),
            source.lost.into(),
        ],
    }
}

fn system(address: Address) -> CsvField {
    u64::from(address.system.0).into()
}

fn component(address: Address) -> CsvField {
    u64::from(address.component.0).into()
}

/// What has no stream of its own.
fn event_row(now: Timestamp<HostClock>, event: &Event) -> CsvRow {
    let (name, link, address, detail) = describe(event);
    CsvRow {
        stream: "events",
        header: columns::EVENTS,
        robot: None,
        fields: vec![
            now.as_secs_f64().into(),
            name.into(),
            link.map(|link| u64::from(link.0)).into(),
            address.map(system).into(),
            address.map(component).into(),
            detail.into(),
        ],
    }
}

/// Name, link, sender and the rest.
fn describe(event: &Event) -> (&'static str, Option<LinkId>, Option<Address>, String) {
    match event {
        Event::RobotDetected { robot } => ("robot_seen", Some(robot.link), Some(robot.address), String::new()),
        Event::RobotNamed { robot, name } => ("robot_named", Some(robot.link), Some(robot.address), name.clone()),
        Event::RobotLost { robot, silence } => {
            ("robot_lost", Some(robot.link), Some(robot.address), format!("silent for {} s", silence.as_secs_f64()))
        }
        Event::BrickRestarted { robot } => ("brick_restarted", Some(robot.link), Some(robot.address), String::new()),
        Event::CameraClockAligned { camera, offset, uncertainty, .. } => (
            "camera_clock_aligned",
            None,
            Some(*camera),
            format!("offset {} s, {} s either way", offset.as_secs_f64(), uncertainty.as_secs_f64()),
        ),
        Event::Link { link, state } => {
            let name = match state {
                LinkState::Up => "link_up",
                LinkState::Down => "link_down",
            };
            (name, Some(*link), None, String::new())
        }
        Event::ReceiveError { link, defect } => ("defect", Some(*link), None, event_json::details_of(defect)),
        Event::Text { source, severity, text } => ("text", None, Some(*source), format!("{severity}: {text}")),
        Event::ObservationAligned { .. }
        | Event::ObservationFused { .. }
        | Event::EstimateUpdated { .. }
        | Event::Temperature { .. }
        | Event::BrickClockAligned { .. }
        | Event::Health { .. } => ("other", None, None, String::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csv::CsvWriter;
    use posebridge_telemetry::{
        BrickClock, Heading, Meters, MetersPerSecond, Observation, ObservationKind, Pose, Radians, RadiansPerSecond,
        SensorId, Validity,
    };
    use std::cell::RefCell;
    use std::collections::BTreeMap;
    use std::io::Write;
    use std::rc::Rc;

    /// Files in memory, by name.
    #[derive(Clone, Default)]
    struct MemoryFiles(Rc<RefCell<BTreeMap<String, Vec<u8>>>>);

    struct MemoryFile(MemoryFiles, String);

    impl Write for MemoryFile {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            let mut files = self.0.0.borrow_mut();
            files.entry(self.1.clone()).or_default().extend(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    fn written_files(events: &[Event]) -> BTreeMap<String, String> {
        let files = MemoryFiles::default();
        let mut streams = CsvWriter::new(|name: &str| Ok(MemoryFile(files.clone(), name.to_owned())));
        for event in events {
            streams.record(Timestamp::from_millis(2_500), event).unwrap();
        }
        streams.finish().unwrap();
        let files = files.0.borrow();
        let text = |bytes: &Vec<u8>| String::from_utf8(bytes.clone()).unwrap();
        files.iter().map(|(name, bytes)| (name.clone(), text(bytes))).collect()
    }

    fn column(text: &str, name: &str) -> String {
        let mut lines = text.lines();
        let header: Vec<&str> = lines.next().unwrap().split(',').collect();
        let row: Vec<&str> = lines.next().unwrap().split(',').collect();
        assert_eq!(header.len(), row.len(), "{text}");
        let index = header.iter().position(|column| *column == name).unwrap();
        row[index].to_owned()
    }

    #[test]
    fn an_estimate_has_its_covariance_row_by_row_under_names_with_units() {
        let mut covariance = [[0.0; 5]; 5];
        for (row, entries) in covariance.iter_mut().enumerate() {
            for (index, entry) in entries.iter_mut().enumerate() {
                *entry = (10 * row.min(index) + row.max(index)) as f64;
            }
        }
        let estimate = Estimate {
            stamp: Timestamp::<BrickClock>::from_millis(1_250),
            pose: Pose::new(Meters(1.5), Meters(-2.0), Heading::from_rad(0.5)),
            forward_speed: MetersPerSecond(0.25),
            turn_rate: RadiansPerSecond(-0.125),
            covariance,
            validity: Validity::default(),
            is_dead_reckoning: true,
            fix_age: None,
            reset_counter: 3,
            last_correction: None,
        };
        let robot = RobotId::default();
        let files = written_files(&[Event::EstimateUpdated { robot, estimate }]);
        let text = &files["estimates"];
        for (name, expected) in [
            ("t_s", "1.25"),
            ("y_m", "-2"),
            ("var_x_m2", "0"),
            ("cov_x_turn_m_rad_per_s", "4"),
            ("var_y_m2", "11"),
            ("var_heading_rad2", "22"),
            ("cov_heading_turn_rad2_per_s", "24"),
            ("var_forward_m2_per_s2", "33"),
            ("var_turn_rad2_per_s2", "44"),
            ("dead_reckoning", "1"),
            ("fix_age_s", ""),
            ("reset_counter", "3"),
            ("host_s", "2.5"),
        ] {
            assert_eq!(column(text, name), expected, "{name}");
        }
    }

    #[test]
    fn each_kind_of_observation_has_a_stream_and_texts_stand_among_the_events() {
        let wheels = Event::ObservationAligned {
            robot: RobotId::default(),
            source: Address::new(1, 1),
            arrival: Timestamp::from_millis(40),
            observation: Observation {
                sensor: SensorId::WHEELS,
                stamp: Timestamp::from_millis(30),
                stamp_sigma: TimeDelta::from_millis(1),
                measurement: ObservationKind::WheelAngles { left: Radians(0.5), right: Radians(0.75) },
            },
        };
        let said = Event::Text { source: Address::new(1, 1), severity: 4, text: "low, very low".to_owned() };
        let named = Event::RobotNamed { robot: RobotId::default(), name: "ada".to_owned() };
        let files = written_files(&[wheels, named, said]);
        assert_eq!(column(&files["wheel_angles"], "right_rad"), "0.75");
        assert_eq!(column(&files["wheel_angles"], "arrival_s"), "0.04");
        assert!(files["events"].contains("2.5,robot_named,0,0,0,ada\n"), "{}", files["events"]);
        assert!(files["events"].ends_with("2.5,text,,1,1,\"4: low, very low\"\n"));
        assert_eq!(files.len(), 2);
    }
}
