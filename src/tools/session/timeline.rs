//! What happened in a session, in words and in order: what a person would have noted down.
//!
//! What comes many times a second is not in it: damage is named once for each link and kind, and the tables of the links count it.

use std::collections::BTreeSet;

use posebridge_telemetry::{Estimate, Event, ReceiveError, SignatureError, TimeDelta};

/// Most events that are kept; the rest is counted.
const MAX_ENTRIES: usize = 400;

/// One thing that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct TimelineEntry {
    /// When, in seconds since the first input.
    pub t_s: f64,
    /// What.
    pub text: String,
}

/// Notes them down.
#[derive(Debug, Default)]
pub struct EventTimeline {
    /// In their order.
    pub entries: Vec<TimelineEntry>,
    /// How many more there were.
    pub omitted: u64,
    /// Events that are listed once.
    pushed_once: BTreeSet<String>,
    resets: Option<u8>,
    is_dead_reckoning: Option<bool>,
}

impl EventTimeline {
    /// Takes an event.
    pub fn on_event(&mut self, t_s: f64, event: &Event) {
        if let Some((severity, text)) = event.describe() {
            let is_text = matches!(event, Event::Text { .. });
            self.push(t_s, if is_text { format!("{text} (severity {severity})") } else { text });
        } else if let Event::EstimateUpdated { estimate, .. } = event {
            self.on_estimate(t_s, estimate);
        } else if let Event::BrickClockAligned { uncertainty, .. } = event {
            self.push_once(t_s, &alignment_text("the brick's clock", *uncertainty), "brick clock");
        } else if let Event::CameraClockAligned { camera, uncertainty, .. } = event {
            let whose = format!("the clock of camera {camera}");
            self.push_once(t_s, &alignment_text(&whose, *uncertainty), &whose);
        } else if let Event::ReceiveError { link, defect } = event {
            let what = format!("first on link {link}: {}", kind_of(defect));
            self.push_once(t_s, &what, &what);
        }
    }

    fn on_estimate(&mut self, t_s: f64, estimate: &Estimate) {
        let before = self.resets.replace(estimate.reset_counter);
        if before.is_some_and(|before| before != estimate.reset_counter) {
            self.push(t_s, estimate.describe_reset());
        }
        let before = self.is_dead_reckoning.replace(estimate.is_dead_reckoning);
        // Before the first fix everything is dead reckoning: nothing has happened.
        if before.is_some_and(|before| before != estimate.is_dead_reckoning) {
            let what = if estimate.is_dead_reckoning {
                "dead reckoning: no fix for longer than the limit"
            } else {
                "fixes: no dead reckoning any more"
            };
            self.push(t_s, what.to_owned());
        }
    }

    fn push_once(&mut self, t_s: f64, what: &str, key: &str) {
        if self.pushed_once.insert(key.to_owned()) {
            self.push(t_s, what.to_owned());
        }
    }

    fn push(&mut self, t_s: f64, what: String) {
        if self.entries.len() < MAX_ENTRIES {
            self.entries.push(TimelineEntry { t_s, text: what });
        } else {
            self.omitted += 1;
        }
    }
}

fn alignment_text(whose: &str, uncertainty: TimeDelta) -> String {
    format!("{whose} aligned, ± {:.2} ms", uncertainty.as_millis_f64())
}

const fn kind_of(defect: &ReceiveError) -> &'static str {
    match defect {
        ReceiveError::Checksum { .. } => "a frame with a wrong checksum",
        ReceiveError::UnframedBytes { .. } => "bytes outside every frame",
        ReceiveError::ImpossibleHeader { .. } => "a header that its message cannot have",
        ReceiveError::Timeout { .. } => "a frame whose bytes stopped coming",
        ReceiveError::Payload { .. } => "a payload that makes no sense",
        ReceiveError::SequenceGap { .. } => "frames missing",
        ReceiveError::SignatureRejected { reason, .. } => match reason {
            SignatureError::Unsigned => "a frame refused: not signed",
            SignatureError::Invalid => "a frame refused: wrong signature",
            SignatureError::Replayed => "a frame refused: its signature was used before",
            SignatureError::Stale => "a frame refused: its signature is too old",
        },
        ReceiveError::AddressConflict { .. } => "a frame under the station's own address",
        ReceiveError::ClockNotAligned { .. } => "a stamp that cannot be aligned",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, LinkId, RobotId};

    fn text(text: &str) -> Event {
        Event::Text { source: Address::new(1, 1), severity: 4, text: text.to_owned() }
    }

    #[test]
    fn damage_is_named_once_and_the_rest_in_order() {
        let mut timeline = EventTimeline::default();
        let damage = Event::ReceiveError { link: LinkId(0), defect: ReceiveError::UnframedBytes { bytes: 3 } };
        timeline.on_event(1.0, &text("battery low"));
        timeline.on_event(2.0, &damage);
        timeline.on_event(3.0, &damage);
        timeline.on_event(4.0, &Event::BrickRestarted { robot: RobotId::default() });
        let texts: Vec<&str> = timeline.entries.iter().map(|one| one.text.as_str()).collect();
        assert_eq!(texts.len(), 3);
        assert_eq!(texts[0], "1/1: battery low (severity 4)");
        assert_eq!(texts[1], "first on link 0: bytes outside every frame");
        assert!(texts[2].contains("restarted"));
    }

    #[test]
    fn a_robot_that_talks_without_end_is_counted() {
        let mut timeline = EventTimeline::default();
        for _ in 0..1_000 {
            timeline.on_event(0.0, &text("x"));
        }
        assert_eq!((timeline.entries.len(), timeline.omitted), (MAX_ENTRIES, 600));
    }
}
