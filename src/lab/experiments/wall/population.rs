//! Filter against line on approaches of many different cars: each kind with its confidence interval.

use anyhow::Result;
use posebridge_lab::wall::{WallEntry, WallLog, WallReading, forecast, score_against_best_line, score_forecasts};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_sim::wall::{ApproachKind, RecordedApproach, draw_approach};
use serde_json::json;

use crate::lab::parallel::run_cases;

/// Configured noise of a reading; the cars have half of it to ten times as much.
const CONFIGURED_SIGMA_M: f64 = 0.01;
/// The line is then called better.
const LOSS: f64 = 1.05;

struct KindResult {
    kind: ApproachKind,
    /// Ratios of the filter's rms to that of the line through two readings, and to that of the best line.
    against_line: Ratios,
    against_best: Ratios,
}

struct Ratios {
    /// Geometric mean and the ends of its 95 % interval.
    mean: f64,
    low: f64,
    high: f64,
    /// Runs on which the filter's rms is larger by more than 5 %.
    lost: usize,
    runs: usize,
}

pub(super) fn add(report: &mut Report, seed: u64, runs: u32) -> Result<()> {
    let kinds = ApproachKind::ALL;
    let scored = run_cases(&kinds, |_| runs, "cars", |kind, run| score(&draw_approach(*kind, seed, run)))?;
    let results: Vec<KindResult> = kinds
        .into_iter()
        .zip(scored)
        .map(|(kind, scored)| KindResult {
            kind,
            against_line: Ratios::of(scored.iter().filter_map(|pair| pair[0])),
            against_best: Ratios::of(scored.iter().filter_map(|pair| pair[1])),
        })
        .collect();
    report.heading(format!("Other cars: {runs} drawn approaches of each kind, seed {seed}"));
    report.paragraph(
        "Each car has its own speed, rise time, noise and rate of readings, and the filter knows none of them. Rms of the predictions \
         of the filter over that of a line: geometric mean with its 95 % interval; lost: approaches on which the filter's is larger by \
         more than 5 %. Best: the line through 2, 3 or 5 readings that was best on that approach, which nobody knows before.",
    );
    let ratio = Format::new(Unit::None, 2);
    let table = Table::of(&results)
        .text("kind", "kind", |row| row.kind.name().to_owned())
        .number("ratio_to_line", "to line", ratio, |row| Some(row.against_line.mean))
        .text("", "95 %", |row| row.against_line.interval())
        .count("lost_to_line", "lost", |row| row.against_line.lost)
        .number("ratio_to_best_line", "to best", ratio, |row| Some(row.against_best.mean))
        .text("", "95 %", |row| row.against_best.interval())
        .count("lost_to_best_line", "lost", |row| row.against_best.lost)
        .data("runs", |row| json!(row.against_best.runs))
        .data("ratio_to_line_95", |row| json!([row.against_line.low, row.against_line.high]))
        .data("ratio_to_best_line_95", |row| json!([row.against_best.low, row.against_best.high]));
    report.table("population", &table);
    Ok(())
}

fn score(approach: &RecordedApproach) -> [Option<f64>; 2] {
    let most = approach.commands.iter().map(|command| command.pwm.abs()).fold(1.0, f64::max);
    let inputs = approach
        .commands
        .iter()
        .map(|command| WallEntry { at_s: command.at_s, reading: WallReading::Input(command.pwm / most) });
    let ranges = approach
        .readings
        .iter()
        .map(|reading| WallEntry { at_s: reading.at_s, reading: WallReading::Range(reading.range_m) });
    let log = WallLog::new(inputs.chain(ranges).collect()).with_assumed_drive();
    let forecasts = forecast(&log, CONFIGURED_SIGMA_M);
    let line = score_forecasts(&forecasts, |one| one.lines_m[0]);
    let best = score_against_best_line(&forecasts).map(|(_, score)| score);
    [line, best].map(|score| score.map(|score| score.kalman_rms_m / score.other_rms_m))
}

impl Ratios {
    fn of(ratios: impl Iterator<Item = f64>) -> Self {
        let ratios: Vec<f64> = ratios.filter(|ratio| ratio.is_finite() && *ratio > 0.0).collect();
        let count = ratios.len().max(1) as f64;
        let mean = ratios.iter().map(|ratio| ratio.ln()).sum::<f64>() / count;
        let squares: f64 = ratios.iter().map(|ratio| (ratio.ln() - mean).powi(2)).sum();
        let half = 1.96 * (squares / (count - 1.0).max(1.0) / count).sqrt();
        Self {
            mean: mean.exp(),
            low: (mean - half).exp(),
            high: (mean + half).exp(),
            lost: ratios.iter().filter(|ratio| **ratio > LOSS).count(),
            runs: ratios.len(),
        }
    }

    fn interval(&self) -> String {
        format!("{:.2} to {:.2}", self.low, self.high)
    }
}
