//! The columns of a file of sensor data, and what can be wrong with it, named so that a person finds the place.

/// Every column that may stand in a file.
pub const COLUMNS: [&str; 15] = [
    "time_s",
    "left_counts",
    "right_counts",
    "left_deg",
    "right_deg",
    "gyro_deg_per_s",
    "accel_left_m_per_s2",
    "accel_right_m_per_s2",
    "camera_x_m",
    "camera_y_m",
    "camera_theta_deg",
    "compass_deg",
    "truth_x_m",
    "truth_y_m",
    "truth_theta_deg",
];

/// More rows than this are no lap: fourteen hours at 20 Hz.
pub const MAX_ROWS: usize = 1_000_000;
/// No sensor of a robot says more than this in any of our units.
pub(super) const MAX_VALUE: f64 = 1e9;

/// Why a text is no table; lines and columns count from 1.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorTextError {
    /// There is no line with the names of the columns.
    #[error("there is no line with the names of the columns; begin with time_s,left_counts,right_counts")]
    NoHeader,
    /// A column is called as none is.
    #[error("line {line}: no column is called `{name}`; there are {}", COLUMNS.join(", "))]
    UnknownColumn {
        /// The line.
        line: usize,
        /// The name.
        name: String,
    },
    /// A column stands there twice.
    #[error("line {line}: the column `{name}` stands there twice")]
    RepeatedColumn {
        /// The line.
        line: usize,
        /// The name.
        name: String,
    },
    /// A column is needed.
    #[error("line {line}: there is no column `{name}`; {advice}")]
    MissingColumn {
        /// The line.
        line: usize,
        /// The name.
        name: &'static str,
        /// What to do.
        advice: &'static str,
    },
    /// A row is longer or shorter than the header.
    #[error("line {line} has {found} cells, the header has {expected}; leave a cell empty where a sensor said nothing")]
    Cells {
        /// The line.
        line: usize,
        /// Cells in it.
        found: usize,
        /// Cells in the header.
        expected: usize,
    },
    /// A cell is no number that a sensor can say.
    #[error("line {line}, column `{column}`: `{text}` is not a finite number of sensible size")]
    Number {
        /// The line.
        line: usize,
        /// The column.
        column: &'static str,
        /// What stands there.
        text: String,
    },
    /// A cell that must hold a number is empty.
    #[error("line {line}, column `{column}`: a number is needed in every row, because {reason}")]
    Empty {
        /// The line.
        line: usize,
        /// The column.
        column: &'static str,
        /// Why.
        reason: &'static str,
    },
    /// Time does not run forwards.
    #[error(
        "line {line}, column `time_s`: {time_s} s does not come after {before_s} s; sort the rows and drop repeated ones"
    )]
    Time {
        /// The line.
        line: usize,
        /// What stands there, s.
        time_s: f64,
        /// The row before, s.
        before_s: f64,
    },
    /// Too few rows to be a drive.
    #[error("there are {rows} rows; a drive has at least 2")]
    TooFew {
        /// How many.
        rows: usize,
    },
    /// More rows than can be a drive.
    #[error("line {line}: more than {MAX_ROWS} rows; cut the file")]
    TooMany {
        /// The line.
        line: usize,
    },
}
