//! What is done to a table of a drive before anything follows it: a compass, and other readings of the paper's measurements.
//!
//! # Model
//! ```text
//! compass   z = round(th + a sin(th - phi) + sigma n)      a, phi drawn once per drive; n standard normal
//! jitter    count + sigma_i n, on each reading anew
//! late      the reference of row k is that of row k - d: a camera with an uncorrected delay
//! interval  the accelerations of row k are those of row k + 1
//! ```
//! The deviation of iron that turns with the robot is one period per turn, to first order (the "semicircular" deviation of
//! a ship's compass). Sources: National Geospatial-Intelligence Agency, Handbook of Magnetic Compass Adjustment (2004), chapter 3;
//! one degree of resolution: data sheet of the HiTechnic compass.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::table::SensorTable;

/// White noise of one reading of the compass, degrees.
const COMPASS_SIGMA_DEG: f64 = 3.0;
/// Standard deviation of the amplitude of its deviation, degrees: motors bend the field by some degrees.
const DEVIATION_SIGMA_DEG: f64 = 3.0;

/// Standard normal numbers of a seed.
struct NormalSampler(Pcg64);

impl NormalSampler {
    fn of(seed: u64) -> Self {
        Self(Pcg64::seed_from_u64(seed))
    }

    /// Box and Muller (1958); one of the pair is enough here.
    fn next(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.0.random::<f64>()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.0.random::<f64>()).cos()
    }
}

/// Fills the compass column of every row that has a true heading.
pub fn add_compass(table: &mut SensorTable, seed: u64) {
    let mut normals = NormalSampler::of(seed ^ 0xc0_4a55);
    let amplitude_deg = DEVIATION_SIGMA_DEG * normals.next();
    let phase_rad = std::f64::consts::PI * normals.next();
    for row in &mut table.rows {
        let Some(theta_deg) = row.truth.and_then(|truth| truth.theta_deg) else {
            continue;
        };
        let bent_deg = amplitude_deg * (theta_deg.to_radians() - phase_rad).sin();
        let noise_deg = COMPASS_SIGMA_DEG * normals.next();
        row.compass_deg = Some((theta_deg + bent_deg + noise_deg).round());
    }
}

/// Adds white noise to every reading of both counters but the first; variances of the left and the right one, in the table's unit
/// squared.
pub fn add_jitter(table: &mut SensorTable, variances: [f64; 2], seed: u64) {
    let mut normals = NormalSampler::of(seed ^ 0x71_77e2);
    for row in table.rows.iter_mut().skip(1) {
        for (count, variance) in row.encoders.iter_mut().zip(variances) {
            *count = (*count + variance.sqrt() * normals.next()).round();
        }
    }
}

/// Delays the truth by this number of rows, like that of a camera with an uncorrected delay.
pub fn delay_reference(table: &mut SensorTable, rows: usize) {
    let truths: Vec<_> = table.rows.iter().map(|row| row.truth).collect();
    for (index, row) in table.rows.iter_mut().enumerate() {
        row.truth = truths.get(index.saturating_sub(rows)).copied().flatten();
    }
}

/// Gives each row the accelerations of the next: an accelerometer measures the change of speed over the interval that ends with its
/// reading, and the paper's equation 20 applies the reading of the row before.
pub fn align_accelerations(table: &mut SensorTable) {
    let mut next = None;
    for row in table.rows.iter_mut().rev() {
        next = std::mem::replace(&mut row.accelerations_m_per_s2, next);
    }
}
