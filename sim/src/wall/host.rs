//! The way to the wall with the estimator on the other side of a link.
//!
//! The brick tells its readings and commands and steers by what comes back: a distance and a speed of an instant of its own clock,
//! which it carries on in a straight line to now.

use posebridge_telemetry::{HostClock, Stamp};

use super::approach::{Approach, Believed, Brain, DistanceEstimator, Task, drive};
use super::ranger::Reading;
use super::scene::{HostSettings, WallScene};
use super::wire::{Frame, Frames};
use crate::impairment::{End, ImpairedLink, LinkEvent, LinkProfile};

/// The link to the host.
#[derive(Clone, Debug, PartialEq)]
pub struct HostLink {
    /// What it is like.
    pub profile: LinkProfile,
    /// Seed of its randomness; that of the world is the scene's.
    pub seed: u64,
}

/// Drives up to the wall by what an estimator on the other side of a link believes.
pub fn approach_over_link(
    scene: &WallScene,
    task: &Task,
    link: &HostLink,
    estimator: &mut dyn DistanceEstimator,
) -> Approach {
    let mut brain = Remote {
        estimator,
        settings: scene.host,
        link: ImpairedLink::new(&link.profile, link.seed, Stamp::ZERO),
        at_station: Frames::default(),
        at_brick: Frames::default(),
        heard: None,
        held: Vec::new(),
    };
    drive(scene, task, &mut brain)
}

struct Remote<'a> {
    estimator: &'a mut dyn DistanceEstimator,
    settings: HostSettings,
    link: ImpairedLink,
    at_station: Frames,
    at_brick: Frames,
    /// The newest estimate that the brick has, and the instant of which it speaks.
    heard: Option<(f64, Believed)>,
    /// The commands that were not told yet, with their instants.
    held: Vec<(f64, f64)>,
}

fn stamp(at_s: f64) -> Stamp<HostClock> {
    Stamp::from_secs_f64(at_s)
}

impl Remote<'_> {
    /// Lets the link do what it does until `at_s`, each thing at its instant.
    fn pass_to(&mut self, at_s: f64) {
        let now = stamp(at_s);
        while let Some(at) = self.link.deadline().filter(|at| *at <= now) {
            while let Some(event) = self.link.poll(at) {
                match event {
                    LinkEvent::Arrived { end, delivery } => match end {
                        End::Station => self.at_host(delivery.at, &delivery.bytes),
                        End::Brick => self.at_brick(&delivery.bytes),
                    },
                    LinkEvent::Down { .. } | LinkEvent::Up { .. } => {}
                }
            }
        }
    }

    fn at_host(&mut self, now: Stamp<HostClock>, bytes: &[u8]) {
        for frame in self.at_station.push(bytes) {
            let of_s = match frame {
                Frame::Reading(at_s, range_m) => {
                    self.estimator.reading(Reading { at_s, range_m });
                    at_s
                }
                Frame::Command(at_s, pwm) => {
                    self.estimator.command(at_s, pwm);
                    at_s
                }
                Frame::Estimate(..) => continue,
            };
            if let Some(believed) = self.estimator.believed(of_s) {
                let answer = Frame::Estimate(of_s, believed.distance_m, believed.towards_m_per_s);
                self.link.offer(End::Station, now, &answer.bytes());
            }
        }
    }

    fn at_brick(&mut self, bytes: &[u8]) {
        for frame in self.at_brick.push(bytes) {
            let Frame::Estimate(of_s, distance_m, towards_m_per_s) = frame else {
                continue;
            };
            // Of two estimates of one instant the later one knows more.
            if self.heard.is_none_or(|(newest_s, _)| newest_s <= of_s) {
                let believed = Believed { distance_m, towards_m_per_s };
                self.heard = Some((of_s, believed));
            }
        }
    }

    fn send(&mut self, at_s: f64, frame: Frame) {
        self.link.offer(End::Brick, stamp(at_s), &frame.bytes());
        self.pass_to(at_s);
    }
}

impl Brain for Remote<'_> {
    fn turn(&mut self, at_s: f64, reading: Option<Reading>) -> Option<Believed> {
        self.pass_to(at_s);
        if let Some(reading) = reading {
            self.send(at_s, Frame::Reading(reading.at_s, reading.range_m));
        }
        let (of_s, believed) = self.heard?;
        let age_s = at_s - of_s;
        (age_s <= self.settings.stale_after_s)
            .then_some(Believed { distance_m: believed.distance_m - believed.towards_m_per_s * age_s, ..believed })
    }

    fn steered(&mut self, at_s: f64, pwm: f64) {
        self.held.push((at_s, pwm));
        if self.held.len() < self.settings.report_every as usize {
            return;
        }
        let mean_pwm = self.held.iter().map(|(_, pwm)| pwm).sum::<f64>() / self.held.len() as f64;
        self.held.clear();
        // Told at their end, as what holds from now on: the mean of the next ones is not known yet.
        self.send(at_s, Frame::Command(at_s, mean_pwm));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall::{DEFAULT_SCENE, Gains};

    /// Believes the last reading, and counts what it hears.
    #[derive(Default)]
    struct Last {
        range_m: Option<f64>,
        readings: usize,
        commands: usize,
    }

    impl DistanceEstimator for Last {
        fn reading(&mut self, reading: Reading) {
            self.range_m = Some(reading.range_m);
            self.readings += 1;
        }
        fn command(&mut self, _: f64, _: f64) {
            self.commands += 1;
        }
        fn believed(&mut self, _: f64) -> Option<Believed> {
            self.range_m.map(|distance_m| Believed { distance_m, towards_m_per_s: 0.0 })
        }
    }

    fn driven(profile: &str) -> (Approach, Last) {
        let scene = WallScene::from_toml(DEFAULT_SCENE).unwrap();
        let task = Task {
            gains: Gains { kp_pwm_per_m: 20.0, ki_pwm_per_m_s: 0.0, kd_pwm_s_per_m: 0.0 },
            most_pwm: 80.0,
            run: 1,
        };
        let link = HostLink { profile: LinkProfile::bundled(profile).unwrap(), seed: 5 };
        let mut host = Last::default();
        let left = approach_over_link(&scene, &task, &link, &mut host);
        (left, host)
    }

    #[test]
    fn over_a_clean_link_everything_arrives_at_once() {
        let (left, host) = driven("none");
        assert_eq!(host.readings, left.readings.len());
        assert_eq!(host.commands, left.moments.len() / 4);
        let first = left.readings[0];
        let steered = left.moments.iter().find(|moment| moment.believed.is_some());
        assert_eq!(steered.unwrap().at_s, first.at_s);
    }

    #[test]
    fn over_a_slow_link_the_brick_hears_later() {
        let (left, host) = driven("bluetooth-spp");
        let first = left.readings[0];
        let steered = left.moments.iter().find(|moment| moment.believed.is_some());
        // 15 ms each way at least.
        assert!(steered.unwrap().at_s - first.at_s >= 0.03);
        assert!(host.readings > left.readings.len() / 2);
        assert!(left.stop.is_some());
    }
}
