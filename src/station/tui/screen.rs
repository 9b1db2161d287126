//! What is drawn, on its way to the terminal.

use anyhow::Result;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::queue;
use ratatui::crossterm::terminal::{Clear, ClearType};
use ratatui::layout::Rect;
use ratatui::{Terminal, TerminalOptions, Viewport};

use std::sync::Arc;

use super::model::Model;
use super::render::render;
use super::theme::Theme;
use super::tty::{TerminalWriter, Tty};

/// A terminal with what it shows, so that only what changes is sent.
pub(super) struct Screen {
    tty: Arc<Tty>,
    look: Theme,
    terminal: Terminal<CrosstermBackend<TerminalWriter>>,
    area: Rect,
}

impl Screen {
    /// One that shows nothing yet.
    ///
    /// # Errors
    /// The terminal does not say how large it is.
    pub(super) fn new(tty: Arc<Tty>, look: Theme) -> Result<Self> {
        let area = tty.area()?;
        let terminal = blank(&tty, area)?;
        Ok(Self { tty, look, terminal, area })
    }

    /// Shows a model, unless the terminal has not taken all of the last picture yet.
    ///
    /// # Errors
    /// The terminal is gone.
    pub(super) fn show(&mut self, model: &Model) -> Result<()> {
        if !self.tty.drain()? {
            return Ok(());
        }
        let area = self.tty.area()?;
        if area != self.area {
            self.terminal = blank(&self.tty, area)?;
            self.area = area;
        }
        let look = self.look;
        self.terminal.draw(|frame| {
            let area = frame.area();
            render(model, look, area, frame.buffer_mut());
        })?;
        self.tty.drain()?;
        Ok(())
    }
}

/// An empty screen of this size.
fn blank(tty: &Arc<Tty>, area: Rect) -> Result<Terminal<CrosstermBackend<TerminalWriter>>> {
    let mut paper = TerminalWriter(Arc::clone(tty));
    queue!(paper, Clear(ClearType::All))?;
    let options = TerminalOptions { viewport: Viewport::Fixed(area) };
    Ok(Terminal::with_options(CrosstermBackend::new(paper), options)?)
}
