//! The live status block: time, link, clocks, pose, last fix, thermometers; with a simulated brick also the errors of odometry and
//! estimate.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;

use posebridge_report::{PoseTrack, TimedPose};
use posebridge_sim::TruthSample;
use posebridge_telemetry::{
    Celsius, ChannelName, Estimate, Event, FusionOutcome, HostClock, LinkId, LinkState, QuantitySteps, RepeatFilter,
    RobotId, ScalarEstimate, TimeDelta, Timestamp,
};
use tokio::sync::watch;

use super::event_collector::MAX_INTERPOLATION_GAP;
use super::link_report::{LinkReport, condition};
use super::simulator::TruthTap;
use crate::console::print_line;
use crate::stderr_writer::{StatusBlock, clear_status, show_status, shows_status};

/// Interval of a plain line without a terminal.
const PLAIN_PERIOD: TimeDelta = TimeDelta::from_millis(5_000);
/// Interval of the short error line with a simulated brick.
const ERROR_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// Lines of robots in the block, so that it fits into a small terminal.
const MAX_ROBOT_LINES: usize = 8;

#[derive(Clone, Debug, Default)]
struct RobotView {
    name: Option<String>,
    estimate: Option<Estimate>,
    /// Of a filter that knows one quantity.
    quantity: Option<ScalarEstimate>,
    steps: QuantitySteps,
    last_fix: Option<(FusionOutcome, TimeDelta)>,
}

pub struct LiveView {
    /// Whether the block stands at the bottom of the terminal; else there are periodic lines.
    has_block: bool,
    progress: Option<watch::Receiver<f64>>,
    error_to_truth: Vec<ErrorToTruth>,
    now: Timestamp<HostClock>,
    last_written: Timestamp<HostClock>,
    links: BTreeMap<LinkId, LinkView>,
    clock: Option<(TimeDelta, f64, TimeDelta)>,
    robots: BTreeMap<RobotId, RobotView>,
    /// Reading and predicted final value of each thermometer.
    thermometers: BTreeMap<(RobotId, ChannelName), (Celsius, Option<ScalarEstimate>)>,
    is_silent: bool,
    repeats: RepeatFilter,
}

#[derive(Clone, Debug)]
struct LinkView {
    state: LinkState,
    report: LinkReport,
    bytes_per_s: f64,
    frames_per_s: f64,
}

impl Default for LinkView {
    fn default() -> Self {
        Self { state: LinkState::Down, report: LinkReport::default(), bytes_per_s: 0.0, frames_per_s: 0.0 }
    }
}

impl LinkView {
    fn update(&mut self, report: LinkReport) {
        let (health, before) = (&report.health, &self.report.health);
        self.bytes_per_s = health.bytes_in.saturating_sub(before.bytes_in) as f64;
        self.frames_per_s = health.frames_in.saturating_sub(before.frames_in) as f64;
        self.report = report;
    }
}

impl LiveView {
    pub fn new(progress: Option<watch::Receiver<f64>>, error_to_truth: Vec<ErrorToTruth>) -> Self {
        Self {
            has_block: shows_status(),
            progress,
            error_to_truth,
            now: Timestamp::ZERO,
            last_written: Timestamp::ZERO,
            links: BTreeMap::new(),
            clock: None,
            robots: BTreeMap::new(),
            thermometers: BTreeMap::new(),
            is_silent: false,
            repeats: RepeatFilter::default(),
        }
    }

