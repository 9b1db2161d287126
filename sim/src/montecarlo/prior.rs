//! The configuration of the filters in a scenario.

use std::sync::Arc;

use posebridge_telemetry::{
    Arena, ArenaMap, BeaconId, Calibration, DriveGeometry, LandmarkId, Meters, MountedSensor, Point2, Pose,
    SensorNoise, UncertainValue,
};

use super::plan::PlanarPose;
use super::robot::nominal_geometry;
use super::scenario::{PriorGeometry, Scenario};
use crate::random::RandomStream;

/// What a filter is told: the distributions from which a run draws, and what `[told]` says.
#[derive(Clone, Debug, PartialEq)]
pub struct FilterPrior {
    pub geometry: DriveGeometry,
    pub noise: SensorNoise,
    pub start: Pose<Arena>,
    /// Whether the filter is told its start.
    pub start_is_known: bool,
    pub start_position_sigma_m: f64,
    pub start_heading_sigma_rad: f64,
    /// The uncertainty of the gyro's bias is in `noise`.
    pub calibration: Calibration,
    /// As the filter knows it.
    pub arena_map: Arc<ArenaMap>,
    /// Tables and keys of a robot profile that replace the above.
    pub profile: Arc<toml::Table>,
}

impl FilterPrior {
    pub(super) fn new(scenario: &Scenario, start: PlanarPose, true_geometry: DriveGeometry, seed: u64) -> Self {
        let prior = &scenario.told;
        let off = RandomStream::new(seed, "start").uniform(-1.0, 1.0);
        let off_rad = off * prior.start_heading_off_deg.to_radians();
        Self {
            geometry: match prior.geometry {
                PriorGeometry::Nominal => nominal_geometry(&scenario.robot),
                PriorGeometry::True => true_geometry,
            },
            noise: noise(scenario),
            start: PlanarPose { heading_rad: start.heading_rad + off_rad, ..start }.into(),
            start_is_known: !prior.start_is_unknown,
            start_position_sigma_m: prior.start_position_sigma_m,
            start_heading_sigma_rad: prior.start_heading_sigma_rad,
            calibration: calibration(scenario),
            arena_map: Arc::new(arena_map(scenario)),
            profile: Arc::new(scenario.profile.clone()),
        }
    }
}

fn calibration(scenario: &Scenario) -> Calibration {
    let known = |sigma| UncertainValue { value: 0.0, sigma };
    let prior = &scenario.told;
    let mut calibration = Calibration {
        radius_scale: known(prior.radius_scale_sigma),
        radius_difference: known(prior.radius_difference_sigma),
        track_scale: known(prior.track_scale_sigma),
        gyro_scale: known(scenario.gyro.scale_sigma),
        ..Calibration::default()
    };
    if let Some(camera) = &scenario.camera {
        calibration.fix_delay_s = camera.stamps.offset_s.prior();
    }
    if let Some(sensor) = &scenario.landmarks {
        calibration.landmark_delay_s = sensor.stamps.offset_s.prior();
        calibration.mountings[MountedSensor::Landmarks] = sensor.mounting.prior();
    }
    if let Some(sensor) = &scenario.beacons {
        calibration.beacon_delay_s = sensor.stamps.offset_s.prior();
        calibration.beacon_offset_m = known(sensor.offset_sigma_m);
        calibration.beacon_scale = known(sensor.scale_sigma);
        calibration.mountings[MountedSensor::Beacons] = sensor.mounting.prior();
    }
    if let Some(sensor) = &scenario.compass {
        calibration.compass_delay_s = sensor.stamps.offset_s.prior();
        calibration.mountings[MountedSensor::Compass] = sensor.mounting.prior();
    }
    calibration
}

fn arena_map(scenario: &Scenario) -> ArenaMap {
    let point = |at: &[f64; 2]| Point2::<Arena>::new(Meters(at[0]), Meters(at[1]));
    let landmarks = scenario.landmarks.iter().flat_map(|sensor| &sensor.positions_m);
    let beacons = scenario.beacons.iter().flat_map(|sensor| &sensor.positions_m);
    ArenaMap {
        landmarks: (0..).map(LandmarkId).zip(landmarks.map(point)).collect(),
        beacons: (0..).map(BeaconId).zip(beacons.map(point)).collect(),
        walls: Vec::new(),
    }
}

