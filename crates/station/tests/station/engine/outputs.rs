//! What the station sends: how often, what for, and for which instant.

use super::{driven, sent_messages};
use crate::support::simulation::StationSimulation;
use crate::support::{config, messages, stream};
use posebridge_protocol::message::{Message, PlanarPose, WireStamp};
use posebridge_station::{OutputInstant, OutputKind};
use posebridge_telemetry::{Event, Output};

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
