//! What `lab links` prints: two tables for people, one object for programs.

use anyhow::Result;
use posebridge_report::tables::NO_VALUE;
use serde::Serialize;
use serde_json::Value;

use super::links_clock::LinkClockRow;
use super::links_pose::{LinkConditions, PoseRow};

#[derive(Serialize)]
struct Report<'a> {
    clock: &'a [LinkClockRow],
    pose: Vec<JsonRow<'a>>,
}

#[derive(Serialize)]
struct JsonRow<'a> {
    profile: &'a str,
    loss: f64,
    delay_ms: f64,
    skew_ppm: f64,
    position_rms_m: Option<f64>,
    odometry_rms_m: Option<f64>,
    estimate_age_p50_ms: Option<f64>,
    estimate_age_p99_ms: Option<f64>,
    link_delay_p99_ms: Option<f64>,
    outages: u64,
}

/// One object.
pub(super) fn json(clock: &[LinkClockRow], pose: &[PoseRow]) -> Result<Value> {
    let pose = pose.iter().map(|row| JsonRow {
        profile: &row.profile,
        loss: row.conditions.loss,
        delay_ms: row.conditions.delay_ms,
        skew_ppm: row.conditions.skew_ppm,
        position_rms_m: row.position_rms_m,
        odometry_rms_m: row.odometry_rms_m,
        estimate_age_p50_ms: row.age_p50_ms,
        estimate_age_p99_ms: row.age_p99_ms,
        link_delay_p99_ms: row.link_delay_p99_ms,
        outages: row.outages,
    });
    let report = Report { clock, pose: pose.collect() };
    Ok(serde_json::to_value(&report)?)
}

/// Both tables.
pub(super) fn tables(clock: &[LinkClockRow], pose: &[PoseRow]) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut line = |words: std::fmt::Arguments<'_>| lines.push(words.to_string());
    line(format_args!("clock: error of the offset, ms"));
    line(format_args!("{:<16} {:<22} {:>10} {:>10}", "case", "method", "worst", "mean"));
    for row in clock {
        line(format_args!(
            "{:<16} {:<22} {:>10} {:>10}",
            row.case,
            row.method,
            number(row.worst_ms, 3),
            number(row.mean_ms, 3)
        ));
    }
    line(format_args!(""));
    line(format_args!("pose: one lap of the square, steered by the estimate"));
    line(format_args!(
        "{:<14} {:>6} {:>8} {:>9} {:>11} {:>11} {:>9} {:>9} {:>11} {:>7}",
        "profile",
        "loss",
        "delay ms",
        "skew ppm",
        "pose mm",
        "odometry mm",
        "age p50",
        "age p99",
        "link p99 ms",
        "outages"
    ));
    for row in pose {
        let LinkConditions { loss, delay_ms, skew_ppm } = row.conditions;
        line(format_args!(
            "{:<14} {loss:>6} {delay_ms:>8} {skew_ppm:>9} {:>11} {:>11} {:>9} {:>9} {:>11} {:>7}",
            row.profile,
            number(row.position_rms_m.map(|rms_m| 1e3 * rms_m), 2),
            number(row.odometry_rms_m.map(|rms_m| 1e3 * rms_m), 1),
            number(row.age_p50_ms, 1),
            number(row.age_p99_ms, 1),
            number(row.link_delay_p99_ms, 1),
            row.outages
        ));
    }
    lines.join("\n") + "\n"
}

/// What comes on top of a profile, in words.
pub(super) fn conditions_text(of: &LinkConditions) -> String {
    format!("{} % more loss, {} ms more delay, clock {} ppm off", 100.0 * of.loss, of.delay_ms, of.skew_ppm)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| NO_VALUE.to_owned(), |value| format!("{value:.digits$}"))
}
