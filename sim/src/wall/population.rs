//! Approaches of many different cars, as students record them: each drawn from a seed, of a kind that names what is hard in it.
//!
//! ```text
//! v_ss 0.4 to 2.5 m/s     t_90 0.2 to 1.8 s     noise 5 to 100 mm     5 to 20 readings/s     start 1.5 to 4 m     rest 0 to 1 s
//! ```
//! Speeds and noises are drawn equal in ratio, the others equal in difference. Half the cars drive at full PWM, half brake by a
//! proportional controller.

use super::car::{Car, RangeReading, TimedCommand};
use super::scene::CarSettings;
use crate::random::RandomStream;

/// What is hard in an approach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ApproachKind {
    /// Nothing: a car of first order.
    Plain,
    /// The motors do nothing below a quarter of the PWM.
    DeadBand,
    /// The speed at a PWM falls by a third.
    SaggingBattery,
    /// 50 to 100 mm.
    NoisySensor,
    /// 5 readings a second.
    SlowSensor,
    /// The car turns, and sees another wall.
    TurnsAway,
    /// For two to six readings the distance is that of a person.
    PersonPasses,
    /// The log does not hold the PWM.
    NoMotorColumn,
    /// The motors stop or reverse on the way.
    Brakes,
    /// The car drives on against the wall.
    Contact,
}

impl ApproachKind {
    pub const ALL: [Self; 10] = [
        Self::Plain,
        Self::DeadBand,
        Self::SaggingBattery,
        Self::NoisySensor,
        Self::SlowSensor,
        Self::TurnsAway,
        Self::PersonPasses,
        Self::NoMotorColumn,
        Self::Brakes,
        Self::Contact,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::DeadBand => "dead band",
            Self::SaggingBattery => "sagging battery",
            Self::NoisySensor => "noisy sensor",
            Self::SlowSensor => "slow sensor",
            Self::TurnsAway => "turns away",
            Self::PersonPasses => "person passes",
            Self::NoMotorColumn => "no motor column",
            Self::Brakes => "brakes",
            Self::Contact => "contact",
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedApproach {
    pub readings: Vec<RangeReading>,
    /// The PWM of each control cycle; empty where nobody recorded it.
    pub commands: Vec<TimedCommand>,
}

const CONTROL_S: f64 = 0.02;
const LONGEST_S: f64 = 12.0;
/// Recorded after the car has come to its end.
const AFTER_S: f64 = 1.0;
const FULL_PWM: f64 = 80.0;
/// A wall that the car touches is this far from its sensor, m.
const BUMPER_M: f64 = 0.06;

/// Approach `run` of a kind. The same numbers give the same readings, bit for bit.
pub fn draw_approach(kind: ApproachKind, seed: u64, run: u32) -> RecordedApproach {
    let mut random = RandomStream::new(seed, &format!("wall population {} {run}", kind.name()));
    let mut ratio = |low: f64, high: f64| low * (high / low).powf(random.uniform(0.0, 1.0));
    let steady_m_per_s = ratio(0.4, 2.5);
    let rise_90_s = ratio(0.2, 1.8);
    let sigma_m = if kind == ApproachKind::NoisySensor { ratio(0.05, 0.1) } else { ratio(0.005, 0.1) };
    let rate = if kind == ApproachKind::SlowSensor { 5.0 } else { ratio(5.0, 20.0) };
    let start_m = random.uniform(1.5, 4.0);
    let rest_s = random.uniform(0.0, 1.0);
    let brakes_by_controller = kind != ApproachKind::Contact && random.bernoulli(0.5);
    let event_m = random.uniform(0.3, 0.7) * start_m;
    let other_wall_m = random.uniform(0.8, 2.5);
    let turned = random.uniform(-1.0, 1.0);
    let person_m = random.uniform(0.3, 0.9);
    let person_readings = random.uniform(2.0, 7.0) as u32;
    let reverse = if random.bernoulli(0.5) { -0.5 } else { 0.0 };
    let shift_s = random.uniform(0.0, 1.0) / rate;
    let mut car = Car::new(&CarSettings { reference_pwm: FULL_PWM, steady_m_per_s, rise_90_s }, start_m);
    let mut found = RecordedApproach::default();
    let (mut at_s, mut next_s, mut event_s, mut ended_s) = (0.0, shift_s, None, None::<f64>);
    let mut persons = 0;
    while at_s < LONGEST_S && ended_s.is_none_or(|ended_s| at_s < ended_s + AFTER_S) {
        let nominal = if at_s < rest_s {
            0.0
        } else if brakes_by_controller {
            (4.0 * (car.distance_m - 0.3)).clamp(-1.0, 1.0)
        } else {
            1.0
        };
        let is_past = car.distance_m < event_m;
        if is_past && event_s.is_none() {
            event_s = Some((at_s, car.distance_m));
        }
        let share = match (kind, event_s) {
            (ApproachKind::Brakes, Some((since_s, _))) => {
                if at_s < since_s + 0.3 {
                    reverse
                } else {
                    0.0
                }
            }
            _ => nominal,
        };
        found.commands.push(TimedCommand { at_s, pwm: (FULL_PWM * share).round() });
        let effective = if kind == ApproachKind::DeadBand {
            share.signum() * (share.abs() - 0.25).max(0.0) / 0.75
        } else if kind == ApproachKind::SaggingBattery {
            share * (1.0 - 0.35 * (at_s / 3.0).min(1.0))
        } else {
            share
        };
        if at_s >= next_s {
            next_s += random.period(1.0 / rate, 0.1);
            let mut true_m = car.distance_m;
            if let (ApproachKind::TurnsAway, Some((_, then_m))) = (kind, event_s) {
                true_m = then_m + other_wall_m + turned * (car.distance_m - then_m);
            }
            if kind == ApproachKind::PersonPasses && event_s.is_some() && persons < person_readings {
                persons += 1;
                true_m = (event_m - person_m).max(0.1);
            }
            let noise_m = sigma_m * random.normal();
            if !random.bernoulli(0.02) {
                found.readings.push(RangeReading { at_s, range_m: (true_m + noise_m).max(0.0) });
            }
        }
        car.drive(FULL_PWM * effective, CONTROL_S);
        if car.distance_m <= BUMPER_M {
            car.distance_m = BUMPER_M;
            car.towards_m_per_s = 0.0;
        }
        let stands = at_s > rest_s + 0.5 && car.towards_m_per_s.abs() < 0.01;
        if stands && ended_s.is_none() {
            ended_s = Some(at_s);
        }
        at_s += CONTROL_S;
    }
    if kind == ApproachKind::NoMotorColumn {
        found.commands.clear();
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_repeats_by_its_seed_and_shows_what_it_is_named_for() {
        for kind in ApproachKind::ALL {
            let drawn: Vec<RecordedApproach> = (0..20).map(|run| draw_approach(kind, 1, run)).collect();
            assert_eq!(drawn[3], draw_approach(kind, 1, 3));
            assert_ne!(drawn[3].readings, draw_approach(kind, 2, 3).readings);
            assert!(drawn.iter().all(|one| one.readings.len() >= 5), "{kind:?}");
            assert_eq!(drawn[0].commands.is_empty(), kind == ApproachKind::NoMotorColumn);
        }
        let jumps = |kind: ApproachKind| {
            let one = draw_approach(kind, 1, 0);
            one.readings.windows(2).any(|pair| (pair[1].range_m - pair[0].range_m).abs() > 0.5)
        };
        assert!(jumps(ApproachKind::TurnsAway) && !jumps(ApproachKind::Plain));
    }
}
