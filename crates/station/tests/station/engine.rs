//! The engine as its callers rely on it: deterministic, never late, never spinning, never panicking.

mod any_input;
mod deadlines;

use crate::support::simulation::StationSimulation;
use crate::support::{BRICK, LINK, TestStation, at, config, frame, link, messages, stream, ticks, vision_fix};
use posebridge_protocol::message::{Message, PlanarPose, WireStamp};
use posebridge_sim::Scenario;
use posebridge_station::{BuildError, OutputInstant, OutputKind, Station, StationConfig};
use posebridge_telemetry::{Event, FusionOutcome, HostClock, Input, Output, Timestamp};

/// Twenty seconds of a simulated robot on a square, with the camera.
fn driven(config: &StationConfig) -> StationSimulation {
    let mut setup = StationSimulation::new(Scenario::default().with_seed(4), config);
    setup.run_for(20);
    setup
}

/// Gives the same inputs to a fresh station.
fn replayed(inputs: &[(Timestamp<HostClock>, Input)]) -> TestStation {
    let mut config = config();
    config.links[0].outputs = all_outputs();
    let mut station = TestStation {
        engine: Station::new(config, Timestamp::ZERO).expect("the configuration is good"),
        inputs: vec![],
        outputs: vec![],
    };
    for (now, input) in inputs {
        station.handle(*now, input.clone());
    }
    station
}

fn all_outputs() -> Vec<posebridge_station::OutputStream> {
    posebridge_station::OUTPUTS.iter().map(|output| stream(output.kind, 0)).collect()
}

/// The inputs of a drive: bytes, link states, ticks.
fn inputs() -> Vec<(Timestamp<HostClock>, Input)> {
    driven(&config()).station.inputs
}

/// What was observed and fused, in enough digits to distinguish any two numbers.
fn observed_and_fused(station: &TestStation) -> Vec<String> {
    station
        .events()
        .filter(|event| matches!(event, Event::ObservationAligned { .. } | Event::ObservationFused { .. }))
        .map(|event| format!("{event:?}"))
        .collect()
}

/// The messages that a station sent, in order, with their instants.
fn sent_messages(station: &TestStation) -> Vec<(Timestamp<HostClock>, Message)> {
    let sent = station.sent();
    let received = sent.flat_map(|sent| messages(sent.bytes).into_iter().map(move |received| (sent.now, received)));
    received.collect()
}

#[test]
fn the_same_inputs_give_the_same_outputs_bit_for_bit() {
    let inputs = inputs();
    let (one, two) = (replayed(&inputs), replayed(&inputs));
    assert!(one.outputs.len() > 2_000, "{}", one.outputs.len());
    assert!(format!("{:?}", one.outputs) == format!("{:?}", two.outputs));
}

#[test]
fn how_the_bytes_are_cut_changes_neither_what_is_observed_nor_what_is_fused() {
    let inputs = inputs();
    let expected = observed_and_fused(&replayed(&inputs));
    assert!(expected.len() > 1_500, "{}", expected.len());
    for size in [1, 3, 20, 41] {
        let cut: Vec<_> = inputs.iter().flat_map(|(now, input)| cut(*now, input, size)).collect();
        assert!(cut.len() > inputs.len());
        assert!(observed_and_fused(&replayed(&cut)) == expected, "in pieces of {size}");
    }
}

fn cut(now: Timestamp<HostClock>, input: &Input, size: usize) -> Vec<(Timestamp<HostClock>, Input)> {
    let Input::Bytes { link, peer, bytes } = input else {
        return vec![(now, input.clone())];
    };
    let pieces = bytes.chunks(size).map(|piece| {
        let bytes = piece.to_vec();
        (now, Input::Bytes { link: *link, peer: *peer, bytes })
    });
    pieces.collect()
}

#[test]
fn an_old_fix_that_the_robot_passes_on_is_late_and_no_restart() {
    let mut station = TestStation::new(&config());
    for step in 0..60 {
        let millis = 1_000 + step * 50;
        station.bytes(at(i64::from(millis)), &frame(BRICK, &ticks(millis, 0, 0)));
    }
    station.bytes(at(4_000), &frame(BRICK, &Message::VisionPosition(vision_fix(1_500, 0.0))));
    assert_eq!(station.restarts(), []);
    let fix = station.events().find_map(|event| match event {
        Event::ObservationFused { record, .. } if record.kind == "fix" => Some(record.clone()),
        _ => None,
    });
    let fix = fix.expect("it was held against the estimate of its own time");
    assert_eq!(fix.stamp, Timestamp::from_millis(1_500));
    assert_eq!(fix.outcome, FusionOutcome::Accepted);
}

#[test]
fn a_configuration_that_cannot_be_is_refused_with_its_reason() {
    let mut unknown = config();
    unknown.robot.filter = "magic".to_owned();
    let error = Station::new(unknown, Timestamp::ZERO).err().expect("no such filter");
    let text = error.to_string();
    assert!(text.starts_with("unknown filter `magic`; there are: odometry, pose, "), "{text}");
    let mut doubled = config();
    doubled.links.push(link(LINK, vec![]));
    let error = Station::new(doubled, Timestamp::ZERO).err().expect("one id twice");
    assert_eq!(error, BuildError::DuplicateLink { id: LINK });
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
