//! What is connected, counted or configured wrongly on a robot is named, and nothing is named on a robot without a fault.

mod csv_recordings;
mod drives;
mod laboratory;
mod simulated_brick;
