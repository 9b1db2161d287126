//! Estimators of the experiments: every filter that estimates a pose, and idealised references.

use posebridge_estimator::smoother::smooth;
use posebridge_estimator::{EstimatedQuantity, FILTERS, FilterConfig, FilterEntry, find_filter};
use posebridge_lab::accuracy::{DriveScore, ReferenceDrive, error_bound, score, score_smoother};
use posebridge_lab::statistics::RunningMean;
use posebridge_sim::montecarlo::{Camera, DrawnValue, Drive, GeometryErrors, PriorGeometry, Scenario};
use posebridge_telemetry::{Calibration, UncertainValue};

use crate::lab::drives::drawn_config;

/// The filter that also runs with the true geometry, as a reference.
pub(super) const MAIN_FILTER: &str = "pose";
/// Name suffix of a filter with the true geometry.
const CLAIRVOYANT: &str = "-true-geometry";
const SMOOTH: &str = "smooth";

/// An estimator for a drive.
///
/// An estimator outside the table of filters (the offline smoother, a foreign program) is a variant here, a line in [`Estimator::all`]
/// and an arm in [`Estimator::score`].
#[derive(Clone, Copy)]
pub enum Estimator {
    /// With the prior of the scenario.
    Filter(&'static FilterEntry),
    /// With the true geometry of the run: the bound for every filter that estimates the geometry.
    TrueGeometry(&'static FilterEntry),
    /// The main filter run forwards and backwards until that changes nothing.
    Smooth,
}

impl Estimator {
    /// In the order of tables and figures.
    pub fn all() -> Vec<Self> {
        let filters = FILTERS.iter().filter(|entry| entry.quantity == EstimatedQuantity::Pose).map(Self::Filter);
        let clairvoyant = find_filter(MAIN_FILTER).map(Self::TrueGeometry);
        filters.chain(clairvoyant).chain([Self::Smooth]).collect()
    }

    pub fn from_name(name: &str) -> Result<Self, UnknownEstimator> {
        Self::all()
            .into_iter()
            .find(|estimator| estimator.name() == name)
            .ok_or_else(|| UnknownEstimator { name: name.to_owned(), known: Self::names().join(", ") })
    }

    pub fn names() -> Vec<String> {
        Self::all().iter().map(Self::name).collect()
    }

    pub fn name(&self) -> String {
        match self {
            Self::Filter(entry) => entry.name.to_owned(),
            Self::TrueGeometry(entry) => format!("{}{CLAIRVOYANT}", entry.name),
            Self::Smooth => SMOOTH.to_owned(),
        }
    }

    pub fn summary(&self) -> String {
        match self {
            Self::Filter(entry) => entry.summary.to_owned(),
            Self::TrueGeometry(entry) => {
                format!("`{}` told the true geometry of each run: what no filter can know", entry.name)
            }
            Self::Smooth => {
                "`pose` run forwards and back over the whole run: what it would have believed, had it known the rest"
                    .to_owned()
            }
        }
    }

    /// `known` is the same drive in the form of the score.
    pub fn score(&self, drive: &Drive, known: &ReferenceDrive, config: &FilterConfig) -> DriveScore {
        let score_filter = |entry: &FilterEntry, config: &FilterConfig| DriveScore {
            score: score(known, (entry.build)(config).as_mut()),
            refusal: None,
        };
        match self {
            Self::Filter(entry) => score_filter(entry, config),
            Self::TrueGeometry(entry) => {
                let fixed = UncertainValue::default();
                let calibration = Calibration {
                    radius_scale: fixed,
                    radius_difference: fixed,
                    track_scale: fixed,
                    ..config.calibration
                };
                let geometry = drive.true_geometry;
                score_filter(entry, &FilterConfig { geometry, calibration, ..config.clone() })
            }
            Self::Smooth => score_smoother(known, config, smooth),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no estimator of a pose is called \"{name}\"; there are {known}")]
pub struct UnknownEstimator {
    name: String,
    known: String,
}

// Which scenarios have a bound on the error of any filter, and what it leaves out.
//
// The bound takes the robot that the filters are configured with. Where the true one is drawn otherwise there is no bound; where
// something is added that no filter knows, the bound is that of the drive without it, and says so.

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum BoundKind {
    Excluding(Vec<&'static str>),
    Unavailable(&'static str),
}

impl BoundKind {
    pub(super) fn for_scenario(scenario: &Scenario) -> Self {
        let (motion, prior) = (&scenario.motion, &scenario.told);
        if scenario.kidnaps.is_some() {
            return Self::Unavailable("the robot is moved by hand");
        }
        if motion.wheel_travel_m_per_sqrt_m != prior.wheel_travel_m_per_sqrt_m
            || motion.turn_rad_per_sqrt_rad != prior.turn_rad_per_sqrt_rad
        {
            return Self::Unavailable("the noise of the motion is not what a filter is told");
        }
        let drawn = match prior.geometry {
            PriorGeometry::Nominal => scenario.errors,
            PriorGeometry::True => {
                GeometryErrors { radius_scale_sigma: 0.0, radius_difference_sigma: 0.0, track_scale_sigma: 0.0 }
            }
        };
        let known = GeometryErrors {
            radius_scale_sigma: prior.radius_scale_sigma,
            radius_difference_sigma: prior.radius_difference_sigma,
            track_scale_sigma: prior.track_scale_sigma,
        };
        if drawn != known {
            return Self::Unavailable("the spread of the geometry is not what a filter is told");
        }
        let has_camera = |is_such: fn(&Camera) -> bool| {
            [&scenario.camera, &scenario.second_camera].into_iter().flatten().any(is_such)
        };
        let of_camera = scenario.camera.iter().chain(&scenario.second_camera).map(|camera| camera.stamps);
        let stamps = of_camera
            .chain(scenario.landmarks.iter().map(|sensor| sensor.stamps))
            .chain(scenario.beacons.iter().map(|sensor| sensor.stamps))
            .chain(scenario.compass.iter().map(|sensor| sensor.stamps));
        let has_skew = stamps.into_iter().any(|stamps| stamps.skew_ppm != DrawnValue::default());
        let left_out = [
            (has_camera(|camera| camera.true_noise_factor != 1.0), "the camera's noise is taken as told"),
            (has_camera(|camera| camera.outliers.is_some()), "without the outliers"),
            (has_camera(|camera| camera.bursts.is_some()), "without the bursts"),
            (has_camera(|camera| camera.patches.is_some()), "without the edges of the patches"),
            (has_skew, "without the skew of the clock"),
            (scenario.kicks.is_some(), "without the kicks"),
            (scenario.slip_bursts.is_some(), "without the slip bursts"),
            (scenario.robot.backlash_deg > 0.0, "without the play of the gears"),
            (scenario.accelerometer.is_some(), "without what the accelerometers tell"),
        ];
        Self::Excluding(left_out.into_iter().filter_map(|(is_there, what)| is_there.then_some(what)).collect())
    }

    pub(super) fn compute(&self, drive: &Drive, known: &ReferenceDrive) -> Option<RunningMean> {
        match self {
            Self::Unavailable(_) => None,
            Self::Excluding(_) => {
                let turns: Vec<_> = drive.wheel_turns.iter().map(|turn| [turn.left, turn.right]).collect();
                error_bound(&drawn_config(&drive.prior), known, &turns)
            }
        }
    }

    /// What the bound omits, or why there is none; `None` without a restriction.
    pub(super) fn note(&self) -> Option<String> {
        match self {
            Self::Unavailable(reason) => Some((*reason).to_owned()),
            Self::Excluding(left_out) if left_out.is_empty() => None,
            Self::Excluding(left_out) => Some(left_out.join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use posebridge_sim::montecarlo::SCENARIOS;
    use posebridge_telemetry::{MountedSensor, Radians};

    use super::*;
    use crate::lab::drives::{filter_config, known_drive};

    #[test]
    fn every_bundled_scenario_says_what_its_bound_leaves_out() {
        for (name, _) in SCENARIOS {
            let note = BoundKind::for_scenario(&Scenario::bundled(name).unwrap()).note();
            let expected = match *name {
                "outliers-3pct" | "outliers-10pct" => Some("without the outliers"),
                "noise-x4" | "noise-quarter" => Some("the camera's noise is taken as told"),
                "noise-x4-outliers" => Some("the camera's noise is taken as told, without the outliers"),
                "kicks" | "kicks-camera-1hz" => Some("without the kicks"),
                "paper-square" => Some("without what the accelerometers tell"),
                "wpilib" => Some("the noise of the motion is not what a filter is told"),
                _ if name.starts_with("outlier-burst") => Some("without the bursts"),
                "patches-with-rests" => Some("without the edges of the patches"),
                "clock-skew" => Some("without the skew of the clock"),
                "slip-bursts-1hz" => Some("without the slip bursts"),
                "backlash" => Some("without the play of the gears"),
                _ if name.starts_with("kidnap") => Some("the robot is moved by hand"),
                _ => None,
            };
            assert_eq!(note.as_deref(), expected, "{name}");
        }
    }

    #[test]
    fn every_bundled_scenario_configures_a_filter_and_a_wrong_key_is_named() {
        for (name, _) in SCENARIOS {
            let drive = Scenario::bundled(name).unwrap().drive(0);
            assert!(filter_config(&drive.prior).is_ok(), "{name}");
        }
        let prior = |profile: &str| {
            let mut prior = Scenario::bundled("kidnap-landmarks").unwrap().drive(0).prior;
            prior.profile = std::sync::Arc::new(toml::from_str(profile).unwrap());
            prior
        };
        let told = filter_config(&prior(
            "[filter]\nstudent_dof = 4\n[robot.mounting.landmarks]\nyaw_deg = { value = 90.0, sigma = 1.0 }",
        ));
        let drawn = drawn_config(&prior(""));
        let told = told.unwrap();
        assert_eq!((told.params.student_dof, told.noise, told.start), (4.0, drawn.noise, drawn.start));
        let yaw = told.calibration.mountings[MountedSensor::Landmarks].yaw_rad;
        assert!((yaw.value - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(told.calibration.gyro_scale, drawn.calibration.gyro_scale);
        for (wrong, part) in [
            ("[robot.calibration]\ngyro_scal = { value = 0.0, sigma = 0.1 }", "unknown field `gyro_scal`"),
            ("[filter]\nstudent_dof = 4000", "must lie in 0 to 100"),
            ("[station]\nmax_robots = 1", "unknown table `station`"),
        ] {
            let error = format!("{:#}", filter_config(&prior(wrong)).unwrap_err());
            assert!(error.starts_with("[profile]: ") && error.contains(part), "{error}");
        }
    }

    #[test]
    fn a_geometry_that_is_drawn_otherwise_than_told_has_no_bound() {
        let mut scenario = Scenario::bundled("camera-10hz").unwrap();
        scenario.told.track_scale_sigma = 0.02;
        let bounded = BoundKind::for_scenario(&scenario);
        assert!(matches!(bounded, BoundKind::Unavailable(reason) if reason.contains("geometry")));
        let drive = scenario.drive(0);
        assert_eq!(bounded.compute(&drive, &ReferenceDrive::default()), None);
    }

    #[test]
    fn each_wheel_is_taken_for_itself() {
        let scenario = Scenario::bundled("unknown-heading").unwrap();
        let mut drive = scenario.drive(0);
        for turn in &mut drive.wheel_turns {
            turn.right = Radians(0.0);
        }
        let known = known_drive(&drive);
        let turns: Vec<_> = drive.wheel_turns.iter().map(|turn| [turn.left, Radians(0.0)]).collect();
        let expected = error_bound(&drawn_config(&drive.prior), &known, &turns);
        assert!(expected.is_some());
        assert_eq!(BoundKind::for_scenario(&scenario).compute(&drive, &known), expected);
    }
}
