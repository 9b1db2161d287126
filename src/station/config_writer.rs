//! The thread that writes saved configurations: the station loop never waits for the disk.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_telemetry::Input;
use tokio::sync::mpsc;

use super::recording_files::{done_message, unused_path};
use super::request_reports::report_input;
use crate::config::Config;
use crate::console::print_line;

/// The name of the saved configuration.
const SAVED: &str = "parameters.toml";
/// Most configurations that wait for the disk; each is a person's request.
const QUEUE_CAPACITY: usize = 4;

/// A running saver.
pub(super) struct ConfigSaver {
    jobs: SyncSender<Config>,
    reports: mpsc::Receiver<Input>,
    thread: JoinHandle<()>,
}

impl ConfigSaver {
    /// Starts the thread. What this run saves goes into one file of the folder; a file of another program is never touched.
    ///
    /// # Errors
    /// The system has no thread left.
    pub(super) fn start(folder: PathBuf) -> Result<Self> {
        let (jobs, waiting) = sync_channel(QUEUE_CAPACITY);
        let (reports, waiting_reports) = mpsc::channel(QUEUE_CAPACITY);
        let thread = std::thread::Builder::new()
            .name("saver".to_owned())
            .spawn(move || save_all(&folder, &waiting, &reports))
            .context("starting the thread that saves")?;
        Ok(Self { jobs, reports: waiting_reports, thread })
    }

    /// Hands a configuration over.
    ///
    /// # Errors
    /// The disk is behind.
    pub(super) fn save(&self, config: Config) -> Result<()> {
        self.jobs.try_send(config).map_err(|refused| match refused {
            TrySendError::Full(_) => anyhow!("not saved: the disk is behind, ask again"),
            TrySendError::Disconnected(_) => anyhow!("not saved: the thread that saves died"),
        })
    }

    /// What became of the next one; never, while nothing waits.
    pub(super) async fn next_report(&mut self) -> Input {
        match self.reports.recv().await {
            Some(report) => report,
            None => std::future::pending().await,
        }
    }

    /// Waits until all is written; results that were not received yet are printed.
    pub(super) fn finish(mut self) {
        drop(self.jobs);
        self.reports.close();
        if self.thread.join().is_err() {
            print_line("the thread that saves died");
        }
        while let Ok(Input::Report { text, .. }) = self.reports.try_recv() {
            print_line(&text);
        }
    }

    /// What became of the next one, for tests without a runtime.
    #[cfg(test)]
    pub(super) fn wait(&mut self) -> Option<Input> {
        self.reports.blocking_recv()
    }
}

fn save_all(folder: &Path, jobs: &Receiver<Config>, reports: &mpsc::Sender<Input>) {
    let mut saved = None;
    for config in jobs {
        let report = report_input(save(folder, &mut saved, &config));
        if let Err(unheard) = reports.blocking_send(report)
            && let Input::Report { text, .. } = unheard.0
        {
            print_line(&text);
        }
    }
}

fn save(folder: &Path, saved: &mut Option<PathBuf>, config: &Config) -> Result<String> {
    let path = match saved {
        Some(path) => path.clone(),
        None => unused_path(folder, SAVED, 1)?.0,
    };
    let text = format!(
        "# The configuration of a run with the parameters that were saved in it: posebridge run --config {SAVED}\n\n{}",
        toml::to_string(config).context("writing the configuration")?
    );
    // Atomic: a reader finds the old file or the new one.
    let beside = path.with_extension("toml.new");
    std::fs::write(&beside, text)
        .and_then(|()| std::fs::rename(&beside, &path))
        .with_context(|| done_message("not saved", &path))?;
    let message = done_message("saved", &path);
    *saved = Some(path);
    Ok(message)
}
