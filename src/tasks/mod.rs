//! One resource each: the shard with its ports, the recorder's file, the observer's terminal, the simulated brick,
//! the dashboard's server.
//!
//! The shard decodes, fuses and answers without a queue between socket and reply. The others hang off bounded channels that drop and
//! count when they are full. The recorder's is long, and the recording says what it lacks, because with holes its replay is not exact.

pub mod calendar;
pub mod dashboard;
pub mod desk;
mod gulps;
pub mod observer;
pub mod parts;
pub mod recorder;
mod saver;
pub mod shard;
pub mod sim_brick;
pub mod tlog_recorder;
pub mod truth_tap;
pub mod watched;
