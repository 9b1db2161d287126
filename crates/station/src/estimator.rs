//! A robot's estimator: its filter, its disabled sensors, and the monitoring of fixes and slip.

use std::collections::BTreeSet;

use posebridge_estimator::numerics::chi_square::chi_square_quantile;
use posebridge_estimator::{EstimatedQuantity, Filter, FilterCommand, FilterConfig, FilterEntry, Params, RestoreError};
use posebridge_telemetry::{
    BrickClock, Calibration, DriveGeometry, Estimate, FusionOutcome, FusionRecord, Observation, ObservationKind,
    OnlineCalibration, ScalarEstimate, SensorId, SensorSwitch, StartPose, Timestamp,
};
use serde::{Deserialize, Serialize};

/// Most components of a fix: x, y and heading.
const MAX_FIX_COMPONENTS: usize = 3;

/// The filter of one robot.
pub(crate) struct Estimator {
    pub(crate) entry: &'static FilterEntry,
    /// With the geometry that the robot has described, if it has.
    pub(crate) config: FilterConfig,
    /// Private, so that no observation bypasses the disabled sensors and the monitoring.
    filter: Box<dyn Filter>,
    pub(crate) switched_off: BTreeSet<SensorId>,
    pub(crate) online_calibration: OnlineCalibration,
    /// Normalised innovation squared of the last fix over its gate, above 1 if it was rejected; 0 before the first.
    pub(crate) fix_ratio: f64,
    /// The gate of a fix with one, two and three components.
    fix_gates: [f64; MAX_FIX_COMPONENTS],
    /// Resets of filters that were replaced because their numbers were not finite.
    resets_before: u8,
}

/// An estimator without its configuration.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct SavedEstimator {
    filter: Vec<u8>,
    switched_off: BTreeSet<SensorId>,
    online_calibration: OnlineCalibration,
    pub(crate) fix_ratio: f64,
    resets_before: u8,
}

/// What is said of a filter that was replaced.
pub(crate) const RESET_TEXT: &str = "the numbers of its filter grew beyond all bounds: it begins anew, and the pose is unknown until something shows it";

pub(crate) struct FusionReport {
    pub(crate) record: FusionRecord,
    /// The observation left the filter without finite numbers: it was replaced.
    pub(crate) is_reset: bool,
    /// The observation's sensor is enabled.
    pub(crate) is_used: bool,
}

impl Estimator {
    pub(crate) fn new(entry: &'static FilterEntry, config: &FilterConfig) -> Self {
        Self {
            entry,
            config: config.clone(),
            filter: (entry.build)(config),
            switched_off: BTreeSet::new(),
            online_calibration: OnlineCalibration::Enabled,
            fix_ratio: 0.0,
            fix_gates: fix_gates(&config.params),
            resets_before: 0,
        }
    }

    pub(crate) fn save(&self) -> SavedEstimator {
        let Self {
            entry: _,
            config: _,
            filter,
            switched_off,
            online_calibration,
            fix_ratio,
            fix_gates: _,
            resets_before,
        } = self;
        SavedEstimator {
            filter: filter.save(),
            switched_off: switched_off.clone(),
            online_calibration: *online_calibration,
            fix_ratio: *fix_ratio,
            resets_before: *resets_before,
        }
    }

    /// An estimator that continues from what another one of the same configuration has saved.
    pub(crate) fn restored(
        entry: &'static FilterEntry,
        config: &FilterConfig,
        saved: &SavedEstimator,
    ) -> Result<Self, RestoreError> {
        let mut estimator = Self::new(entry, config);
        estimator.filter.restore(&saved.filter)?;
        let latest = estimator.filter.latest_time();
        let is_finite = latest.is_none_or(|latest| {
            estimator.filter.estimate_at(latest).is_none_or(|estimate| estimate.is_finite())
                && estimator.filter.scalar_at(latest).is_none_or(|quantity| quantity.is_finite())
        });
        is_finite.then_some(()).ok_or(RestoreError::Implausible("its estimate is not finite"))?;
        estimator.switched_off.clone_from(&saved.switched_off);
        estimator.online_calibration = saved.online_calibration;
        estimator.fix_ratio = saved.fix_ratio;
        estimator.resets_before = saved.resets_before;
        Ok(estimator)
    }

    /// Uses an observation, late or not, unless its sensor is disabled.
    pub(crate) fn observe(&mut self, observation: &Observation) -> FusionReport {
        if self.switched_off.contains(&observation.sensor) {
            let Observation { sensor, stamp, .. } = *observation;
            let record = FusionRecord::new(sensor, observation.measurement.kind(), stamp, FusionOutcome::Unused);
            return FusionReport { record, is_reset: false, is_used: false };
        }
        let record = self.filter.observe(observation);
        let components = usize::from(record.degrees_of_freedom);
        if matches!(observation.measurement, ObservationKind::Fix(_)) && components > 0 && record.nis.is_finite() {
            self.fix_ratio = record.nis / self.fix_gates[components.min(MAX_FIX_COMPONENTS) - 1];
        }
        FusionReport { record, is_reset: self.reset_if_not_finite(), is_used: true }
    }

