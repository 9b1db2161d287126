//! Flags of who else looks on: the terminal view and PlotJuggler.

use std::net::SocketAddr;

use clap::Args;

use crate::config::PLOTJUGGLER_ADDRESS;

/// What is shown besides the page.
#[derive(Args, Clone, Debug, Default)]
pub struct ViewFlags {
    /// Show map, pose, innovations, links and events in this terminal (docs/terminal.md); q ends the run, ? explains the other keys.
    #[arg(long)]
    pub tui: bool,
    /// Send what happens as JSON to PlotJuggler's UDP server there, by default 127.0.0.1:9870 (docs/plotjuggler.md).
    #[arg(
        long,
        value_name = "IP:PORT",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = PLOTJUGGLER_ADDRESS
    )]
    pub plotjuggler: Option<SocketAddr>,
}
