//! Which states a filter has, and in which row each is: the core of every robot, and what its configuration leaves unknown.
//!
//! Rows beyond the core follow each other without gaps, in the order of the priors, so that a robot pays only for what it
//! estimates. Only this file knows both names and rows.

use std::ops::Range;

use nalgebra::SMatrix;
use posebridge_telemetry::{Calibration, MountedSensor, UncertainValue};

use crate::filter::FilterConfig;
use crate::observations::{ArenaAxis, MountingAxis, ObservationModel, StateTerm};
use crate::update::LinearizedMeasurement;

// Rows of the core, in the order of the head of state.rs.

pub const FORWARD: usize = 0;
pub const LEFT: usize = 1;
pub const HEADING: usize = 2;
pub const GYRO_BIAS: usize = 3;
pub const WINDOW_TURN: usize = 4;
pub const RADIUS: usize = 5;
pub const DIFFERENCE: usize = 6;
pub const TRACK: usize = 7;
pub const ROUNDING: usize = 8;
pub const GYRO_SCALE: usize = 9;
pub const BACKLASH: usize = 10;
/// Number of states that every filter has.
pub const CORE_STATES: usize = 11;

/// Rows of the smallest filter that has more than the core.
pub const SMALL_STATES: usize = 16;
/// Rows of a filter for ranges and mountings.
pub const MEDIUM_STATES: usize = 32;
/// Rows of the largest filter, which may have the positions of two dozen landmarks.
pub const LARGE_STATES: usize = 64;

/// Most beacons with an offset and a scale of their own; ranges to further ones are used as measured.
pub const MAX_BEACONS: usize = 8;
/// Most sources of fixes whose shared error is a state.
pub const MAX_FIX_SOURCES: usize = 4;
/// Most landmarks whose positions are states; positions of further ones are taken from the map.
pub const MAX_LANDMARKS: usize = 24;

/// A state beyond the core with its prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatePrior {
    pub term: StateTerm,
    pub row: usize,
    pub known: UncertainValue,
}

/// The rows of the states beyond the core.
#[derive(Clone, Debug, PartialEq)]
pub struct StateLayout {
    priors: Vec<StatePrior>,
    /// The row of each term by its [`index`]; zero, which is a row of the core, for none.
    rows: [u8; INDEXES],
    fix_bias_rows: Range<usize>,
    delay_rows: Vec<usize>,
}

impl StateLayout {
    /// The states of a configuration, of which the filter has no more than `max_states`. The last ones are left out.
    pub fn new(config: &FilterConfig, max_states: usize) -> Self {
        let mut layout = Self { priors: Vec::new(), rows: [0; INDEXES], fix_bias_rows: 0..0, delay_rows: Vec::new() };
        for (term, known) in priors(config) {
            let row = CORE_STATES + layout.priors.len();
            if row >= max_states.min(LARGE_STATES) {
                break;
            }
            if let Some(index) = index(term) {
                layout.rows[index] = row as u8;
                layout.priors.push(StatePrior { term, row, known });
                if matches!(term, StateTerm::FixDelay | StateTerm::Delay(_)) {
                    layout.delay_rows.push(row);
                }
                if matches!(term, StateTerm::FixBias(..)) {
                    let first = if layout.fix_bias_rows.is_empty() { row } else { layout.fix_bias_rows.start };
                    layout.fix_bias_rows = first..row + 1;
                }
            }
        }
        layout
    }

    /// Number of rows, the core included.
    pub fn states(&self) -> usize {
        CORE_STATES + self.priors.len()
    }

    pub fn priors(&self) -> &[StatePrior] {
        &self.priors
    }

    /// The rows of the errors that fixes share.
    pub fn fix_bias_rows(&self) -> Range<usize> {
        self.fix_bias_rows.clone()
    }

    /// The rows of delays by other clocks than the brick's.
    pub fn delay_rows(&self) -> &[usize] {
        &self.delay_rows
    }