    /// The configured start is of another place by now, so the pose is unknown.
    fn reset_if_not_finite(&mut self) -> bool {
        let Some(latest) = self.filter.latest_time() else {
            return false;
        };
        let estimate = self.filter.estimate_at(latest);
        let is_lost = estimate.is_some_and(|estimate| !estimate.is_finite())
            || self.filter.scalar_at(latest).is_some_and(|quantity| !quantity.is_finite());
        if is_lost {
            let resets = estimate.map_or(0, |estimate| estimate.reset_counter);
            self.resets_before = self.resets_before.wrapping_add(resets).wrapping_add(1);
            self.rebuild(None);
        }
        is_lost
    }

    pub(crate) const fn quantity(&self) -> EstimatedQuantity {
        self.entry.quantity
    }

    pub(crate) fn estimate_at(&self, time: Timestamp<BrickClock>) -> Option<Estimate> {
        let estimate = self.filter.estimate_at(time).filter(Estimate::is_finite)?;
        Some(Estimate { reset_counter: estimate.reset_counter.wrapping_add(self.resets_before), ..estimate })
    }

    /// The latest instant of any observation.
    pub(crate) fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.filter.latest_time()
    }

    /// The learned constants, relative to the geometry of `config`.
    pub(crate) fn calibration(&self) -> Option<Calibration> {
        self.filter.calibration()
    }

    /// [`FusionOutcome::Malformed`] and no change if a number is not finite or a sigma is negative.
    pub(crate) fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        self.filter.set_pose(start)
    }

    /// After a reset of the brick's clock.
    pub(crate) fn restart_clock(&mut self) {
        self.filter.restart_clock();
    }

    /// At the latest instant of any observation.
    pub(crate) fn latest_estimate(&self) -> Option<Estimate> {
        self.estimate_at(self.filter.latest_time()?)
    }

    /// The same of a filter that knows one quantity.
    pub(crate) fn latest_quantity(&self) -> Option<ScalarEstimate> {
        self.filter.scalar_at(self.filter.latest_time()?).filter(ScalarEstimate::is_finite)
    }

    /// False if the filter does not support the command.
    pub(crate) fn apply(&mut self, command: &FilterCommand) -> bool {
        if self.filter.apply_command(command) != FusionOutcome::Accepted {
            return false;
        }
        match command {
            FilterCommand::SetParams(params) => {
                self.config.params = *params;
                self.fix_gates = fix_gates(params);
            }
            FilterCommand::SetOnlineCalibration(to) => self.online_calibration = *to,
            FilterCommand::ResetPose | FilterCommand::ResetCalibration => {}
        }
        true
    }

    pub(crate) fn switch_sensor(&mut self, sensor: SensorId, to: SensorSwitch) {
        match to {
            SensorSwitch::On => self.switched_off.remove(&sensor),
            SensorSwitch::Off => self.switched_off.insert(sensor),
        };
    }

    /// A filter of another geometry continues at the old one's pose, if that was known.
    pub(crate) fn set_geometry(&mut self, geometry: DriveGeometry) {
        self.config.geometry = geometry;
        let start = self.latest_estimate().and_then(|estimate| estimate.start_pose());
        self.rebuild(start.or(self.config.start));
    }

    fn rebuild(&mut self, start: Option<StartPose>) {
        let config = FilterConfig { start, ..self.config.clone() };
        self.filter = (self.entry.build)(&config);
        // A frozen calibration stays frozen; a filter that does not calibrate refuses, and nothing is lost.
        self.apply(&FilterCommand::SetOnlineCalibration(self.online_calibration));
    }
}

