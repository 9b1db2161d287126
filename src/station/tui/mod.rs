//! The terminal view: the content of the dashboard page, for users on ssh (docs/dashboard.md).
//!
//! It receives the messages of the page through a channel that drops and counts ([`FrameTap`]), and sends commands like the page. A
//! pure function converts a [`Model`] to the cells of the screen ([`render::render`]); [`tty`] takes the terminal, never waits for it,
//! and restores it: at the end, after an error, and on a panic.

mod arena;
mod fleet_panel;
pub mod keys;
pub mod model;
pub mod panels;
pub mod render;
pub mod theme;
pub mod tty;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use posebridge_dashboard::model::SimulatorFacts;
use posebridge_dashboard::views::parse_robot_name;
use posebridge_dashboard::{CommandSubmitter, FleetSource, FrameTap, TapPoll};
use posebridge_telemetry::{Command, RobotId};
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::queue;
use ratatui::crossterm::terminal::{Clear, ClearType};
use ratatui::layout::Rect;
use ratatui::{Terminal, TerminalOptions, Viewport};
use tokio_util::sync::CancellationToken;

use self::keys::{CameraState, KeyPress, OperatorAction, UiAction, action_of};
use self::model::Model;
use self::panels::PANELS;
use self::render::render;
use self::theme::Theme;
use self::tty::{TerminalWriter, Tty};
use crate::console::{redirect_stderr, restore_stderr};

/// Queued messages: a bit more than a second; the view polls twenty times a second.
pub const WAITING_FRAMES: usize = 64;
/// Redraw period and timeout of waiting for a key: twenty frames a second suffice for numbers.
const DRAW_PERIOD_MILLIS: u16 = 50;
/// What a pose is written with, and how long it may be.
const POSE_LETTERS: &str = "0123456789.-+, ";
const MAX_POSE_LETTERS: usize = 40;
const TOO_MANY_COMMANDS: &str = "too many commands wait; try again";
/// Messages of the program read between two frames.
const MAX_LINES: usize = 256;

pub struct TerminalInputs {
    pub frames: FrameTap,
    pub commands: CommandSubmitter,
    pub quit: CancellationToken,
    /// `None` without an embedded simulated brick.
    pub simulator: Option<SimulatorFacts>,
    /// `None` for a station that is in no fleet.
    pub fleet: Option<FleetSource>,
    pub greeting: String,
}

/// Owns the terminal; restores it when dropped.
pub struct TerminalView {
    tty: Arc<Tty>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl TerminalView {
    pub fn start(inputs: TerminalInputs) -> Result<Self> {
        let no_color = std::env::var_os("NO_COLOR");
        let theme = Theme::from_env(no_color.as_deref());
        let tty = Tty::open()?;
        restore_on_panic(&tty, restore_stderr);
        let log_lines = redirect_stderr();
        let is_over = Arc::new(AtomicBool::new(false));
        let mut view = Self { tty: Arc::clone(&tty), is_over: Arc::clone(&is_over), thread: None };
        let screen = Screen::new(Arc::clone(&tty), theme)?;
        let mut model = Model::new(inputs.simulator.clone());
        model.push_message(&inputs.greeting);
        let work = TerminalLoop { tty, screen, model, inputs, log_lines, is_over };
        let thread = std::thread::Builder::new().name("terminal".to_owned());
        view.thread = Some(thread.spawn(move || work.run()).context("starting the terminal view's thread")?);
        Ok(view)
    }
}

impl Drop for TerminalView {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        let ended = self.thread.take().map(JoinHandle::join);
        self.tty.restore();
        restore_stderr();
        if let Some(Err(_panic)) = ended {
            tracing::error!("the terminal view's thread died");
        }
    }
}

/// Restores the screen before a panic message, after the retained messages that `print_rest` prints.
fn restore_on_panic(tty: &Arc<Tty>, print_rest: fn()) {
    let tty = Arc::downgrade(tty);
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if let Some(tty) = tty.upgrade() {
            tty.restore();
            print_rest();
        }
        before(panic);
    }));
}

struct TerminalLoop {
    tty: Arc<Tty>,
    screen: Screen,
    model: Model,
    inputs: TerminalInputs,
    log_lines: Receiver<String>,
    is_over: Arc<AtomicBool>,
}

impl TerminalLoop {
    fn run(mut self) {
        while !self.is_over.load(Ordering::SeqCst) {
            if let Err(error) = self.step() {
                // The run goes on: a robot may steer by it.
                self.tty.restore();
                restore_stderr();
                tracing::warn!("there is no terminal view any more: {error:#}");
                return;
            }
        }
    }

    /// Draws once, then waits for a key for one frame period.
    fn step(&mut self) -> Result<()> {
        while let TapPoll::Frame(frame) = self.inputs.frames.try_recv() {
            self.model.on_frame(&frame);
        }
        if let Some(fleet) = &self.inputs.fleet
            && self.model.is_fleet_due()
        {
            self.model.set_fleet((fleet.state)());
        }
        self.model.missed = self.inputs.frames.missed();
        for line in self.log_lines.try_iter().take(MAX_LINES) {
            self.model.push_message(&line);
        }
        self.screen.show(&self.model)?;
        let input = self.tty.read(DRAW_PERIOD_MILLIS)?;
        for key_press in keys::parse_key_presses(&input) {
            if self.model.selection.typed_pose.is_some() {
                self.type_pose(key_press);
            } else if let Some(action) = action_of(key_press) {
                self.apply(action);
            }
        }
        Ok(())
    }

