//! The states of the bound beyond its core, and the rows by which observations of the arena depend on all of them.
//!
//! Rows of the observation models are by the error of the pose in the body's frame; the bound's pose is that of the arena, so that with
//! the heading th
//!
//! ```text
//! dh/dx = cos(th) h_f - sin(th) h_l        dh/dy = sin(th) h_f + cos(th) h_l
//! ```

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{Calibration, MountedSensor, ObservationKind, SensorId, UncertainValue};

use crate::filter::FilterConfig;
use crate::models::lie::Se2;
use crate::observations::absolute::{MeasuredPoint, RangeBearing, beacon, compass, landmark};
use crate::observations::sensor_frame::{Exposure, SensorFrame};
use crate::observations::{ArenaAxis, JacobianRow, MountingAxis, PoseView, StateTerm};

pub(super) const X: usize = 0;
pub(super) const Y: usize = 1;
pub(super) const HEADING: usize = 2;
pub(super) const GYRO_BIAS: usize = 3;
/// Row of the gyro's turn of the last step beyond that of the wheels.
pub(super) const STEP_ERROR: usize = 4;
/// First of three rows: radius scale, radius difference, track scale.
pub(super) const FIRST_CONSTANT: usize = 5;
/// Rows that every bound has; the motion changes no others.
pub(super) const CORE: usize = 8;

/// An observation after step `exposure_step`, available from step `arrival_step` on. Both count steps from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrivedObservation {
    pub exposure_step: usize,
    /// Not before `exposure_step`.
    pub arrival_step: usize,
    pub sensor: SensorId,
    /// Only its kind, its subject and the size of a range matter.
    pub measurement: ObservationKind,
}

/// One scalar of an observation: its derivatives by the rows of the bound, and its variance.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ObservedScalar {
    /// In the order of the rows.
    pub(super) entries: Vec<(usize, f64)>,
    pub(super) variance: f64,
}

/// The states beyond the core: what the configuration leaves unknown.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ExtraStates {
    /// In the order of the rows, with their prior sigmas.
    pub(super) priors: Vec<(StateTerm, f64)>,
    /// Sources of fixes, by their ids.
    sources: Vec<SensorId>,
}

impl ExtraStates {
    pub(super) fn new(config: &FilterConfig, observations: &[ArrivedObservation]) -> Self {
        let of_fixes = observations.iter().filter(|arrived| matches!(arrived.measurement, ObservationKind::Fix(_)));
        let sources: BTreeSet<SensorId> = of_fixes.map(|arrived| arrived.sensor).collect();
        let mut priors: Vec<(StateTerm, f64)> =
            constants(&config.calibration).into_iter().map(|(term, known)| (term, known.sigma)).collect();
        let mut add = |count: usize, terms: &dyn Fn(usize) -> [StateTerm; 2], sigmas: [f64; 2]| {
            priors.extend((0..count).flat_map(|slot| terms(slot).into_iter().zip(sigmas)));
        };
        let (map, noise, calibration) = (&config.arena_map, &config.noise, &config.calibration);
        add(
            map.beacons.len(),
            &|slot| [StateTerm::BeaconOffset(slot), StateTerm::BeaconScale(slot)],
            [calibration.beacon_offset_m.sigma, calibration.beacon_scale.sigma],
        );
        add(
            map.landmarks.len(),
            &|slot| ArenaAxis::ALL.map(|axis| StateTerm::LandmarkPlace(slot, axis)),
            [noise.landmark_place_m; 2],
        );
        add(
            sources.len(),
            &|slot| ArenaAxis::ALL.map(|axis| StateTerm::FixBias(slot, axis)),
            [noise.fix_persistent_m; 2],
        );
        priors.retain(|(_, sigma)| *sigma > 0.0);
        Self { priors, sources: sources.into_iter().collect() }
    }

    /// `None` for what the configuration takes as known.
    pub(super) fn row(&self, term: StateTerm) -> Option<usize> {
        self.priors.iter().position(|(known, _)| *known == term).map(|index| CORE + index)
    }

