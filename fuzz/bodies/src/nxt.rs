//! Any bytes at any time as replies of an NXT: the codec has no needless deadline, never stops polling, and has at most
//! one request outstanding, with at most one telegram before it.

use posebridge_protocol::bricks::nxt::{MaxOutstanding, NxtSensor, NxtSettings};
use posebridge_protocol::bricks::{CodecEvent, CodecSettings, brick_protocol};
use posebridge_telemetry::{TimeDelta, Timestamp};

use crate::operands::Operands;

/// Telegrams that may leave at once: two questions, each with one in front.
const MAX_TELEGRAMS: usize = 4;

/// Input: row and settings, then steps of a wait in milliseconds, a length, and so many bytes.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    let choice = operands.byte();
    let is_pushed = choice & 1 == 1;
    let row = if is_pushed { "nxt-push" } else { "nxt" };
    let Some(protocol) = brick_protocol(row) else {
        return;
    };
    let mut codec = (protocol.open)(&settings(choice));
    let mut now = Timestamp::ZERO;
    codec.on_link_up(now);
    loop {
        let mut telegrams = 0;
        while codec.poll().is_some() {
            telegrams += 1;
            assert!(telegrams <= MAX_TELEGRAMS, "{telegrams} telegrams at once");
        }
        // A program that answers no commands is left alone, and waited for until it has been silent for two seconds.
        match codec.deadline() {
            Some(due) => assert!(due > now, "due at {due:?}, and it is {now:?}"),
            None => assert!(is_pushed, "nothing to wait for"),
        }
        if operands.is_empty() {
            break;
        }
        now = now + TimeDelta::from_millis(i64::from(operands.byte()));
        let length = usize::from(operands.byte());
        let mut texts = 0;
        let mut sink = |heard: CodecEvent<'_>| texts += usize::from(matches!(heard, CodecEvent::StatusText { .. }));
        codec.push(now, operands.take_up_to(length), &mut sink);
        codec.tick(now, &mut sink);
        assert!(texts <= 300, "{texts} lines at once");
    }
}

fn settings(choice: u8) -> CodecSettings {
    let is = |bit: u8| choice & (1 << bit) != 0;
    CodecSettings {
        nxt: NxtSettings {
            sensors: [NxtSensor::HtGyro, NxtSensor::HtCompass, NxtSensor::Ultrasonic, NxtSensor::Temperature],
            outstanding: if is(1) { MaxOutstanding::Two } else { MaxOutstanding::One },
            ..NxtSettings::default()
        },
        ..CodecSettings::default()
    }
}
