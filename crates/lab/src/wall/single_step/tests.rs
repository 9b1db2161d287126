use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::*;
use crate::wall::log::test_logs::log_of;

#[derive(Clone, Copy, Debug)]
struct Scenario {
    steady_m_per_s: f64,
    rise_90_s: f64,
    sigma_m: f64,
    period_s: f64,
    rest_s: f64,
    driven_s: f64,
    /// At rest after contact, or after a stop.
    after_s: f64,
    command: StepCommand,
}

fn draw(scenario: &Scenario, seed: u64) -> WallLog {
    let mut random = Pcg64::seed_from_u64(seed);
    let tau_s = scenario.rise_90_s / std::f64::consts::LN_10;
    let way_m = |since_s: f64| {
        let since_s = since_s.clamp(0.0, scenario.driven_s);
        scenario.steady_m_per_s * (since_s + tau_s * (-since_s / tau_s).exp_m1())
    };
    let start_m = way_m(1e9) + 0.15;
    let shift_s: f64 = random.random::<f64>() * scenario.period_s;
    let last_s = scenario.rest_s + scenario.driven_s + scenario.after_s;
    let count = (last_s / scenario.period_s) as u32;
    let ranges: Vec<(f64, f64)> = (0..count)
        .map(|index| {
            let at_s = shift_s + scenario.period_s * f64::from(index);
            let noise: f64 = random.sample(StandardNormal);
            (at_s, (start_m - way_m(at_s - scenario.rest_s) + scenario.sigma_m * noise).max(0.0))
        })
        .collect();
    match scenario.command {
        StepCommand::Recorded => log_of([(0.0, 0.0), (scenario.rest_s, 1.0)], ranges),
        StepCommand::Unknown => log_of([], ranges).with_assumed_drive(),
    }
}

const CAR: Scenario = Scenario {
    steady_m_per_s: 1.11,
    rise_90_s: 0.8,
    sigma_m: 0.01,
    period_s: 0.08,
    rest_s: 0.6,
    driven_s: 2.0,
    after_s: 1.5,
    command: StepCommand::Unknown,
};

#[test]
fn what_a_step_cannot_tell_is_left_out_with_the_true_reason() {
    let short = Scenario { rise_90_s: 3.0, driven_s: 1.2, after_s: 0.0, ..CAR };
    let found = find_step(&draw(&short, 1), StepCommand::Unknown);
    let reason = match found {
        Ok(step) => {
            assert_eq!(step.drag_s_per_m, None);
            step.undetermined.unwrap()
        }
        Err(WallStepError::Undetermined(reason)) => reason,
        Err(error) => panic!("{error}"),
    };
    assert!(matches!(reason, UndeterminedReason::NoSteadySpeed { .. }), "{reason}");
    let sudden = Scenario { rise_90_s: 0.03, after_s: 0.0, ..CAR };
    let step = find_step(&draw(&sudden, 1), StepCommand::Recorded).unwrap();
    assert!(matches!(step.undetermined, Some(UndeterminedReason::RisesBetweenReadings { .. })), "{step:?}");
    assert!((step.drag_s_per_m.unwrap().value * 1.11 - 1.0).abs() < 0.05 && step.mass_s2_per_m.is_none());
    let rest: Vec<(f64, f64)> =
        (0..30).map(|index| (0.1 * f64::from(index), 2.0 + 0.01 * f64::from(index % 3))).collect();
    let stands = find_step(&log_of([], rest.clone()).with_assumed_drive(), StepCommand::Unknown);
    assert!(matches!(stands, Err(WallStepError::Stands { .. })), "{stands:?}");
    let away = rest.iter().map(|(at_s, range_m)| (*at_s, range_m + 0.4 * at_s * at_s));
    let away = find_step(&log_of([], away).with_assumed_drive(), StepCommand::Unknown);
    assert!(matches!(away, Err(WallStepError::MovesAway { .. })), "{away:?}");
    let silent = find_step(&log_of([], rest), StepCommand::Recorded);
    assert_eq!(silent, Err(WallStepError::NoInput));
}

/// A coarse clock stamps two readings alike: they tell of the noise once, and of no infinite speed.
#[test]
fn readings_that_share_their_stamps_in_pairs_have_the_noise_that_they_have() {
    let mut random = Pcg64::seed_from_u64(3);
    let readings: Vec<(f64, f64)> = (0..4_000)
        .map(|index| {
            let at_s = 0.16 * f64::from(index / 2);
            let noise: f64 = random.sample(StandardNormal);
            (at_s, 3.0 - 0.5 * at_s + 0.01 * noise)
        })
        .collect();
    let noise_m = noise(&readings);
    assert!((0.008..0.012).contains(&noise_m), "{noise_m}");
}
