//! What `lab links` reports: two tables and a picture.

use posebridge_lab::clocks::ClockRow;
use posebridge_report::chart::{AccuracyChart, AccuracyMark, AccuracyPanel, render_accuracy_chart};
use posebridge_report::report::{Format, Report, Table, Unit};
use serde_json::json;

use super::links_pose::{LinkConditions, PoseRow};

/// The rows are in milliseconds as they come.
const MS: Unit = Unit::Named("ms");

pub(super) fn report(clock: &[ClockRow], pose: &[PoseRow]) -> Report {
    let mut report = Report::new("lab-links", "What links do to clocks and poses");
    report.background(
        "Every way to align two clocks gets the same exchanges over links of known delays; then the same lap is driven over each \
         link profile, steered by the estimate. All of it in virtual time.",
    );
    add_clock(&mut report, clock);
    add_pose(&mut report, pose);
    report.figure(render_accuracy_chart(&chart(pose)), "Position error of a lap over each link, for each circumstance");
    report
}

fn add_clock(report: &mut Report, rows: &[ClockRow]) {
    let error = Format::new(MS, 3);
    let table = Table::of(rows)
        .text("case", "case", |row| row.case.to_owned())
        .text("method", "method", |row| row.method.to_owned())
        .number("worst_ms", "worst", error, |row| row.worst_ms)
        .number("mean_ms", "mean", error, |row| row.mean_ms);
    report.heading("Clock: error of the offset");
    report.table("clock", &table);
}

fn add_pose(report: &mut Report, rows: &[PoseRow]) {
    let delay = Format::new(MS, 1);
    let table = Table::of(rows)
        .text("profile", "profile", |row| row.profile.clone())
        .text("", "loss", |row| row.conditions.loss.to_string())
        .data("loss", |row| json!(row.conditions.loss))
        .text("", "delay ms", |row| row.conditions.delay_ms.to_string())
        .data("delay_ms", |row| json!(row.conditions.delay_ms))
        .text("", "skew ppm", |row| row.conditions.skew_ppm.to_string())
        .data("skew_ppm", |row| json!(row.conditions.skew_ppm))
        .labels(4)
        .number("position_rms_m", "pose", Format::new(Unit::Millimetres, 2), |row| row.position_rms_m)
        .number("odometry_rms_m", "odometry", Format::new(Unit::Millimetres, 1), |row| row.odometry_rms_m)
        .number("estimate_age_p50_ms", "age p50", delay, |row| row.age_p50_ms)
        .number("estimate_age_p99_ms", "age p99", delay, |row| row.age_p99_ms)
        .number("link_delay_p99_ms", "link p99", delay, |row| row.link_delay_p99_ms)
        .count("outages", "outages", |row| row.outages as usize);
    report.heading("Pose: one lap of the square, steered by the estimate");
    report.table("pose", &table);
}

/// One panel per circumstance, one mark per profile.
fn chart(rows: &[PoseRow]) -> AccuracyChart {
    let mut panels: Vec<AccuracyPanel> = Vec::new();
    for row in rows {
        let title = conditions_text(&row.conditions);
        let mark = AccuracyMark { name: row.profile.clone(), rms_m: row.position_rms_m, claimed_m: None, anees: None };
        match panels.iter_mut().find(|panel| panel.title == title) {
            Some(panel) => panel.marks.push(mark),
            None => panels.push(AccuracyPanel { title, marks: vec![mark] }),
        }
    }
    AccuracyChart { title: "Position error of a lap over links".to_owned(), panels }
}

/// What comes on top of a profile, in words.
fn conditions_text(of: &LinkConditions) -> String {
    format!("{} % more loss, {} ms more delay, clock {} ppm off", 100.0 * of.loss, of.delay_ms, of.skew_ppm)
}
