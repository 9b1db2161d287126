//! The terminal view: what the page shows, for people on ssh (docs/terminal.md).
//!
//! It is fed with the messages of the page through a channel that drops and counts ([`FrameTap`]), and gives its commands by the same way
//! as the page. From a [`Model`] to the cells of the screen goes a pure function ([`render::render`]); [`tty`] takes the terminal, never
//! waits for it, and gives it back as it was: at the end, after an error, and when something panics.

pub mod hands;
pub mod keys;
pub mod look;
pub mod model;
pub mod panels;
pub mod render;
mod screen;
pub mod tty;
mod words;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use posebridge_dashboard::model::SimulatorFacts;
use posebridge_dashboard::{Commander, Found, FrameTap};
use tokio_util::sync::CancellationToken;

use self::hands::{Camera, Deed};
use self::keys::{Action, action_of};
use self::look::Look;
use self::model::Model;
use self::panels::PANELS;
use self::screen::Screen;
use self::tty::Tty;
use crate::stderr;

/// So many messages wait for the view, a bit more than a second of them; it looks twenty times a second.
pub const WAITING_FRAMES: usize = 64;
/// A key is waited for so long before the screen is drawn anew: twenty pictures a second are more than an eye needs for numbers.
const DRAW_PERIOD_MILLIS: u16 = 50;
/// So many lines of the program are taken between two pictures.
const MOST_LINES: usize = 256;

/// What the view is connected to.
pub struct Wires {
    /// What happens.
    pub frames: FrameTap,
    /// What is asked for.
    pub commands: Commander,
    /// Cancelled when a person ends the run.
    pub quit: CancellationToken,
    /// The simulated brick, if the station has one of its own.
    pub simulator: Option<SimulatorFacts>,
    /// The first line among the events.
    pub greeting: String,
}

/// A view that has the terminal. It gives it back when it is dropped.
pub struct TerminalView {
    tty: Arc<Tty>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl TerminalView {
    /// Takes the terminal and starts the thread that draws.
    ///
    /// # Errors
    /// The terminal cannot be taken, or the thread cannot be started.
    pub fn start(wires: Wires) -> Result<Self> {
        let no_color = std::env::var_os("NO_COLOR");
        let look = Look::of_environment(no_color.as_deref());
        let tty = Tty::take()?;
        give_back_on_panic(&tty, stderr::give_back);
        let said = stderr::divert();
        let is_over = Arc::new(AtomicBool::new(false));
        let mut view = Self { tty: Arc::clone(&tty), is_over: Arc::clone(&is_over), thread: None };
        let screen = Screen::new(Arc::clone(&tty), look)?;
        let mut model = Model::new(wires.simulator.clone());
        model.say(&wires.greeting);
        let work = Work { tty, screen, model, wires, said, is_over };
        let thread = std::thread::Builder::new().name("terminal".to_owned());
        view.thread = Some(thread.spawn(move || work.run()).context("starting the terminal view's thread")?);
        Ok(view)
    }
}

impl Drop for TerminalView {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        let ended = self.thread.take().map(JoinHandle::join);
        self.tty.give_back();
        stderr::give_back();
        if let Some(Err(_panic)) = ended {
            tracing::error!("the terminal view's thread died");
        }
    }
}

/// A message about a panic belongs on the screen as it was, behind what was said before, which `say_rest` says.
fn give_back_on_panic(tty: &Arc<Tty>, say_rest: fn()) {
    let tty = Arc::downgrade(tty);
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if let Some(tty) = tty.upgrade() {
            tty.give_back();
            say_rest();
        }
        before(panic);
    }));
}

/// What the thread does.
struct Work {
    tty: Arc<Tty>,
    screen: Screen,
    model: Model,
    wires: Wires,
    said: Receiver<String>,
    is_over: Arc<AtomicBool>,
}

impl Work {
    fn run(mut self) {
        while !self.is_over.load(Ordering::SeqCst) {
            if let Err(error) = self.once() {
                // The run goes on: a robot may steer by it.
                self.tty.give_back();
                stderr::give_back();
                tracing::warn!("there is no terminal view any more: {error:#}");
                return;
            }
        }
    }

    /// Draws once, then waits for a key as long as a picture lasts.
    fn once(&mut self) -> Result<()> {
        while let Found::Frame(frame) = self.wires.frames.look() {
            self.model.take(&frame);
        }
        self.model.missed = self.wires.frames.missed();
        for line in self.said.try_iter().take(MOST_LINES) {
            self.model.say(&line);
        }
        self.screen.show(&self.model)?;
        let heard = self.tty.hear(DRAW_PERIOD_MILLIS)?;
        for action in keys::strokes(&heard).into_iter().filter_map(action_of) {
            self.act(action);
        }
        Ok(())
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Quit => {
                self.model.note("ending the run");
                self.wires.quit.cancel();
            }
            Action::Do(deed) => self.carry_out(deed),
            Action::NextPanel
            | Action::PreviousPanel
            | Action::NextRobot
            | Action::PreviousRobot
            | Action::Help
            | Action::Back => choose(&mut self.model, action),
        }
    }

    fn carry_out(&mut self, deed: Deed) {
        if self.model.simulator.is_none() {
            self.model.note("this station has no simulated brick");
            return;
        }
        let camera = if self.model.chosen.is_camera_covered { Camera::Covered } else { Camera::Open };
        if !self.wires.commands.give(deed.command(camera)) {
            self.model.note("too many commands wait; try again");
            return;
        }
        self.model.note(deed.words(camera));
        if deed == Deed::Camera {
            let chosen = &mut self.model.chosen;
            chosen.is_camera_covered = !chosen.is_camera_covered;
        }
    }
}

/// Chooses what is shown.
pub fn choose(model: &mut Model, action: Action) {
    let robots = model.shown().len().max(1);
    let chosen = &mut model.chosen;
    // All together come before the first panel and behind the last.
    let places = PANELS.len() + 1;
    let place = chosen.panel.map_or(0, |panel| panel + 1);
    let panel_at = |place: usize| (place % places).checked_sub(1);
    match action {
        Action::NextPanel => chosen.panel = panel_at(place + 1),
        Action::PreviousPanel => chosen.panel = panel_at(place + places - 1),
        Action::NextRobot => chosen.robot = (chosen.robot + 1) % robots,
        Action::PreviousRobot => chosen.robot = (chosen.robot + robots - 1) % robots,
        Action::Help => chosen.has_help = !chosen.has_help,
        Action::Back if chosen.has_help => chosen.has_help = false,
        Action::Back => chosen.panel = None,
        Action::Quit | Action::Do(_) => {}
    }
}

#[cfg(test)]
mod tests;
