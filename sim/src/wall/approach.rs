//! The approach to the wall, with the estimator on board or on a host behind a link.
//!
//! Over a link the brick sends its readings and commands and steers by the replies: a distance and a speed at an instant of its own
//! clock, which it extrapolates linearly to now. The frames are a private format of this simulation, typical of a brick of this class:
//!
//! ```text
//! 0xA7 | kind | time, first and second value: three f64, little endian | CRC-16/MCRF4XX of kind and values, little endian
//! ```

use posebridge_protocol::framing::checksum;
use posebridge_telemetry::{HostClock, Timestamp};

use super::car::{Car, Pid, RangeEstimate, RangeReading, Ranger, control_periods};
use super::scene::{Gains, HostSettings, WallScene};
use crate::impairment::{ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkProfile};

/// Estimates a distance from readings and commands. All times are the brick's, in seconds.
pub trait DistanceEstimator {
    fn on_reading(&mut self, reading: RangeReading);
    fn on_command(&mut self, at_s: f64, pwm: f64);
    /// The estimate at an instant not before its last input; `None` before the first reading.
    fn estimate_at(&mut self, at_s: f64) -> Option<RangeEstimate>;
}

/// Settings of one approach; the scene has the rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachTask {
    pub gains: Gains,
    /// Absolute value.
    pub max_pwm: f64,
    /// Run number under the scene's seed.
    pub run: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachSample {
    pub at_s: f64,
    pub distance_m: f64,
    pub towards_m_per_s: f64,
    pub estimate: Option<RangeEstimate>,
    /// Applied from then on.
    pub pwm: f64,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Approach {
    /// Every control cycle; the last is the one at which the car stood, if it did.
    pub samples: Vec<ApproachSample>,
    pub readings: Vec<RangeReading>,
    /// True distance and time at which the car first stood after it had driven; `None` if it never stood.
    pub stop: Option<StopPoint>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopPoint {
    pub at_s: f64,
    /// True distance from the wall; 0 is a crash.
    pub distance_m: f64,
}

pub fn approach(scene: &WallScene, task: &ApproachTask, estimator: &mut dyn DistanceEstimator) -> Approach {
    let settings = &scene.approach;
    let mut car = Car::new(&scene.car, settings.start_m);
    let mut next_period_s = control_periods(scene.control, scene.seed, task.run);
    let mut ranger = Ranger::new(scene.ranger, scene.seed, task.run);
    let mut pid = Pid {
        gains: task.gains,
        target_m: settings.target_m,
        max_pwm: task.max_pwm,
        integral_most_m_s: settings.integral_most_m_s,
        integral_m_s: 0.0,
    };
    let mut run = Approach::default();
    let (mut at_s, mut dt_s, mut has_driven) = (0.0, 0.0, false);
    while at_s < settings.longest_s && run.stop.is_none() {
        let reading = ranger.read(at_s, car.distance_m);
        run.readings.extend(reading);
        if let Some(reading) = reading {
            estimator.on_reading(reading);
        }
        let estimate = estimator.estimate_at(at_s);
        let pwm = estimate.map_or(0.0, |estimate| pid.steer(estimate, dt_s));
        estimator.on_command(at_s, pwm);
        run.samples.push(ApproachSample {
            at_s,
            distance_m: car.distance_m,
            towards_m_per_s: car.towards_m_per_s,
            estimate,
            pwm,
        });
        has_driven |= car.towards_m_per_s > 2.0 * settings.still_m_per_s;
        if has_driven && car.towards_m_per_s <= settings.still_m_per_s {
            run.stop = Some(StopPoint { at_s, distance_m: car.distance_m });
        }
        dt_s = next_period_s();
        car.drive(pwm, dt_s);
        at_s += dt_s;
    }
    run
}

#[derive(Clone, Debug, PartialEq)]
pub struct HostLink {
    pub profile: LinkProfile,
    /// Seed of the link; the world uses the scene's.
    pub seed: u64,
}

/// Approaches the wall with the estimator on a host behind a link.
pub fn approach_over_link(
    scene: &WallScene,
    task: &ApproachTask,
    link: &HostLink,
    estimator: &mut dyn DistanceEstimator,
) -> Approach {
    let mut remote = RemoteEstimator {
        estimator,
        settings: scene.host,
        link: ImpairedLink::new(&link.profile, link.seed, Timestamp::ZERO),
        at_station: WallFramer::default(),
        at_brick: WallFramer::default(),
        last_estimate: None,
        unsent_commands: Vec::new(),
    };
    approach(scene, task, &mut remote)
}

/// The brick's side of the link to the host that has the estimator.
struct RemoteEstimator<'a> {
    estimator: &'a mut dyn DistanceEstimator,
    settings: HostSettings,
    link: ImpairedLink,
    at_station: WallFramer,
    at_brick: WallFramer,
    /// The newest estimate on the brick, with its timestamp.
    last_estimate: Option<(f64, RangeEstimate)>,
    unsent_commands: Vec<(f64, f64)>,
}

impl RemoteEstimator<'_> {
    fn advance_to(&mut self, at_s: f64) {
        let now = Timestamp::from_secs_f64(at_s);
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
            if let Some(estimate) = self.estimator.estimate_at(of_s) {
                let answer = WallFrame::Estimate(of_s, estimate.distance_m, estimate.towards_m_per_s);
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
                let estimate = RangeEstimate { distance_m, towards_m_per_s };
                self.last_estimate = Some((of_s, estimate));
            }
        }
    }

    fn send(&mut self, at_s: f64, frame: WallFrame) {
        self.link.offer(LinkEnd::Brick, Timestamp::from_secs_f64(at_s), &frame.encode());
        self.advance_to(at_s);
    }
}

