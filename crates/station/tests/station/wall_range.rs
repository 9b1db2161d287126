//! A robot whose filter knows one quantity, the distance to a wall: its estimates are events, and go back to the brick.

use crate::support::{BRICK, TestStation, at, config, frame, messages, ticks};
use posebridge_protocol::message::{Message, WireStamp};
use posebridge_telemetry::{Event, Meters};

#[test]
fn the_distance_to_a_wall_is_an_event_and_is_sent_to_the_brick_with_its_rate() {
    let mut config = config();
    config.robot.filter = "range-kf".to_owned();
    let mut station = TestStation::new(&config);
    for k in 0..40 {
        let millis = 5_000 + 50 * k;
        let mut bytes = frame(BRICK, &ticks(millis, 0, 0));
        let range = Meters(2.0 - 0.02 * f64::from(k));
        let stamp = WireStamp::Millis32(millis);
        bytes.extend(frame(BRICK, &Message::DistanceSensor { stamp, range, sigma: None }));
        station.bytes(at(i64::from(100 + 50 * k)), &bytes);
    }
    let estimates = station.select(|event| match event {
        Event::QuantityUpdated { robot, estimate } if robot.address == BRICK => Some(*estimate),
        _ => None,
    });
    let last = estimates.last().expect("it was given readings");
    assert!(estimates.len() >= 40 && (last.value - 1.22).abs() < 0.05 && last.unit == "m", "{last:?}");
    assert_eq!(station.estimates(), []);
    let sent = station.sent().flat_map(|sent| messages(sent.bytes));
    let values: Vec<(String, f32)> = sent
        .filter_map(|message| match message {
            Message::NamedValue(named) => Some((named.name.to_string(), named.value)),
            _ => None,
        })
        .collect();
    for (name, expected) in [("estimate", last.value), ("est_rate", last.rate_per_s)] {
        let (_, value) = values.iter().rfind(|(sent, _)| sent == name).expect("it is sent");
        assert!((f64::from(*value) - expected).abs() < 1e-5, "{name}: {value}");
    }
}
