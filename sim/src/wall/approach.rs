//! The approach with the estimator on board.

use super::car::{Car, ControlPeriods};
use super::pid::Pid;
use super::ranger::{RangeEstimate, RangeReading, Ranger};
use super::scene::{Gains, WallScene};

/// Makes a distance out of readings and commands. All times are the brick's, in seconds.
pub trait DistanceEstimator {
    /// Takes a reading.
    fn on_reading(&mut self, reading: RangeReading);
    /// Takes the PWM that holds from an instant on.
    fn on_command(&mut self, at_s: f64, pwm: f64);
    /// Its estimate for an instant not before its last input; `None` before it knows anything.
    fn estimate_at(&mut self, at_s: f64) -> Option<RangeEstimate>;
}

/// How an approach is driven; the scene says the rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachTask {
    /// The controller's gains.
    pub gains: Gains,
    /// Largest PWM, either way.
    pub max_pwm: f64,
    /// Which run of the scene's seed.
    pub run: u32,
}

/// A turn of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachSample {
    /// When, in the brick's seconds.
    pub at_s: f64,
    /// The true distance, in metres.
    pub distance_m: f64,
    /// The true speed towards the wall, in m/s.
    pub towards_m_per_s: f64,
    /// The estimate.
    pub estimate: Option<RangeEstimate>,
    /// The PWM from then on.
    pub pwm: f64,
}

/// What an approach leaves behind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Approach {
    /// Every turn of the loop; the last is the one at which the car stood, if it did.
    pub samples: Vec<ApproachSample>,
    /// The sensor's reading.
    pub readings: Vec<RangeReading>,
    /// True distance and time at which the car first stood after it had driven; `None` if it did not.
    pub stop: Option<StopPoint>,
}

/// Where and when a car came to a stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopPoint {
    /// When, in the brick's seconds.
    pub at_s: f64,
    /// How far from the wall, in metres; 0 is a crash.
    pub distance_m: f64,
}

/// Drives up to the wall by the estimator's output.
pub fn approach(scene: &WallScene, task: &ApproachTask, estimator: &mut dyn DistanceEstimator) -> Approach {
    drive(scene, task, &mut OnboardLoop(estimator))
}

/// What the loop asks at each turn.
pub(super) trait ControlLoop {
    /// Takes the reading of this turn, if there is one, and returns the present estimate.
    fn step(&mut self, at_s: f64, reading: Option<RangeReading>) -> Option<RangeEstimate>;
    /// Takes the PWM from this turn on.
    fn on_command(&mut self, at_s: f64, pwm: f64);
}

struct OnboardLoop<'a>(&'a mut dyn DistanceEstimator);

impl ControlLoop for OnboardLoop<'_> {
    fn step(&mut self, at_s: f64, reading: Option<RangeReading>) -> Option<RangeEstimate> {
        if let Some(reading) = reading {
            self.0.on_reading(reading);
        }
        self.0.estimate_at(at_s)
    }

    fn on_command(&mut self, at_s: f64, pwm: f64) {
        self.0.on_command(at_s, pwm);
    }
}

/// The loop on board.
pub(super) fn drive(scene: &WallScene, task: &ApproachTask, brain: &mut dyn ControlLoop) -> Approach {
    let settings = &scene.approach;
    let mut car = Car::new(&scene.car, settings.start_m);
    let mut ticks = ControlPeriods::new(scene.control, scene.seed, task.run);
    let mut ranger = Ranger::new(scene.ranger, scene.seed, task.run);
    let mut pid = Pid {
        gains: task.gains,
        target_m: settings.target_m,
        max_pwm: task.max_pwm,
        integral_most_m_s: settings.integral_most_m_s,
        integral_m_s: 0.0,
    };
    let mut left = Approach::default();
    let (mut at_s, mut dt_s, mut has_driven) = (0.0, 0.0, false);
    while at_s < settings.longest_s && left.stop.is_none() {
        let reading = ranger.read(at_s, car.distance_m);
        left.readings.extend(reading);
        let believed = brain.step(at_s, reading);
        let pwm = believed.map_or(0.0, |believed| pid.steer(believed, dt_s));
        brain.on_command(at_s, pwm);
        left.samples.push(ApproachSample {
            at_s,
            distance_m: car.distance_m,
            towards_m_per_s: car.towards_m_per_s,
            estimate: believed,
            pwm,
        });
        has_driven |= car.towards_m_per_s > 2.0 * settings.still_m_per_s;
        if has_driven && car.towards_m_per_s <= settings.still_m_per_s {
            left.stop = Some(StopPoint { at_s, distance_m: car.distance_m });
        }
        dt_s = ticks.next_s();
        car.drive(pwm, dt_s);
        at_s += dt_s;
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall::DEFAULT_SCENE;

    /// Holds the last reading.
    #[derive(Default)]
    struct LastReadingEstimator(Option<f64>);

    impl DistanceEstimator for LastReadingEstimator {
        fn on_reading(&mut self, reading: RangeReading) {
            self.0 = Some(reading.range_m);
        }
        fn on_command(&mut self, _: f64, _: f64) {}
        fn estimate_at(&mut self, _: f64) -> Option<RangeEstimate> {
            self.0.map(|distance_m| RangeEstimate { distance_m, towards_m_per_s: 0.0 })
        }
    }

    fn task(kp_pwm_per_m: f64) -> ApproachTask {
        ApproachTask { gains: Gains { kp_pwm_per_m, ki_pwm_per_m_s: 0.0, kd_pwm_s_per_m: 0.0 }, max_pwm: 80.0, run: 3 }
    }

    #[test]
    fn a_weak_controller_stops_near_the_target_and_a_strong_one_on_stale_readings_beyond() {
        let scene = WallScene::from_toml(DEFAULT_SCENE).unwrap();
        let weak = approach(&scene, &task(20.0), &mut LastReadingEstimator::default());
        let weak_m = weak.stop.unwrap().distance_m;
        assert!((0.27..0.36).contains(&weak_m), "{weak_m}");
        let strong = approach(&scene, &task(400.0), &mut LastReadingEstimator::default());
        assert!(strong.stop.unwrap().distance_m < 0.2);
        assert!(strong.samples.iter().all(|moment| moment.pwm.abs() <= 80.0));
        assert_eq!(weak, approach(&scene, &task(20.0), &mut LastReadingEstimator::default()));
    }

    #[test]
    fn who_knows_nothing_does_not_drive() {
        let mut scene = WallScene::from_toml(DEFAULT_SCENE).unwrap();
        scene.ranger.miss_probability = 1.0;
        scene.approach.longest_s = 1.0;
        let left = approach(&scene, &task(20.0), &mut LastReadingEstimator::default());
        assert_eq!(left.stop, None);
        assert!(left.samples.iter().all(|moment| moment.pwm == 0.0 && moment.distance_m == 3.0));
    }
}
