//! A simulated brick during its drive: its cable, the commands to it, and its ground truth.

use anyhow::Result;
use posebridge_link::{HostTimer, Link, LinkEvent, LinkOpenConfig};
use posebridge_sim::impairment::{ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkProfile};
use posebridge_sim::{CommandExecutor, Simulation, TruthSample};
use posebridge_telemetry::{HostClock, PeerId, RobotId, SimulatorCommand, TimeDelta, Timestamp};
use tokio::sync::broadcast::error::TryRecvError;
use tokio::sync::{broadcast, mpsc};

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
    if let SimulatorCommand::PullCable { duration } = command {
        cable.unplug(now, *duration);
    } else if let SimulatorCommand::LinkProfile(name) = command {
        match name.map(|name| LinkProfile::bundled(name.as_str())) {
            None => cable.impair(now, None, seed),
            Some(Ok(profile)) => cable.impair(now, Some(&profile), seed),
            // The request was refused already.
            Some(Err(_)) => {}
        }
    }
}

/// The cable between a simulated brick and its end of the link: intact, impaired by a profile, or disconnected.
pub struct SimulatedCable {
    port: Option<Link>,
    /// Settings for reconnection; a port that another program opened stays open.
    reopen_config: Option<(LinkOpenConfig, HostTimer)>,
    replug_at: Timestamp<HostClock>,
    station: Option<PeerId>,
    impairment: Option<ImpairedLink>,
}

impl SimulatedCable {
    pub const fn fixed(port: Link) -> Self {
        Self { port: Some(port), reopen_config: None, replug_at: Timestamp::ZERO, station: None, impairment: None }
    }

    pub fn pluggable(config: LinkOpenConfig, timer: HostTimer) -> Self {
        Self { reopen_config: Some((config.clone(), timer)), ..Self::fixed(Link::new(config, timer)) }
    }

    /// Opens the port at its end for the first time.
    pub async fn open_first(&mut self) -> Result<()> {
        match &mut self.port {
            Some(port) => Ok(port.try_open().await?),
            None => Ok(()),
        }
    }

    /// The next event of the port; pending while disconnected.
    pub async fn next_event(&mut self) -> LinkEvent {
        match &mut self.port {
            Some(port) => port.next_event().await,
            None => std::future::pending().await,
        }
    }

    pub fn on_link_event(&mut self, now: Timestamp<HostClock>, event: LinkEvent, simulation: &mut Simulation) {
        match event {
            LinkEvent::Bytes { peer, bytes, .. } => {
                if self.station.is_some_and(|station| station != peer) {
                    simulation.reopen_link();
                }
                self.station = Some(peer);
                match &mut self.impairment {
                    // Its number is for those who keep books.
                    Some(impaired) => {
                        impaired.offer(LinkEnd::Station, now, &bytes);
                    }
                    None => simulation.receive(&bytes),
                }
            }
            LinkEvent::Up { .. } | LinkEvent::Down { .. } => {
                self.station = None;
                simulation.reopen_link();
            }
            LinkEvent::Finished { .. } => {}
        }
    }

    /// Sends the brick's bytes, and delivers what has arrived through an impaired cable by `now`.
    pub fn transfer(&mut self, now: Timestamp<HostClock>, simulation: &mut Simulation) {
        self.replug_if_due(now, simulation);
        while let Some(bytes) = simulation.poll() {
            match &mut self.impairment {
                Some(impaired) => {
                    impaired.offer(LinkEnd::Brick, now, &bytes);
                }
                None => self.send(&bytes),
            }
        }
        while let Some(event) = self.impairment.as_mut().and_then(|impaired| impaired.poll(now)) {
            match event {
                ImpairedLinkEvent::Arrived { end, delivery } => match end {
                    LinkEnd::Station => self.send(&delivery.bytes),
                    LinkEnd::Brick => simulation.receive(&delivery.bytes),
                },
                // As with a radio that loses its other end: nothing is reported, it is silent.
                ImpairedLinkEvent::Down { .. } => {}
                ImpairedLinkEvent::Up { .. } => simulation.reopen_link(),
            }
        }
        if let Some(impaired) = &mut self.impairment {
            for end in [LinkEnd::Station, LinkEnd::Brick] {
                drop(impaired.take_log(end));
            }
        }
    }

    /// Impairs the cable, or restores it; bytes in transit through an impaired one are lost.
    pub fn impair(&mut self, now: Timestamp<HostClock>, profile: Option<&LinkProfile>, seed: u64) {
        self.impairment = profile.map(|profile| ImpairedLink::new(profile, seed, now));
    }

    /// Disconnects the cable for `duration`, if it can be disconnected.
    pub fn unplug(&mut self, now: Timestamp<HostClock>, duration: TimeDelta) {
        if self.reopen_config.is_some() {
            // The terminal disappears with its port, and its reader gets a hang-up.
            self.port = None;
            self.station = None;
            self.replug_at = now + duration;
        }
    }

    fn replug_if_due(&mut self, now: Timestamp<HostClock>, simulation: &mut Simulation) {
        if self.port.is_some() || now < self.replug_at {
            return;
        }
        if let Some((config, timer)) = &self.reopen_config {
            self.port = Some(Link::new(config.clone(), *timer));
            simulation.reopen_link();
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        if let Some(port) = &mut self.port {
            port.send(bytes);
        }
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
