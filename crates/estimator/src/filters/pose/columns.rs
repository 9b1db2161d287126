//! Maps named states to columns of the pose filter's state; nothing else knows both.

use nalgebra::SMatrix;

use super::state::{
    BEACONS, DELAY, FORWARD, GYRO_BIAS, HEADING, LANDMARK_OFFSET, LANDMARK_SCALE, LEFT, MAX_BEACONS, PoseState,
    ROUNDING, TAG_FORWARD, TAG_LEFT, WINDOW_TURN,
};
use crate::models::lie::Se2;
use crate::observations::gyro_window::GyroWindowModel;
use crate::observations::model::{ObservationModel, PoseView, StateTerm};
use crate::update::{LinearizedMeasurement, ScalarMeasurement};

/// The column of a named state in the largest state vector; `None` for a beacon beyond the limit.
const fn column(term: StateTerm) -> Option<usize> {
    match term {
        StateTerm::GyroBias => Some(GYRO_BIAS),
        StateTerm::WindowTurn => Some(WINDOW_TURN),
        StateTerm::HeadingRounding => Some(ROUNDING),
        StateTerm::FixDelay => Some(DELAY),
        StateTerm::TagForward => Some(TAG_FORWARD),
        StateTerm::TagLeft => Some(TAG_LEFT),
        StateTerm::BeaconOffset(slot) if slot < MAX_BEACONS => Some(BEACONS + 2 * slot),
        StateTerm::BeaconScale(slot) if slot < MAX_BEACONS => Some(BEACONS + 2 * slot + 1),
        StateTerm::BeaconOffset(_) | StateTerm::BeaconScale(_) => None,
        StateTerm::LandmarkOffset => Some(LANDMARK_OFFSET),
        StateTerm::LandmarkScale => Some(LANDMARK_SCALE),
    }
}

impl<const N: usize> PoseView for PoseState<N> {
    fn pose(&self) -> Se2 {
        self.pose
    }

    fn term(&self, term: StateTerm) -> f64 {
        column(term).filter(|column| *column < N).map_or(0.0, |column| self.mean[column])
    }
}

/// H over the filter's columns; states that this filter does not have are left out.
pub fn linearize<const N: usize, const M: usize>(model: &ObservationModel<M>) -> LinearizedMeasurement<N, M> {
    let mut jacobian = SMatrix::<f64, M, N>::zeros();
    for (index, row) in model.rows.iter().enumerate() {
        jacobian[(index, FORWARD)] = row.forward;
        jacobian[(index, LEFT)] = row.left;
        jacobian[(index, HEADING)] = row.heading;
        for (term, derivative) in row.terms.into_iter().flatten() {
            if let Some(column) = column(term).filter(|column| *column < N) {
                jacobian[(index, column)] = derivative;
            }
        }
    }
    LinearizedMeasurement { innovation: model.innovation, jacobian, noise: model.noise }
}

/// A gyro window over the columns, which every variant of the filter has.
pub const fn linearize_gyro_window(model: &GyroWindowModel) -> ScalarMeasurement<3> {
    ScalarMeasurement {
        innovation: model.innovation,
        rows: [WINDOW_TURN, GYRO_BIAS, ROUNDING],
        jacobian: [model.by_window_turn, model.by_gyro_bias, model.by_rounding],
        variance: model.variance,
    }
}