    /// Prints nothing, for benchmarks.
    pub fn silent() -> Self {
        Self { is_silent: true, ..Self::new(None, Vec::new()) }
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    pub fn on_event(&mut self, now: Timestamp<HostClock>, event: &Event) {
        self.now = now;
        match event {
            Event::Link { link, state } => self.links.entry(*link).or_default().state = *state,
            Event::Health { link, health, sources } => {
                self.links.entry(*link).or_default().update(LinkReport { health: *health, sources: sources.clone() });
            }
            Event::BrickClockAligned { offset, skew_ppm, uncertainty, .. } => {
                self.clock = Some((*offset, *skew_ppm, *uncertainty));
            }
            Event::ObservationFused { robot, record } if record.kind == "fix" => {
                self.robots.entry(*robot).or_default().last_fix = Some((record.outcome, record.lag));
            }
            Event::ObservationFused { robot, record } if QuantitySteps::is_reading(record) => {
                self.robots.entry(*robot).or_default().steps.observe(record);
            }
            Event::EstimateUpdated { robot, estimate } => {
                self.robots.entry(*robot).or_default().estimate = Some(*estimate);
                for error in &mut self.error_to_truth {
                    error.push_estimate(*robot, estimate);
                }
            }
            Event::QuantityUpdated { robot, estimate } => {
                let view = self.robots.entry(*robot).or_default();
                view.quantity = Some(*estimate);
                view.steps.step(estimate.stamp);
            }
            Event::Temperature { brick, channel, shown, settled, .. } => {
                self.thermometers.insert((*brick, *channel), (*shown, *settled));
            }
            Event::RobotNamed { robot, name } => {
                self.robots.entry(*robot).or_default().name = Some(name.clone());
            }
            _ => {}
        }
        // The block shows the state of the links.
        if !matches!(event, Event::Link { .. })
            && let Some((_, text)) = event.describe()
        {
            self.print_line(&text);
        }
    }

    /// Draws the block, or without a terminal prints a periodic line.
    pub fn draw(&mut self) {
        if let Some(repeated) = self.repeats.flush_due(self.now) {
            self.print(&repeated);
        }
        if self.is_silent {
            return;
        }
        if !self.has_block {
            self.write_plainly();
            return;
        }
        let errors = self.error_line().map_or_else(String::new, |line| format!("\n  {line}"));
        let progress = self.progress.as_ref().map(|progress| *progress.borrow());
        show_status(StatusBlock { text: self.block() + &errors, progress });
    }

    /// Prints a periodic line where the block is not shown.
    fn write_plainly(&mut self) {
        let period = if self.error_to_truth.is_empty() { PLAIN_PERIOD } else { ERROR_PERIOD };
        if self.now - self.last_written < period {
            return;
        }
        self.last_written = self.now;
        match self.error_line() {
            Some(line) => print_line(&line),
            None => print_line(&self.block().replace('\n', " |")),
        }
    }

    fn error_line(&mut self) -> Option<String> {
        let errors: Vec<_> = self.error_to_truth.iter_mut().filter_map(ErrorToTruth::errors).collect();
        error_line(&errors)
    }

    pub fn finish(&self) {
        if let Some(repeated) = self.repeats.suppressed_summary() {
            self.print(&repeated);
        }
        clear_status();
    }

    /// Prints a line; counts repetitions of the same one.
    fn print_line(&mut self, line: &str) {
        let shown = self.repeats.push(self.now, line);
        if let Some(repeated) = shown.repeat_summary {
            self.print(&repeated);
        }
        if shown.is_shown {
            self.print(line);
        }
    }

    fn print(&self, line: &str) {
        if !self.is_silent {
            print_line(line);
        }
    }

    /// One line for each of the first robots; the dashboard shows all.
    fn robot_lines(&self) -> String {
        let mut lines = String::new();
        for (robot, view) in self.robots.iter().take(MAX_ROBOT_LINES) {
            let id = format!("{}/{}", robot.link, robot.address);
            lines.push_str(&view.line(view.name.as_deref().unwrap_or(&id)));
        }
        let others = self.robots.len().saturating_sub(MAX_ROBOT_LINES);
        if others > 0 {
            let _ = write!(lines, "\n  and {others} more robots");
        }
        lines
    }

    fn block(&self) -> String {
        let mut block = String::new();
        // Writing to a String cannot fail.
        let _ = write!(block, "  time {:7.1} s", self.now.as_secs_f64());
        for (id, link) in &self.links {
            let state = match link.state {
                LinkState::Up => "up",
                LinkState::Down => "DOWN",
            };
            let _ = write!(
                block,
                "\n  link {id} {state}  {:.0} B/s  {:.0} frames/s  {}",
                link.bytes_per_s,
                link.frames_per_s,
                condition(&link.report),
            );
        }
        match self.clock {
            Some((offset, skew_ppm, uncertainty)) => {
                let _ = write!(
                    block,
                    "\n  clock {:+.4} s {skew_ppm:+.0} ppm ± {:.2} ms",
                    offset.as_secs_f64(),
                    uncertainty.as_millis_f64(),
                );
            }
            None => block.push_str("\n  clock not aligned"),
        }
        match self.robots.len() {
            0 => block.push_str(&RobotView::default().line("pose")),
            1 => self.robots.values().for_each(|robot| block.push_str(&robot.line(robot.title()))),
            _ => block.push_str(&self.robot_lines()),
        }
        for ((brick, channel), (shown, settled)) in &self.thermometers {
            block.push_str(&thermometer_line(*brick, *channel, *shown, *settled));
        }
        block
    }
}

impl RobotView {
    /// The beginning of its line where it is the only robot.
    const fn title(&self) -> &'static str {
        if self.estimate.is_none() && self.quantity.is_some() { "estimate" } else { "pose" }
    }

