//! Who says how far the wall is: the last reading, a line through the last two, or the wall filter.

use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::{RangeFilter, RangeFilterVariant};
use posebridge_estimator::{Filter, FilterConfig, Params};
use posebridge_telemetry::{
    BrickClock, Calibration, DriveGeometry, FusionRecord, Meters, MetersPerSecond, Observation, ObservationKind,
    Radians, RadiansPerSecond, SensorId, SensorNoise, TimeDelta, Timestamp,
};

/// The estimate for an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachEstimate {
    /// Distance to the wall, m.
    pub distance_m: f64,
    /// Speed towards it, m/s.
    pub towards_m_per_s: f64,
}

/// A filter that computes a distance from readings and inputs. Times are the brick's, in s.
pub trait ApproachEstimator {
    /// Takes a reading, in m.
    fn observe_range(&mut self, at_s: f64, range_m: f64);
    /// Takes the motor input that holds from an instant on; 1 is that of the step test.
    fn observe_input(&mut self, at_s: f64, input: f64);
    /// Its estimate for an instant; `None` before the first reading.
    fn estimate(&self, at_s: f64) -> Option<ApproachEstimate>;
}

/// The last two readings, time and distance.
#[derive(Clone, Copy, Debug, Default)]
struct LastTwoReadings {
    last: Option<(f64, f64)>,
    before: Option<(f64, f64)>,
}

impl LastTwoReadings {
    fn push(&mut self, at_s: f64, range_m: f64) {
        if self.last.is_none_or(|(last_s, _)| at_s > last_s) {
            self.before = self.last.replace((at_s, range_m));
        }
    }

    fn towards_m_per_s(&self) -> f64 {
        match (self.before, self.last) {
            (Some((t0, z0)), Some((t1, z1))) => (z0 - z1) / (t1 - t0),
            _ => 0.0,
        }
    }
}

/// Holds the last reading until the next; the speed is the slope between the last two.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastReading(LastTwoReadings);

impl ApproachEstimator for LastReading {
    fn observe_range(&mut self, at_s: f64, range_m: f64) {
        self.0.push(at_s, range_m);
    }
    fn observe_input(&mut self, _: f64, _: f64) {}
    fn estimate(&self, _: f64) -> Option<ApproachEstimate> {
        let (_, distance_m) = self.0.last?;
        Some(ApproachEstimate { distance_m, towards_m_per_s: self.0.towards_m_per_s() })
    }
}

/// Extrapolates the line through the last two readings: linear extrapolation.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinearExtrapolation(LastTwoReadings);

impl ApproachEstimator for LinearExtrapolation {
    fn observe_range(&mut self, at_s: f64, range_m: f64) {
        self.0.push(at_s, range_m);
    }
    fn observe_input(&mut self, _: f64, _: f64) {}
    fn estimate(&self, at_s: f64) -> Option<ApproachEstimate> {
        let (last_s, range_m) = self.0.last?;
        let towards_m_per_s = self.0.towards_m_per_s();
        Some(ApproachEstimate { distance_m: range_m - towards_m_per_s * (at_s - last_s), towards_m_per_s })
    }
}

/// The configured noise of the wall filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalmanNoise {
    /// sigma_u: of distance (m) and speed (m/s) per step of 7.6 ms.
    pub process_m: f64,
    /// sigma_z: of a reading, m.
    pub range_m: f64,
}

impl KalmanNoise {
    /// The paper's: 50 mm and 20 mm.
    pub const PAPER: Self = Self { process_m: 0.05, range_m: 0.02 };
}

/// The wall filter of the estimator.
pub struct WallKalman {
    filter: RangeFilter,
    drag_s_per_m: f64,
}

impl WallKalman {
    /// Waits for its first reading.
    pub fn new(model: WallApproachModel, noise: KalmanNoise, variant: RangeFilterVariant) -> Self {
        let config = FilterConfig {
            geometry: UNUSED_GEOMETRY,
            noise: SensorNoise { wall_range_m: noise.range_m, ..SensorNoise::EXACT },
            start: None,
            params: Params {
                wall_drag_s_per_m: model.drag_s_per_m,
                wall_mass_s2_per_m: model.mass_s2_per_m,
                wall_process_m: noise.process_m,
                ..Params::default()
            },
            calibration: Calibration::default(),
            arena_map: std::sync::Arc::default(),
        };
        Self { filter: RangeFilter::new(&config, variant), drag_s_per_m: model.drag_s_per_m }
    }

    /// Processes a reading, in m, and returns its outcome.
    pub fn fuse(&mut self, at_s: f64, range_m: f64) -> FusionRecord {
        self.observe(at_s, ObservationKind::WallRange(Meters(range_m)))
    }

    fn observe(&mut self, at_s: f64, observed: ObservationKind) -> FusionRecord {
        self.filter.observe(&Observation {
            sensor: SensorId::RANGE,
            stamp: timestamp(at_s),
            stamp_sigma: TimeDelta::ZERO,
            measurement: observed,
        })
    }
}

impl ApproachEstimator for WallKalman {
    fn observe_range(&mut self, at_s: f64, range_m: f64) {
        self.fuse(at_s, range_m);
    }

    /// The filter takes commands in the speed at which the car would settle.
    fn observe_input(&mut self, at_s: f64, input: f64) {
        let observed = ObservationKind::BodyVelocity {
            forward: MetersPerSecond(input / self.drag_s_per_m),
            turn: RadiansPerSecond(0.0),
        };
        self.observe(at_s, observed);
    }

    fn estimate(&self, at_s: f64) -> Option<ApproachEstimate> {
        let scalar = self.filter.scalar_at(timestamp(at_s))?;
        Some(ApproachEstimate { distance_m: scalar.value, towards_m_per_s: -scalar.rate_per_s })
    }
}

fn timestamp(at_s: f64) -> Timestamp<BrickClock> {
    Timestamp::from_secs_f64(at_s)
}

/// The wall filter knows no wheels.
const UNUSED_GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(1.0),
    right_wheel_radius: Meters(1.0),
    track_width: Meters(1.0),
    tick: Radians(1.0),
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_goes_on_where_the_last_reading_stays() {
        let (mut last, mut line) = (LastReading::default(), LinearExtrapolation::default());
        assert_eq!(line.estimate(0.0), None);
        for (at_s, range_m) in [(0.0, 2.0), (0.1, 1.9), (0.1, 7.0)] {
            last.observe_range(at_s, range_m);
            line.observe_range(at_s, range_m);
        }
        assert!((last.estimate(0.3).unwrap().distance_m - 1.9).abs() < 1e-12);
        let line = line.estimate(0.3).unwrap();
        assert!((line.distance_m - 1.7).abs() < 1e-12 && (line.towards_m_per_s - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_filter_takes_the_input_of_the_step_for_the_steady_speed() {
        let model = WallApproachModel::from_step_test(1.225, 0.997);
        let mut kalman = WallKalman::new(model, KalmanNoise::PAPER, RangeFilterVariant::Corrected);
        kalman.observe_range(0.0, 9.0);
        kalman.observe_input(0.0, 1.0);
        let settled = kalman.estimate(5.0).unwrap();
        assert!((settled.towards_m_per_s - 1.225).abs() < 1e-4, "{settled:?}");
    }
}
