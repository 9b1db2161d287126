//! Commands to a simulated brick during its drive, and its ground truth.

use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::{CommandExecutor, Simulation, TruthSample};
use posebridge_telemetry::{HostClock, RobotId, SimulatorCommand, Timestamp};
use tokio::sync::broadcast::error::TryRecvError;
use tokio::sync::{broadcast, mpsc};

use super::cable::SimulatedCable;

/// Commands queued for the brick, which polls every 2 ms; more are rejected.
pub const COMMAND_CAPACITY: usize = 64;
/// Samples queued for each receiver, 12 s at 20 per second; a slow one misses the oldest and gets their number.
const SAMPLE_CAPACITY: usize = 256;

/// Ground truth at one instant, without delay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedTruthSample {
    /// By the session's clock.
    pub at: Timestamp<HostClock>,
    pub sample: TruthSample,
}

pub type CommandSender = mpsc::Sender<SimulatorCommand>;

#[derive(Clone, Debug)]
pub struct SimulatorControls {
    pub commands: CommandSender,
    /// Ground truth. A subscriber receives later samples. Lossy, and the receiver counts the losses.
    pub truth: broadcast::Sender<TimedTruthSample>,
}

pub struct ControlReceiver {
    commands: mpsc::Receiver<SimulatorCommand>,
    truth: broadcast::Sender<TimedTruthSample>,
    /// Published samples of the simulation's truth.
    published: u64,
}

pub fn controls() -> (SimulatorControls, ControlReceiver) {
    let (sender, commands) = mpsc::channel(COMMAND_CAPACITY);
    let (truth, _) = broadcast::channel(SAMPLE_CAPACITY);
    let controls = SimulatorControls { commands: sender, truth: truth.clone() };
    let receiver = ControlReceiver { commands, truth, published: 0 };
    (controls, receiver)
}

impl ControlReceiver {
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

    /// Publishes the new samples; `start` is the host time at which the world began.
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

/// Receives ground truth. A slow receiver misses the oldest samples, which are counted.
pub struct TruthTap {
    receiver: broadcast::Receiver<TimedTruthSample>,
    robot: Option<RobotId>,
    missed: u64,
}

impl TruthTap {
    /// Receives later samples of a robot's truth; `None` for the only one.
    pub fn new(truth: &broadcast::Sender<TimedTruthSample>, robot: Option<RobotId>) -> Self {
        Self { receiver: truth.subscribe(), robot, missed: 0 }
    }

    /// `None` for the only robot.
    pub const fn robot(&self) -> Option<RobotId> {
        self.robot
    }

    /// The samples since the last call; never waits.
    pub fn drain(&mut self) -> Vec<TimedTruthSample> {
        let mut samples = Vec::new();
        loop {
            match self.receiver.try_recv() {
                Ok(sample) => samples.push(sample),
                Err(TryRecvError::Lagged(missed)) => self.missed += missed,
                Err(TryRecvError::Empty | TryRecvError::Closed) => return samples,
            }
        }
    }

    pub const fn missed(&self) -> u64 {
        self.missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_sim::Scenario;
    use posebridge_telemetry::TimeDelta;

    #[test]
    fn who_looks_too_rarely_misses_the_oldest_and_knows_how_many() {
        let (controls, mut control_receiver) = controls();
        let mut tap = TruthTap::new(&controls.truth, None);
        let mut simulation = Simulation::new(Scenario::default());
        control_receiver.publish_truth(Timestamp::from_millis(5_000), &simulation);
        let first = tap.drain();
        assert_eq!(first.len(), 1, "the start");
        assert_eq!(first[0].at, Timestamp::from_millis(5_000));
        // 20 samples a second for 30 s; 256 wait.
        for _ in 0..30_000 {
            simulation.step();
            control_receiver.publish_truth(Timestamp::ZERO, &simulation);
        }
        let kept = tap.drain();
        assert_eq!((kept.len(), tap.missed()), (256, 600 - 256));
        let last = kept.last().unwrap();
        assert_eq!(last.at - Timestamp::ZERO, simulation.elapsed());
        assert_eq!(last.sample.sim_time, TimeDelta::from_millis(30_000));
        assert_eq!(tap.drain(), []);
    }
}