    fn line(&self, name: &str) -> String {
        let mut line = match (&self.estimate, &self.quantity) {
            (Some(estimate), _) => pose_line(name, estimate),
            // Of a filter without a pose there is no fix to speak of.
            (None, Some(quantity)) => return quantity_line(name, quantity, &self.steps),
            (None, None) => format!("\n  {name}  unknown"),
        };
        match self.last_fix {
            Some((verdict, lag)) => {
                // Writing to a String cannot fail.
                let _ = write!(line, "   fix {} {:.0} ms late", verdict.reason(), lag.as_millis_f64());
            }
            None => line.push_str("   no fix yet"),
        }
        line
    }
}

fn quantity_line(name: &str, quantity: &ScalarEstimate, steps: &QuantitySteps) -> String {
    let ScalarEstimate { value, sigma, rate_per_s, unit, .. } = quantity;
    format!("\n  {name}  {value:.3} ± {sigma:.3} {unit}, {rate_per_s:+.3} {unit}/s   {steps}")
}

/// Reading, predicted final value and its 95 % bound.
fn thermometer_line(brick: RobotId, channel: ChannelName, shown: Celsius, settled: Option<ScalarEstimate>) -> String {
    let address = brick.address;
    let settled = settled.map_or_else(
        || "cannot tell yet".to_owned(),
        |settled| format!("{:.2} ± {:.2} °C", settled.value, settled.bound_95()),
    );
    format!("\n  {channel} of {address}  {:.2} °C -> {settled}", shown.0)
}

fn pose_line(name: &str, estimate: &Estimate) -> String {
    let flag = match estimate.missing {
        Some(missing) if estimate.is_relative() => format!("  from its start: {}", missing.describe()),
        Some(missing) => format!("  heading unknown: {}", missing.describe()),
        None if estimate.is_dead_reckoning => "  dead reckoning".to_owned(),
        None => String::new(),
    };
    format!(
        "\n  {name}  x {:.3} ± {:.3} m   y {:.3} ± {:.3} m   heading {:.1} ± {:.1} deg{flag}",
        estimate.pose.x.0,
        estimate.x_sigma_m(),
        estimate.pose.y.0,
        estimate.y_sigma_m(),
        estimate.pose.heading.rad().to_degrees(),
        estimate.heading_sigma_rad().to_degrees(),
    )
}

/// Truth kept for comparison; estimates for steering are newer.
const TRUTH_WINDOW: TimeDelta = TimeDelta::from_millis(2_000);

/// Present errors of odometry and estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentErrors {
    pub odometry_m: f64,
    /// `None` while no estimate can be compared.
    pub estimate_m: Option<f64>,
}

/// Errors of one robot or several as text; `None` without data.
pub fn error_line(errors: &[CurrentErrors]) -> Option<String> {
    let largest = |values: &mut dyn Iterator<Item = f64>| values.reduce(f64::max);
    let odometry_m = largest(&mut errors.iter().map(|errors| errors.odometry_m))?;
    let estimate_m = largest(&mut errors.iter().filter_map(|errors| errors.estimate_m));
    let at_most = if errors.len() > 1 { " at most" } else { "" };
    let estimate = estimate_m
        .map_or_else(|| "estimate not known".to_owned(), |off_m| format!("estimate {off_m:.3} m off{at_most}"));
    let line = format!("odometry {odometry_m:.2} m off{at_most}, {estimate}");
    Some(if errors.len() > 1 { format!("{} robots: {line}", errors.len()) } else { line })
}

/// Compares estimates with the ground truth as it arrives.
pub struct ErrorToTruth {
    tap: TruthTap,
    truth: VecDeque<TruthSample>,
    /// In time order; some are newer than the truth, which arrives at its own instants.
    estimates: VecDeque<TimedPose>,
}

