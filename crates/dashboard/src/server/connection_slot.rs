//! A limited number of slots, each counted while it is in use.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::counters::{ServerCounter, ServerCounters};

/// A slot in use; dropping it frees the slot.
pub(super) struct ConnectionSlot {
    counts: Arc<ServerCounters>,
    count: ServerCounter,
    _permit: OwnedSemaphorePermit,
}

impl ConnectionSlot {
    /// Acquires a slot, if one is free.
    pub(super) fn acquire(
        semaphore: &Arc<Semaphore>,
        counts: &Arc<ServerCounters>,
        count: ServerCounter,
    ) -> Option<Self> {
        let permit = Arc::clone(semaphore).try_acquire_owned().ok()?;
        counts.increment(count);
        Some(Self { counts: Arc::clone(counts), count, _permit: permit })
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.counts.decrement(self.count);
    }
}
