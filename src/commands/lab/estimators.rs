//! What the experiments can run over a drive: every filter that estimates a pose, and yardsticks that no robot can have.

use std::sync::Arc;

use posebridge_analysis::accuracy::{KnownDrive, Score, score};
use posebridge_estimator::{
    Estimates, FILTERS, FilterConfig, FilterEntry, Params, StartPose, filter_named,
};
use posebridge_sim::montecarlo::{Drive, Told};
use posebridge_telemetry::Calibration;

/// The filter whose clairvoyant twin is a yardstick.
const FLAGSHIP: &str = "pose";
/// What a clairvoyant filter's name ends in.
const CLAIRVOYANT: &str = "-true-geometry";

/// An estimator that can be run over a drive.
///
/// One that is no row of the table of filters (an offline smoother, a foreign program) is a variant here, a line in
/// [`Estimator::all`] and an arm in [`Estimator::score`].
#[derive(Clone, Copy)]
pub enum Estimator {
    /// A row of the table of filters, told what the scenario tells.
    Filter(&'static FilterEntry),
    /// A row of the table, told the true geometry of the run: the bound for every filter that has to learn it.
    TrueGeometry(&'static FilterEntry),
}

impl Estimator {
    /// Every estimator of a pose, in the order of tables and pictures.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let filters = FILTERS
            .iter()
            .filter(|entry| entry.estimates == Estimates::Pose)
            .map(Self::Filter);
        let clairvoyant = filter_named(FLAGSHIP).map(Self::TrueGeometry);
        filters.chain(clairvoyant).collect()
    }

    /// The estimator of this name.
    ///
    /// # Errors
    /// [`UnknownEstimator`] lists the names that exist.
    pub fn named(name: &str) -> Result<Self, UnknownEstimator> {
        Self::all()
            .into_iter()
            .find(|estimator| estimator.name() == name)
            .ok_or_else(|| UnknownEstimator {
                name: name.to_owned(),
                known: Self::names().join(", "),
            })
    }

    /// The names of all.
    #[must_use]
    pub fn names() -> Vec<String> {
        Self::all().iter().map(Self::name).collect()
    }

    /// Its name in tables and on the command line.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Filter(entry) => entry.name.to_owned(),
            Self::TrueGeometry(entry) => format!("{}{CLAIRVOYANT}", entry.name),
        }
    }

    /// What it is, in one line.
    #[must_use]
    pub fn summary(&self) -> String {
        match self {
            Self::Filter(entry) => entry.summary.to_owned(),
            Self::TrueGeometry(entry) => format!(
                "`{}` told the true geometry of each run: what no filter can know",
                entry.name
            ),
        }
    }

    /// Runs it over a drive. `known` is the same drive as the scoring wants it.
    #[must_use]
    pub fn score(&self, drive: &Drive, known: &KnownDrive) -> Score {
        match self {
            Self::Filter(entry) => {
                score(known, (entry.build)(&filter_config(&drive.told)).as_mut())
            }
            Self::TrueGeometry(entry) => {
                let config = FilterConfig {
                    geometry: drive.true_geometry,
                    calibration: Calibration::default(),
                    ..filter_config(&drive.told)
                };
                score(known, (entry.build)(&config).as_mut())
            }
        }
    }
}

/// A filter's configuration from what it may know.
fn filter_config(told: &Told) -> FilterConfig {
    FilterConfig {
        geometry: told.geometry,
        noise: told.noise,
        start: Some(StartPose {
            pose: told.start,
            position_sigma_m: told.start_position_sigma_m,
            heading_sigma_rad: told.start_heading_sigma_rad,
        }),
        params: Params::default(),
        calibration: told.calibration,
        world: Arc::default(),
    }
}

/// There is no such estimator.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no estimator of a pose is called \"{name}\"; there are {known}")]
pub struct UnknownEstimator {
    name: String,
    known: String,
}
