//! Long runs over the worst links, in virtual and in real time.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and a long run shows how it goes"
)]

#[path = "../support/mod.rs"]
mod support;

mod real_time;
mod virtual_time;

/// Frames by which the two accounts may differ, because no receiver can see the damage: a byte that is missing at a frame's edge and the
/// equal last byte of a damaged neighbour that takes its place, or a 16-bit checksum that fits by chance. A few a day are expected of
/// some hundred thousand damaged and torn frames.
const UNSEEN_PER_HOUR: f64 = 0.2;

/// Damaged frames that may have passed for whole ones in so many hours.
fn max_unseen(hours: f64) -> f64 {
    1.0 + UNSEEN_PER_HOUR * hours
}

/// What became of the frames of one sender.
#[derive(Clone, Copy, Debug, Default)]
struct FrameAccount {
    /// Frames that came, copies among them.
    received: u64,
    /// Frames that are missing.
    lost: u64,
}

impl FrameAccount {
    /// Whether the station's account is as good as that of the link: what came but for damage that nobody can see, and the sum but
    /// for frames that an 8-bit number does not date.
    fn agrees(self, made: Self, unseen: f64, undatable: u64) -> bool {
        let [sum, sum_made] = [self, made].map(|account| account.received + account.lost);
        self.received.abs_diff(made.received) as f64 <= unseen && sum.abs_diff(sum_made) <= undatable
    }
}
