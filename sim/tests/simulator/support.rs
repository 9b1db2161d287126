//! Scenarios without errors, and what simulations send.

use posebridge_protocol::dialect;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_protocol::message::Message;
use posebridge_sim::scenario::ErrorSettings;
use posebridge_sim::{Scenario, Simulation, TruthSample};
use posebridge_telemetry::{Address, HostClock, Timestamp};

pub(crate) fn bundled(name: &str) -> Scenario {
    Scenario::bundled(name).unwrap()
}

/// The same scenario without errors of motion, gyro scale, play or clock skew.
pub(crate) fn exact(mut scenario: Scenario) -> Scenario {
    scenario.errors = ErrorSettings::none();
    (scenario.gyro.scale_error, scenario.gyro.scale_error_sigma) = (0.0, 0.0);
    scenario.robot.backlash_deg = 0.0;
    scenario.brick.clock_skew_ppm = 0.0;
    scenario
}

/// What the brick's link carries within `millis`, in pieces as they come.
pub(crate) fn run(simulation: &mut Simulation, millis: u32) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    for _ in 0..millis {
        simulation.step();
        sent.extend(std::iter::from_fn(|| simulation.poll()));
    }
    sent
}

/// Runs to the end; gives up after ten minutes of world time.
pub(crate) fn driven(scenario: Scenario) -> Simulation {
    let mut simulation = Simulation::new(scenario);
    while !simulation.is_finished() && simulation.elapsed().as_secs_f64() < 600.0 {
        run(&mut simulation, 1);
    }
    simulation
}

pub(crate) fn last(simulation: &Simulation) -> &TruthSample {
    simulation.truth().last().unwrap()
}

/// The messages in these bytes; nothing may be left over.
pub(crate) fn messages(bytes: &[u8]) -> Vec<(Address, Message)> {
    let mut received = Vec::new();
    let sink = &mut |scanned: FramerOutput<'_>| match scanned {
        FramerOutput::Frame(frame) => received.push((frame.source, dialect::decode(&frame).unwrap().unwrap())),
        other @ (FramerOutput::UnknownFrame(_) | FramerOutput::Error(_)) => panic!("the simulation sent {other:?}"),
    };
    Framer::new(FramerConfig::default()).push(Timestamp::<HostClock>::ZERO, bytes, sink);
    received
}

pub(crate) fn count(received: &[(Address, Message)], is_match: fn(&Message) -> bool) -> usize {
    received.iter().filter(|(_, message)| is_match(message)).count()
}
