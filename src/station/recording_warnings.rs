//! What is missing of a recording or damaged in it, in words.

use posebridge_recording::container::{PartHeader, ReadError, RecordingEnd};

/// Most damaged places that are listed.
const MAX_NOTES: usize = 50;

/// The first of them in words, the others as a number.
#[derive(Debug, Default)]
pub struct RecordingWarnings {
    lines: Vec<String>,
    omitted: u64,
}

impl RecordingWarnings {
    /// Of what was found already.
    pub fn from_notes(found: &[String]) -> Self {
        let mut notes = Self::default();
        found.iter().cloned().for_each(|note| notes.add(note));
        notes
    }

    /// Adds one.
    pub fn add(&mut self, note: String) {
        if self.lines.len() < MAX_NOTES {
            self.lines.push(note);
        } else {
            self.omitted += 1;
        }
    }

    /// Says what of the session is before the recording.
    pub fn add_missing_start(&mut self, beginning: &PartHeader) {
        if let Some(lack) = missing_start(beginning) {
            self.add(format!("{lack}; the replay is not that of the live run"));
        }
    }

    /// Says what cannot be read; what is whole behind it is still worth replaying.
    pub fn add_damage(&mut self, error: &ReadError) {
        self.add(format!("{error}; the replay is not that of the live run any more"));
    }

    /// Says where the recording was cut off, if it was.
    pub fn add_ending(&mut self, ending: &RecordingEnd) {
        if let RecordingEnd::Truncated { offset, what } = ending {
            self.add(format!("cut off at byte {offset} ({what}); everything before was replayed"));
        }
    }

    /// All of them.
    pub fn into_lines(mut self) -> Vec<String> {
        if self.omitted > 0 {
            self.lines.push(format!("{} more places are damaged", self.omitted));
        }
        self.lines
    }
}

/// What a recording lacks of its session's beginning, in words; `None` if it begins with the session.
pub fn missing_start(beginning: &PartHeader) -> Option<String> {
    let before = beginning.inputs_before;
    let holder = match &beginning.continues {
        Some(name) => format!("they are in `{name}` and what that continues"),
        None => "nobody recorded them".to_owned(),
    };
    (before > 0).then(|| format!("it lacks the first {before} inputs of its session ({holder})"))
}
