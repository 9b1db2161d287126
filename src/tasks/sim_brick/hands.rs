//! What people do to a simulated brick while it drives, and what it shows them that a real brick could not.

use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::{Doer, Simulation, TruthSample};
use posebridge_telemetry::{HostClock, SimulatorCommand, Stamp};
use tokio::sync::{broadcast, mpsc};

use super::cable::Cable;

/// So many commands wait for the brick, which looks every 2 ms; more are refused.
pub const WAITING_COMMANDS: usize = 64;
/// So many samples wait for each who watches, at 20 per second 12 s; who is slower misses the oldest, and is told how many.
const WAITING_SAMPLES: usize = 256;

/// What really happened at one instant, as soon as it has happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveTruth {
    /// The instant by the session's clock.
    pub at: Stamp<HostClock>,
    /// What happened.
    pub sample: TruthSample,
}

/// By this a command goes to the brick.
pub type CommandSender = mpsc::Sender<SimulatorCommand>;

/// The people's side.
#[derive(Clone, Debug)]
pub struct Hands {
    /// What is to be done to the brick.
    pub commands: CommandSender,
    /// Where the robot really is: whoever subscribes hears from then on. Lossy, and what is lost is counted by the receiver.
    pub truth: broadcast::Sender<LiveTruth>,
}

/// The brick's side.
pub struct Reach {
    commands: mpsc::Receiver<SimulatorCommand>,
    truth: broadcast::Sender<LiveTruth>,
    /// Samples of the simulation's truth that were shown.
    shown: u64,
}

/// Both sides.
#[must_use]
pub fn hands() -> (Hands, Reach) {
    let (sender, commands) = mpsc::channel(WAITING_COMMANDS);
    let (truth, _) = broadcast::channel(WAITING_SAMPLES);
    let hands = Hands { commands: sender, truth: truth.clone() };
    let reach = Reach { commands, truth, shown: 0 };
    (hands, reach)
}

impl Reach {
    /// Does what was asked for since the last time.
    pub fn carry_out(&mut self, now: Stamp<HostClock>, simulation: &mut Simulation, cable: &mut Cable) {
        while let Ok(command) = self.commands.try_recv() {
            match simulation.carry_out(&command) {
                Doer::World => {}
                Doer::Link => change_link(now, &command, cable, simulation.scenario().seed),
            }
        }
    }

    /// Shows what has happened since the last time; `start` is when the world began.
    pub fn show(&mut self, start: Stamp<HostClock>, simulation: &Simulation) {
        let fresh = simulation.truth_samples() - self.shown;
        let kept = simulation.truth();
        let first = kept.len().saturating_sub(fresh as usize);
        for sample in kept.iter().skip(first) {
            let at = start + sample.world;
            let sample = *sample;
            // Nobody has to watch.
            drop(self.truth.send(LiveTruth { at, sample }));
        }
        self.shown = simulation.truth_samples();
    }
}

fn change_link(now: Stamp<HostClock>, command: &SimulatorCommand, cable: &mut Cable, seed: u64) {
    match command {
        SimulatorCommand::LinkProfile(None) => cable.impair(now, None, seed),
        // Who asked was told if there is no such profile.
        SimulatorCommand::LinkProfile(Some(name)) => {
            if let Ok(profile) = LinkProfile::bundled(name.as_str()) {
                cable.impair(now, Some(&profile), seed);
            }
        }
        SimulatorCommand::PullCable { duration } => cable.pull(now, *duration),
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
