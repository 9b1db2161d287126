//! The live status block: time, link, clocks, pose, last fix, thermometers.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use posebridge_telemetry::{
    Celsius, ChannelName, Estimate, Event, HostClock, LinkId, LinkState, Repeats, RobotId, ScalarEstimate, Span, Stamp,
    Verdict,
};
use tokio::sync::watch;

use super::links::{LinkReport, condition};
use super::off::Off;
use crate::stderr::say;

/// Without a terminal a plain line is written this often instead.
const PLAIN_PERIOD: Span = Span::from_millis(5_000);
/// With a simulated brick a short line is written this often instead: who is how far off.
const OFF_PERIOD: Span = Span::from_millis(1_000);
/// The bar's resolution.
const BAR_STEPS: u64 = 1_000;

/// The block.
pub struct LiveView {
    bar: ProgressBar,
    progress: Option<watch::Receiver<f64>>,
    off: Option<Off>,
    now: Stamp<HostClock>,
    written: Stamp<HostClock>,
    links: BTreeMap<LinkId, LinkView>,
    clock: Option<(Span, f64, Span)>,
    estimate: Option<Estimate>,
    last_fix: Option<(Verdict, Span)>,
    /// What each thermometer shows, and what it will show in the end.
    thermometers: BTreeMap<(RobotId, ChannelName), (Celsius, Option<ScalarEstimate>)>,
    voice: Voice,
    repeats: Repeats,
}

/// Whether the block says anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Voice {
    Speaking,
    Silent,
}

/// What the block shows of one link.
#[derive(Clone, Debug)]
struct LinkView {
    state: LinkState,
    report: LinkReport,
    /// Received per second, between two health events.
    bytes_per_s: f64,
    frames_per_s: f64,
}

impl Default for LinkView {
    fn default() -> Self {
        Self { state: LinkState::Down, report: LinkReport::default(), bytes_per_s: 0.0, frames_per_s: 0.0 }
    }
}

impl LinkView {
    fn take(&mut self, report: LinkReport) {
        let (health, before) = (&report.health, &self.report.health);
        self.bytes_per_s = health.bytes_in.saturating_sub(before.bytes_in) as f64;
        self.frames_per_s = health.frames_in.saturating_sub(before.frames_in) as f64;
        self.report = report;
    }
}

