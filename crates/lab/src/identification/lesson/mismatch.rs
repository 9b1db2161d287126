//! How wrong may the identified lags be? Settling against mismatch, for lags taken for certain and for lags that are estimated along.

use super::super::prediction::EndPrediction;
use super::super::settling_time_s;
use super::identified::{DIPPED_S, DipTemperatures, IdentifiedModels, LAGS, simulate_dip};
use super::live::sample_points;
use super::section::{LessonSection, header, seconds};

/// By what every lag of the next sensor is multiplied.
const FACTORS: [f64; 7] = [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3];
/// Runs for each factor; the median is reported.
const RUNS: u64 = 3;
/// Where the step begins and ends, in degrees Celsius.
const DIP: DipTemperatures = DipTemperatures { before: 20.0, after: 4.0 };
/// Settled is within this share of the step.
const SHARE: f64 = 0.05;

/// What one run gave: seconds until within 5 % for good, shown, taken for certain and estimated.
type SettlingTimes = [Option<f64>; 3];

const METHODS: [&str; 3] = ["shown", "certain", "estimated"];

pub(super) fn mismatch(seed: u64) -> LessonSection {
    let mut section = LessonSection {
        name: "mismatch",
        title: "How wrong may the lags be?".to_owned(),
        paragraphs: vec![format!(
            "The sensor is identified on one run. The next ones have every lag shorter or longer by up to 30 %. Seconds until within 5 % of the step for good, the middle one of {RUNS} runs, \
             and how often the 95 % bound contained the end."
        )],
        header: header(&["lags", "shown", "taken for certain", "estimated", "inside, certain", "inside, estimated"]),
        ..LessonSection::default()
    };
    let models = match IdentifiedModels::of(&simulate_dip(&LAGS, seed, DipTemperatures { before: 22.0, after: 8.0 })) {
        Ok(models) => models,
        Err(why) => {
            section.paragraphs.push(format!("Nothing was identified: {why}."));
            return section;
        }
    };
    for (index, factor) in FACTORS.into_iter().enumerate() {
        let first = seed.wrapping_add(1 + RUNS * index as u64);
        let runs: Vec<(SettlingTimes, [f64; 2])> =
            (0..RUNS).map(|run| one_run(&models, factor, first.wrapping_add(run))).collect();
        add_row(&mut section, factor, &runs);
    }
    section
}

fn one_run(models: &IdentifiedModels, factor: f64, seed: u64) -> (SettlingTimes, [f64; 2]) {
    let samples = simulate_dip(&LAGS.map(|(tau_s, share)| (factor * tau_s, share)), seed, DIP);
    let (certain, estimated) = models.predictions(&samples);
    let limit = SHARE * (DIP.after - DIP.before).abs();
    let settled = |series: &[(f64, f64)]| settling_time_s(series, DIPPED_S, DIP.after, limit);
    let values = |all: &[EndPrediction]| -> Vec<(f64, f64)> { all.iter().map(|p| (p.at_s, p.value)).collect() };
    let all = [settled(&sample_points(&samples)), settled(&values(&certain)), settled(&values(&estimated))];
    (all, [share_inside(&certain), share_inside(&estimated)])
}

/// The share of bounds that contain the end, once a step was seen.
fn share_inside(predictions: &[EndPrediction]) -> f64 {
    let moving: Vec<&EndPrediction> = predictions.iter().filter(|p| p.is_settling).collect();
    let held = moving.iter().filter(|p| {
        let (low, high) = p.bound();
        low <= DIP.after && DIP.after <= high
    });
    held.count() as f64 / moving.len().max(1) as f64
}

fn add_row(section: &mut LessonSection, factor: f64, runs: &[(SettlingTimes, [f64; 2])]) {
    let mut row = vec![format!("{:+.0} %", 100.0 * (factor - 1.0))];
    for (method, name) in METHODS.into_iter().enumerate() {
        let middle = median(runs.iter().map(|(settled, _)| settled[method]).collect());
        row.push(seconds(middle));
        section.record_value(format!("{name}_5_percent_s_at_{factor}"), middle);
    }
    for (method, name) in METHODS.into_iter().skip(1).enumerate() {
        let mean = runs.iter().map(|(_, inside)| inside[method]).sum::<f64>() / runs.len() as f64;
        row.push(format!("{:.0} %", 100.0 * mean));
        section.record_value(format!("{name}_inside_at_{factor}"), mean);
    }
    section.rows.push(row);
}

/// The middle one; a run that never settles is later than all others.
fn median(mut all: Vec<Option<f64>>) -> Option<f64> {
    all.sort_by(|a, b| a.unwrap_or(f64::INFINITY).total_cmp(&b.unwrap_or(f64::INFINITY)));
    all.get(all.len() / 2).copied().flatten()
}
