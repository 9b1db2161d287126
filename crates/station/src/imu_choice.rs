//! Which of a robot's inertial messages moves its filter: an autopilot sends one unit in several messages, and several units.
//!
//! Two of them together would count one turn twice.

use posebridge_protocol::message::ImuMessage;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// After this silence of the chosen message another one takes its place.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(1_000);

#[derive(Debug, Default)]
pub(crate) struct ImuChoice {
    /// The chosen message, and when it was last heard.
    chosen: Option<(ImuMessage, Timestamp<HostClock>)>,
}

impl ImuChoice {
    /// Whether a message that arrived at `now` is used: the one that was chosen, or a better one, or any after its silence.
    pub(crate) fn is_used(&mut self, now: Timestamp<HostClock>, message: ImuMessage) -> bool {
        let is_used = self.chosen.is_none_or(|(chosen, last)| message <= chosen || now - last >= MAX_SILENCE);
        if is_used {
            self.chosen = Some((message, now));
        }
        is_used
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_message_is_used_until_a_better_one_comes_or_it_falls_silent() {
        let mut choice = ImuChoice::default();
        let heard = [
            (0, ImuMessage::Scaled2, true),
            (10, ImuMessage::Scaled3, false),
            (20, ImuMessage::Raw, true),
            (30, ImuMessage::Scaled2, false),
            (1_019, ImuMessage::Scaled2, false),
            (1_020, ImuMessage::Scaled2, true),
            (1_030, ImuMessage::Raw, true),
        ];
        for (millis, message, is_used) in heard {
            assert_eq!(choice.is_used(Timestamp::from_millis(millis), message), is_used, "{millis} {message:?}");
        }
    }
}
