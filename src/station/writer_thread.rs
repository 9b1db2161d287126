//! A thread that writes a file, and how long the end of a run waits for it: as long as the disk takes anything.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};

/// How long the end of a run waits for a disk that takes nothing.
pub const END_TIMEOUT: Duration = Duration::from_millis(if cfg!(test) { 2_000 } else { 5_000 });

#[derive(Debug)]
pub struct WriterThread<T> {
    thread: JoinHandle<()>,
    /// The thread's result, when it has ended.
    ended: Receiver<Result<T>>,
    /// Items of its queue that it has taken to the file.
    written: Arc<AtomicU64>,
}

impl<T: Send + 'static> WriterThread<T> {
    /// `write` counts the items that it has written.
    pub fn spawn(name: &str, write: impl FnOnce(&AtomicU64) -> Result<T> + Send + 'static) -> Result<Self> {
        let (end, ended) = bounded(1);
        let written = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&written);
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || drop(end.try_send(write(&count))))
            .with_context(|| format!("starting the thread `{name}`"))?;
        Ok(Self { thread, ended, written })
    }

    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// Waits for the thread, whose queue has got `queued` items and no further ones.
    ///
    /// # Errors
    /// It failed, or its disk takes nothing: then the thread is left alone.
    pub fn wait(self, queued: u64) -> Result<T> {
        loop {
            let before = self.written.load(Ordering::Relaxed);
            match self.ended.recv_timeout(END_TIMEOUT) {
                Ok(result) => return result,
                Err(RecvTimeoutError::Disconnected) => bail!("its thread died"),
                Err(RecvTimeoutError::Timeout) => {}
            }
            let written = self.written.load(Ordering::Relaxed);
            if written == before {
                bail!("its disk takes nothing: the last {} items are not written", queued.saturating_sub(written));
            }
        }
    }
}
