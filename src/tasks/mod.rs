//! One resource each: the shard with its ports, the recorder's file, the observer's terminal, the simulated brick.
//!
//! The shard decodes, fuses and answers without a queue between socket and reply. The others hang off bounded channels: the
//! recorder's waits, because a recording with holes cannot be replayed; the observer's drops and counts.

mod gulps;
pub mod observer;
pub mod recorder;
pub mod shard;
pub mod sim_brick;
