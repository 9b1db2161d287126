//! `lab nxt-square --json`: one object, documented in docs/lab/square.md. The same drives give the same text.

use posebridge_lab::square::{
    ErrorMetric, MeanAndVariance, MethodOrder, MethodRanking, NoiseRecord, OrderStep, PathErrors, SquareReport,
};
use posebridge_report::report::Report;
use serde_json::{Value, json};

/// Adds what programs get; `recordings` are the files of a real robot's drives.
pub(super) fn add(report: &mut Report, found: &SquareReport, recordings: &[String]) {
    let readings = found.interpretations.iter().map(|reading| {
        json!({
            "name": reading.name,
            "metric": reading.metric.name(),
            "order": order(&reading.order),
        })
    });
    report.data("source", json!(found.source));
    report.data("recordings", json!(recordings));
    report.data("settings", found.rankings.iter().map(chain).collect());
    report.data("outlook", chain(&found.extended));
    report.data("readings", readings.collect());
    report.data("stop", json!(found.stop.as_ref().map(record)));
    report.data("straight", json!(found.straight.as_ref().map(record)));
}

fn chain(chain: &MethodRanking) -> Value {
    let methods = chain.names.iter().enumerate().map(|(index, name)| {
        let runs: Vec<Value> = chain.runs.iter().filter_map(|run| run.get(index)).map(errors).collect();
        json!({
            "name": name,
            "position_rms_m": chain.rms(index, ErrorMetric::Position),
            "position_end_m": chain.rms(index, ErrorMetric::End),
            "heading_rms_rad": chain.rms(index, ErrorMetric::Heading),
            "forward_rms_m_per_s": chain.rms(index, ErrorMetric::Forward),
            "turn_rms_rad_per_s": chain.rms(index, ErrorMetric::Turn),
            "diverged": chain.diverged(index),
            "runs": runs,
        })
    });
    json!({
        "setting": chain.matrices,
        "methods": methods.collect::<Vec<_>>(),
        "order": order(&chain.order(ErrorMetric::Position)),
    })
}

fn errors(errors: &PathErrors) -> Value {
    json!({
        "position_rms_m": errors.position_m,
        "position_end_m": errors.end_m,
        "heading_rms_rad": errors.heading_rad,
        "forward_rms_m_per_s": errors.forward_m_per_s,
        "turn_rms_rad_per_s": errors.turn_rad_per_s,
    })
}

fn order(order: &MethodOrder) -> Value {
    let step = |step: &OrderStep| {
        json!({
            "worse": step.worse,
            "better": step.better,
            "holds": step.holds,
            "drives": step.drives,
            "sign_test_p": step.sign_p,
            "ratio": step.ratio.map(|ratio| ratio[0]),
            "ratio_interval": step.ratio.map(|ratio| [ratio[1], ratio[2]]),
            "verdict": step.as_text(),
        })
    };
    json!({
        "steps": order.steps.iter().map(step).collect::<Vec<_>>(),
        "holds_on_average": order.holds_on_average(),
        "all_hold": order.all_hold,
        "drives": order.drives,
        "left_out": order.excluded,
    })
}

fn record(record: &NoiseRecord) -> Value {
    let variance = |spread: &Option<MeanAndVariance>| spread.map(|spread| spread.variance);
    let both = |spreads: &Option<[MeanAndVariance; 2]>| spreads.map(|both| both.map(|spread| spread.variance));
    json!({
        "from_row": record.from,
        "rows": record.rows,
        "counters_deg2": both(&record.counters),
        "forward_cm2_per_s2": variance(&record.forward),
        "turn_deg2_per_s2": variance(&record.turn),
        "wheel_heading_deg2": variance(&record.wheel_heading),
        "gyro_mean_deg_per_s": record.gyro.map(|spread| spread.mean),
        "gyro_deg2_per_s2": variance(&record.gyro),
        "gyro_heading_deg2": variance(&record.gyro_heading),
        "accelerometers_m2_per_s4": both(&record.accelerometers),
        "camera_cm2": both(&record.camera),
    })
}
