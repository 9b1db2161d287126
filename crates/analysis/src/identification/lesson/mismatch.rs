//! How wrong may the identified lags be? Settling against mismatch, for lags taken for certain and for lags that are estimated along.

use super::super::prediction::Prediction;
use super::super::settled_after_s;
use super::identified::{DIPPED_S, LAGS, Models, dipped};
use super::live::shown;
use super::{Section, header, seconds};

/// By what every lag of the next sensor is multiplied.
const FACTORS: [f64; 7] = [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3];
/// Runs for each factor, of which the middle one is told.
const RUNS: u64 = 3;
/// Where the step begins and ends, in degrees Celsius.
const ENDS: (f64, f64) = (20.0, 4.0);
/// Settled is within this share of the step.
const SHARE: f64 = 0.05;

/// What one run gave: seconds until within 5 % for good, shown, taken for certain and estimated.
type SettledAfter = [Option<f64>; 3];

const METHODS: [&str; 3] = ["shown", "certain", "estimated"];

pub(super) fn mismatch(seed: u64) -> Section {
    let mut section = Section {
        name: "mismatch",
        title: "How wrong may the lags be?".to_owned(),
        words: vec![format!(
            "The sensor is identified on one run. The next ones have every lag shorter or longer by up to 30 %. Seconds until within 5 % of the step for good, the middle one of {RUNS} runs, \
             and how often the 95 % bound contained the end."
        )],
        header: header(&["lags", "shown", "taken for certain", "estimated", "inside, certain", "inside, estimated"]),
        ..Section::default()
    };
    let models = match Models::of(&dipped(&LAGS, seed, (22.0, 8.0))) {
        Ok(models) => models,
        Err(why) => {
            section.words.push(format!("Nothing was identified: {why}."));
            return section;
        }
    };
    for (index, factor) in FACTORS.into_iter().enumerate() {
        let first = seed.wrapping_add(1 + RUNS * index as u64);
        let runs: Vec<(SettledAfter, [f64; 2])> =
            (0..RUNS).map(|run| one_run(&models, factor, first.wrapping_add(run))).collect();
        tell(&mut section, factor, &runs);
    }
    section
}

fn one_run(models: &Models, factor: f64, seed: u64) -> (SettledAfter, [f64; 2]) {
    let samples = dipped(&LAGS.map(|(tau_s, share)| (factor * tau_s, share)), seed, ENDS);
    let (certain, estimated) = models.predictions(&samples);
    let limit = SHARE * (ENDS.1 - ENDS.0).abs();
    let settled = |series: &[(f64, f64)]| settled_after_s(series, DIPPED_S, (ENDS.1, limit));
    let values = |all: &[Prediction]| -> Vec<(f64, f64)> { all.iter().map(|p| (p.at_s, p.value)).collect() };
    let all = [settled(&shown(&samples)), settled(&values(&certain)), settled(&values(&estimated))];
    (all, [inside(&certain), inside(&estimated)])
}

/// The share of bounds that contain the end, once a step was seen.
fn inside(predictions: &[Prediction]) -> f64 {
    let moving: Vec<&Prediction> = predictions.iter().filter(|p| p.is_on_its_way).collect();
    let held = moving.iter().filter(|p| {
        let (low, high) = p.bound();
        low <= ENDS.1 && ENDS.1 <= high
    });
    held.count() as f64 / moving.len().max(1) as f64
}

fn tell(section: &mut Section, factor: f64, runs: &[(SettledAfter, [f64; 2])]) {
    let mut row = vec![format!("{:+.0} %", 100.0 * (factor - 1.0))];
    for (method, name) in METHODS.into_iter().enumerate() {
        let middle = middle(runs.iter().map(|(settled, _)| settled[method]).collect());
        row.push(seconds(middle));
        section.note(format!("{name}_5_percent_s_at_{factor}"), middle);
    }
    for (method, name) in METHODS.into_iter().skip(1).enumerate() {
        let mean = runs.iter().map(|(_, inside)| inside[method]).sum::<f64>() / runs.len() as f64;
        row.push(format!("{:.0} %", 100.0 * mean));
        section.note(format!("{name}_inside_at_{factor}"), mean);
    }
    section.rows.push(row);
}

/// The middle one; a run that never settles is later than all others.
fn middle(mut all: Vec<Option<f64>>) -> Option<f64> {
    all.sort_by(|a, b| a.unwrap_or(f64::INFINITY).total_cmp(&b.unwrap_or(f64::INFINITY)));
    all.get(all.len() / 2).copied().flatten()
}
