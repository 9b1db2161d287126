//! The NXT's protocol against a double of the brick, in virtual time.
#![expect(
    clippy::expect_used,
    clippy::panic,
    reason = "helpers outside #[test] stop where the test is broken"
)]

mod bench;
mod brick;
mod damage;
mod golden;
mod push;
mod rates;
mod session;
