//! The radio of a LEGO brick: it receives or sends, and needs time to turn from the one to the other.
//!
//! # Model
//! ```text
//! one buffer is on the air, others wait; a telegram for which there is none is dropped without a word
//! on the air for   turn-around, if something was received since the last turn, + bytes * time of a byte
//! ```
//! # Sources
//! LEGO's figure of about 30 ms for the Bluetooth chip of the NXT, which all its hosts report; the firmware's send buffers.

use std::collections::VecDeque;

use posebridge_telemetry::TimeDelta;

/// How a radio is built.
#[derive(Clone, Copy, Debug)]
pub(super) struct RadioSettings {
    /// Time from receiving to sending.
    pub(super) turn_around: TimeDelta,
    /// Time of a byte, in seconds.
    pub(super) byte_s: f64,
    /// Telegrams that it holds, the one on the air included.
    pub(super) buffers: usize,
}

/// What is being sent, and when it has been.
#[derive(Clone, Debug)]
struct RadioTransmission {
    bytes: Vec<u8>,
    done: TimeDelta,
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Radio {
    settings: RadioSettings,
    /// Something was received since it turned to sending.
    must_turn: bool,
    on_air: Option<RadioTransmission>,
    queued: VecDeque<Vec<u8>>,
}

impl Radio {
    /// A radio that receives.
    pub(super) const fn new(settings: RadioSettings) -> Self {
        Self { settings, must_turn: true, on_air: None, queued: VecDeque::new() }
    }

    /// As it was in the beginning.
    pub(super) fn reset(&mut self) {
        *self = Self::new(self.settings);
    }

    /// Something is received.
    pub(super) const fn receive(&mut self) {
        self.must_turn = true;
    }

    /// Whether nothing waits to be sent.
    pub(super) fn is_idle(&self) -> bool {
        self.on_air.is_none() && self.queued.is_empty()
    }

    /// Sends a telegram; one for which there is no buffer is dropped.
    pub(super) fn send(&mut self, bytes: Vec<u8>) {
        if self.queued.len() + usize::from(self.on_air.is_some()) < self.settings.buffers {
            self.queued.push_back(bytes);
        }
    }

    /// What has gone over the air at `now`, the time since the beginning of the world.
    pub(super) fn step(&mut self, now: TimeDelta) -> Option<Vec<u8>> {
        if self.on_air.is_none()
            && let Some(bytes) = self.queued.pop_front()
        {
            let turn = if std::mem::take(&mut self.must_turn) { self.settings.turn_around } else { TimeDelta::ZERO };
            let sending = TimeDelta::from_secs_f64(bytes.len() as f64 * self.settings.byte_s);
            let done = now + turn + sending;
            self.on_air = Some(RadioTransmission { bytes, done });
        }
        let sent = self.on_air.take_if(|on_air| on_air.done <= now)?;
        Some(sent.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_telegram_waits_for_the_turn_the_second_does_not_and_the_third_is_lost() {
        let mut radio = Radio::new(RadioSettings { turn_around: TimeDelta::from_millis(30), byte_s: 1e-3, buffers: 2 });
        let sent_at = |radio: &mut Radio| -> Vec<(i64, Vec<u8>)> {
            let pass = |at: i64| Some((at, radio.step(TimeDelta::from_millis(at))?));
            (0..100).filter_map(pass).collect()
        };
        for number in 1..=3 {
            radio.send(vec![number; 5]);
        }
        assert_eq!(sent_at(&mut radio), [(35, vec![1; 5]), (41, vec![2; 5])]);
        radio.send(vec![4]);
        assert_eq!(sent_at(&mut radio), [(1, vec![4])]);
        radio.receive();
        radio.send(vec![5]);
        assert_eq!(sent_at(&mut radio), [(31, vec![5])]);
    }
}
