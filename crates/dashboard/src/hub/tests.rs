use super::*;

use posebridge_telemetry::{Address, ScalarEstimate};

use crate::model::{Message, ParameterValue, SimulatorFacts, SimulatorNow};
use crate::token::AccessRole;
use crate::views::tests::{estimate, fused_event, truth};

fn hub() -> Hub {
    let facts = StationInfo {
        parameters: vec![ParameterRow { name: "gate_prob".to_owned(), value: 0.999, ..ParameterRow::default() }],
        simulator: Some(SimulatorFacts::default()),
        ..StationInfo::default()
    };
    Hub::new(facts, None, None)
}

fn batch(millis: i64, events: Vec<Event>) -> EventBatch {
    EventBatch {
        now: Timestamp::from_millis(millis),
        latency: TimeDelta::from_micros(20),
        events: events.into(),
        status: None,
    }
}

fn estimated_event() -> Event {
    Event::EstimateUpdated {
        robot: RobotId { address: Address::new(7, 1), ..RobotId::default() },
        estimate: estimate(),
    }
}

fn named_event(name: &str) -> Event {
    let robot = RobotId { address: Address::new(7, 1), ..RobotId::default() };
    Event::RobotNamed { robot, name: name.to_owned() }
}

fn recording_now(name: &str) -> RecordingNow {
    RecordingNow { name: name.to_owned(), bytes: 12 }
}

#[test]
fn a_message_leaves_when_something_is_new_and_once_a_second() {
    let mut hub = hub();
    let at = Timestamp::from_millis;
    assert!(hub.next_frame(at(0), recording_now).is_some(), "the first second");
    assert_eq!(hub.next_frame(at(20), recording_now), None);
    hub.push_batch(&batch(30, vec![estimated_event()]));
    let frame = hub.next_frame(at(40), recording_now).unwrap();
    assert_eq!((frame.now_s, frame.robots[0].id.as_str()), (0.04, "0/7/1"));
    assert_eq!(frame.recording, None, "told once a second");
    assert_eq!(hub.next_frame(at(60), recording_now), None);
    assert!(hub.next_frame(at(1_000), recording_now).is_some());
    assert_eq!(hub.robots(), [RobotRow { id: "0/7/1".to_owned(), name: None }]);
}

#[test]
fn a_robot_whose_filter_knows_one_quantity_is_a_robot_with_a_name_that_is_lost_and_found() {
    let mut hub = hub();
    let at = Timestamp::from_millis;
    let robot = RobotId { address: Address::new(7, 1), ..RobotId::default() };
    let updated = |millis| {
        let estimate = ScalarEstimate {
            stamp: Timestamp::from_millis(millis),
            value: 1.5,
            sigma: 0.1,
            rate_per_s: -0.5,
            unit: "m",
        };
        Event::QuantityUpdated { robot, estimate }
    };
    let state_after = |hub: &mut Hub, millis: i64, event: Event| {
        hub.push_batch(&batch(millis, vec![event]));
        hub.next_frame(at(millis), recording_now);
        hub.state(&ServerCounters::default()).robots.remove(0)
    };
    hub.push_batch(&batch(0, vec![named_event("car")]));
    let first = state_after(&mut hub, 10, updated(10));
    assert_eq!(first.name.as_deref(), Some("car"));
    let lost = state_after(&mut hub, 5_000, Event::RobotLost { robot, silence: SECOND });
    assert_eq!(lost.lost_t_s, Some(5.0));
    let found = state_after(&mut hub, 6_000, updated(6_000));
    assert_eq!((found.lost_t_s, found.quantities.len()), (None, 1));
    assert_eq!((found.quantities[0].t_s, found.quantities[0].steps, found.quantities[0].predicted), (6.0, 2, 2));
}

#[test]
fn what_stands_reaches_the_first_message_and_the_parameters() {
    let mut hub = hub();
    let status = StationStatus {
        parameters: vec![ParameterValue { name: "gate_prob".to_owned(), value: 0.5 }],
        recording: Some("recording.mcap".to_owned()),
        ..StationStatus::default()
    };
    hub.push_batch(&EventBatch { status: Some(status), ..batch(0, vec![]) });
    let frame = hub.next_frame(Timestamp::ZERO, recording_now).unwrap();
    assert_eq!(frame.recording, Some(Some(recording_now("recording.mcap"))));
    assert_eq!(hub.parameters()[0].value, 0.5);
    let hello = hub.hello(vec![], AccessRole::Operator);
    assert_eq!(hello.parameters[0].value, 0.5);
    assert_eq!(hub.state(&ServerCounters::default()).recording, Some(recording_now("recording.mcap")));
}

#[test]
fn a_new_reader_is_told_what_is_switched_off_and_how_the_brick_is_set() {
    let mut hub = hub();
    let now_set = SimulatorNow { steering: "odometry".to_owned(), link_profile: Some("bluetooth-spp".to_owned()) };
    let status = StationStatus {
        switched_off: vec![SensorId::CAMERA.0],
        simulator: Some(now_set.clone()),
        ..StationStatus::default()
    };
    hub.push_batch(&EventBatch { status: Some(status), ..batch(0, vec![fused_event(FusionOutcome::Accepted, 2)]) });
    hub.next_frame(Timestamp::ZERO, recording_now);
    let hello = hub.hello(vec![], AccessRole::Operator);
    let facts = hello.simulator.unwrap();
    assert_eq!((facts.steering, facts.link_profile), (now_set.steering.clone(), now_set.link_profile.clone()));
    assert_eq!(hello.history.simulator, Some(now_set));
    assert_eq!(hello.history.switched_off, Some(vec![SensorId::CAMERA.0]));
    assert!(!hello.sources[0].is_used);
    hub.push_batch(&EventBatch { status: Some(StationStatus::default()), ..batch(20, vec![]) });
    hub.next_frame(Timestamp::from_millis(20), recording_now);
    assert!(hub.sources()[0].is_used);
}

