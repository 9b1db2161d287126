//! What a run was worth: figures of merit, pictures and tables over estimates, odometry, fixes and truth.
//!
//! The shell and the experiments give it what a run or a recording left behind; it gives back numbers
//! ([`metrics`]), SVG text ([`figures`]) and aligned plain text ([`report`]). It reads no file, writes none, draws no
//! random number but by a given seed (the links of [`clocks`]), and holds no estimator of its own: two calls with the same data give the
//! same bytes.
//!
//! Everything is in the arena, in SI units and in brick time; millimetres and degrees appear only in text for people.
//! A value that is not finite is left out and counted, never averaged and never drawn.
//!
//! ```
//! use posebridge_analysis::metrics::{PoseError, summarise};
//! let errors = [
//!     PoseError { dx_m: 0.003, dy_m: 0.004, heading_rad: None, covariance: None },
//!     PoseError { dx_m: 0.0, dy_m: 0.001, heading_rad: None, covariance: None },
//! ];
//! let summary = summarise(&errors);
//! assert_eq!(summary.position_max_m, Some(0.005));
//! assert_eq!(summary.position_end_m, Some(0.001));
//! ```

pub mod accuracy;
pub mod calibration;
pub mod clocks;
pub mod ends;
pub mod figures;
pub mod identification;
mod markup;
pub mod metrics;
pub mod noise_identification;
pub mod recorded_drive;
pub mod report;
pub mod smoothed;
pub mod square;
pub mod track;
pub mod tuning;
pub mod wall;

pub use figures::{FIGURES, Figure, FixMark, RunLayers};
pub use metrics::{
    Consistency, ConsistencyBand, ErrorSummary, Evidence, METRICS, Metric, PoseError, RecentNis, SourceTally,
    mean_over_runs, summarise, tally,
};
pub use report::{EstimatorRow, RunRow};
pub use smoothed::SmoothedPath;
pub use track::{TimedPose, Track};
