//! One who watches where a simulated robot really is.

use posebridge_telemetry::RobotId;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::TryRecvError;

use super::TimedTruthSample;

/// Takes what was shown since it looked last. Who is too slow misses the oldest samples, and they are counted.
pub struct TruthTap {
    receiver: broadcast::Receiver<TimedTruthSample>,
    robot: Option<RobotId>,
    missed: u64,
}

impl TruthTap {
    /// A receiver of a robot's truth from now on; `None` for the only one.
    pub fn new(truth: &broadcast::Sender<TimedTruthSample>, robot: Option<RobotId>) -> Self {
        Self { receiver: truth.subscribe(), robot, missed: 0 }
    }

    /// Whose truth it is; `None` for that of the only robot.
    pub const fn robot(&self) -> Option<RobotId> {
        self.robot
    }

    /// What was shown since the last time; never waits.
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

    /// Samples that were missed so far.
    pub const fn missed(&self) -> u64 {
        self.missed
    }
}

#[cfg(test)]
mod tests {
    use posebridge_sim::{Scenario, Simulation};
    use posebridge_telemetry::{TimeDelta, Timestamp};

    use super::*;
    use crate::station::simulator::controls;

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
