//! The NXT's protocol against a double of the brick, in virtual time.
#![expect(clippy::expect_used, clippy::panic, reason = "helpers outside #[test] stop where the test is broken")]
#![expect(clippy::wildcard_enum_match_arm, reason = "each test looks for one kind of message among all")]
#![expect(clippy::print_stdout, reason = "figures are for whoever runs the tests with --nocapture")]

mod bench;
mod brick;
mod damage;
mod golden;
mod missing_sensors;
mod push;
mod rates;
mod session;
