//! The report of `identify step` about its runs.

use posebridge_lab::identification::{
    DirectionComparison, IdentifiedStep, StepDirection, StepParameters, compare_directions,
};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_telemetry::UncertainValue;
use serde_json::{Map, Value, json};

use super::findings::{Findings, Quantity};
use super::step_dataset::{StepDataset, StepRun, StepTruth};

const STEP_PX: f64 = 280.0;
const REST_PX: f64 = 160.0;
/// Number of plotted samples; more do not fit side by side.
const MAX_PLOTTED_SAMPLES: usize = 600;

pub(super) struct StepResult {
    pub(super) run: StepRun,
    pub(super) identified: IdentifiedStep,
    pub(super) numbers: StepParameters,
}

pub(super) fn findings(material: &StepDataset, found: &[StepResult]) -> Findings {
    let compared = direction_comparison(found);
    let mut notes: Vec<String> = found.iter().map(note).collect();
    notes.extend(compared.map(|directions| direction_note(&directions)));
    let mut more = Map::new();
    more.insert("sensor".to_owned(), json!(material.sensor));
    more.insert("runs".to_owned(), found.iter().map(run_object).collect());
    let directions = compared.map(
        |directions| json!({ "up_s": uncertain_value_json(directions.up), "down_s": uncertain_value_json(directions.down), "z": directions.z, "differ": directions.differ() }),
    );
    more.insert("ways".to_owned(), json!(directions));
    Findings {
        name: "identify-step",
        title: format!("Step response: {}", material.sensor),
        quantities: found.iter().flat_map(|one| quantities(material, one)).collect(),
        notes,
        plots: found.iter().map(|one| picture(material, one)).collect(),
        extra_json: more,
    }
}

fn direction_of(found: &StepResult) -> StepDirection {
    StepDirection::from_step(found.identified.response().step)
}

const fn direction_name(direction: StepDirection) -> &'static str {
    match direction {
        StepDirection::Up => "up",
        StepDirection::Down => "down",
    }
}

fn direction_comparison(found: &[StepResult]) -> Option<DirectionComparison> {
    let lags = found.iter().map(|one| (direction_of(one), one.numbers.mean_lag_s));
    compare_directions(&lags.collect::<Vec<_>>())
}

fn quantities(material: &StepDataset, found: &StepResult) -> Vec<Quantity> {
    let (numbers, truth) = (&found.numbers, found.run.truth.as_ref());
    let quantity = |name: &str, unit: &'static str, known: UncertainValue| {
        Quantity::new(name, unit, known.value, Some(known.sigma)).for_run(&found.run.name)
    };
    let mut all = vec![
        Quantity::new("order", "1", found.identified.order() as f64, None)
            .for_run(&found.run.name)
            .with_truth(truth.map(|truth| truth.lags.len() as f64)),
    ];
    all.extend(
        numbers.gain.map(|gain| quantity("gain", material.gain_unit, gain).with_truth(truth.map(|truth| truth.gain))),
    );
    all.extend(numbers.delay_s.map(|delay| quantity("dead time", "s", delay).with_truth(truth.map(|one| one.delay_s))));
    for (j, lag) in numbers.lags.iter().enumerate() {
        let own = true_lag(truth, numbers.lags.len(), j);
        let tau = UncertainValue { value: lag.time_constant_s, sigma: lag.time_constant_sigma_s };
        let tau = quantity(&format!("time constant {}", j + 1), "s", tau);
        all.push(tau.with_truth(own.map(|(tau_s, _)| tau_s)));
        if numbers.lags.len() > 1 {
            let share = UncertainValue { value: lag.share, sigma: lag.share_sigma };
            let share = quantity(&format!("share {}", j + 1), "1", share);
            all.push(share.with_truth(own.map(|(_, share)| share)));
        }
    }
    let mean_lag = truth.map(|truth| truth.lags.iter().map(|(tau_s, share)| tau_s * share).sum::<f64>());
    all.push(quantity("mean lag", "s", numbers.mean_lag_s).with_truth(mean_lag));
    all.push(quantity("step", material.unit, numbers.step));
    all.push(quantity("end", material.unit, numbers.end));
    all
}

