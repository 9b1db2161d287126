//! What a replay keeps of an estimator's events: for tables, for a file, and for the eye.

use std::fs::File;
use std::io::BufWriter;

use anyhow::{Context, Result};
use posebridge_telemetry::{Event, HostClock, TimeDelta, Timestamp};

use super::watch::EventWatcher;
use crate::station::event_collector::EventCollector;
use crate::station::live_status::LiveView;
use crate::station::observer::write_event;
use crate::station::per_robot::PerRobot;

/// The status block is drawn this often, by the clock of the recording at its real speed.
const DRAW_PERIOD_S: f64 = 0.2;

/// Watches one estimator.
pub(super) struct ReplayWatcher<'e> {
    collectors: PerRobot<EventCollector>,
    /// Every event goes there as a line of text.
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
    /// One that keeps what tables need.
    pub(super) fn new(collectors: PerRobot<EventCollector>) -> Self {
        Self { collectors, events: None, view: None }
    }

    /// Shows the status block of a live run if the replay has a speed.
    pub(super) fn show_at(&mut self, speed: Option<f64>) {
        self.view = speed.map(|speed| TimedView {
            live: LiveView::new(None),
            period: TimeDelta::from_secs_f64(DRAW_PERIOD_S * speed),
            last_drawn: Timestamp::ZERO,
        });
    }

    /// What it kept.
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
