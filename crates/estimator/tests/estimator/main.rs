//! The filters and the smoothers from outside: laws for every filter, oracles, order of arrival, and Monte-Carlo against truth.
//!
//! The Monte-Carlo tests print their figures: `cargo test -p posebridge-estimator --test estimator consistency -- --nocapture`.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where a filter gives nothing, and print the figures that they found"
)]

mod adjustments;
mod change_indication;
mod conformance;
mod consistency;
mod dynamic;
mod indirect;
mod jacobians;
mod no_allocation;
mod order;
mod paper1;
mod paper1_behaviour;
mod paper1_order;
mod properties;
mod range;
mod robustness;
mod saved;
mod smoother;
mod smoother_oracle;
mod support;
mod thermometer;
mod update;
mod wiring;