// A robot's file gives the noise of every sensor whether or not there is one, so a filter is never configured with a sensor
// without noise. These are the values of the scenarios that have them, and of a LEGO robot.
const DEFAULT_FIX_SIGMA_M: f64 = 0.005;
const DEFAULT_FIX_SIGMA_DEG: f64 = 1.0;
const DEFAULT_ACCELEROMETER_SIGMA_M_PER_S2: f64 = 0.05;
const DEFAULT_RANGE_SIGMA_M: f64 = 0.1;
const DEFAULT_BEARING_SIGMA_DEG: f64 = 2.0;
const DEFAULT_COMPASS_SIGMA_DEG: f64 = 5.0;
const DEFAULT_WALL_SIGMA_M: f64 = 0.01;
const DEFAULT_TEMPERATURE_SIGMA_K: f64 = 0.1;

/// The correlation of an error that never changes falls after a path that no robot drives, m.
const FOR_EVER_M: f64 = 1e6;

fn noise(scenario: &Scenario) -> SensorNoise {
    let gyro = &scenario.gyro;
    let camera = scenario.camera;
    let (landmarks, beacons) = (scenario.landmarks.as_ref(), scenario.beacons.as_ref());
    let [fix_persistent_m, fix_persistence_m] = persistent_error(scenario);
    SensorNoise {
        wheel_travel_m_per_sqrt_m: scenario.told.wheel_travel_m_per_sqrt_m,
        turn_rad_per_sqrt_rad: scenario.told.turn_rad_per_sqrt_rad,
        gyro_rad_per_s: gyro.sigma_deg_per_s.to_radians(),
        gyro_resolution_rad_per_s: gyro.resolution_deg_per_s.to_radians(),
        gyro_bias_rad_per_s: gyro.bias_sigma_deg_per_s.to_radians(),
        gyro_bias_walk_rad_per_s_sqrt_s: gyro.bias_walk_deg_per_s_sqrt_s.to_radians(),
        fix_position_m: camera.map_or(DEFAULT_FIX_SIGMA_M, |camera| camera.position_sigma_m),
        fix_heading_rad: camera.map_or(DEFAULT_FIX_SIGMA_DEG, |camera| camera.heading_sigma_deg).to_radians(),
        fix_persistent_m,
        fix_persistence_m,
        accelerometer_m_per_s2: scenario
            .accelerometer
            .map_or(DEFAULT_ACCELEROMETER_SIGMA_M_PER_S2, |settings| settings.sigma_m_per_s2),
        compass_rad: scenario.compass.map_or(DEFAULT_COMPASS_SIGMA_DEG, |sensor| sensor.heading_sigma_deg).to_radians(),
        landmark_range_m: landmarks.map_or(DEFAULT_RANGE_SIGMA_M, |sensor| sensor.range_sigma_m),
        landmark_range_share: landmarks.map_or(0.0, |sensor| sensor.range_share),
        landmark_bearing_rad: landmarks
            .map_or(DEFAULT_BEARING_SIGMA_DEG, |sensor| sensor.bearing_sigma_deg)
            .to_radians(),
        landmark_place_m: landmarks.map_or(0.0, |sensor| sensor.map_sigma_m),
        beacon_range_m: beacons.map_or(DEFAULT_RANGE_SIGMA_M, |sensor| sensor.range_sigma_m),
        beacon_range_share: beacons.map_or(0.0, |sensor| sensor.range_share),
        wall_range_m: DEFAULT_WALL_SIGMA_M,
        temperature_k: DEFAULT_TEMPERATURE_SIGMA_K,
        ..SensorNoise::EXACT
    }
}

/// Sigma and length of the errors that fixes share, m; those of the worse camera, because a filter is told one pair.
fn persistent_error(scenario: &Scenario) -> [f64; 2] {
    let errors = [scenario.camera, scenario.second_camera].into_iter().flatten().map(|camera| {
        let patch_m = camera.patches.map_or(0.0, |patches| patches.sigma_m);
        // About half of a patch is what a robot crosses until the next error.
        let length_m = camera.patches.map_or(FOR_EVER_M, |patches| 0.5 * patches.size_m);
        [camera.bias_sigma_m.hypot(patch_m), length_m]
    });
    let worse = errors.filter(|[sigma_m, _]| *sigma_m > 0.0).max_by(|one, other| one[0].total_cmp(&other[0]));
    worse.unwrap_or([0.0, SensorNoise::EXACT.fix_persistence_m])
}
