//! Tables of several robots: every line says whom it is about.

#![expect(clippy::unwrap_used, reason = "helpers outside the test functions may fail loudly as well")]

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{Result as IoResult, Write};
use std::rc::Rc;

use posebridge_recording::csv::CsvWriter;
use posebridge_telemetry::{
    Address, Celsius, ChannelName, Estimate, Event, FusionOutcome, FusionRecord, LinkHealth, LinkId, MetersPerSecond,
    Observation, ObservationKind, Pose, Radians, RadiansPerSecond, RobotId, SensorId, SourceHealth, TimeDelta,
    Timestamp, Validity,
};

/// Name and content of each file.
type Files = Rc<RefCell<BTreeMap<String, String>>>;

struct MemoryFile {
    files: Files,
    name: String,
}

impl Write for MemoryFile {
    fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
        let mut files = self.files.borrow_mut();
        files.entry(self.name.clone()).or_default().push_str(std::str::from_utf8(bytes).unwrap());
        Ok(bytes.len())
    }
    fn flush(&mut self) -> IoResult<()> {
        Ok(())
    }
}

fn written_files(events: &[Event]) -> BTreeMap<String, String> {
    let files = Files::default();
    let open = |name: &str| Ok(MemoryFile { files: Rc::clone(&files), name: name.to_owned() });
    let mut streams = CsvWriter::new(open);
    for event in events {
        streams.record(Timestamp::from_millis(2_500), event).unwrap();
    }
    streams.finish().unwrap();
    files.take()
}

fn id(system: u8) -> RobotId {
    RobotId { link: LinkId(7), address: Address::new(system, 1) }
}

fn estimate() -> Estimate {
    Estimate {
        stamp: Timestamp::ZERO,
        pose: Pose::default(),
        forward_speed: MetersPerSecond(0.0),
        turn_rate: RadiansPerSecond(0.0),
        covariance: [[0.0; 5]; 5],
        validity: Validity::default(),
        is_dead_reckoning: false,
        fix_age: None,
        reset_counter: 0,
        last_correction: None,
    }
}

/// One line for each stream of a robot.
fn events_of(robot: RobotId) -> Vec<Event> {
    vec![
        Event::BrickClockAligned {
            robot,
            offset: TimeDelta::ZERO,
            skew_ppm: 0.0,
            uncertainty: TimeDelta::ZERO,
            round_trip: None,
            brick: Timestamp::ZERO,
            host: Timestamp::ZERO,
        },
        Event::ObservationAligned {
            robot,
            source: Address::new(9, 1),
            arrival: Timestamp::ZERO,
            observation: Observation {
                sensor: SensorId::WHEELS,
                stamp: Timestamp::ZERO,
                stamp_sigma: TimeDelta::ZERO,
                measurement: ObservationKind::WheelAngles { left: Radians(0.5), right: Radians(0.75) },
            },
        },
        Event::ObservationFused {
            robot,
            record: FusionRecord {
                sensor: SensorId::WHEELS,
                kind: "wheel_angles",
                stamp: Timestamp::ZERO,
                lag: TimeDelta::ZERO,
                outcome: FusionOutcome::Accepted,
                innovation: [0.0; 3],
                innovation_covariance: [[0.0; 3]; 3],
                nis: 1.0,
                degrees_of_freedom: 2,
                log_likelihood: 0.0,
            },
        },
        Event::EstimateUpdated { robot, estimate: estimate() },
        Event::Temperature {
            brick: robot,
            channel: ChannelName::from_bytes(b"temp1"),
            arrival: Timestamp::ZERO,
            stamp: Timestamp::ZERO,
            shown: Celsius(20.5),
            verdict: FusionOutcome::Accepted,
            settled: None,
        },
    ]
}

#[test]
fn the_last_column_of_a_robots_streams_is_its_name_or_its_ids() {
    let named = |system, name: &str| Event::RobotNamed { robot: id(system), name: name.to_owned() };
    let mut events = vec![named(2, "ada"), named(3, "left, \"old\"")];
    for system in 1..=3 {
        events.extend(events_of(id(system)));
    }
    let files = written_files(&events);
    for stream in ["estimates", "fusion", "wheel_angles", "clock", "temperature"] {
        let lines: Vec<&str> = files[stream].lines().collect();
        let [header, first, second, third] = lines[..] else {
            panic!("{stream}: {lines:?}");
        };
        assert!(header.ends_with(",robot"), "{header}");
        assert!(first.ends_with(",7/1/1"), "{first}");
        assert!(second.ends_with(",ada"), "{second}");
        assert!(third.ends_with(",\"left, \"\"old\"\"\""), "{third}");
        let columns = header.split(',').count();
        assert_eq!([first, second].map(|line| line.split(',').count()), [columns, columns], "{stream}");
    }
}

#[test]
fn streams_of_links_and_the_rest_have_no_column_for_a_robot() {
    let source = SourceHealth { source: Address::new(1, 1), frames: 40, lost: 3 };
    let health = Event::Health { link: LinkId(7), health: LinkHealth::default(), sources: vec![source] };
    let files = written_files(&[health, Event::RobotDetected { robot: id(1) }]);
    for stream in ["links", "sources", "events"] {
        assert!(!files[stream].contains("robot,") && !files[stream].contains(",robot\n"), "{}", files[stream]);
    }
}
