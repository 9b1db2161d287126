//! The fleet from outside: keys and estimates.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the test itself is wrong")]

mod estimate;
mod keys;
