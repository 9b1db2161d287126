//! The step test: rest, full drive, and every reading until one is below the cut-off.

use super::car::{Car, ControlPeriods};
use super::ranger::{RangeReading, Ranger};
use super::scene::WallScene;

/// A command and the instant from which it holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedCommand {
    /// From when, in the brick's seconds.
    pub at_s: f64,
    /// The PWM.
    pub pwm: f64,
}

/// What a step test leaves behind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepRun {
    /// The turns of the loop, in order: what was commanded from each on.
    pub commands: Vec<TimedCommand>,
    /// The readings, in order; the last is the one below the cut-off.
    pub readings: Vec<RangeReading>,
    /// The true speed at each turn, in m/s.
    pub towards_m_per_s: Vec<f64>,
}

/// Longest step, beyond its rest, in seconds: a car that never arrives.
const LONGEST_S: f64 = 60.0;

/// Draws step number `run`. The same scene and number give the same readings, bit for bit.
pub fn simulate_step(scene: &WallScene, run: u32) -> StepRun {
    let mut car = Car::new(&scene.car, scene.step.start_m);
    let mut ticks = ControlPeriods::new(scene.control, scene.seed, run);
    let mut ranger = Ranger::new(scene.ranger, scene.seed, run);
    let mut left = StepRun::default();
    let mut at_s = 0.0;
    while at_s < scene.step.rest_s + LONGEST_S {
        let pwm = if at_s < scene.step.rest_s { 0.0 } else { scene.step.pwm };
        left.commands.push(TimedCommand { at_s, pwm });
        left.towards_m_per_s.push(car.towards_m_per_s);
        if let Some(reading) = ranger.read(at_s, car.distance_m) {
            left.readings.push(reading);
            if reading.range_m < scene.step.cutoff_m {
                break;
            }
        }
        let dt_s = ticks.next_s();
        car.drive(pwm, dt_s);
        at_s += dt_s;
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall::DEFAULT_SCENE;

    #[test]
    fn a_step_has_the_readings_of_the_text_and_repeats_by_its_number() {
        let scene = WallScene::from_toml(DEFAULT_SCENE).unwrap();
        let first = simulate_step(&scene, 0);
        let on_the_way = first.readings.iter().filter(|reading| reading.at_s >= 0.241);
        let on_the_way = on_the_way.count();
        assert!((17..=22).contains(&on_the_way), "{on_the_way}");
        let (last, others) = first.readings.split_last().unwrap();
        assert!(last.range_m < 0.5 && others.iter().all(|reading| reading.range_m >= 0.5));
        let first_drive = first.commands.iter().find(|command| command.pwm > 0.0).unwrap();
        assert!((0.241..0.252).contains(&first_drive.at_s));
        assert_eq!(first, simulate_step(&scene, 0));
        assert_ne!(first.readings, simulate_step(&scene, 1).readings);
    }
}