/// 2 s of the fastest brick.
const MAX_ESTIMATES: usize = 1_024;

impl ErrorToTruth {
    pub const fn new(tap: TruthTap) -> Self {
        Self { tap, truth: VecDeque::new(), estimates: VecDeque::new() }
    }

    /// `None` without data.
    pub fn errors(&mut self) -> Option<CurrentErrors> {
        self.drain_truth();
        let newest = self.truth.back()?;
        let odometry_m = newest.odometry.origin().distance(newest.pose.origin()).0;
        Some(CurrentErrors { odometry_m, estimate_m: self.estimate_m() })
    }

    pub fn push_estimate(&mut self, robot: RobotId, estimate: &Estimate) {
        if self.tap.robot().is_none_or(|own| own == robot) && estimate.validity.position {
            if self.estimates.len() >= MAX_ESTIMATES {
                self.estimates.pop_front();
            }
            self.estimates.push_back(TimedPose { time: estimate.stamp, pose: estimate.pose });
        }
    }

    /// Error of the last estimate that is not newer than the truth.
    fn estimate_m(&self) -> Option<f64> {
        let samples = self.truth.iter().map(|sample| TimedPose { time: sample.brick_time, pose: sample.pose });
        let really = PoseTrack::new(samples, MAX_INTERPOLATION_GAP);
        self.estimates.iter().rev().find_map(|estimate| {
            let pose = really.at(estimate.time)?;
            Some(pose.origin().distance(estimate.pose.origin()).0)
        })
    }

    fn drain_truth(&mut self) {
        self.truth.extend(self.tap.drain().into_iter().map(|live| live.sample));
        let newest = self.truth.back().map(|sample| sample.sim_time);
        while let (Some(newest), Some(oldest)) = (newest, self.truth.front())
            && newest - oldest.sim_time > TRUTH_WINDOW
        {
            self.truth.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, FusionRecord, SensorId};

    #[test]
    fn a_quantity_has_the_last_verdict_and_the_share_of_predictions_and_no_fix() {
        let mut view = LiveView::silent();
        let robot = RobotId { link: LinkId(0), address: Address::new(1, 1) };
        for (millis, outcome) in [(0, FusionOutcome::Accepted), (100, FusionOutcome::Gated)] {
            let stamp = Timestamp::from_millis(millis);
            let record = FusionRecord::new(SensorId::RANGE, "wall_range", stamp, outcome);
            let estimate = ScalarEstimate { stamp, value: 1.5, sigma: 0.02, rate_per_s: -0.25, unit: "m" };
            view.on_event(Timestamp::ZERO, &Event::ObservationFused { robot, record });
            view.on_event(Timestamp::ZERO, &Event::QuantityUpdated { robot, estimate });
        }
        let expected =
            "\n  estimate  1.500 ± 0.020 m, -0.250 m/s   last reading gated, 50 % of 2 steps by prediction alone";
        assert!(view.block().ends_with(expected), "{}", view.block());
    }

    #[test]
    fn a_thermometer_has_a_line_of_its_own_with_the_bound_of_its_end() {
        let mut view = LiveView::silent();
        let brick = RobotId { link: LinkId(0), address: Address::new(7, 158) };
        for (shown, settled) in [(20.0, None), (36.2, Some((48.7, 0.306)))] {
            let settled = settled.map(|(value, sigma)| ScalarEstimate {
                stamp: Timestamp::ZERO,
                value,
                sigma,
                rate_per_s: 0.0,
                unit: "°C",
            });
            let event = Event::Temperature {
                brick,
                channel: ChannelName::from_bytes(b"temp1"),
                arrival: Timestamp::ZERO,
                stamp: Timestamp::ZERO,
                shown: Celsius(shown),
                verdict: FusionOutcome::Accepted,
                settled,
            };
            view.on_event(Timestamp::ZERO, &event);
            let expected = match settled {
                None => "\n  temp1 of 7/158  20.00 °C -> cannot tell yet",
                Some(_) => "\n  temp1 of 7/158  36.20 °C -> 48.70 ± 0.60 °C",
            };
            assert!(view.block().ends_with(expected), "{}", view.block());
        }
    }
}
