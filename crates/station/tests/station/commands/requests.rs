//! Questions about messages: to the station alone they are always answered, to all components of its system only with what it has.

use super::{ACCEPTED, DENIED, EVERYBODY_OF_OURS, UNSUPPORTED};
use crate::support::STATION;
use crate::support::ground::{GCS_LINK, Ground};
use posebridge_protocol::dialect::ids::{
    self, COMMAND_GET_MESSAGE_INTERVAL, COMMAND_REQUEST_MESSAGE, COMMAND_SET_MESSAGE_INTERVAL,
};
use posebridge_protocol::message::{CommandLong, Message};
use posebridge_telemetry::Address;

const EVERYBODY: Address = Address::new(0, 0);

/// Requests a message; returns the results of the replies, and the number of other messages.
fn request(ground: &mut Ground, target: Address, command: u16, params: [f32; 2]) -> (Vec<u8>, usize) {
    let params = [params[0], params[1], 0.0, 0.0, 0.0, 0.0, 0.0];
    let messages = ground.send(100, &Message::Command(CommandLong { target, command, params }));
    let results: Vec<u8> = messages
        .iter()
        .filter_map(|message| match message {
            Message::CommandAck(ack) => Some(ack.result),
            _ => None,
        })
        .collect();
    let others = messages.len() - results.len();
    (results, others)
}

#[test]
fn a_request_to_all_components_is_answered_with_what_the_station_has() {
    let mut ground = Ground::new(|_| {});
    for (command, about) in
        [(COMMAND_REQUEST_MESSAGE, ids::AUTOPILOT_VERSION), (COMMAND_GET_MESSAGE_INTERVAL, ids::ODOMETRY)]
    {
        for target in [STATION, EVERYBODY_OF_OURS] {
            let answer = request(&mut ground, target, command, [about as f32, 0.0]);
            assert_eq!(answer, (vec![ACCEPTED], 1), "{command} to {target}");
        }
        // A whole class would reply.
        let answer = request(&mut ground, EVERYBODY, command, [about as f32, 0.0]);
        assert_eq!(answer, (vec![], 0), "{command}");
    }
    // GPS_RAW_INT, or a message that is none: another component may have it.
    for (command, about, alone) in [
        (COMMAND_REQUEST_MESSAGE, 24.0, UNSUPPORTED),
        (COMMAND_REQUEST_MESSAGE, -1.0, DENIED),
        (COMMAND_GET_MESSAGE_INTERVAL, -1.0, DENIED),
    ] {
        let answer = request(&mut ground, STATION, command, [about, 0.0]);
        assert_eq!(answer, (vec![alone], 0), "{command} {about}");
        let answer = request(&mut ground, EVERYBODY_OF_OURS, command, [about, 0.0]);
        assert_eq!(answer, (vec![], 0), "{command} {about}");
    }
}

#[test]
fn an_interval_that_is_none_is_denied_and_changes_nothing() {
    let mut ground = Ground::new(|_| {});
    let mut set = |micros: f32| {
        let pose = ids::PB_PLANAR_POSE as f32;
        let command = COMMAND_SET_MESSAGE_INTERVAL;
        let (results, _) = request(&mut ground, STATION, command, [pose, micros]);
        let first_output = ground.station.outputs.len();
        request(&mut ground, STATION, COMMAND_GET_MESSAGE_INTERVAL, [pose, 0.0]);
        let messages = ground.received_since(first_output, GCS_LINK);
        let interval = messages.iter().find_map(|message| match message {
            Message::MessageInterval(message) => Some(message.interval_micros),
            _ => None,
        });
        (results, interval.expect("an interval"))
    };
    assert_eq!(set(200_000.0), (vec![ACCEPTED], 200_000));
    for nonsense in [-2.0, -0.5, -1e30, f32::NAN, f32::INFINITY] {
        assert_eq!(set(nonsense), (vec![DENIED], 200_000), "{nonsense}");
    }
    assert_eq!(set(-1.0), (vec![ACCEPTED], -1));
}
