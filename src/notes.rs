//! What is missing of a recording or damaged in it, in words.

use posebridge_recording::container::{Beginning, Ending, ReadError};

use crate::own_recording::lack_of;

/// So many damaged places are named.
const MOST: usize = 50;

/// The first of them in words, the others as a number.
#[derive(Debug, Default)]
pub struct Notes {
    told: Vec<String>,
    more: u64,
}

impl Notes {
    /// Of what was found already.
    #[must_use]
    pub fn of(found: &[String]) -> Self {
        let mut notes = Self::default();
        found.iter().cloned().for_each(|note| notes.add(note));
        notes
    }

    /// Adds one.
    pub fn add(&mut self, note: String) {
        if self.told.len() < MOST {
            self.told.push(note);
        } else {
            self.more += 1;
        }
    }

    /// Says what of the session is before the recording.
    pub fn add_lack(&mut self, beginning: &Beginning) {
        if let Some(lack) = lack_of(beginning) {
            self.add(format!("{lack}; the replay is not that of the live run"));
        }
    }

    /// Says what cannot be read; what is whole behind it is still worth replaying.
    pub fn add_damage(&mut self, error: &ReadError) {
        self.add(format!("{error}; the replay is not that of the live run any more"));
    }

    /// Says where the recording was cut off, if it was.
    pub fn add_ending(&mut self, ending: &Ending) {
        if let Ending::Torn { offset, what } = ending {
            self.add(format!("cut off at byte {offset} ({what}); everything before was replayed"));
        }
    }

    /// All of them.
    #[must_use]
    pub fn finish(mut self) -> Vec<String> {
        if self.more > 0 {
            self.told.push(format!("{} more places are damaged", self.more));
        }
        self.told
    }
}
