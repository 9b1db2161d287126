//! A filter for repeated lines: equal lines in quick succession become one line and a count.

use crate::{HostClock, TimeDelta, Timestamp};

/// Equal lines closer together than this are repetitions; a person who repeats a command is slower. Also the period of the summaries.
const REPEAT_WINDOW: TimeDelta = TimeDelta::from_millis(1_000);

/// Suppresses a line that has just been shown, and counts the repetitions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RepeatFilter {
    last_line: Option<String>,
    last_arrival: Timestamp<HostClock>,
    held: u64,
    first_suppressed: Timestamp<HostClock>,
}

impl Default for RepeatFilter {
    fn default() -> Self {
        Self { last_line: None, last_arrival: Timestamp::ZERO, held: 0, first_suppressed: Timestamp::ZERO }
    }
}

/// Which lines to show for one pushed line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RepeatDecision {
    /// The previous line with the number of its repetitions, if there were any.
    pub repeat_summary: Option<String>,
    pub is_shown: bool,
}

impl RepeatFilter {
    pub fn push(&mut self, now: Timestamp<HostClock>, line: &str) -> RepeatDecision {
        let is_repeated = self.last_line.as_deref() == Some(line) && now - self.last_arrival < REPEAT_WINDOW;
        self.last_arrival = now;
        if is_repeated {
            if self.held == 0 {
                self.first_suppressed = now;
            }
            self.held += 1;
            return RepeatDecision::default();
        }
        let before = self.suppressed_summary();
        self.held = 0;
        self.last_line = Some(line.to_owned());
        RepeatDecision { repeat_summary: before, is_shown: true }
    }

    /// The summary of repetitions that have been suppressed for the whole period.
    pub fn flush_due(&mut self, now: Timestamp<HostClock>) -> Option<String> {
        let due = self.suppressed_summary().filter(|_| now - self.first_suppressed >= REPEAT_WINDOW)?;
        self.held = 0;
        Some(due)
    }

    /// The suppressed line with the number of its repetitions.
    pub fn suppressed_summary(&self) -> Option<String> {
        let line = self.last_line.as_ref()?;
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

    /// What a terminal shows of these lines, each with its time in milliseconds.
    fn printed_lines(lines: &[(i64, &str)]) -> Vec<String> {
        let mut repeats = RepeatFilter::default();
        let mut shown = Vec::new();
        for (now_ms, line) in lines {
            let now = Timestamp::from_millis(*now_ms);
            shown.extend(repeats.flush_due(now));
            let taken = repeats.push(now, line);
            shown.extend(taken.repeat_summary);
            shown.extend(taken.is_shown.then(|| (*line).to_owned()));
        }
        shown.extend(repeats.suppressed_summary());
        shown
    }

    #[test]
    fn a_flood_of_one_line_is_two_lines_a_second_at_most() {
        let flood: Vec<_> = (0..100).map(|index| (index * 20, "same")).collect();
        let expected = ["same", "same (50 times more)", "same (49 times more)"];
        assert_eq!(printed_lines(&flood), expected);
    }

    #[test]
    fn other_lines_and_slow_ones_are_shown_as_they_come() {
        let slow = [(0, "a"), (1_000, "a"), (2_000, "a")];
        assert_eq!(printed_lines(&slow), ["a", "a", "a"]);
        let mixed = [(0, "a"), (10, "a"), (20, "b"), (30, "a"), (40, "b")];
        assert_eq!(printed_lines(&mixed), ["a", "a (once more)", "b", "a", "b"]);
    }
}