impl DistanceEstimator for RemoteEstimator<'_> {
    fn on_reading(&mut self, reading: RangeReading) {
        self.advance_to(reading.at_s);
        self.send(reading.at_s, WallFrame::Reading(reading.at_s, reading.range_m));
    }

    /// The newest estimate on the brick, extrapolated; `None` once it is stale.
    fn estimate_at(&mut self, at_s: f64) -> Option<RangeEstimate> {
        self.advance_to(at_s);
        let (of_s, estimate) = self.last_estimate?;
        let age_s = at_s - of_s;
        (age_s <= self.settings.stale_after_s)
            .then_some(RangeEstimate { distance_m: estimate.distance_m - estimate.towards_m_per_s * age_s, ..estimate })
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

const START: u8 = 0xa7;
const LENGTH: usize = 28;
/// CRC extra byte, not used by any real dialect.
const EXTRA: u8 = 0x57;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum WallFrame {
    /// Time in s, range in m.
    Reading(f64, f64),
    /// From when in s, PWM.
    Command(f64, f64),
    /// Time in s, distance in m, speed towards the wall in m/s.
    Estimate(f64, f64, f64),
}

impl WallFrame {
    pub(super) fn encode(self) -> [u8; LENGTH] {
        let (kind, values) = match self {
            Self::Reading(at_s, range_m) => (1, [at_s, range_m, 0.0]),
            Self::Command(at_s, pwm) => (2, [at_s, pwm, 0.0]),
            Self::Estimate(at_s, distance_m, towards) => (3, [at_s, distance_m, towards]),
        };
        let mut bytes = [0; LENGTH];
        bytes[0] = START;
        bytes[1] = kind;
        for (slot, value) in bytes[2..26].chunks_exact_mut(8).zip(values) {
            slot.copy_from_slice(&value.to_le_bytes());
        }
        let sum = checksum(&bytes[1..26], EXTRA);
        bytes[26..].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// `None` if the frame is damaged or a value is not finite.
    fn decode(bytes: &[u8; LENGTH]) -> Option<Self> {
        let [start, kind, ..] = *bytes;
        let sum = checksum(&bytes[1..26], EXTRA);
        if start != START || bytes[26..] != sum.to_le_bytes() {
            return None;
        }
        let mut values = [0.0; 3];
        for (value, slot) in values.iter_mut().zip(bytes[2..26].chunks_exact(8)) {
            *value = f64::from_le_bytes(slot.try_into().ok()?);
        }
        let [at_s, first, second] = values;
        if !values.iter().all(|value| value.is_finite()) {
            return None;
        }
        match kind {
            1 => Some(Self::Reading(at_s, first)),
            2 => Some(Self::Command(at_s, first)),
            3 => Some(Self::Estimate(at_s, first, second)),
            _ => None,
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct WallFramer {
    held: Vec<u8>,
}

impl WallFramer {
    /// The frames that are complete now, in order.
    pub(super) fn push(&mut self, bytes: &[u8]) -> Vec<WallFrame> {
        self.held.extend_from_slice(bytes);
        let mut found = Vec::new();
        let mut at = 0;
        while let Some(candidate) = self.held.get(at..).and_then(|rest| rest.first_chunk()) {
            let frame = WallFrame::decode(candidate);
            // One byte after a defect: a real frame may begin inside it.
            at += if frame.is_some() { LENGTH } else { 1 };
            found.extend(frame);
        }
        self.held.drain(..at);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall::DEFAULT_SCENE;

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

    fn scene() -> WallScene {
        WallScene::from_toml(DEFAULT_SCENE).unwrap()
    }

    fn task(kp_pwm_per_m: f64) -> ApproachTask {
        ApproachTask { gains: Gains { kp_pwm_per_m, ki_pwm_per_m_s: 0.0, kd_pwm_s_per_m: 0.0 }, max_pwm: 80.0, run: 3 }
    }

    #[test]
    fn a_weak_controller_stops_near_the_target_and_a_strong_one_on_stale_readings_beyond() {
        let drive = |gain| approach(&scene(), &task(gain), &mut LastReadingEstimator::default());
        let weak = drive(20.0);
        let weak_m = weak.stop.unwrap().distance_m;
        assert!((0.27..0.36).contains(&weak_m), "{weak_m}");
        let strong = drive(400.0);
        assert!(strong.stop.unwrap().distance_m < 0.2);
        assert!(strong.samples.iter().all(|sample| sample.pwm.abs() <= 80.0));
        assert_eq!(weak, drive(20.0));
    }

    #[test]
    fn without_an_estimate_the_car_does_not_drive() {
        let mut scene = scene();
        scene.ranger.miss_probability = 1.0;
        scene.approach.longest_s = 1.0;
        let run = approach(&scene, &task(20.0), &mut LastReadingEstimator::default());
        assert_eq!(run.stop, None);
        assert!(run.samples.iter().all(|sample| sample.pwm == 0.0 && sample.distance_m == 3.0));
    }

    #[test]
    fn over_a_link_the_brick_steers_by_estimates_as_late_as_the_link() {
        // Bluetooth takes 15 ms each way at least, and may lose something.
        for (profile, least_delay_s, least_share) in [("none", 0.0, 1.0), ("bluetooth-spp", 0.03, 0.5)] {
            let link = HostLink { profile: LinkProfile::bundled(profile).unwrap(), seed: 5 };
            let mut host = LastReadingEstimator::default();
            let run = approach_over_link(&scene(), &task(20.0), &link, &mut host);
            let first_s = run.readings[0].at_s;
            let delay_s = run.samples.iter().find(|sample| sample.estimate.is_some()).unwrap().at_s - first_s;
            assert!(delay_s >= least_delay_s && (profile != "none" || delay_s == 0.0), "{profile}: {delay_s}");
            assert!(host.readings as f64 >= least_share * run.readings.len() as f64, "{profile}");
            assert!(host.commands as f64 >= least_share * (run.samples.len() / 4) as f64, "{profile}");
            assert!(run.stop.is_some(), "{profile}");
        }
    }

    #[test]
    fn frames_are_found_in_any_pieces_and_between_garbage() {
        let frames =
            [WallFrame::Reading(1.25, 0.304), WallFrame::Command(2.5, -80.0), WallFrame::Estimate(-3.0, 1e-9, 7.0)];
        let mut bytes = vec![START, 1, 2];
        for frame in frames {
            bytes.extend(frame.encode());
            bytes.push(START);
        }
        for chunk_size in 1..40 {
            let mut framer = WallFramer::default();
            let mut found: Vec<WallFrame> = bytes.chunks(chunk_size).flat_map(|chunk| framer.push(chunk)).collect();
            found.extend(framer.push(&[0; LENGTH]));
            assert_eq!(found, frames, "{chunk_size}");
        }
    }

    #[test]
    fn a_flipped_bit_and_a_value_that_is_none_are_no_frames() {
        let good = WallFrame::Reading(1.0, 2.0).encode();
        for index in 0..LENGTH {
            let mut bad = good;
            bad[index] ^= 4;
            assert_eq!(WallFrame::decode(&bad), None, "{index}");
        }
        assert_eq!(WallFrame::decode(&WallFrame::Command(f64::NAN, 0.0).encode()), None);
    }
}
