use super::*;

use posebridge_telemetry::{Address, RobotId, Span};

use crate::feed::Standing;
use crate::model::{Message, ParameterValue, SimulatorFacts, SimulatorNow};
use crate::views::tests::{estimate, fused};

fn hub() -> Hub {
    let facts = Facts {
        parameters: vec![ParameterRow { name: "gate_prob".to_owned(), value: 0.999, ..ParameterRow::default() }],
        simulator: Some(SimulatorFacts::default()),
        ..Facts::default()
    };
    Hub::new(facts, None)
}

fn batch(millis: i64, events: Vec<Event>) -> Batch {
    Batch { now: Stamp::from_millis(millis), took: Span::from_micros(20), events: events.into(), standing: None }
}

fn estimated() -> Event {
    Event::Estimated { robot: RobotId { address: Address::new(7, 1), ..RobotId::default() }, estimate: estimate() }
}

fn now(name: &str) -> RecordingNow {
    RecordingNow { name: name.to_owned(), bytes: 12 }
}

#[test]
fn a_message_leaves_when_something_is_new_and_once_a_second() {
    let mut hub = hub();
    let at = Stamp::from_millis;
    assert!(hub.news(at(0), now).is_some(), "the first second");
    assert_eq!(hub.news(at(20), now), None);
    hub.take(&batch(30, vec![estimated()]));
    let frame = hub.news(at(40), now).unwrap();
    assert_eq!((frame.now_s, frame.robots[0].id.as_str()), (0.04, "0/7/1"));
    assert_eq!(frame.recording, None, "told once a second");
    assert_eq!(hub.news(at(60), now), None);
    assert!(hub.news(at(1_000), now).is_some());
    assert_eq!(hub.robots(), ["0/7/1"]);
}

#[test]
fn what_stands_reaches_the_first_message_and_the_parameters() {
    let mut hub = hub();
    let standing = Standing {
        parameters: vec![ParameterValue { name: "gate_prob".to_owned(), value: 0.5 }],
        recording: Some("recording.mcap".to_owned()),
        ..Standing::default()
    };
    hub.take(&Batch { standing: Some(standing), ..batch(0, vec![]) });
    let frame = hub.news(Stamp::ZERO, now).unwrap();
    assert_eq!(frame.recording, Some(Some(now("recording.mcap"))));
    assert_eq!(hub.parameters()[0].value, 0.5);
    let hello = hub.hello(vec![]);
    assert_eq!(hello.parameters[0].value, 0.5);
    assert_eq!(hub.state(&Counts::default()).recording, Some(now("recording.mcap")));
}

#[test]
fn a_new_reader_is_told_what_is_switched_off_and_how_the_brick_is_set() {
    let mut hub = hub();
    let now_set = SimulatorNow { steering: "odometry".to_owned(), link_profile: Some("bluetooth-spp".to_owned()) };
    let standing =
        Standing { switched_off: vec![SensorId::CAMERA.0], simulator: Some(now_set.clone()), ..Standing::default() };
    hub.take(&Batch { standing: Some(standing), ..batch(0, vec![fused(Verdict::Accepted, 2)]) });
    hub.news(Stamp::ZERO, now);
    let hello = hub.hello(vec![]);
    let facts = hello.simulator.unwrap();
    assert_eq!((facts.steering, facts.link_profile), (now_set.steering.clone(), now_set.link_profile.clone()));
    assert_eq!(hello.history.simulator, Some(now_set));
    assert_eq!(hello.history.switched_off, Some(vec![SensorId::CAMERA.0]));
    assert!(!hello.sources[0].is_used);
    hub.take(&Batch { standing: Some(Standing::default()), ..batch(20, vec![]) });
    hub.news(Stamp::from_millis(20), now);
    assert!(hub.sources()[0].is_used);
}

#[test]
fn messages_are_read_again_as_what_they_were() {
    let mut hub = hub();
    hub.take(&batch(0, vec![estimated()]));
    let frame = hub.news(Stamp::ZERO, now).unwrap();
    for message in [Message::Frame(Box::new(frame)), Message::Hello(Box::new(hub.hello(vec![RecordingRow::default()])))]
    {
        let text = serde_json::to_string(&message).unwrap();
        assert_eq!(serde_json::from_str::<Message>(&text).unwrap(), message);
    }
}

#[test]
fn the_metrics_page_is_in_the_format_of_prometheus() {
    let mut hub = hub();
    hub.take(&batch(0, vec![estimated()]));
    let page = crate::metrics::page(&hub, &Counts::default());
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
