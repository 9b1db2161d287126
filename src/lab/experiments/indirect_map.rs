//! Part of `posebridge lab indirect`: the robots for which accelerometers help, as a map.

use std::f64::consts::FRAC_PI_2;

use anyhow::Result;
use posebridge_estimator::find_filter;
use posebridge_lab::end_errors::run_filter;
use posebridge_lab::indirect_map::{
    CountedShare, DrawnRobot, EndRms, HelpBoundary, MappedRobot, cross_validate, draw_robots,
};
use posebridge_report::chart::{Axes, Curve, Plot};
use posebridge_report::metrics::PoseError;
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_sim::montecarlo::{Course, Scenario};
use posebridge_telemetry::ObservationKind;
use serde_json::{Value, json};

use super::indirect_drive::{PAPER_END_M, draw_drive};
use crate::lab::drives::drawn_config;
use crate::lab::parallel::run_with_bar;

/// Rounds of each robot: its end error is their root mean square.
const ROUNDS: u32 = 4;

/// Drives every robot round the scenario's square; none where the scenario has no square or no accelerometers.
pub(super) fn drive_robots(scenario: &Scenario, robots: u32) -> Result<Vec<MappedRobot>> {
    let (Course::Laps(laps), Some(_)) = (&scenario.path, scenario.accelerometer) else { return Ok(Vec::new()) };
    // A quarter turn with its ramps, T of docs/lab/indirect.md (4).
    let turn_s = FRAC_PI_2 / laps.turn_rate_rad_per_s + f64::from(laps.ramp_steps) * scenario.step_s;
    let jobs: Vec<(u64, DrawnRobot)> = (1..).zip(draw_robots(scenario.seed, robots)).collect();
    run_with_bar(&jobs, "robots", |(number, drawn)| drive_robot(scenario, *number, *drawn, turn_s))
}

fn drive_robot(scenario: &Scenario, number: u64, drawn: DrawnRobot, turn_s: f64) -> MappedRobot {
    // Far from the seeds of the experiment's own rounds.
    let mut own = scenario.clone().with_seed(scenario.seed.wrapping_add(number << 32));
    own.errors.track_scale_sigma = drawn.track_scale_sigma;
    own.told.track_scale_sigma = drawn.track_scale_sigma;
    if let Some(accelerometer) = &mut own.accelerometer {
        accelerometer.sigma_m_per_s2 = drawn.accelerometer_m_per_s2;
    }
    let mut ends: [Vec<PoseError>; 2] = [Vec::new(), Vec::new()];
    for round in 0..ROUNDS {
        let drive = draw_drive(&own, round);
        let config = drawn_config(&drive.prior);
        let Some(truth) = drive.truth.last().copied() else { continue };
        for (name, ends) in ["odometry", "indirect-feedback"].into_iter().zip(&mut ends) {
            let Some(found) = find_filter(name) else { continue };
            let observations = drive.arrivals.iter().map(|arrival| &arrival.observation);
            let accepted = observations.filter(|observation| {
                let kind = &observation.measurement;
                matches!(kind, ObservationKind::WheelAngles { .. } | ObservationKind::WheelAccelerations { .. })
            });
            ends.extend(run_filter((found.build)(&config).as_mut(), accepted, truth).end);
        }
    }
    let [wheels, fused] = ends.map(|ends| EndRms::of(&ends));
    let turn = drawn.turn_errors(scenario.robot.track_width_m, turn_s, scenario.step_s);
    MappedRobot { drawn, turn, wheels, fused }
}

/// Bounds of e_a / e_w between the rows of the table.
const RATIO_BOUNDS: [f64; 6] = [0.0, 0.5, 1.0, 2.0, 4.0, f64::INFINITY];

struct RatioRow {
    from: f64,
    to: f64,
    helped: CountedShare,
    within: CountedShare,
    both: CountedShare,
}

fn ratio_rows(robots: &[MappedRobot]) -> Vec<RatioRow> {
    let bounds = RATIO_BOUNDS.windows(2).map(|pair| (pair[0], pair[1]));
    bounds
        .map(|(from, to)| {
            let ratio = |robot: &MappedRobot| robot.turn.accelerometers_rad / robot.turn.wheels_rad;
            let among: Vec<MappedRobot> =
                robots.iter().copied().filter(|robot| (from..to).contains(&ratio(robot))).collect();
            RatioRow {
                from,
                to,
                helped: CountedShare::of(&among, MappedRobot::is_helped),
                within: CountedShare::of(&among, |robot| robot.is_within(PAPER_END_M)),
                both: CountedShare::of(&among, |robot| robot.is_helped() && robot.is_within(PAPER_END_M)),
            }
        })
        .collect()
}

