//! Which part of a recording counts, how fast it is given, and who sees what the engine makes of it.

use anyhow::{Result, ensure};
use posebridge_link::HostTimer;
use posebridge_pipeline::Pipeline;
use posebridge_telemetry::{Event, HostClock, Input, Output, Span, Stamp};

use crate::cli::SessionFlags;
use crate::collect::Collector;

/// Sees what one estimator's pipeline does.
pub trait Watch {
    /// Something happened when the input of `now` was handled.
    ///
    /// # Errors
    /// It cannot be kept.
    fn event(&mut self, now: Stamp<HostClock>, event: &Event) -> Result<()>;
    /// All that follows from the input of `now` has happened.
    fn handled(&mut self, _now: Stamp<HostClock>, _pipeline: &Pipeline) {}
}

/// For who needs no more than tracks and tallies.
impl Watch for Collector {
    fn event(&mut self, _now: Stamp<HostClock>, event: &Event) -> Result<()> {
        self.take(event);
        Ok(())
    }
}

/// Whether anybody sees what happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Before the part that counts: the filter needs it, nobody else does.
    Before,
    /// Within it.
    Within,
    /// Behind it.
    Behind,
}

/// The part of a recording that counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    /// Behind the first input.
    from: Option<Span>,
    /// Behind the first input.
    to: Option<Span>,
}

impl Window {
    /// What the flags say.
    ///
    /// # Errors
    /// It ends before it begins.
    pub fn of(flags: &SessionFlags) -> Result<Self> {
        if let (Some(from), Some(to)) = (flags.from, flags.to) {
            ensure!(from < to, "--from {from} does not lie before --to {to}: nothing would be left");
        }
        Ok(Self { from: flags.from.map(Span::from_secs_f64), to: flags.to.map(Span::from_secs_f64) })
    }

    /// Whether everything counts.
    pub fn is_whole(self) -> bool {
        self == Self::default()
    }

    /// Where an instant lies, by the time since the first input.
    pub fn place(self, elapsed: Span) -> Place {
        if self.to.is_some_and(|to| elapsed > to) {
            Place::Behind
        } else if self.from.is_some_and(|from| elapsed < from) {
            Place::Before
        } else {
            Place::Within
        }
    }
}

/// Waits until an input's turn has come.
pub struct Pace {
    runtime: tokio::runtime::Runtime,
    timer: HostTimer,
    speed: f64,
    start: Stamp<HostClock>,
}

impl Pace {
    /// One that begins when its first input does.
    ///
    /// # Errors
    /// The system gives no timer.
    pub fn new(speed: f64) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        let timer = HostTimer::start();
        Ok(Self { runtime, timer, speed, start: timer.now() })
    }

    /// The next run begins.
    pub fn restart(&mut self) {
        self.start = self.timer.now();
    }

    /// Waits until so much of the recording is due.
    pub fn wait(&self, elapsed: Span) {
        let due = self.start + Span::from_secs_f64(elapsed.as_secs_f64() / self.speed);
        if due > self.timer.now() {
            self.runtime.block_on(self.timer.sleep_until(due));
        }
    }
}

/// One estimator with its watcher.
pub struct Lane<'w> {
    /// The engine.
    pub pipeline: Pipeline,
    /// Who sees what it does.
    pub watch: &'w mut dyn Watch,
}

impl Lane<'_> {
    /// Gives an input.
    ///
    /// # Errors
    /// As the watcher says.
    pub fn give(&mut self, now: Stamp<HostClock>, input: &Input, place: Place) -> Result<()> {
        self.pipeline.handle(now, input);
        while let Some(output) = self.pipeline.peek() {
            match output {
                Output::Event(event) if place == Place::Within => self.watch.event(now, event)?,
                Output::Event(_) | Output::Transmit { .. } | Output::Request(_) => {}
            }
            self.pipeline.pass_over();
        }
        if place == Place::Within {
            self.watch.handled(now, &self.pipeline);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(window: Window, elapsed_s: f64) -> Place {
        window.place(Span::from_secs_f64(elapsed_s))
    }

    #[test]
    fn a_window_holds_both_of_its_ends_and_without_ends_everything() {
        let window = Window { from: Some(Span::from_millis(1_000)), to: Some(Span::from_millis(2_000)) };
        let places = [0.999, 1.0, 2.0, 2.001].map(|elapsed_s| place(window, elapsed_s));
        assert_eq!(places, [Place::Before, Place::Within, Place::Within, Place::Behind]);
        assert_eq!(place(Window::default(), 1e6), Place::Within);
    }
}
