//! What people must know, each line once until it changes.

use std::collections::BTreeMap;

use crate::bricks::Heard;
use posebridge_telemetry::Address;

/// MAVLink severities.
pub(super) const WARNING: u8 = 4;
pub(super) const NOTICE: u8 = 5;
pub(super) const INFO: u8 = 6;

/// What a line is about; a new line about it replaces the old.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Topic {
    Presence,
    Firmware,
    Clock,
    Maps,
    Motors,
    Outstanding,
    Program,
    Late,
    /// What a program on the brick says by itself.
    Foreign,
    Gyro,
    /// A sensor port, 0 to 3.
    Port(u8),
}

/// What was said so far.
#[derive(Debug, Default)]
pub(super) struct Notes {
    said: BTreeMap<Topic, String>,
}

impl Notes {
    /// Says a line, unless it is the last one about its topic.
    pub(super) fn say(
        &mut self,
        (topic, severity): (Topic, u8),
        text: String,
        from: Address,
        sink: &mut dyn FnMut(Heard<'_>),
    ) {
        if self.said.get(&topic) == Some(&text) {
            return;
        }
        self.said.insert(topic, text.clone());
        sink(Heard::Note { from, severity, text });
    }

    /// There is nothing to say about a topic any more; what is said next is news.
    pub(super) fn clear(&mut self, topic: Topic) {
        self.said.remove(&topic);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_said_once_until_it_changes() {
        let mut notes = Notes::default();
        let mut lines = Vec::new();
        let mut sink = |heard: Heard<'_>| {
            if let Heard::Note { text, .. } = heard {
                lines.push(text);
            }
        };
        let who = Address::new(1, 1);
        for text in ["a", "a", "b", "a"] {
            notes.say((Topic::Maps, INFO), text.to_owned(), who, &mut sink);
        }
        notes.say((Topic::Port(1), INFO), "a".to_owned(), who, &mut sink);
        notes.clear(Topic::Maps);
        notes.say((Topic::Maps, INFO), "a".to_owned(), who, &mut sink);
        assert_eq!(lines, ["a", "b", "a", "a", "a"]);
    }
}
