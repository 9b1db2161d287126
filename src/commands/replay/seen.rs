//! What a replay keeps of an estimator's events: for tables, for a file, and for the eye.

use std::fs::File;
use std::io::BufWriter;

use anyhow::{Context, Result};
use posebridge_telemetry::{Event, HostClock, Span, Stamp};

use super::watch::Watch;
use crate::collect::Collector;
use crate::report::live::LiveView;
use crate::tasks::observer::write_event;

/// The status block is drawn this often, by the clock of the recording at its real speed.
const DRAW_PERIOD_S: f64 = 0.2;

/// Watches one estimator.
pub(super) struct Seen<'e> {
    collector: Collector,
    /// Every event goes there as a line of text.
    pub(super) events: Option<&'e mut BufWriter<File>>,
    view: Option<View>,
}

/// The status block of a replay that somebody watches.
struct View {
    shown: LiveView,
    period: Span,
    drawn: Stamp<HostClock>,
}

impl Seen<'_> {
    /// One that keeps what tables need.
    pub(super) fn new(collector: Collector) -> Self {
        Self { collector, events: None, view: None }
    }

    /// Shows the status block of a live run if the replay has a speed.
    pub(super) fn show_at(&mut self, speed: Option<f64>) {
        self.view = speed.map(|speed| View {
            shown: LiveView::new(None),
            period: Span::from_secs_f64(DRAW_PERIOD_S * speed),
            drawn: Stamp::ZERO,
        });
    }

    /// What it kept.
    pub(super) fn finish(self) -> Collector {
        if let Some(View { shown, .. }) = self.view {
            shown.finish();
        }
        self.collector
    }
}

impl Watch for Seen<'_> {
    fn event(&mut self, now: Stamp<HostClock>, event: &Event) -> Result<()> {
        self.collector.take(event);
        if let Some(file) = self.events.as_deref_mut() {
            write_event(file, event).context("writing the events")?;
        }
        if let Some(view) = &mut self.view {
            view.shown.take(now, event);
            if now - view.drawn >= view.period {
                view.shown.draw();
                view.drawn = now;
            }
        }
        Ok(())
    }
}