    fn apply(&mut self, action: UiAction) {
        match action {
            UiAction::Quit => {
                self.model.set_notice("ending the run");
                self.inputs.quit.cancel();
            }
            UiAction::Do(action) => self.execute(action),
            UiAction::TypePose => self.model.selection.typed_pose = Some(String::new()),
            UiAction::NextPanel
            | UiAction::PreviousPanel
            | UiAction::NextRobot
            | UiAction::PreviousRobot
            | UiAction::Help
            | UiAction::Back => choose(&mut self.model, action),
        }
    }

    /// A key while a pose is typed.
    fn type_pose(&mut self, key_press: KeyPress) {
        let Some(mut typed) = self.model.selection.typed_pose.take() else { return };
        match key_press {
            KeyPress::Interrupt => self.apply(UiAction::Quit),
            KeyPress::Enter => self.set_pose(&typed),
            KeyPress::Letter(letter) => {
                if POSE_LETTERS.contains(letter) && typed.len() < MAX_POSE_LETTERS {
                    typed.push(letter);
                }
                self.model.selection.typed_pose = Some(typed);
            }
            KeyPress::Backspace => {
                typed.pop();
                self.model.selection.typed_pose = Some(typed);
            }
            KeyPress::Escape
            | KeyPress::Tab
            | KeyPress::BackTab
            | KeyPress::Up
            | KeyPress::Down
            | KeyPress::Left
            | KeyPress::Right => {}
        }
    }

    fn set_pose(&mut self, typed: &str) {
        let notice = match Command::parse_pose(typed) {
            Err(_) => "no pose: type x and y in metres and the heading in degrees",
            Ok(pose) if self.inputs.commands.send(self.commanded_robot(), Command::set_pose_by_eye(pose)) => {
                "the pose is sent"
            }
            Ok(_) => TOO_MANY_COMMANDS,
        };
        self.model.set_notice(notice);
    }

    /// One robot needs no name, and a recording of it is as ever.
    fn commanded_robot(&self) -> Option<RobotId> {
        let id = &self.model.selected_robot()?.id;
        if self.model.visible_robots().len() > 1 { parse_robot_name(id) } else { None }
    }

    fn execute(&mut self, action: OperatorAction) {
        if self.model.simulator.is_none() {
            self.model.set_notice("this station has no simulated brick");
            return;
        }
        let id = self.model.selected_robot().map_or_else(String::new, |robot| robot.id.clone());
        let covered = &self.model.selection.covered_cameras;
        let camera = if covered.contains(&id) { CameraState::Covered } else { CameraState::Open };
        if !self.inputs.commands.send(self.commanded_robot(), action.command(camera)) {
            self.model.set_notice(TOO_MANY_COMMANDS);
            return;
        }
        self.model.set_notice(action.description(camera));
        if action == OperatorAction::Camera {
            let covered = &mut self.model.selection.covered_cameras;
            if !covered.remove(&id) {
                covered.insert(id);
            }
        }
    }
}

pub fn choose(model: &mut Model, action: UiAction) {
    let robots = model.visible_robots().len().max(1);
    let chosen = &mut model.selection;
    // All together come before the first panel and behind the last.
    let slots = PANELS.len() + 1;
    let slot = chosen.panel.map_or(0, |panel| panel + 1);
    let panel_at = |slot: usize| (slot % slots).checked_sub(1);
    match action {
        UiAction::NextPanel => chosen.panel = panel_at(slot + 1),
        UiAction::PreviousPanel => chosen.panel = panel_at(slot + slots - 1),
        UiAction::NextRobot => chosen.robot = (chosen.robot + 1) % robots,
        UiAction::PreviousRobot => chosen.robot = (chosen.robot + robots - 1) % robots,
        UiAction::Help => chosen.has_help = !chosen.has_help,
        UiAction::Back if chosen.has_help => chosen.has_help = false,
        UiAction::Back => chosen.panel = None,
        UiAction::Quit | UiAction::TypePose | UiAction::Do(_) => {}
    }
}

#[cfg(test)]
mod tests;

/// A terminal with its content, so that only changes are sent.
struct Screen {
    tty: Arc<Tty>,
    theme: Theme,
    terminal: Terminal<CrosstermBackend<TerminalWriter>>,
    area: Rect,
}

impl Screen {
    fn new(tty: Arc<Tty>, theme: Theme) -> Result<Self> {
        let area = tty.area()?;
        let terminal = blank(&tty, area)?;
        Ok(Self { tty, theme, terminal, area })
    }

    /// Draws a model, unless the terminal has not accepted all of the last frame yet.
    fn show(&mut self, model: &Model) -> Result<()> {
        if !self.tty.drain()? {
            return Ok(());
        }
        let area = self.tty.area()?;
        if area != self.area {
            self.terminal = blank(&self.tty, area)?;
            self.area = area;
        }
        let theme = self.theme;
        self.terminal.draw(|frame| {
            let area = frame.area();
            render(model, theme, area, frame.buffer_mut());
        })?;
        self.tty.drain()?;
        Ok(())
    }
}

fn blank(tty: &Arc<Tty>, area: Rect) -> Result<Terminal<CrosstermBackend<TerminalWriter>>> {
    let mut writer = TerminalWriter(Arc::clone(tty));
    queue!(writer, Clear(ClearType::All))?;
    let options = TerminalOptions { viewport: Viewport::Fixed(area) };
    Ok(Terminal::with_options(CrosstermBackend::new(writer), options)?)
}
