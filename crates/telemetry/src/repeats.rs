//! Equal lines that follow one another quickly, joined: whoever says the same fifty times a second fills no log and no terminal with it.

use crate::{HostClock, Span, Stamp};

/// Equal lines that come closer together than this are one line that is repeated; a person who asks again waits longer. What was repeated is
/// told as often.
const JOINED_WITHIN: Span = Span::from_millis(1_000);

/// Holds back a line that has just been shown, and counts it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repeats {
    last: Option<String>,
    /// When it came last.
    at: Stamp<HostClock>,
    held: u64,
    /// When the first one was held back.
    since: Stamp<HostClock>,
}

impl Default for Repeats {
    /// Nothing was said yet.
    fn default() -> Self {
        Self { last: None, at: Stamp::ZERO, held: 0, since: Stamp::ZERO }
    }
}

/// What is to be shown for a line that came.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Shown {
    /// The one before it with how often it was repeated, if it was.
    pub before: Option<String>,
    /// Whether the line itself is shown, or held back.
    pub is_shown: bool,
}

impl Repeats {
    /// Takes a line that came now.
    pub fn take(&mut self, now: Stamp<HostClock>, line: &str) -> Shown {
        let is_repeated = self.last.as_deref() == Some(line) && now - self.at < JOINED_WITHIN;
        self.at = now;
        if is_repeated {
            if self.held == 0 {
                self.since = now;
            }
            self.held += 1;
            return Shown::default();
        }
        let before = self.held();
        self.held = 0;
        self.last = Some(line.to_owned());
        Shown { before, is_shown: true }
    }

    /// What was held back for long enough, to be shown now.
    pub fn due(&mut self, now: Stamp<HostClock>) -> Option<String> {
        let due = self.held().filter(|_| now - self.since >= JOINED_WITHIN)?;
        self.held = 0;
        Some(due)
    }

    /// What is held back: the line, with how often it came again.
    #[must_use]
    pub fn held(&self) -> Option<String> {
        let line = self.last.as_ref()?;
        match self.held {
            0 => None,
            1 => Some(format!("{line} (once more)")),
            times => Some(format!("{line} ({times} times more)")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a terminal shows of these lines, each at so many milliseconds.
    fn shown(lines: &[(i64, &str)]) -> Vec<String> {
        let mut repeats = Repeats::default();
        let mut shown = Vec::new();
        for (now_ms, line) in lines {
            let now = Stamp::from_millis(*now_ms);
            shown.extend(repeats.due(now));
            let taken = repeats.take(now, line);
            shown.extend(taken.before);
            shown.extend(taken.is_shown.then(|| (*line).to_owned()));
        }
        shown.extend(repeats.held());
        shown
    }

    #[test]
    fn a_flood_of_one_line_is_two_lines_a_second_at_most() {
        let flood: Vec<_> = (0..100).map(|index| (index * 20, "same")).collect();
        let expected = ["same", "same (50 times more)", "same (49 times more)"];
        assert_eq!(shown(&flood), expected);
    }

    #[test]
    fn other_lines_and_slow_ones_are_shown_as_they_come() {
        let slow = [(0, "a"), (1_000, "a"), (2_000, "a")];
        assert_eq!(shown(&slow), ["a", "a", "a"]);
        let mixed = [(0, "a"), (10, "a"), (20, "b"), (30, "a"), (40, "b")];
        assert_eq!(shown(&mixed), ["a", "a (once more)", "b", "a", "b"]);
    }
}