impl LiveView {
    /// A block for a run whose progress is known, or not.
    #[must_use]
    pub fn new(progress: Option<watch::Receiver<f64>>) -> Self {
        let bar = ProgressBar::with_draw_target(Some(BAR_STEPS), ProgressDrawTarget::stderr());
        let template = match progress {
            Some(_) => "{msg}\n  {wide_bar} {percent:>3} %",
            None => "{msg}",
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        Self {
            bar,
            progress,
            off: None,
            now: Stamp::ZERO,
            written: Stamp::ZERO,
            links: BTreeMap::new(),
            clock: None,
            estimate: None,
            last_fix: None,
            thermometers: BTreeMap::new(),
            voice: Voice::Speaking,
            repeats: Repeats::default(),
        }
    }

    /// The same for a robot whose true place is known.
    #[must_use]
    pub fn with_truth(mut self, off: Option<Off>) -> Self {
        self.off = off;
        self
    }

    /// A block that says nothing, for measurements.
    #[must_use]
    pub fn silent() -> Self {
        Self { voice: Voice::Silent, ..Self::new(None) }
    }

    /// Takes an event.
    pub fn take(&mut self, now: Stamp<HostClock>, event: &Event) {
        self.now = now;
        match event {
            Event::Link { link, state } => self.links.entry(*link).or_default().state = *state,
            Event::Health { link, health, sources } => {
                self.links.entry(*link).or_default().take(LinkReport { health: *health, sources: sources.clone() })
            }
            Event::BrickClockAligned { offset, skew_ppm, uncertainty, .. } => {
                self.clock = Some((*offset, *skew_ppm, *uncertainty));
            }
            Event::Fused { record, .. } if record.kind == "fix" => {
                self.last_fix = Some((record.verdict, record.lag));
            }
            Event::Estimated { estimate, .. } => {
                self.estimate = Some(*estimate);
                if let Some(off) = &mut self.off {
                    off.note(estimate);
                }
            }
            Event::Temperature { brick, channel, shown, settled, .. } => {
                self.thermometers.insert((*brick, *channel), (*shown, *settled));
            }
            Event::RobotSeen { robot } => self.say(&format!("heard {robot}")),
            Event::RobotLost { robot, silence } => {
                self.say(&format!("lost {robot}, silent for {:.1} s", silence.as_secs_f64()));
            }
            Event::BrickRestarted { robot } => self.say(&format!("{robot} was restarted: clock and counters re-based")),
            Event::Text { source, text, .. } => self.say(&format!("{source} says: {text}")),
            Event::Fused { .. } | Event::Observed { .. } | Event::CameraClockAligned { .. } | Event::Defect { .. } => {}
        }
    }

    /// Draws the block, or without a terminal a line now and then.
    pub fn draw(&mut self) {
        if let Some(repeated) = self.repeats.due(self.now) {
            self.print(&repeated);
        }
        if self.voice == Voice::Silent {
            return;
        }
        if self.bar.is_hidden() {
            self.write_plainly();
            return;
        }
        if let Some(progress) = &self.progress {
            let share = (*progress.borrow()).clamp(0.0, 1.0);
            self.bar.set_position((share * BAR_STEPS as f64) as u64);
        }
        let off = self.off_line();
        let off = off.map_or_else(String::new, |line| format!("\n  {line}"));
        self.bar.set_message(self.block() + &off);
    }

    /// A line now and then, for who reads no block.
    fn write_plainly(&mut self) {
        let period = match self.off {
            Some(_) => OFF_PERIOD,
            None => PLAIN_PERIOD,
        };
        if self.now - self.written < period {
            return;
        }
        self.written = self.now;
        match self.off_line() {
            Some(line) => say(&line),
            None => say(&self.block().replace('\n', " |")),
        }
    }

    fn off_line(&mut self) -> Option<String> {
        self.off.as_mut()?.line()
    }

    /// Takes the block away.
    pub fn finish(&self) {
        if let Some(repeated) = self.repeats.held() {
            self.print(&repeated);
        }
        self.bar.finish_and_clear();
    }

    /// Says a line, and of one that comes again and again how often.
    fn say(&mut self, line: &str) {
        let shown = self.repeats.take(self.now, line);
        if let Some(repeated) = shown.before {
            self.print(&repeated);
        }
        if shown.is_shown {
            self.print(line);
        }
    }

    fn print(&self, line: &str) {
        if self.voice == Voice::Silent {
            return;
        }
        if self.bar.is_hidden() {
            say(line);
        } else {
            self.bar.println(line);
        }
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
        match &self.estimate {
            Some(estimate) => block.push_str(&pose_line(estimate)),
            None => block.push_str("\n  pose  unknown"),
        }
        match self.last_fix {
            Some((verdict, lag)) => {
                let _ = write!(block, "   fix {} {:.0} ms late", verdict.reason(), lag.as_millis_f64());
            }
            None => block.push_str("   no fix yet"),
        }
        for ((brick, channel), (shown, settled)) in &self.thermometers {
            block.push_str(&thermometer_line(*brick, *channel, *shown, *settled));
        }
        block
    }
}

/// What a thermometer shows, what it will show in the end, and the bound that holds that with 95 %.
fn thermometer_line(brick: RobotId, channel: ChannelName, shown: Celsius, settled: Option<ScalarEstimate>) -> String {
    let place = brick.address;
    let settled = settled
        .map_or_else(|| "unknown".to_owned(), |settled| format!("{:.2} ± {:.2} °C", settled.value, settled.bound_95()));
    format!("\n  {channel} of {place}  {:.2} °C -> {settled}", shown.0)
}

fn pose_line(estimate: &Estimate) -> String {
    let flag = if estimate.is_dead_reckoning { "  dead reckoning" } else { "" };
    format!(
        "\n  pose  x {:.3} ± {:.3} m   y {:.3} ± {:.3} m   heading {:.1} ± {:.1} deg{flag}",
        estimate.pose.x.0,
        estimate.x_sigma_m(),
        estimate.pose.y.0,
        estimate.y_sigma_m(),
        estimate.pose.heading.rad().to_degrees(),
        estimate.heading_sigma_rad().to_degrees(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::Address;

    #[test]
    fn a_thermometer_has_a_line_of_its_own_with_the_bound_of_its_end() {
        let mut view = LiveView::silent();
        let brick = RobotId { link: LinkId(0), address: Address::new(7, 158) };
        for (shown, settled) in [(20.0, None), (36.2, Some((48.7, 0.306)))] {
            let settled = settled.map(|(value, sigma)| ScalarEstimate {
                stamp: Stamp::ZERO,
                value,
                sigma,
                rate_per_s: 0.0,
                unit: "°C",
            });
            let event = Event::Temperature {
                brick,
                channel: ChannelName::from_bytes(b"temp1"),
                arrival: Stamp::ZERO,
                stamp: Stamp::ZERO,
                shown: Celsius(shown),
                verdict: Verdict::Accepted,
                settled,
            };
            view.take(Stamp::ZERO, &event);
            let expected = match settled {
                None => "\n  temp1 of 7/158  20.00 °C -> unknown",
                Some(_) => "\n  temp1 of 7/158  36.20 °C -> 48.70 ± 0.60 °C",
            };
            assert!(view.block().ends_with(expected), "{}", view.block());
        }
    }
}