    pub(super) fn rows_of_fix_biases(&self) -> impl Iterator<Item = usize> + '_ {
        let rows = (CORE..).zip(&self.priors);
        rows.filter(|(_, (term, _))| matches!(term, StateTerm::FixBias(..))).map(|(row, _)| row)
    }

    /// The scalars of an observation that is measured at the true pose; none of a kind that does not observe it.
    pub(super) fn linearise(
        &self,
        arrived: &ArrivedObservation,
        config: &FilterConfig,
        pose: Se2,
        exposure: &Exposure,
    ) -> Vec<ObservedScalar> {
        let view = TrueState { pose, calibration: &config.calibration };
        let noise = &config.noise;
        let range_m2 = |range_m: f64, sigma_m: f64, share: f64| sigma_m.powi(2) + (share * range_m).powi(2);
        match arrived.measurement {
            ObservationKind::Fix(fix) => {
                let position_m2 = noise.fix_position_m.powi(2);
                let slot = self.sources.iter().position(|source| *source == arrived.sensor).unwrap_or_default();
                let (sin, cos) = pose.heading_rad.sin_cos();
                let v = exposure.forward_m_per_s;
                let mut scalars = vec![
                    self.fix_scalar(X, -v * cos, Some(StateTerm::FixBias(slot, ArenaAxis::X)), position_m2),
                    self.fix_scalar(Y, -v * sin, Some(StateTerm::FixBias(slot, ArenaAxis::Y)), position_m2),
                ];
                if fix.heading.is_some() {
                    let heading_rad2 = noise.fix_heading_rad.powi(2);
                    scalars.push(self.fix_scalar(HEADING, -exposure.turn_rad_per_s, None, heading_rad2));
                }
                scalars
            }
            ObservationKind::Landmark { id, range, bearing } => {
                let Some((slot, position)) = position_of(&config.arena_map.landmarks, &id) else { return Vec::new() };
                let frame = SensorFrame::of_sensor(&view, MountedSensor::Landmarks, exposure);
                let variances = [
                    range_m2(range.0, noise.landmark_range_m, noise.landmark_range_share),
                    noise.landmark_bearing_rad.powi(2),
                ];
                let measured = RangeBearing { range_m: range.0, bearing_rad: bearing.0 };
                let point = MeasuredPoint::landmark(position, slot);
                let model = landmark(&view, &frame, &point, measured, variances);
                model.map_or_else(Vec::new, |model| self.scalars(&model.rows, &variances, pose))
            }
            ObservationKind::BeaconRange { id, range } => {
                let Some((slot, position)) = position_of(&config.arena_map.beacons, &id) else { return Vec::new() };
                let frame = SensorFrame::of_sensor(&view, MountedSensor::Beacons, exposure);
                let variance = range_m2(range.0, noise.beacon_range_m, noise.beacon_range_share);
                let model = beacon(&view, &frame, &MeasuredPoint::beacon(position, slot), range.0, variance);
                model.map_or_else(Vec::new, |model| self.scalars(&model.rows, &[variance], pose))
            }
            ObservationKind::CompassHeading(heading) => {
                let frame = SensorFrame::of_sensor(&view, MountedSensor::Compass, exposure);
                let variance = noise.compass_rad.powi(2);
                self.scalars(&compass(&frame, heading.rad(), variance).rows, &[variance], pose)
            }
            ObservationKind::WheelAngles { .. }
            | ObservationKind::OdometerPose(_)
            | ObservationKind::BodyVelocity { .. }
            | ObservationKind::TurnRate(_)
            | ObservationKind::WheelAccelerations { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::Temperature(_) => Vec::new(),
        }
    }

    fn fix_scalar(&self, row: usize, by_delay: f64, bias: Option<StateTerm>, variance: f64) -> ObservedScalar {
        let delay = self.row(StateTerm::FixDelay).map(|row| (row, by_delay));
        let bias = bias.and_then(|term| self.row(term)).map(|row| (row, 1.0));
        let entries = [Some((row, 1.0)), delay, bias].into_iter().flatten();
        ObservedScalar { entries: entries.collect(), variance }
    }

    fn scalars(&self, rows: &[JacobianRow], variances: &[f64], pose: Se2) -> Vec<ObservedScalar> {
        let (sin, cos) = pose.heading_rad.sin_cos();
        let scalars = rows.iter().zip(variances).map(|(row, variance)| {
            let of_pose = [
                (X, cos * row.forward - sin * row.left),
                (Y, sin * row.forward + cos * row.left),
                (HEADING, row.heading),
            ];
            let terms = row.terms.iter().flatten();
            let of_terms = terms.filter_map(|(term, derivative)| Some((self.row(*term)?, *derivative)));
            let mut entries: Vec<(usize, f64)> = of_pose.into_iter().chain(of_terms).collect();
            entries.sort_by_key(|(row, _)| *row);
            ObservedScalar { entries, variance: *variance }
        });
        scalars.collect()
    }
}

/// The constants of a calibration that are not in the core.
fn constants(calibration: &Calibration) -> Vec<(StateTerm, UncertainValue)> {
    let mut constants = vec![
        (StateTerm::GyroScale, calibration.gyro_scale),
        (StateTerm::FixDelay, calibration.fix_delay_s),
        (StateTerm::LandmarkOffset, calibration.landmark_offset_m),
        (StateTerm::LandmarkScale, calibration.landmark_scale),
        (StateTerm::Delay(MountedSensor::Landmarks), calibration.landmark_delay_s),
        (StateTerm::Delay(MountedSensor::Beacons), calibration.beacon_delay_s),
        (StateTerm::Delay(MountedSensor::Compass), calibration.compass_delay_s),
    ];
    for sensor in [MountedSensor::Landmarks, MountedSensor::Beacons, MountedSensor::Compass] {
        let mounting = &calibration.mountings[sensor];
        let values = [mounting.x_m, mounting.y_m, mounting.yaw_rad];
        let terms = MountingAxis::ALL.map(|axis| StateTerm::Mounting(sensor, axis));
        constants.extend(terms.into_iter().zip(values));
    }
    constants
}

/// The true pose, with the constants as configured: their errors change the rows by less than a per cent.
struct TrueState<'a> {
    pose: Se2,
    calibration: &'a Calibration,
}

impl PoseView for TrueState<'_> {
    fn pose(&self) -> Se2 {
        self.pose
    }

    fn term(&self, term: StateTerm) -> f64 {
        let constants = constants(self.calibration);
        constants.into_iter().find(|(known, _)| *known == term).map_or(0.0, |(_, known)| known.value)
    }
}

/// The number of a point among those of the map, and its position.
fn position_of<K: Ord, P: Copy>(points: &BTreeMap<K, P>, id: &K) -> Option<(usize, P)> {
    points.iter().enumerate().find(|(_, (known, _))| *known == id).map(|(slot, (_, position))| (slot, *position))
}
