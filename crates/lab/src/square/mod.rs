//! The square of paper 1: three filters over one table of sensor readings, and a test of the ranking that the paper claims.
//!
//! Source: Paper 1 (Valera et al.), equations 12 to 26 and figures 5 to 7; docs/lab/square.md.

mod csv;
mod methods;
mod noise;
mod recorded;
mod report;
mod score;
mod table;
mod tuned;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{Heading, Meters, Pose, StartPose, UncertainValue};

pub use self::csv::{MAX_ROWS, SensorTextError, parse, write};
pub use self::methods::{DriveState, Method, MethodGroup, chains, outlook, printed_chain, swapped_chain};
pub use self::noise::{
    MeanAndVariance, NoiseRecord, RoundingVariances, noise_at_stop, noise_on_straight, rounding_variances,
};
pub use self::recorded::table_of;
pub use self::report::{MethodRanking, PaperInterpretation, RecoveryTrial, SquareExample, SquareReport};
pub use self::score::{ErrorMetric, MethodOrder, OrderStep, PathErrors, compare_order, path_errors, true_speeds};
pub use self::table::{
    EncoderUnit, MeasuredPose, SensorRow, SensorTable, TableSensor, add_compass, add_jitter, align_accelerations,
    delay_reference,
};

pub use self::tuned::ChainMatrices;

/// Minimum gyro readings at rest for a bias.
const MIN_REST_ROWS: usize = 20;
/// Sigma of a true start, m and rad; as in the Monte-Carlo scenarios.
const EXACT_START_SIGMA: f64 = 1e-4;

/// Filter configuration for one table: the start from its first row, the gyro's bias from the initial rest.
///
/// Without a pose in the first row the configured start is used, else the arena's origin.
pub fn prepare_config(table: &SensorTable, base: &FilterConfig) -> FilterConfig {
    let mut config = base.clone();
    config.start = Some(start_pose(table, base));
    if let Some(bias) = bias_at_rest(table, base) {
        config.calibration.gyro_bias_rad_per_s = bias;
    }
    config
}

fn start_pose(table: &SensorTable, base: &FilterConfig) -> StartPose {
    let first = table.rows.first();
    let exact = StartPose {
        pose: Pose::new(Meters(0.0), Meters(0.0), Heading::from_rad(0.0)),
        position_sigma_m: EXACT_START_SIGMA,
        heading_sigma_rad: EXACT_START_SIGMA,
    };
    if let Some(truth) = first.and_then(|row| row.truth) {
        return StartPose { pose: truth.pose(), ..exact };
    }
    let initial_row = first.and_then(|row| row.camera).filter(|measured| measured.theta_deg.is_some());
    if let Some(measured) = initial_row {
        return StartPose {
            pose: measured.pose(),
            position_sigma_m: base.noise.fix_position_m,
            heading_sigma_rad: base.noise.fix_heading_rad,
        };
    }
    base.start.unwrap_or(exact)
}

/// The gyro's bias is its mean while the robot stands, as a user would calibrate it before the drive.
fn bias_at_rest(table: &SensorTable, base: &FilterConfig) -> Option<UncertainValue> {
    let readings = table.at_rest().iter().filter_map(|row| row.gyro_deg_per_s);
    let readings: Vec<f64> = readings.collect();
    if readings.len() < MIN_REST_ROWS {
        return None;
    }
    let n = readings.len() as f64;
    let noise = &base.noise;
    let variance = noise.gyro_rad_per_s.powi(2) + noise.gyro_resolution_rad_per_s.powi(2) / 12.0;
    Some(UncertainValue { value: (readings.iter().sum::<f64>() / n).to_radians(), sigma: (variance / n).sqrt() })
}
