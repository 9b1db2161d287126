//! A compass for drives that were drawn without one: the true heading, bent by iron on the robot, noisy, in whole degrees.
//!
//! # Model
//! ```text
//! z = round(th + a sin(th - phi) + sigma n)      a, phi drawn once per drive; n standard normal
//! ```
//! The deviation of iron that turns with the robot is one period per turn, to first order (the "semicircular" deviation of
//! a ship's compass). Sources: National Geospatial-Intelligence Agency, Handbook of Magnetic Compass Adjustment (2004), chapter 3;
//! one degree of resolution: data sheet of the HiTechnic compass.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::table::SensorTable;

/// White noise of one reading, degrees.
pub const SIGMA_DEG: f64 = 3.0;
/// Standard deviation of the amplitude of the deviation, degrees: motors bend the field by some degrees.
pub const DEVIATION_SIGMA_DEG: f64 = 3.0;

/// Fills the compass column of every row that has a true heading.
pub fn add(table: &mut SensorTable, seed: u64) {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0xc0_4a55);
    let mut normal = || {
        // Box and Muller (1958); one of the pair is enough here.
        let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
        radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
    };
    let amplitude_deg = DEVIATION_SIGMA_DEG * normal();
    let phase_rad = std::f64::consts::PI * normal();
    for row in &mut table.rows {
        let Some(theta_deg) = row.truth.and_then(|truth| truth.theta_deg) else {
            continue;
        };
        let bent_deg = amplitude_deg * (theta_deg.to_radians() - phase_rad).sin();
        row.compass_deg = Some((theta_deg + bent_deg + SIGMA_DEG * normal()).round());
    }
}
