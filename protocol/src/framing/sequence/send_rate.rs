//! The send rate of a sender, and the number of frames that it sends in a silence.
//!
//! # Model
//! ```text
//! expected = pace t            pace: frames per second of the sender's clock, averaged over some twenty seconds
//! n = a + 256 k nearest to expected,         known while  0.12 expected < 128
//! n = a + 256 k nearest to 0.95 expected,    beyond that, known while  0.07 expected < 128
//! ```
//! The pace is that of all frames of the sender. It varies with the requests that it gets: in an outage there are no
//! time requests, and a brick of 42 frames per second that otherwise answers five requests falls short of its mean by a
//! tenth. It does not exceed its mean then, so a long silence has between 0.88 and 1.02 of the expected frames.

/// Time over which the pace is averaged, s of the sender's clock: longer than an outage, short enough for a user to
/// wait.
const AVERAGE_S: f64 = 20.0;
/// Time before the first average, s: heartbeats come once per second.
const GATHER_S: f64 = 1.0;
/// Deviation of a sender from its pace through a silence, either way: the effect of time requests on a brick.
const VARIATION: f64 = 0.12;
/// Deviation from [`LONG_SHARE`] of the pace through a long silence: 0.88 to 1.02.
const LONG_VARIATION: f64 = 0.07;
/// See [`LONG_VARIATION`].
const LONG_SHARE: f64 = 0.95;
/// Frames that are sent once per second or less often may fall on either side of a silence's ends.
const VARIATION_FRAMES: f64 = 8.0;
/// Half the circle: a number further from the expected one is nearer to the next turn.
const HALF_CIRCLE: f64 = 128.0;
/// Largest advance over a silence of many turns that means that the sender itself was silent.
const MAX_ADVANCE_OVER_PAUSE: u32 = 16;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SendRate {
    per_s: Option<f64>,
    gathered_s: f64,
    gathered_frames: f64,
}

impl SendRate {
    /// Number of frames sent in `elapsed_s`, in which the number advanced by `advance` modulo 256 and `received` frames
    /// came. 0 for a sender that does not count by one, `None` if the silence was too long to decide.
    pub(super) fn estimate_sent(&self, elapsed_s: f64, advance: u8, received: u32) -> Option<u32> {
        let Some(per_s) = self.per_s else {
            // Nothing is known yet: half the circle or more is an old number.
            let is_newer = f64::from(advance) <= HALF_CIRCLE;
            return Some(if is_newer { u32::from(advance) } else { 0 });
        };
        let by_pace = per_s * elapsed_s;
        let expected = if by_pace * VARIATION <= HALF_CIRCLE {
            by_pace
        } else if by_pace * LONG_VARIATION <= HALF_CIRCLE {
            LONG_SHARE * by_pace
        } else {
            return None;
        };
        let turns = ((expected - f64::from(advance)) / 256.0).round().max(0.0);
        let sent = u32::from(advance) + 256 * turns as u32;
        let is_off = (expected - f64::from(sent)).abs() > VARIATION_FRAMES + VARIATION * expected;
        let has_paused = u32::from(advance) <= received + MAX_ADVANCE_OVER_PAUSE;
        if turns > 0.0 && is_off && has_paused {
            return Some(u32::from(advance));
        }
        // Half a circle more than expected is an advance that falls: the number of a sender that does not count by one.
        if f64::from(sent) - expected > HALF_CIRCLE {
            return Some(0);
        }
        Some(sent)
    }

    /// Number of frames between an overtaken frame and the stamped one: its stamp is `back_s` earlier, its number
    /// `behind` modulo 256. `None` if it was sent later: a camera's images may overtake each other.
    pub(super) fn estimate_behind(&self, back_s: f64, behind: u8) -> Option<u64> {
        let expected = self.per_s.unwrap_or(0.0) * back_s;
        let turns = ((expected - f64::from(behind)) / 256.0).round();
        (turns >= 0.0).then(|| u64::from(behind) + 256 * turns as u64)
    }

    pub(super) fn update(&mut self, sent: u32, elapsed_s: f64) {
        self.gathered_frames += f64::from(sent);
        self.gathered_s += elapsed_s;
        if self.gathered_s < GATHER_S {
            return;
        }
        let measured_per_s = self.gathered_frames / self.gathered_s;
        let weight = self.gathered_s / (self.gathered_s + AVERAGE_S);
        self.per_s = Some(self.per_s.map_or(measured_per_s, |per_s| per_s + weight * (measured_per_s - per_s)));
        (self.gathered_frames, self.gathered_s) = (0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(per_s: u32) -> SendRate {
        let mut pace = SendRate::default();
        pace.update(per_s, 1.0);
        pace
    }

    #[test]
    fn a_silence_has_as_many_turns_as_fit_its_length() {
        let pace = of(45);
        for sent in [1_u32, 100, 225, 400, 700, 950] {
            for off in [0.9, 1.0, 1.1] {
                let elapsed_s = f64::from(sent) / 45.0 * off;
                assert_eq!(pace.estimate_sent(elapsed_s, sent as u8, 1), Some(sent), "{off}");
            }
        }
    }

    #[test]
    fn a_brick_without_time_requests_is_not_taken_for_silent() {
        // 46 frames per second with the answers, 41 without; the number is that of the first frames after a turn.
        for sent in 513_u32..525 {
            assert_eq!(of(46).estimate_sent(f64::from(sent) / 41.0, sent as u8, 1), Some(sent));
        }
    }

    #[test]
    fn a_long_silence_of_a_brick_without_time_requests_is_detected() {
        for sent in (1_080_u32..1_600).step_by(7) {
            for of_pace in [0.89, 0.95, 1.01] {
                let elapsed_s = f64::from(sent) / 45.0 / of_pace;
                assert_eq!(of(45).estimate_sent(elapsed_s, sent as u8, 1), Some(sent), "{of_pace}");
            }
        }
    }

    #[test]
    fn losses_in_a_silence_of_minutes_are_unknown() {
        assert_eq!(of(45).estimate_sent(60.0, 7, 1), None);
        assert_eq!(of(1).estimate_sent(60.0, 60, 1), Some(60));
    }

    #[test]
    fn a_sender_that_was_silent_itself_has_lost_nothing() {
        assert_eq!(of(45).estimate_sent(4.0, 3, 1), Some(3));
        assert_eq!(of(45).estimate_sent(4.0, 180, 1), Some(180));
    }

    #[test]
    fn a_sender_that_does_not_count_loses_nothing() {
        assert_eq!(of(45).estimate_sent(0.1, 0, 4), Some(0));
        assert_eq!(of(45).estimate_sent(0.1, 200, 4), Some(0));
        assert_eq!(of(0).estimate_sent(10.0, 0, 450), Some(0));
    }

    #[test]
    fn the_pace_follows_slowly() {
        let mut pace = of(40);
        pace.update(400, 5.0);
        let per_s = pace.per_s.unwrap();
        assert!((per_s - 48.0).abs() < 1e-9, "{per_s}");
    }
}
