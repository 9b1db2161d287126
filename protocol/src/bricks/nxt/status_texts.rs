//! Status texts for people; each is sent once until it changes.

use std::collections::BTreeMap;

use posebridge_telemetry::Address;

use crate::bricks::codec::CodecEvent;

/// What a line is about; a new line about it replaces the old.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum StatusTopic {
    Presence,
    Firmware,
    Clock,
    IoMaps,
    Motors,
    Outstanding,
    Program,
    LateReplies,
    /// What a program on the brick says by itself.
    ForeignMessages,
    Gyro,
    /// A sensor port, 0 to 3.
    Port(u8),
}

/// The texts that were sent so far.
#[derive(Debug, Default)]
pub(super) struct StatusTextFilter {
    last_texts: BTreeMap<StatusTopic, String>,
}

impl StatusTextFilter {
    /// Says a line, unless it is the last one about its topic.
    pub(super) fn emit_if_new(
        &mut self,
        topic: StatusTopic,
        severity: u8,
        text: String,
        from: Address,
        sink: &mut dyn FnMut(CodecEvent<'_>),
    ) {
        if self.last_texts.get(&topic) == Some(&text) {
            return;
        }
        self.last_texts.insert(topic, text.clone());
        sink(CodecEvent::StatusText { from, severity, text });
    }

    /// There is nothing to say about a topic any more; the next text is new.
    pub(super) fn clear(&mut self, topic: StatusTopic) {
        self.last_texts.remove(&topic);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::severity::INFO;

    #[test]
    fn a_line_is_said_once_until_it_changes() {
        let mut notes = StatusTextFilter::default();
        let mut lines = Vec::new();
        let mut sink = |heard: CodecEvent<'_>| {
            if let CodecEvent::StatusText { text, .. } = heard {
                lines.push(text);
            }
        };
        let who = Address::new(1, 1);
        for text in ["a", "a", "b", "a"] {
            notes.emit_if_new(StatusTopic::IoMaps, INFO, text.to_owned(), who, &mut sink);
        }
        notes.emit_if_new(StatusTopic::Port(1), INFO, "a".to_owned(), who, &mut sink);
        notes.clear(StatusTopic::IoMaps);
        notes.emit_if_new(StatusTopic::IoMaps, INFO, "a".to_owned(), who, &mut sink);
        assert_eq!(lines, ["a", "b", "a", "a", "a"]);
    }
}
