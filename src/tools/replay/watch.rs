//! Evaluated window and pace of a replay, observers of its events, and their files.

use std::fs::File;
use std::io::{BufWriter, Write as _};

use anyhow::{Context, Result, ensure};
use posebridge_link::HostTimer;
use posebridge_report::{FIGURES, PoseTrack, RunLayers};
use posebridge_station::RecordedStations;
use posebridge_telemetry::{Event, HostClock, Input, Output, TimeDelta, Timestamp};

use super::result::ReplayArgs;
use crate::flags::SessionFlags;
use crate::station::event_collector::EventCollector;
use crate::station::event_file::write_event;
use crate::station::live_status::LiveView;
use crate::station::per_robot::PerRobot;

/// Observes the events of one estimator's stations.
pub trait EventWatcher {
    /// An event caused by the input at `now`.
    fn observe(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<()>;
    /// Called after all events of the input at `now`.
    fn after_input(&mut self, _now: Timestamp<HostClock>, _stations: &RecordedStations) {}
}

/// For callers that need only tracks and counts.
impl EventWatcher for EventCollector {
    fn observe(&mut self, _now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        self.on_event(event);
        Ok(())
    }
}

impl EventWatcher for PerRobot<EventCollector> {
    fn observe(&mut self, _now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        self.push(event, EventCollector::on_event);
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowPosition {
    /// Before the window: only the filter gets it.
    Before,
    Within,
    After,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    /// Since the first input.
    from: Option<TimeDelta>,
    /// Since the first input.
    to: Option<TimeDelta>,
}

impl Window {
    pub fn from_flags(flags: &SessionFlags) -> Result<Self> {
        if let (Some(from), Some(to)) = (flags.from, flags.to) {
            ensure!(from < to, "--from {from} does not lie before --to {to}: nothing would be left");
        }
        Ok(Self { from: flags.from.map(TimeDelta::from_secs_f64), to: flags.to.map(TimeDelta::from_secs_f64) })
    }

    pub fn is_unbounded(self) -> bool {
        self == Self::default()
    }

    /// `elapsed` is the time since the first input.
    pub fn position(self, elapsed: TimeDelta) -> WindowPosition {
        if self.to.is_some_and(|to| elapsed > to) {
            WindowPosition::After
        } else if self.from.is_some_and(|from| elapsed < from) {
            WindowPosition::Before
        } else {
            WindowPosition::Within
        }
    }
}

pub struct ReplayPacer {
    runtime: tokio::runtime::Runtime,
    timer: HostTimer,
    speed: f64,
    start: Timestamp<HostClock>,
}

impl ReplayPacer {
    pub fn new(speed: f64) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        let timer = HostTimer::start();
        Ok(Self { runtime, timer, speed, start: timer.now() })
    }

    pub fn restart(&mut self) {
        self.start = self.timer.now();
    }

    /// Waits until this part of the recording is due.
    pub fn wait(&self, elapsed: TimeDelta) {
        let due = self.start + TimeDelta::from_secs_f64(elapsed.as_secs_f64() / self.speed);
        if due > self.timer.now() {
            self.runtime.block_on(self.timer.sleep_until(due));
        }
    }
}

pub struct ReplayLane<'w> {
    pub stations: RecordedStations,
    pub watcher: &'w mut dyn EventWatcher,
}

impl ReplayLane<'_> {
    pub fn push(&mut self, now: Timestamp<HostClock>, input: &Input, position: WindowPosition) -> Result<()> {
        self.stations.handle(now, input);
        while let Some(output) = &self.stations.poll() {
            if let (Output::Event(event), WindowPosition::Within) = (output, position) {
                self.watcher.observe(now, event)?;
            }
        }
        if position == WindowPosition::Within {
            self.watcher.after_input(now, &self.stations);
        }
        Ok(())
    }
}

/// Draw period of the status block, in recording time at real speed.
const DRAW_PERIOD_S: f64 = 0.2;

pub(super) struct ReplayWatcher<'e> {
    collectors: PerRobot<EventCollector>,
    /// Receives every event as a line of text.
    pub(super) events: Option<&'e mut BufWriter<File>>,
    view: Option<TimedView>,
}

/// The status block of a replay with `--speed`.
struct TimedView {
    live: LiveView,
    period: TimeDelta,
    last_drawn: Timestamp<HostClock>,
}

impl ReplayWatcher<'_> {
    pub(super) fn new(collectors: PerRobot<EventCollector>) -> Self {
        Self { collectors, events: None, view: None }
    }

    /// Shows the status block of a live run if the replay has a speed.
    pub(super) fn show_at(&mut self, speed: Option<f64>) {
        self.view = speed.map(|speed| TimedView {
            live: LiveView::new(None, Vec::new()),
            period: TimeDelta::from_secs_f64(DRAW_PERIOD_S * speed),
            last_drawn: Timestamp::ZERO,
        });
    }

    pub(super) fn finish(self) -> PerRobot<EventCollector> {
        if let Some(TimedView { live: shown, .. }) = self.view {
            shown.finish();
        }
        self.collectors
    }
}

impl EventWatcher for ReplayWatcher<'_> {
    fn observe(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        self.collectors.push(event, EventCollector::on_event);
        if let Some(file) = self.events.as_deref_mut() {
            write_event(file, event).context("writing the events")?;
        }
        if let Some(view) = &mut self.view {
            view.live.on_event(now, event);
            if now - view.last_drawn >= view.period {
                view.live.draw();
                view.last_drawn = now;
            }
        }
        Ok(())
    }
}

/// Flushes explicitly: dropping a writer does not report a full disk.
pub(super) fn finish_events(mut events: BufWriter<File>) -> Result<()> {
    events.flush().context("writing the events")
}

#[derive(Clone, Copy, Default)]
pub(super) struct ReferenceTracks<'a> {
    pub(super) truth: Option<&'a PoseTrack>,
    pub(super) odometry: Option<&'a PoseTrack>,
    pub(super) smoothed: Option<&'a PoseTrack>,
}

pub(super) fn write_charts(
    args: &ReplayArgs,
    title: &str,
    collector: &EventCollector,
    tracks: ReferenceTracks<'_>,
) -> Result<()> {
    let (Some(path), Some(figure)) = (&args.figure, FIGURES.first()) else {
        return Ok(());
    };
    let ReferenceTracks { truth, odometry, smoothed } = tracks;
    let compared = collector.compared_tracks();
    let layers = RunLayers {
        title,
        compared: &compared,
        truth,
        odometry,
        estimates: collector.estimates.items(),
        fixes: collector.fixes.items(),
        smoothed,
        ..RunLayers::default()
    };
    std::fs::write(path, (figure.render)(&layers)).with_context(|| format!("writing `{}`", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn position(window: Window, elapsed_s: f64) -> WindowPosition {
        window.position(TimeDelta::from_secs_f64(elapsed_s))
    }

    #[test]
    fn a_window_holds_both_of_its_ends_and_without_ends_everything() {
        let window = Window { from: Some(TimeDelta::from_millis(1_000)), to: Some(TimeDelta::from_millis(2_000)) };
        let positions = [0.999, 1.0, 2.0, 2.001].map(|elapsed_s| position(window, elapsed_s));
        assert_eq!(
            positions,
            [WindowPosition::Before, WindowPosition::Within, WindowPosition::Within, WindowPosition::After]
        );
        assert_eq!(position(Window::default(), 1e6), WindowPosition::Within);
    }
}