    /// The row of a named state; `None` for one that this filter does not have.
    pub fn row(&self, term: StateTerm) -> Option<usize> {
        match term {
            StateTerm::GyroBias => Some(GYRO_BIAS),
            StateTerm::GyroScale => Some(GYRO_SCALE),
            StateTerm::Backlash => Some(BACKLASH),
            StateTerm::WindowTurn => Some(WINDOW_TURN),
            StateTerm::HeadingRounding => Some(ROUNDING),
            StateTerm::OdometryDelay
            | StateTerm::FixDelay
            | StateTerm::TagForward
            | StateTerm::TagLeft
            | StateTerm::BeaconOffset(_)
            | StateTerm::BeaconScale(_)
            | StateTerm::LandmarkOffset
            | StateTerm::LandmarkScale
            | StateTerm::Delay(_)
            | StateTerm::Mounting(..)
            | StateTerm::LandmarkPlace(..)
            | StateTerm::FixBias(..) => index(term).map(|index| usize::from(self.rows[index])).filter(|row| *row > 0),
        }
    }

    /// H over the filter's rows; states that this filter does not have are left out.
    pub fn linearize<const N: usize, const M: usize>(
        &self,
        model: &ObservationModel<M>,
    ) -> LinearizedMeasurement<N, M> {
        let mut jacobian = SMatrix::<f64, M, N>::zeros();
        for (index, row) in model.rows.iter().enumerate() {
            jacobian[(index, FORWARD)] = row.forward;
            jacobian[(index, LEFT)] = row.left;
            jacobian[(index, HEADING)] = row.heading;
            for (term, derivative) in row.terms.into_iter().flatten() {
                if let Some(column) = self.row(term) {
                    jacobian[(index, column)] = derivative;
                }
            }
        }
        LinearizedMeasurement { innovation: model.innovation, jacobian, noise: model.noise }
    }
}

// The order of the terms in the table of rows.
const FIX: usize = 0;
const RANGES: usize = FIX + 4;
const DELAYS: usize = RANGES + 2;
const MOUNTINGS: usize = DELAYS + MountedSensor::ALL.len();
const BEACONS: usize = MOUNTINGS + 3 * MountedSensor::ALL.len();
const FIX_BIASES: usize = BEACONS + 2 * MAX_BEACONS;
const PLACES: usize = FIX_BIASES + 2 * MAX_FIX_SOURCES;
const INDEXES: usize = PLACES + 2 * MAX_LANDMARKS;

/// The place of a term in the table of rows; `None` for a term of the core, and for one beyond a limit.
const fn index(term: StateTerm) -> Option<usize> {
    match term {
        StateTerm::FixDelay => Some(FIX),
        StateTerm::TagForward => Some(FIX + 1),
        StateTerm::TagLeft => Some(FIX + 2),
        StateTerm::OdometryDelay => Some(FIX + 3),
        StateTerm::LandmarkOffset => Some(RANGES),
        StateTerm::LandmarkScale => Some(RANGES + 1),
        StateTerm::Delay(sensor) => Some(DELAYS + sensor as usize),
        StateTerm::Mounting(sensor, axis) => Some(MOUNTINGS + 3 * sensor as usize + axis as usize),
        StateTerm::BeaconOffset(slot) if slot < MAX_BEACONS => Some(BEACONS + 2 * slot),
        StateTerm::BeaconScale(slot) if slot < MAX_BEACONS => Some(BEACONS + 2 * slot + 1),
        StateTerm::FixBias(slot, axis) if slot < MAX_FIX_SOURCES => Some(FIX_BIASES + 2 * slot + axis as usize),
        StateTerm::LandmarkPlace(slot, axis) if slot < MAX_LANDMARKS => Some(PLACES + 2 * slot + axis as usize),
        StateTerm::BeaconOffset(_)
        | StateTerm::BeaconScale(_)
        | StateTerm::FixBias(..)
        | StateTerm::LandmarkPlace(..)
        | StateTerm::GyroBias
        | StateTerm::GyroScale
        | StateTerm::Backlash
        | StateTerm::WindowTurn
        | StateTerm::HeadingRounding => None,
    }
}

