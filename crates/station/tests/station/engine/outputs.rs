//! What the station sends: how often, what for, and for which instant.

use super::{driven, sent_messages};
use crate::support::simulation::StationSimulation;
use crate::support::{BRICK, STATION, TestStation, at, config, frame, messages, stream, ticks};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{Message, PlanarPose, SetMessageInterval, WireStamp};
use posebridge_station::{OutputInstant, OutputKind};
use posebridge_telemetry::{Event, HostClock, Output, TimeDelta, Timestamp};

#[test]
fn a_peer_may_request_a_message_at_an_interval_and_stop_it_again() {
    let mut config = config();
    config.links[0].outputs = vec![];
    let mut station = TestStation::new(&config);
    let request = |interval| {
        Message::SetMessageInterval(SetMessageInterval { target: STATION, message_id: ids::ODOMETRY, interval })
    };
    let drive = |station: &mut TestStation, from_ms: u32| {
        for step in 0..20 {
            let millis = from_ms + step * 50;
            station.bytes(at(i64::from(millis)), &frame(BRICK, &ticks(millis, 0, 0)));
        }
        let odometry =
            sent_messages(station).iter().filter(|(_, message)| matches!(message, Message::Odometry(_))).count();
        station.outputs.clear();
        odometry
    };
    assert_eq!(drive(&mut station, 0), 0, "nothing is configured");
    station.bytes(at(1_000), &frame(BRICK, &request(Some(TimeDelta::from_millis(100)))));
    assert_eq!(drive(&mut station, 1_000), 10);
    station.bytes(at(2_000), &frame(BRICK, &request(None)));
    assert_eq!(drive(&mut station, 2_000), 0);
}

#[test]
fn the_status_message_has_the_gate_ratio_of_the_last_fix() {
    let mut config = config();
    config.links[0].outputs = vec![stream(OutputKind::EstimatorStatus, 0)];
    let setup = driven(&config);
    let ratios: Vec<f64> = sent_messages(&setup.station)
        .iter()
        .filter_map(|(_, message)| match message {
            Message::EstimatorStatus(status) => Some(status.position_ratio),
            _ => None,
        })
        .collect();
    // NIS of three components over 16.27: about 0.18 in the mean, and never above 1 for fixes that are used.
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    assert!((0.08..0.3).contains(&mean), "{mean}");
}

#[test]
fn outputs_keep_their_intervals_and_zero_sends_every_estimate() {
    let mut config = config();
    config.links[0].outputs =
        vec![stream(OutputKind::PlanarPose, 0), stream(OutputKind::Odometry, 100), stream(OutputKind::Attitude, 1_000)];
    let setup = driven(&config);
    let sent = sent_messages(&setup.station);
    let of = |matches: fn(&Message) -> bool| -> Vec<Timestamp<HostClock>> {
        let selected = sent.iter().filter(|(_, message)| matches(message));
        selected.map(|(now, _)| *now).collect()
    };
    let poses = of(|message| matches!(message, Message::PlanarPose(_)));
    assert_eq!(poses.len(), setup.station.estimates().len());
    for (instants, interval_ms, at_least) in [
        (of(|message| matches!(message, Message::Odometry(_))), 100, 120),
        (of(|message| matches!(message, Message::Attitude { .. })), 1_000, 18),
    ] {
        // They leave with estimates, which come each 50 ms: an interval is kept in the mean, and no two leave together.
        let interval = TimeDelta::from_millis(interval_ms);
        let shortest = instants.windows(2).map(|pair| pair[1] - pair[0]).min();
        assert!(shortest > Some(TimeDelta::from_millis(interval_ms / 2)), "{shortest:?}");
        let all = instants[instants.len() - 1] - instants[0];
        let expected = all.as_nanos() / interval.as_nanos() + 1;
        assert!(expected.abs_diff(instants.len() as i64) <= 1, "{} of {expected}", instants.len());
        assert!(instants.len() >= at_least, "{}", instants.len());
    }
}

#[test]
fn an_estimate_for_its_arrival_lies_ahead_and_is_marked_as_predicted() {
    let mut config = config();
    config.links[0].outputs[0].instant = OutputInstant::Arrival;
    let ahead = planar_poses(&driven(&config));
    let (predicted, observed): (Vec<&(PlanarPose, u32)>, Vec<_>) =
        ahead.iter().partition(|(pose, _)| pose.flags.predicted);
    assert!(predicted.len() > 400 && observed.len() < 40, "{}", observed.len());
    // Link and brick take 10 to 20 ms each way; 50 ms of telemetry period and as much again bound the rest.
    for (pose, latest_micros) in predicted {
        let lead_micros = micros(pose).wrapping_sub(*latest_micros) as i32;
        assert!((1..150_000).contains(&lead_micros), "{lead_micros}");
    }
    let present = planar_poses(&driven(&crate::support::config()));
    for (pose, latest_micros) in &present {
        assert!(!pose.flags.predicted);
        assert_eq!(micros(pose), *latest_micros);
    }
}

/// Every pose that was sent, with the wrapped microseconds of the estimate from which it was made.
fn planar_poses(setup: &StationSimulation) -> Vec<(PlanarPose, u32)> {
    let mut latest = 0;
    let mut poses = vec![];
    for (_, output) in &setup.station.outputs {
        match output {
            Output::Event(Event::EstimateUpdated { estimate, .. }) => {
                latest = estimate.stamp.as_micros() as u32;
            }
            Output::Transmit { bytes, .. } => {
                poses.extend(messages(bytes).into_iter().filter_map(|message| match message {
                    Message::PlanarPose(pose) => Some((pose, latest)),
                    _ => None,
                }));
            }
            Output::Event(_) | Output::Request(_) => {}
        }
    }
    poses
}

fn micros(pose: &PlanarPose) -> u32 {
    let WireStamp::Micros32(micros) = pose.stamp else {
        panic!("the stamp has 32 bits on the wire");
    };
    micros
}
