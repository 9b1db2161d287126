//! The NXT's protocol against a double of the brick, in virtual time.

mod battery;
mod bench;
mod brick;
mod damage;
mod golden;
mod missing_sensors;
mod push;
mod rates;
mod session;