/// The true lag, if the identified order is the true one.
fn true_lag(truth: Option<&StepTruth>, order: usize, j: usize) -> Option<(f64, f64)> {
    let lags = &truth?.lags;
    (lags.len() == order).then(|| lags.get(j).copied())?
}

fn note(found: &StepResult) -> String {
    let StepResult { run, identified, numbers } = found;
    let by_order: Vec<String> = identified
        .candidates
        .iter()
        .map(|candidate| {
            let order = candidate.fit.response.lags.len();
            let is_resolved = IdentifiedStep::is_resolved(candidate);
            let remark = if is_resolved { "" } else { ", not told apart" };
            format!("{order}: {:.1}{remark}", candidate.criterion)
        })
        .collect();
    format!(
        "{}: {}, {} samples of noise {:.4}; residual {:.4}, rho(1) {:+.2}; criterion by order, the least is best: {}",
        run.name,
        direction_name(direction_of(found)),
        identified.samples.len(),
        identified.sigma,
        numbers.residual_rms,
        numbers.rho_1,
        by_order.join("; ")
    )
}

fn direction_note(directions: &DirectionComparison) -> String {
    let verdict = if directions.differ() {
        "they differ: identify and predict each way by its own"
    } else {
        "no difference is shown"
    };
    format!(
        "mean lag up {:.4} ± {:.4} s, down {:.4} ± {:.4} s, {:+.1} sigma apart: {verdict}",
        directions.up.value, directions.up.sigma, directions.down.value, directions.down.sigma, directions.z
    )
}

fn uncertain_value_json(known: UncertainValue) -> Value {
    json!({ "value": known.value, "sigma": known.sigma })
}

fn run_object(found: &StepResult) -> Value {
    let candidates = found.identified.candidates.iter().map(|candidate| {
        json!({
            "order": candidate.fit.response.lags.len(),
            "criterion": candidate.criterion,
            "residual_rms": candidate.residual_rms,
            "resolved": IdentifiedStep::is_resolved(candidate),
        })
    });
    json!({
        "name": found.run.name,
        "way": direction_name(direction_of(found)),
        "order": found.identified.order(),
        "samples": found.identified.samples.len(),
        "noise": found.identified.sigma,
        "residual_rms": found.numbers.residual_rms,
        "rho_1": found.numbers.rho_1,
        "candidates": candidates.collect::<Vec<_>>(),
    })
}

fn picture(material: &StepDataset, found: &StepResult) -> Plot {
    let samples = &found.identified.samples;
    let response = found.identified.response();
    let every = samples.len().div_ceil(MAX_PLOTTED_SAMPLES).max(1);
    let by = |of: &dyn Fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
        let drawn = samples.iter().step_by(every);
        drawn.map(|sample| (sample.at_s, of(sample.at_s, sample.value))).collect()
    };
    let unit = if material.unit.is_empty() { String::new() } else { format!(" [{}]", material.unit) };
    let lags: Vec<String> = found
        .numbers
        .lags
        .iter()
        .map(|lag| format!("{:.4} ± {:.4} s", lag.time_constant_s, lag.time_constant_sigma_s))
        .collect();
    let above = [
        Curve::dots("samples", by(&|_, value| value)),
        Curve::line("response", by(&|at_s, _| response.value_at(at_s))),
    ];
    let below = [
        Curve::dots("sample - response", by(&|at_s, value| value - response.value_at(at_s))),
        Curve::new("zero", CurveShape::Level(0.0)),
    ];
    Plot::new(
        format!("{}: {}", material.sensor, found.run.name),
        format!("time constants {}", lags.join(", ")),
        vec![
            Axes::new("time [s]", format!("{}{unit}", material.sensor), STEP_PX, above),
            Axes::new("time [s]", format!("left{unit}"), REST_PX, below),
        ],
    )
}