fn fix_gates(params: &Params) -> [f64; MAX_FIX_COMPONENTS] {
    [1, 2, 3].map(|components| chi_square_quantile(components, params.gate_probability))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::config;
    use posebridge_estimator::find_filter;
    use posebridge_telemetry::{Fix, Heading, Meters, Point2, Pose, Radians, SensorNoise, TimeDelta};

    fn estimator() -> Estimator {
        let noise = SensorNoise {
            travel_m_per_sqrt_m: 0.005,
            turn_rad_per_sqrt_rad: 0.01,
            fix_position_m: 0.01,
            fix_heading_rad: 0.01,
            ..SensorNoise::EXACT
        };
        let config = FilterConfig { noise, ..config().robot.filter_config };
        Estimator::new(find_filter("pose").expect("the main filter"), &config)
    }

    fn wheels(millis: i64, turned_rad: f64) -> Observation {
        let angle = Radians(turned_rad);
        Observation {
            sensor: SensorId::WHEELS,
            stamp: Timestamp::from_millis(millis),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::WheelAngles { left: angle, right: angle },
        }
    }

    fn fix(millis: i64, x_m: f64) -> Observation {
        let fix = Fix {
            position: Point2::new(Meters(x_m), Meters(0.0)),
            heading: Some(Heading::from_rad(0.0)),
            covariance: None,
            tag_in_body: Point2::ORIGIN,
            reset_counter: 0,
        };
        Observation { sensor: SensorId::CAMERA, measurement: ObservationKind::Fix(fix), ..wheels(millis, 0.0) }
    }

    /// The main filter, whose numbers are lost with its first fix.
    struct BrokenFilter(Box<dyn Filter>, f64);

    impl Filter for BrokenFilter {
        fn observe(&mut self, observation: &Observation) -> FusionRecord {
            if matches!(observation.measurement, ObservationKind::Fix(_)) {
                self.1 = f64::INFINITY;
            }
            self.0.observe(observation)
        }

        fn save(&self) -> Vec<u8> {
            self.0.save()
        }

        fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
            self.0.restore(saved)
        }

        fn restart_clock(&mut self) {
            self.0.restart_clock();
        }

        fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
            self.0.latest_time()
        }

        fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
            let mut estimate = Estimate { reset_counter: 3, ..self.0.estimate_at(stamp)? };
            estimate.covariance[4][4] += self.1;
            Some(estimate)
        }
    }

    #[test]
    fn a_filter_whose_numbers_are_not_finite_begins_anew_without_a_pose_and_counts_it() {
        let main = find_filter("pose").expect("the main filter");
        let broken: fn(&FilterConfig) -> Box<dyn Filter> =
            |config| Box::new(BrokenFilter((find_filter("pose").expect("the main filter").build)(config), 0.0));
        let start = StartPose { pose: Pose::default(), position_sigma_m: 0.1, heading_sigma_rad: 0.1 };
        let config = FilterConfig { start: Some(start), ..config().robot.filter_config };
        let mut estimator = Estimator::new(Box::leak(Box::new(FilterEntry { build: broken, ..*main })), &config);
        assert!(!estimator.observe(&wheels(0, 0.0)).is_reset);
        let before = estimator.latest_estimate().expect("it has a start");
        assert_eq!((before.validity.position, before.reset_counter), (true, 3));
        for resets in [7, 11] {
            assert!(estimator.observe(&fix(100, 0.0)).is_reset);
            assert!(!estimator.observe(&wheels(200, 0.0)).is_reset);
            let after = estimator.latest_estimate().expect("it goes on");
            assert_eq!((after.validity.position, after.reset_counter), (false, resets));
        }
    }

    #[test]
    fn a_sensor_that_is_switched_off_is_recorded_and_changes_nothing() {
        let mut estimator = estimator();
        estimator.observe(&wheels(0, 0.0));
        estimator.observe(&wheels(100, 1.0));
        let before = estimator.latest_estimate();
        estimator.switch_sensor(SensorId::CAMERA, SensorSwitch::Off);
        let report = estimator.observe(&fix(100, 0.028));
        assert!(!report.is_used);
        assert_eq!((report.record.outcome, report.record.kind), (FusionOutcome::Unused, "fix"));
        assert_eq!(estimator.latest_estimate(), before);
        estimator.switch_sensor(SensorId::CAMERA, SensorSwitch::On);
        assert!(estimator.observe(&fix(100, 0.028)).is_used);
    }

    #[test]
    fn the_fix_ratio_is_above_one_exactly_for_a_fix_that_the_gate_rejects() {
        let mut estimator = estimator();
        estimator.observe(&wheels(0, 0.0));
        estimator.observe(&wheels(100, 0.0));
        assert_eq!(estimator.fix_ratio, 0.0);
        assert_eq!(estimator.observe(&fix(100, 0.005)).record.outcome, FusionOutcome::Accepted);
        assert!(estimator.fix_ratio < 1.0, "{}", estimator.fix_ratio);
        assert_eq!(estimator.observe(&fix(100, 0.5)).record.outcome, FusionOutcome::Gated);
        assert!(estimator.fix_ratio > 1.0, "{}", estimator.fix_ratio);
    }

    #[test]
    fn another_geometry_goes_on_at_the_pose_and_a_frozen_calibration_stays_frozen() {
        let mut estimator = estimator();
        estimator.observe(&wheels(0, 0.0));
        estimator.observe(&wheels(100, 2.0));
        assert!(estimator.apply(&FilterCommand::SetOnlineCalibration(OnlineCalibration::Frozen)));
        let before = estimator.latest_estimate().expect("it has a start");
        estimator.set_geometry(DriveGeometry { track_width: Meters(0.2), ..estimator.config.geometry });
        estimator.observe(&wheels(200, 2.0));
        let after = estimator.latest_estimate().expect("it goes on");
        assert!((after.pose.x.0 - before.pose.x.0).abs() < 1e-9, "{} {}", after.pose.x.0, before.pose.x.0);
        assert_eq!(estimator.config.geometry.track_width, Meters(0.2));
    }
}