#[test]
fn the_state_has_the_name_of_a_robot_and_when_it_was_lost_until_it_is_back() {
    let mut hub = hub();
    let robot = RobotId { address: Address::new(7, 1), ..RobotId::default() };
    hub.push_batch(&batch(0, vec![named_event("left"), estimated_event()]));
    hub.push_batch(&batch(5_000, vec![Event::RobotLost { robot, silence: TimeDelta::from_millis(3_000) }]));
    let looked = |hub: &mut Hub, millis| {
        hub.next_frame(Timestamp::from_millis(millis), recording_now);
        let known = hub.state(&ServerCounters::default()).robots.remove(0);
        (known.name, known.lost_t_s)
    };
    let name = Some("left".to_owned());
    assert_eq!(looked(&mut hub, 5_000), (name.clone(), Some(5.0)));
    assert_eq!(hub.robots()[0].name, name);
    hub.push_batch(&batch(9_000, vec![estimated_event()]));
    assert_eq!(looked(&mut hub, 9_000), (name, None));
}

#[test]
fn the_state_tells_the_truths_of_robots_apart() {
    let mut hub = hub();
    let robot = |system| RobotId { address: Address::new(system, 1), ..RobotId::default() };
    for system in [1, 2] {
        let updated = Event::EstimateUpdated { robot: robot(system), estimate: estimate() };
        hub.push_batch(&batch(0, vec![updated]));
    }
    for (system, x_m) in [(1, 1.0), (2, 2.0)] {
        hub.push_truth(&truth(Some(robot(system)), 5_000, x_m));
    }
    hub.next_frame(Timestamp::ZERO, recording_now);
    let state = hub.state(&ServerCounters::default());
    let positions: Vec<_> = state.robots.iter().map(|one| one.truth.as_ref().unwrap().x_m.get()).collect();
    assert_eq!(positions, [Some(1.0), Some(2.0)]);
    assert_eq!(state.truth.unwrap().robot.as_deref(), Some("0/1/1"));
}

#[test]
fn messages_are_read_again_as_what_they_were() {
    let mut hub = hub();
    hub.push_batch(&batch(0, vec![estimated_event()]));
    let frame = hub.next_frame(Timestamp::ZERO, recording_now).unwrap();
    for message in [
        Message::Frame(Box::new(frame)),
        Message::Hello(Box::new(hub.hello(vec![RecordingRow::default()], AccessRole::Operator))),
    ] {
        let text = serde_json::to_string(&message).unwrap();
        assert_eq!(serde_json::from_str::<Message>(&text).unwrap(), message);
    }
}

#[test]
fn the_metrics_page_is_in_the_format_of_prometheus() {
    let mut hub = hub();
    hub.push_batch(&batch(0, vec![named_event("a \"b\" \\\n"), estimated_event()]));
    hub.next_frame(Timestamp::from_millis(2_000), recording_now);
    let page = crate::metrics::page(&hub, &ServerCounters::default());
    for line in [
        r#"posebridge_robot_info{robot="0/7/1",name="a \"b\" \\\n"} 1"#,
        r#"posebridge_robot_estimates_total{robot="0/7/1"} 1"#,
        r#"posebridge_estimate_age_seconds{robot="0/7/1"} 2"#,
        r#"posebridge_fix_age_seconds{robot="0/7/1"} 2.3"#,
    ] {
        assert!(page.lines().any(|known| known.starts_with(line)), "{line} is missing");
    }
    let mut families = BTreeSet::new();
    for line in page.lines() {
        if let Some(typed) = line.strip_prefix("# TYPE ") {
            let name = typed.split(' ').next().unwrap();
            assert!(families.insert(name.to_owned()), "{name} is there twice");
            let is_total = typed.ends_with(" counter");
            assert_eq!(is_total, name.ends_with("_total"), "{typed}");
        } else if !line.starts_with("# HELP ") {
            let name = line.split(['{', ' ']).next().unwrap();
            let family =
                ["_bucket", "_sum", "_count"].iter().find_map(|ending| name.strip_suffix(ending)).unwrap_or(name);
            assert!(families.contains(family), "{line} has no type");
            let value = line.rsplit(' ').next().unwrap();
            assert!(value.parse::<f64>().is_ok(), "{line}");
        }
    }
    assert!(families.len() > 20, "{}", families.len());
}

#[test]
fn percentiles_and_buckets_of_known_latencies() {
    let mut latency = LatencyHistogram::default();
    for micros in (1..=101).rev() {
        latency.record(TimeDelta::from_micros(micros));
    }
    let row = latency.row();
    assert_eq!((row.p50_ms, row.p99_ms), (0.051.into(), 0.1.into()));
    let counts: Vec<u64> = latency.buckets().map(|(_, count)| count).collect();
    assert_eq!(counts[..4], [10, 30, 100, 101]);
    assert_eq!(latency.sum, TimeDelta::from_micros(101 * 51));
    assert_eq!(LatencyHistogram::default().row().p50_ms, f64::NAN.into());
}

#[test]
fn only_the_last_ones_are_kept() {
    let mut latency = LatencyHistogram::default();
    for _ in 0..3 * MAX_LATENCY_SAMPLES {
        latency.record(TimeDelta::from_millis(9));
    }
    for _ in 0..MAX_LATENCY_SAMPLES {
        latency.record(TimeDelta::from_millis(1));
    }
    assert_eq!(latency.last.len(), MAX_LATENCY_SAMPLES);
    assert_eq!(latency.row().p99_ms, 1.0.into());
    assert_eq!(latency.count, 4 * MAX_LATENCY_SAMPLES as u64);
}
