//! Linear algebra and statistics: pure numbers, no robot, no filter.

pub mod chi_square;
pub mod cholesky;
pub mod covariance;
pub mod quantization;
pub mod statistics;
