//! What people do to a simulated brick while it drives, and what it shows them that a real brick could not.

use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::{CommandExecutor, Simulation, TruthSample};
use posebridge_telemetry::{HostClock, SimulatorCommand, Timestamp};
use tokio::sync::{broadcast, mpsc};

use super::cable::SimulatedCable;

/// Most commands that wait for the brick, which polls every 2 ms; more are refused.
pub const COMMAND_CAPACITY: usize = 64;
/// Most samples that wait for each receiver, at 20 per second 12 s; a slower one misses the oldest, and learns how many.
const SAMPLE_CAPACITY: usize = 256;

/// What really happened at one instant, as soon as it has happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedTruthSample {
    /// The instant by the session's clock.
    pub at: Timestamp<HostClock>,
    /// What happened.
    pub sample: TruthSample,
}

/// By this a command goes to the brick.
pub type CommandSender = mpsc::Sender<SimulatorCommand>;

/// The people's side.
#[derive(Clone, Debug)]
pub struct SimulatorControls {
    /// What is to be done to the brick.
    pub commands: CommandSender,
    /// The true pose. A subscriber receives the samples from then on. Lossy, and what is lost is counted by the receiver.
    pub truth: broadcast::Sender<TimedTruthSample>,
}

/// The brick's side.
pub struct ControlReceiver {
    commands: mpsc::Receiver<SimulatorCommand>,
    truth: broadcast::Sender<TimedTruthSample>,
    /// Samples of the simulation's truth that were shown.
    published: u64,
}

/// Both sides.
pub fn controls() -> (SimulatorControls, ControlReceiver) {
    let (sender, commands) = mpsc::channel(COMMAND_CAPACITY);
    let (truth, _) = broadcast::channel(SAMPLE_CAPACITY);
    let controls = SimulatorControls { commands: sender, truth: truth.clone() };
    let receiver = ControlReceiver { commands, truth, published: 0 };
    (controls, receiver)
}

impl ControlReceiver {
    /// Does what was asked for since the last time.
    pub fn execute_commands(
        &mut self,
        now: Timestamp<HostClock>,
        simulation: &mut Simulation,
        cable: &mut SimulatedCable,
    ) {
        while let Ok(command) = self.commands.try_recv() {
            match simulation.execute(&command) {
                CommandExecutor::Simulation => {}
                CommandExecutor::Link => change_link(now, &command, cable, simulation.scenario().seed),
            }
        }
    }

    /// Shows what has happened since the last time; `start` is when the world began.
    pub fn publish_truth(&mut self, start: Timestamp<HostClock>, simulation: &Simulation) {
        let fresh = simulation.truth_samples() - self.published;
        let kept = simulation.truth();
        let first = kept.len().saturating_sub(fresh as usize);
        for sample in kept.iter().skip(first) {
            let at = start + sample.sim_time;
            let sample = *sample;
            // It does not need a viewer.
            drop(self.truth.send(TimedTruthSample { at, sample }));
        }
        self.published = simulation.truth_samples();
    }
}

fn change_link(now: Timestamp<HostClock>, command: &SimulatorCommand, cable: &mut SimulatedCable, seed: u64) {
    match command {
        SimulatorCommand::LinkProfile(None) => cable.impair(now, None, seed),
        // The request was refused already if there is no such profile.
        SimulatorCommand::LinkProfile(Some(name)) => {
            if let Ok(profile) = LinkProfile::bundled(name.as_str()) {
                cable.impair(now, Some(&profile), seed);
            }
        }
        SimulatorCommand::PullCable { duration } => cable.unplug(now, *duration),
        SimulatorCommand::Kidnap { .. }
        | SimulatorCommand::Slip { .. }
        | SimulatorCommand::Camera(_)
        | SimulatorCommand::CameraDelay { .. }
        | SimulatorCommand::GyroBiasStep { .. }
        | SimulatorCommand::Steering(_)
        | SimulatorCommand::Drive { .. }
        | SimulatorCommand::Path => {}
    }
}
