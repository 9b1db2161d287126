//! `lab nxt-square --json`: one object, documented in docs/lab/nxt-square.md. The same drives give the same text.

use posebridge_analysis::square::{Chain, Errors, Metric, Order, OrderStep, Record, Report, Spread};
use serde_json::{Value, json};

/// The object; `recordings` are the files of a real robot's drives.
pub(super) fn object(report: &Report, recordings: &[String]) -> Value {
    let settings: Vec<Value> = report.chains.iter().map(chain).collect();
    let readings = report.readings.iter().map(|reading| {
        json!({
            "name": reading.name,
            "metric": reading.metric.name(),
            "order": order(&reading.order),
        })
    });
    json!({
        "source": report.source,
        "recordings": recordings,
        "settings": settings,
        "outlook": chain(&report.outlook),
        "readings": readings.collect::<Vec<_>>(),
        "stop": report.stop.as_ref().map(record),
        "straight": report.straight.as_ref().map(record),
    })
}

fn chain(chain: &Chain) -> Value {
    let methods = chain.names.iter().enumerate().map(|(index, name)| {
        let runs: Vec<Value> = chain.runs.iter().filter_map(|run| run.get(index)).map(errors).collect();
        json!({
            "name": name,
            "position_rms_m": chain.rms(index, Metric::Position),
            "position_end_m": chain.rms(index, Metric::End),
            "heading_rms_rad": chain.rms(index, Metric::Heading),
            "forward_rms_m_per_s": chain.rms(index, Metric::Forward),
            "turn_rms_rad_per_s": chain.rms(index, Metric::Turn),
            "diverged": chain.diverged(index),
            "runs": runs,
        })
    });
    json!({
        "setting": chain.setting,
        "methods": methods.collect::<Vec<_>>(),
        "order": order(&chain.order(Metric::Position)),
    })
}

fn errors(errors: &Errors) -> Value {
    json!({
        "position_rms_m": errors.position_m,
        "position_end_m": errors.end_m,
        "heading_rms_rad": errors.heading_rad,
        "forward_rms_m_per_s": errors.forward_m_per_s,
        "turn_rms_rad_per_s": errors.turn_rad_per_s,
    })
}

fn order(order: &Order) -> Value {
    let step = |step: &OrderStep| {
        json!({
            "worse": step.worse,
            "better": step.better,
            "holds": step.holds,
            "drives": step.drives,
            "sign_test_p": step.sign_p,
            "ratio": step.ratio.map(|ratio| ratio[0]),
            "ratio_interval": step.ratio.map(|ratio| [ratio[1], ratio[2]]),
            "verdict": step.in_words(),
        })
    };
    json!({
        "steps": order.steps.iter().map(step).collect::<Vec<_>>(),
        "holds_on_average": order.holds_on_average(),
        "all_hold": order.all_hold,
        "drives": order.drives,
        "left_out": order.left_out,
    })
}

fn record(record: &Record) -> Value {
    let variance = |spread: &Option<Spread>| spread.map(|spread| spread.variance);
    let both = |spreads: &Option<[Spread; 2]>| spreads.map(|both| both.map(|spread| spread.variance));
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
