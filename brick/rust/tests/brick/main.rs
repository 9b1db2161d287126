//! The crate beside the other languages of the brick SDK: the same bytes, the same results from a damaged link, no standard library.
#![expect(clippy::unwrap_used, clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod hostile;
mod no_std;
mod support;
mod vectors;
