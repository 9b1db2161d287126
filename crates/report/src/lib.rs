//! Evaluation of runs: metrics, figures, tables and pages over estimates, odometry, fixes and truth.
//!
//! Input is the data of a run or a recording; output is numbers ([`metrics`]), SVG text ([`chart`]), aligned plain text ([`tables`])
//! and HTML ([`page`]); a [`report::Report`] renders text, page and JSON from the same values. It does no IO, draws no random numbers
//! and contains no estimator: two calls with the same data give the same bytes.
//!
//! Everything is in the arena, in SI units and in brick time; millimetres and degrees appear only in text for people. Non-finite values
//! are omitted and counted, never averaged and never drawn.
//!
//! ```
//! use posebridge_report::metrics::{PoseError, summarise};
//! let errors = [
//!     PoseError { dx_m: 0.003, dy_m: 0.004, heading_rad: None, covariance: None },
//!     PoseError { dx_m: 0.0, dy_m: 0.001, heading_rad: None, covariance: None },
//! ];
//! let summary = summarise(&errors);
//! assert_eq!(summary.position_max_m, Some(0.005));
//! assert_eq!(summary.position_end_m, Some(0.001));
//! ```

pub mod answer;
pub mod chart;
pub mod colour;
mod markup;
pub mod metrics;
pub mod page;
pub mod quantity;
pub mod report;
pub mod setup_checklist;
pub mod tables;
pub mod track;

pub use self::answer::{RunAnswer, final_pose_text};
pub use self::chart::{ComparedTrack, FIGURES, Figure, FixMark, RunLayers, on_map};
pub use self::metrics::{
    Consistency, ConsistencyBand, ErrorSummary, FilterVerdict, PoseError, RecentInnovations, SourceTally,
    mean_over_runs, source_verdicts, summarise, tally_sources,
};
pub use self::tables::{EstimatorRow, RunRow};
pub use self::track::{PoseTrack, SmoothedPath, TimedPose};
