//! The viewers of a running station: dashboard, terminal view, PlotJuggler. The station loop waits for none of them.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_dashboard::model::SimulatorFacts;
use posebridge_dashboard::{Dashboard, FrameTap, FrameTaps};
use posebridge_link::HostTimer;
use tokio_util::sync::CancellationToken;

use super::args::RunArgs;
use super::dashboard::{self, DashboardHandle, ReservedListener, SimulatedBrickInfo};
use super::links::EmbeddedLink;
use super::plotjuggler::{self, PlotJuggler, SendCounts};
use super::simulator::EmbeddedBrick;
use super::tui::{self, TerminalInputs, TerminalView};
use crate::config::Config;
use crate::console::print_line;

#[derive(Default)]
pub(super) struct Viewers {
    terminal: Option<TerminalView>,
    plotjuggler: Option<PlotJuggler>,
    /// Dropped last, because its end ends the others.
    dashboard: Option<Dashboard>,
    quit: CancellationToken,
}

impl Viewers {
    /// Starts them; returns the station loop's end of the channels, if there are any.
    pub(super) fn start(
        reserved: Option<ReservedListener>,
        args: &RunArgs,
        config: &Config,
        timer: HostTimer,
        folder: &Path,
        embedded: Option<&EmbeddedLink>,
    ) -> Result<(Self, Option<DashboardHandle>)> {
        let simulated = embedded.map(|link| SimulatedBrickInfo {
            name: &link.name,
            scenarios: link.bricks().iter().map(|brick| &brick.scenario).collect(),
            truth: link.bricks().iter().map(EmbeddedBrick::truth_tap).collect(),
        });
        let facts = simulated.as_ref().map(dashboard::simulator_facts);
        let mut taps = FrameTaps::default();
        let terminal_frames = args.views.tui.then(|| taps.add(tui::WAITING_FRAMES));
        let configured = config.plotjuggler.checked()?;
        let plotted = args.views.plotjuggler.or_else(|| config.plotjuggler.enabled.then_some(configured));
        let plotted = plotted.map(|address| (address, taps.add(plotjuggler::WAITING_FRAMES)));
        let started = dashboard::start(reserved, &args.page, config, timer, folder, simulated, taps)?;
        let Some((dashboard, handle)) = started else {
            return Ok((Self::default(), None));
        };
        let mut viewers = Self { dashboard: Some(dashboard), ..Self::default() };
        if let Some((address, frames)) = plotted {
            viewers.plotjuggler = Some(PlotJuggler::start(address, frames)?);
            print_line(&format!("plotjuggler: sending to udp://{address}"));
        }
        // Last: from here on the screen is the view's.
        if let Some(frames) = terminal_frames {
            viewers.terminal = Some(viewers.view(frames, facts)?);
        }
        Ok((viewers, Some(handle)))
    }

    fn view(&self, frames: FrameTap, simulator: Option<SimulatorFacts>) -> Result<TerminalView> {
        let dashboard = self.dashboard.as_ref();
        let dashboard = dashboard.context("the view has no source of messages")?;
        // Not the whole address: a token is printed once.
        let page = dashboard.address();
        let greeting =
            page.map_or_else(|| "there is no page".to_owned(), |address| format!("the page listens at {address}"));
        TerminalView::start(TerminalInputs {
            frames,
            commands: dashboard.commander(),
            quit: self.quit.clone(),
            simulator,
            greeting,
        })
    }

    /// Completes when the user quits in the terminal view.
    pub(super) async fn quit(&self) {
        self.quit.cancelled().await;
    }

    /// Restores the terminal, so that messages are visible again.
    pub(super) fn close_terminal(&mut self) {
        self.terminal = None;
    }

    /// Stops the others, and reports unsent data.
    pub(super) fn finish(self) -> Result<()> {
        drop(self.terminal);
        drop(self.dashboard);
        let Some(plotjuggler) = self.plotjuggler else {
            return Ok(());
        };
        let SendCounts { datagrams, dropped, missed } = plotjuggler.finish()?;
        print_line(&match (dropped, missed) {
            (0, 0) => format!("plotjuggler: {datagrams} datagrams sent"),
            _ => format!(
                "plotjuggler: {datagrams} datagrams sent, {dropped} could not be, {missed} messages were missed"
            ),
        });
        Ok(())
    }
}
