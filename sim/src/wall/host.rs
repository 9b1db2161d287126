//! The approach with the estimator on the other side of a link.
//!
//! The brick sends its readings and commands and steers by the replies: a distance and a speed at an instant of its own
//! clock, which it extrapolates linearly to now.

use posebridge_telemetry::{HostClock, Timestamp};

use super::approach::{Approach, ApproachTask, ControlLoop, DistanceEstimator, drive};
use super::ranger::{RangeEstimate, RangeReading};
use super::scene::{HostSettings, WallScene};
use super::wire::{WallFrame, WallFramer};
use crate::impairment::{ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkProfile};

/// The link to the host.
#[derive(Clone, Debug, PartialEq)]
pub struct HostLink {
    /// What it is like.
    pub profile: LinkProfile,
    /// Seed of its randomness; that of the world is the scene's.
    pub seed: u64,
}

/// Drives up to the wall by an estimator on the other side of a link.
pub fn approach_over_link(
    scene: &WallScene,
    task: &ApproachTask,
    link: &HostLink,
    estimator: &mut dyn DistanceEstimator,
) -> Approach {
    let mut brain = RemoteLoop {
        estimator,
        settings: scene.host,
        link: ImpairedLink::new(&link.profile, link.seed, Timestamp::ZERO),
        at_station: WallFramer::default(),
        at_brick: WallFramer::default(),
        last_estimate: None,
        unsent_commands: Vec::new(),
    };
    drive(scene, task, &mut brain)
}

struct RemoteLoop<'a> {
    estimator: &'a mut dyn DistanceEstimator,
    settings: HostSettings,
    link: ImpairedLink,
    at_station: WallFramer,
    at_brick: WallFramer,
    /// The newest estimate that the brick has, with its timestamp.
    last_estimate: Option<(f64, RangeEstimate)>,
    /// The commands that were not sent yet, with their instants.
    unsent_commands: Vec<(f64, f64)>,
}

fn time_from_secs(at_s: f64) -> Timestamp<HostClock> {
    Timestamp::from_secs_f64(at_s)
}

impl RemoteLoop<'_> {
    /// Lets the link do what it does until `at_s`, each thing at its instant.
    fn advance_to(&mut self, at_s: f64) {
        let now = time_from_secs(at_s);
        while let Some(at) = self.link.deadline().filter(|at| *at <= now) {
            while let Some(event) = self.link.poll(at) {
                match event {
                    ImpairedLinkEvent::Arrived { end, delivery } => match end {
                        LinkEnd::Station => self.at_host(delivery.at, &delivery.bytes),
                        LinkEnd::Brick => self.at_brick(&delivery.bytes),
                    },
                    ImpairedLinkEvent::Down { .. } | ImpairedLinkEvent::Up { .. } => {}
                }
            }
        }
    }

    fn at_host(&mut self, now: Timestamp<HostClock>, bytes: &[u8]) {
        for frame in self.at_station.push(bytes) {
            let of_s = match frame {
                WallFrame::Reading(at_s, range_m) => {
                    self.estimator.on_reading(RangeReading { at_s, range_m });
                    at_s
                }
                WallFrame::Command(at_s, pwm) => {
                    self.estimator.on_command(at_s, pwm);
                    at_s
                }
                WallFrame::Estimate(..) => continue,
            };
            if let Some(believed) = self.estimator.estimate_at(of_s) {
                let answer = WallFrame::Estimate(of_s, believed.distance_m, believed.towards_m_per_s);
                self.link.offer(LinkEnd::Station, now, &answer.encode());
            }
        }
    }

    fn at_brick(&mut self, bytes: &[u8]) {
        for frame in self.at_brick.push(bytes) {
            let WallFrame::Estimate(of_s, distance_m, towards_m_per_s) = frame else {
                continue;
            };
            // Of two estimates of one instant the later one knows more.
            if self.last_estimate.is_none_or(|(newest_s, _)| newest_s <= of_s) {
                let believed = RangeEstimate { distance_m, towards_m_per_s };
                self.last_estimate = Some((of_s, believed));
            }
        }
    }

    fn send(&mut self, at_s: f64, frame: WallFrame) {
        self.link.offer(LinkEnd::Brick, time_from_secs(at_s), &frame.encode());
        self.advance_to(at_s);
    }
}

impl ControlLoop for RemoteLoop<'_> {
    fn step(&mut self, at_s: f64, reading: Option<RangeReading>) -> Option<RangeEstimate> {
        self.advance_to(at_s);
        if let Some(reading) = reading {
            self.send(at_s, WallFrame::Reading(reading.at_s, reading.range_m));
        }
        let (of_s, believed) = self.last_estimate?;
        let age_s = at_s - of_s;
        (age_s <= self.settings.stale_after_s)
            .then_some(RangeEstimate { distance_m: believed.distance_m - believed.towards_m_per_s * age_s, ..believed })
    }

    fn on_command(&mut self, at_s: f64, pwm: f64) {
        self.unsent_commands.push((at_s, pwm));
        if self.unsent_commands.len() < self.settings.report_every as usize {
            return;
        }
        let mean_pwm = self.unsent_commands.iter().map(|(_, pwm)| pwm).sum::<f64>() / self.unsent_commands.len() as f64;
        self.unsent_commands.clear();
        // Sent at their end, as the command from now on: the mean of the next ones is not known yet.
        self.send(at_s, WallFrame::Command(at_s, mean_pwm));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall::{DEFAULT_SCENE, Gains};

    /// Holds the last reading, and counts its inputs.
    #[derive(Default)]
    struct LastReadingEstimator {
        range_m: Option<f64>,
        readings: usize,
        commands: usize,
    }

    impl DistanceEstimator for LastReadingEstimator {
        fn on_reading(&mut self, reading: RangeReading) {
            self.range_m = Some(reading.range_m);
            self.readings += 1;
        }
        fn on_command(&mut self, _: f64, _: f64) {
            self.commands += 1;
        }
        fn estimate_at(&mut self, _: f64) -> Option<RangeEstimate> {
            self.range_m.map(|distance_m| RangeEstimate { distance_m, towards_m_per_s: 0.0 })
        }
    }

    fn driven(profile: &str) -> (Approach, LastReadingEstimator) {
        let scene = WallScene::from_toml(DEFAULT_SCENE).unwrap();
        let task = ApproachTask {
            gains: Gains { kp_pwm_per_m: 20.0, ki_pwm_per_m_s: 0.0, kd_pwm_s_per_m: 0.0 },
            max_pwm: 80.0,
            run: 1,
        };
        let link = HostLink { profile: LinkProfile::bundled(profile).unwrap(), seed: 5 };
        let mut host = LastReadingEstimator::default();
        let left = approach_over_link(&scene, &task, &link, &mut host);
        (left, host)
    }

    #[test]
    fn over_a_clean_link_everything_arrives_at_once() {
        let (left, host) = driven("none");
        assert_eq!(host.readings, left.readings.len());
        assert_eq!(host.commands, left.samples.len() / 4);
        let first = left.readings[0];
        let steered = left.samples.iter().find(|moment| moment.estimate.is_some());
        assert_eq!(steered.unwrap().at_s, first.at_s);
    }

    #[test]
    fn over_a_slow_link_the_brick_hears_later() {
        let (left, host) = driven("bluetooth-spp");
        let first = left.readings[0];
        let steered = left.samples.iter().find(|moment| moment.estimate.is_some());
        // 15 ms each way at least.
        assert!(steered.unwrap().at_s - first.at_s >= 0.03);
        assert!(host.readings > left.readings.len() / 2);
        assert!(left.stop.is_some());
    }
}