/// Adds the map to the experiment's report.
pub(super) fn add_map(report: &mut Report, robots: &[MappedRobot]) {
    if robots.is_empty() {
        return;
    }
    report.heading(format!("For which robots: {} robots, {ROUNDS} rounds each", robots.len()));
    let rows = ratio_rows(robots);
    report.table("ratios", &ratio_table(&rows));
    report.paragraph(
        "e_w and e_a: error of a quarter turn by wheels whose track is known to sigma_b (sigma_b pi/2), and by the \
         accelerometers alone. Helped: the fused end error is at most 3/4 of the wheels'. Within: below the paper's 23.5 \
         cm in x and 32 cm in y, root mean square. In brackets the 95 % interval of the share.",
    );
    report.paragraph(verdict(robots));
    let plot = map(robots);
    report.chart(&plot, plot.title.as_str());
    report.data("map", json!(robots.iter().map(robot_json).collect::<Vec<_>>()));
    report.data("boundary", boundary_json(robots));
}

fn ratio_table(rows: &[RatioRow]) -> Table<'_, RatioRow> {
    let two = Format::new(Unit::None, 1);
    Table::of(rows)
        .number("ratio_from", "e_a / e_w from", two, |row| Some(row.from))
        .number("ratio_to", "to", two, |row| row.to.is_finite().then_some(row.to))
        .count("robots", "robots", |row| row.helped.cases)
        .text("", "helped", |row| share_text(row.helped))
        .text("", "within", |row| share_text(row.within))
        .text("", "both", |row| share_text(row.both))
        .data("helped", |row| json!(row.helped.hits))
        .data("within", |row| json!(row.within.hits))
        .data("both", |row| json!(row.both.hits))
}

fn share_text(share: CountedShare) -> String {
    let interval = share.interval().map(|(low, high)| format!(" ({:.0}-{:.0} %)", 100.0 * low, 100.0 * high));
    format!("{}{}", share.hits, interval.unwrap_or_default())
}

fn verdict(robots: &[MappedRobot]) -> String {
    let (Some(boundary), Some(right)) = (HelpBoundary::fit(robots), cross_validate(robots)) else {
        return "These robots are too few, or too alike, for a boundary.".to_owned();
    };
    let (low, high) = right.interval().unwrap_or_default();
    format!(
        "Rule of thumb: accelerometers help a robot with e_a < {:.2} e_w^{:.2} (at e_w = 0.05 rad: {:.3} rad). Fitted to one half of the \
         robots, the rule is right about {} of {} in the other half ({:.0} to {:.0} % with 95 % confidence).",
        boundary.factor(),
        boundary.exponent(),
        boundary.accelerometer_limit_rad(0.05),
        right.hits,
        right.cases,
        100.0 * low,
        100.0 * high
    )
}

fn boundary_json(robots: &[MappedRobot]) -> Value {
    let (Some(boundary), Some(right)) = (HelpBoundary::fit(robots), cross_validate(robots)) else {
        return Value::Null;
    };
    json!({
        "factor": boundary.factor(), "exponent": boundary.exponent(), "right": right.hits, "judged": right.cases,
        "right_95": right.interval().map(|(low, high)| [low, high]),
    })
}

fn robot_json(robot: &MappedRobot) -> Value {
    json!({
        "track_scale_sigma": robot.drawn.track_scale_sigma, "accelerometer_m_per_s2": robot.drawn.accelerometer_m_per_s2,
        "turn_by_wheels_rad": robot.turn.wheels_rad, "turn_by_accelerometers_rad": robot.turn.accelerometers_rad,
        "wheels_rms_m": [robot.wheels.x_m, robot.wheels.y_m], "fused_rms_m": [robot.fused.x_m, robot.fused.y_m],
        "helped": robot.is_helped(), "within": robot.is_within(PAPER_END_M),
    })
}

fn map(robots: &[MappedRobot]) -> Plot {
    let place = |robot: &MappedRobot| (robot.turn.wheels_rad.log10(), robot.turn.accelerometers_rad.log10());
    let among = |is_in: &dyn Fn(&MappedRobot) -> bool| -> Vec<(f64, f64)> {
        robots.iter().filter(|robot| is_in(robot)).map(place).collect()
    };
    let within = |robot: &MappedRobot| robot.is_within(PAPER_END_M);
    let mut curves = vec![
        Curve::dots("helped, within", among(&|robot| robot.is_helped() && within(robot))),
        Curve::dots("helped, not within", among(&|robot| robot.is_helped() && !within(robot))),
        Curve::dots("not helped, within", among(&|robot| !robot.is_helped() && within(robot))),
        Curve::dots("neither", among(&|robot| !robot.is_helped() && !within(robot))),
    ];
    if let Some(boundary) = HelpBoundary::fit(robots) {
        let wheels = robots.iter().map(|robot| robot.turn.wheels_rad);
        let (low, high) = wheels.fold((f64::INFINITY, 0.0_f64), |(low, high), e| (low.min(e), high.max(e)));
        let ends = [low, high].map(|e_w| (e_w.log10(), boundary.accelerometer_limit_rad(e_w).log10()));
        curves.push(Curve::line("boundary", ends));
    }
    let axes = Axes::new("wheels: log10 of e_w [rad]", "accelerometers: log10 of e_a [rad]", 480.0, curves);
    Plot::new("For which robots accelerometers help", "", vec![axes])
}
