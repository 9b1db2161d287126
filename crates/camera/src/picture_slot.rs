//! The newest picture of a camera, between the thread that receives and the thread that searches.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use posebridge_link::LinkError;

use crate::picture::EncodedPicture;

/// How a camera's pictures ended.
#[derive(Debug)]
pub(crate) enum StreamEnd {
    /// A file or folder was played.
    Finished,
    Lost(LinkError),
}

/// Holds one picture: a newer one replaces it.
#[derive(Debug, Default)]
pub(crate) struct PictureSlot {
    state: Mutex<SlotState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct SlotState {
    newest: Option<EncodedPicture>,
    /// Pictures that were replaced before they were searched.
    dropped: u64,
    end: Option<StreamEnd>,
    is_closed: bool,
}

impl PictureSlot {
    pub(crate) fn put(&self, picture: EncodedPicture) {
        let mut state = self.lock();
        state.dropped += u64::from(state.newest.replace(picture).is_some());
        self.changed.notify_one();
    }

    /// Waits until the last picture was taken: nothing of a file is skipped.
    pub(crate) fn wait_until_taken(&self) {
        let state = self.lock();
        let is_waiting = |state: &mut SlotState| state.newest.is_some() && !state.is_closed;
        drop(self.changed.wait_while(state, is_waiting));
    }

    /// Nothing follows; what is in the slot is still taken.
    pub(crate) fn end(&self, end: StreamEnd) {
        let mut state = self.lock();
        state.end.get_or_insert(end);
        state.is_closed = true;
        self.changed.notify_all();
    }

    /// Waits for the next picture; `None` once there are no more. The number is that of pictures dropped so far.
    pub(crate) fn take(&self) -> Option<(EncodedPicture, u64)> {
        let state = self.lock();
        let is_idle = |state: &mut SlotState| state.newest.is_none() && !state.is_closed;
        let mut state = self.changed.wait_while(state, is_idle).unwrap_or_else(PoisonError::into_inner);
        let picture = state.newest.take()?;
        self.changed.notify_all();
        Some((picture, state.dropped))
    }

    pub(crate) fn take_end(&self) -> Option<StreamEnd> {
        self.lock().end.take()
    }

    fn lock(&self) -> MutexGuard<'_, SlotState> {
        // A thread that died in here has left a whole state: each change is one assignment.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::Timestamp;

    use super::*;
    use crate::picture::PictureTime;

    fn picture(number: u8) -> EncodedPicture {
        EncodedPicture { time: PictureTime::Received(Timestamp::ZERO), bytes: vec![number] }
    }

    #[test]
    fn the_newest_picture_is_taken_and_the_others_are_counted() {
        let slot = PictureSlot::default();
        for number in 1..=3 {
            slot.put(picture(number));
        }
        assert_eq!(slot.take(), Some((picture(3), 2)));
        slot.put(picture(4));
        slot.end(StreamEnd::Finished);
        slot.end(StreamEnd::Lost(LinkError::HungUp));
        assert_eq!(slot.take(), Some((picture(4), 2)), "what was there before the end");
        assert_eq!(slot.take(), None);
        assert!(matches!(slot.take_end(), Some(StreamEnd::Finished)), "the first reason counts");
    }
}
