//! Places of which there are so many, counted for as long as somebody has one.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::counts::{Count, Counts};

/// A place that somebody has; it is free again when this is dropped.
pub(super) struct Seat {
    counts: Arc<Counts>,
    count: Count,
    _permit: OwnedSemaphorePermit,
}

impl Seat {
    /// Takes a place, if one is free.
    pub(super) fn take(room: &Arc<Semaphore>, counts: &Arc<Counts>, count: Count) -> Option<Self> {
        let permit = Arc::clone(room).try_acquire_owned().ok()?;
        counts.one(count);
        Some(Self { counts: Arc::clone(counts), count, _permit: permit })
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.counts.less(self.count);
    }
}
