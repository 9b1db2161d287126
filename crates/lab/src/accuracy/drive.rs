//! A drive with its truth and what was observed on it.

use posebridge_report::track::TimedPose;
use posebridge_telemetry::Observation;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReferenceDrive {
    /// At the start and at the end of each step, in time order.
    pub truth: Vec<TimedPose>,
    pub arrivals: Vec<ObservationArrival>,
    /// Index into `truth` from which errors count.
    pub scored_from: usize,
    /// Indexes into `truth` at which the robot stands where no filter knows it to be.
    pub landings: Vec<usize>,
    /// Indexes into `truth` at which a wheel begins to spin.
    pub slip_bursts: Vec<usize>,
}

/// An observation and its arrival; its own timestamp may be earlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservationArrival {
    /// Index into [`ReferenceDrive::truth`]: it arrives before that step is scored.
    pub step: usize,
    /// Index of the true pose that it measures.
    pub measured_step: usize,
    pub observation: Observation,
}