/// The states beyond the core that a configuration leaves unknown, or whose value is not zero.
fn priors(config: &FilterConfig) -> Vec<(StateTerm, UncertainValue)> {
    let mut calibration = config.calibration;
    let terms = calibration_terms(config.arena_map.beacons.len().min(MAX_BEACONS));
    let known = terms.filter_map(|term| Some((term, *calibration_field(&mut calibration, term)?)));
    let mut priors: Vec<_> = known.filter(|(_, known)| known.sigma > 0.0 || known.value != 0.0).collect();
    let mut push_axes = |count: usize, sigma: f64, term: fn(usize, ArenaAxis) -> StateTerm| {
        if sigma > 0.0 {
            let terms = (0..count).flat_map(|slot| ArenaAxis::ALL.map(|axis| term(slot, axis)));
            priors.extend(terms.map(|term| (term, UncertainValue { value: 0.0, sigma })));
        }
    };
    let noise = &config.noise;
    push_axes(MAX_FIX_SOURCES, noise.fix_persistent_m, StateTerm::FixBias);
    push_axes(config.arena_map.landmarks.len().min(MAX_LANDMARKS), noise.landmark_place_m, StateTerm::LandmarkPlace);
    priors
}

/// The constants beyond the core, in the order of their rows.
fn calibration_terms(beacons: usize) -> impl Iterator<Item = StateTerm> {
    // Accelerations only predict the speeds: no observation could tell anything of where they are measured.
    let observing = MountedSensor::ALL.into_iter().filter(|sensor| *sensor != MountedSensor::Imu);
    let of_mountings = observing.flat_map(|sensor| {
        let axes = MountingAxis::ALL.map(|axis| StateTerm::Mounting(sensor, axis));
        std::iter::once(StateTerm::Delay(sensor)).chain(axes)
    });
    let of_beacons = (0..beacons).flat_map(|slot| [StateTerm::BeaconOffset(slot), StateTerm::BeaconScale(slot)]);
    [
        StateTerm::OdometryDelay,
        StateTerm::FixDelay,
        StateTerm::TagForward,
        StateTerm::TagLeft,
        StateTerm::LandmarkOffset,
        StateTerm::LandmarkScale,
    ]
    .into_iter()
    .chain(of_mountings)
    .chain(of_beacons)
}

/// The constant of a term; `None` for a term that is none. All beacons have one prior.
pub(super) fn calibration_field(calibration: &mut Calibration, term: StateTerm) -> Option<&mut UncertainValue> {
    let field = match term {
        StateTerm::GyroBias => &mut calibration.gyro_bias_rad_per_s,
        StateTerm::GyroScale => &mut calibration.gyro_scale,
        StateTerm::Backlash => &mut calibration.backlash_rad,
        StateTerm::OdometryDelay => &mut calibration.odometry_delay_s,
        StateTerm::FixDelay => &mut calibration.fix_delay_s,
        StateTerm::TagForward => &mut calibration.tag_forward_m,
        StateTerm::TagLeft => &mut calibration.tag_left_m,
        StateTerm::LandmarkOffset => &mut calibration.landmark_offset_m,
        StateTerm::LandmarkScale => &mut calibration.landmark_scale,
        StateTerm::BeaconOffset(_) => &mut calibration.beacon_offset_m,
        StateTerm::BeaconScale(_) => &mut calibration.beacon_scale,
        StateTerm::Delay(sensor) => match sensor {
            MountedSensor::Landmarks => &mut calibration.landmark_delay_s,
            MountedSensor::Beacons => &mut calibration.beacon_delay_s,
            MountedSensor::Range => &mut calibration.range_delay_s,
            MountedSensor::Compass => &mut calibration.compass_delay_s,
            MountedSensor::Imu => return None,
        },
        StateTerm::Mounting(sensor, axis) => {
            let mounting = &mut calibration.mountings[sensor];
            match axis {
                MountingAxis::Forward => &mut mounting.x_m,
                MountingAxis::Left => &mut mounting.y_m,
                MountingAxis::Yaw => &mut mounting.yaw_rad,
            }
        }
        StateTerm::WindowTurn | StateTerm::HeadingRounding | StateTerm::LandmarkPlace(..) | StateTerm::FixBias(..) => {
            return None;
        }
    };
    Some(field)
}
