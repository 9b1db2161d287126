//! Exit codes of commands, deferred errors, and signals.

use std::sync::Arc;

use anyhow::{Result, anyhow};

/// Of a station whose loop stood still, with `--watchdog-exit`.
pub const EXIT_CODE_OF_WATCHDOG: u8 = 3;

#[derive(Debug)]
pub enum Failure {
    /// Exit code 2.
    CouldNotStart(anyhow::Error),
    /// Exit code 1.
    Failed(anyhow::Error),
}

impl Failure {
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::CouldNotStart(_) => 2,
            Self::Failed(_) => 1,
        }
    }

    pub const fn error(&self) -> &anyhow::Error {
        match self {
            Self::CouldNotStart(error) | Self::Failed(error) => error,
        }
    }
}

pub trait ExitStage<T> {
    fn before_start(self) -> Result<T, Failure>;
    fn while_running(self) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> ExitStage<T> for Result<T, E> {
    fn before_start(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::CouldNotStart(error.into()))
    }
    fn while_running(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::Failed(error.into()))
    }
}

/// Errors kept in full; bounds repeated requests for a recording on a full disk.
const MAX_ERRORS: usize = 8;

/// Errors that do not stop a run: reported together at its end.
#[derive(Debug, Default)]
pub struct DeferredErrors {
    errors: Vec<anyhow::Error>,
    omitted: u64,
}

impl DeferredErrors {
    /// Stores an error; returns the value of a success.
    pub fn record<T>(&mut self, result: Result<T>) -> Option<T> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                if self.errors.len() < MAX_ERRORS {
                    self.errors.push(error);
                } else {
                    self.omitted += 1;
                }
                None
            }
        }
    }

    pub fn into_result(mut self) -> Result<()> {
        if self.errors.len() <= 1 {
            return self.errors.pop().map_or(Ok(()), Err);
        }
        let mut words: Vec<String> = self.errors.iter().map(|error| format!("{error:#}")).collect();
        if self.omitted > 0 {
            words.push(format!("{} more", self.omitted));
        }
        Err(anyhow!(words.join("; ")))
    }
}

/// Makes a write beyond the limit of a file's size (`ulimit -f`) an error like that of a full disk: by default it ends the program.
pub fn survive_file_limits() -> std::io::Result<()> {
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()).map(drop)
}

/// Handlers of Ctrl-C, SIGTERM and SIGHUP, installed at the start so that no signal is lost while links open.
pub(crate) struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    /// The terminal was closed, or an ssh ended; `None` under `nohup`, which ignores that.
    hangup: Option<tokio::signal::unix::Signal>,
}

impl Signals {
    pub(crate) fn listen() -> Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let hangup = if ignores_hangup(&status) { None } else { Some(signal(SignalKind::hangup())?) };
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())?, hangup })
    }

    pub(crate) async fn received(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            () = hung_up(&mut self.hangup) => {}
        }
    }
}

async fn hung_up(hangup: &mut Option<tokio::signal::unix::Signal>) {
    match hangup {
        Some(hangup) => {
            hangup.recv().await;
        }
        None => std::future::pending().await,
    }
}

/// Whether a process with this `/proc/PID/status` was started to ignore SIGHUP. Source: proc_pid_status(5), SigIgn.
fn ignores_hangup(status: &str) -> bool {
    const SIGHUP_BIT: u64 = 1;
    let masks = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    masks.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & SIGHUP_BIT != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nohup_is_heeded() {
        assert!(ignores_hangup("Name:\tposebridge\nSigIgn:\t0000000000001001\nSigCgt:\t0000000000000440\n"));
        assert!(!ignores_hangup("SigBlk:\t0000000000000001\nSigIgn:\t0000000000001000\n"));
        assert!(!ignores_hangup(""));
    }

    #[test]
    fn all_that_failed_is_told_and_what_is_too_much_is_counted() {
        let mut failures = DeferredErrors::default();
        assert_eq!(failures.record(Ok(7)), Some(7));
        assert!(failures.into_result().is_ok());
        let mut failures = DeferredErrors::default();
        for number in 1..=10 {
            let failed: Option<()> = failures.record(Err(anyhow!("file {number}")));
            assert_eq!(failed, None);
        }
        let message = failures.into_result().unwrap_err().to_string();
        assert!(message.starts_with("file 1; file 2; "), "{message}");
        assert!(message.ends_with("file 8; 2 more"), "{message}");
    }
}
