//! Flags of the dashboard.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

/// Whether there is a page, and where (docs/dashboard.md).
#[derive(Args, Clone, Debug, Default)]
pub struct DashboardFlags {
    /// Serve the dashboard there, e.g. 0.0.0.0:4680 for other computers, which open one of the addresses that are printed, with their token;
    /// port 0 takes a free one.
    #[arg(long, value_name = "IP:PORT", conflicts_with = "no_dashboard")]
    pub dashboard: Option<SocketAddr>,
    /// Serve no dashboard.
    #[arg(long)]
    pub no_dashboard: bool,
    /// Open the dashboard in a browser.
    #[arg(long, conflicts_with = "no_dashboard")]
    pub open: bool,
    /// Serve the page's files from this folder instead of from the program: for whoever edits them.
    #[arg(long, value_name = "DIR", conflicts_with = "no_dashboard")]
    pub ui_dir: Option<PathBuf>,
}
