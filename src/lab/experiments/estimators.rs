//! What the experiments can run over a drive: every filter that estimates a pose, and references that no robot can have.

use posebridge_estimator::smoother::{OfflineError, batch, rts};
use posebridge_estimator::{EstimatedQuantity, FILTERS, FilterConfig, FilterEntry, find_filter};
use posebridge_lab::accuracy::{FilterScore, ReferenceDrive, SmootherScore, score, score_smoother};
use posebridge_sim::montecarlo::Drive;
use posebridge_telemetry::Calibration;

use crate::lab::drives::filter_config;

/// The filter that also runs with the true geometry, as a reference.
const MAIN_FILTER: &str = "pose";
/// What a clairvoyant filter's name ends in.
const CLAIRVOYANT: &str = "-true-geometry";
/// The name of the most likely path.
const SMOOTH: &str = "smooth";
/// The name of the flagship run forwards and back.
const RTS: &str = "rts";

/// An estimator that can be run over a drive.
///
/// One that is no row of the table of filters (the offline smoother, a foreign program) is a variant here, a line in
/// [`Estimator::all`] and an arm in [`Estimator::score`].
#[derive(Clone, Copy)]
pub enum Estimator {
    /// A row of the table of filters, with the prior of the scenario.
    Filter(&'static FilterEntry),
    /// A row of the table, with the true geometry of the run: the bound for every filter that has to learn it.
    TrueGeometry(&'static FilterEntry),
    /// The flagship run forwards and back.
    Rts,
    /// The most likely path of the whole run, found when it is over.
    Smooth,
}

/// What an estimator made of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimatorResult {
    /// What its errors add up to.
    pub score: FilterScore,
    /// Why it says nothing at all; only a smoother can refuse a whole drive.
    pub refusal: Option<OfflineError>,
}

impl EstimatorResult {
    const fn from_filter(score: FilterScore) -> Self {
        Self { score, refusal: None }
    }
}

impl From<SmootherScore> for EstimatorResult {
    fn from(SmootherScore { score, error: refusal }: SmootherScore) -> Self {
        Self { score, refusal }
    }
}

impl Estimator {
    /// Every estimator of a pose, in the order of tables and pictures.
    pub fn all() -> Vec<Self> {
        let filters = FILTERS.iter().filter(|entry| entry.quantity == EstimatedQuantity::Pose).map(Self::Filter);
        let clairvoyant = find_filter(MAIN_FILTER).map(Self::TrueGeometry);
        filters.chain(clairvoyant).chain([Self::Rts, Self::Smooth]).collect()
    }

    /// The estimator of this name.
    ///
    /// # Errors
    /// [`UnknownEstimator`] lists the names that exist.
    pub fn from_name(name: &str) -> Result<Self, UnknownEstimator> {
        Self::all()
            .into_iter()
            .find(|estimator| estimator.name() == name)
            .ok_or_else(|| UnknownEstimator { name: name.to_owned(), known: Self::names().join(", ") })
    }

    /// The names of all.
    pub fn names() -> Vec<String> {
        Self::all().iter().map(Self::name).collect()
    }

    /// Its name in tables and on the command line.
    pub fn name(&self) -> String {
        match self {
            Self::Filter(entry) => entry.name.to_owned(),
            Self::TrueGeometry(entry) => format!("{}{CLAIRVOYANT}", entry.name),
            Self::Rts => RTS.to_owned(),
            Self::Smooth => SMOOTH.to_owned(),
        }
    }

    /// What it is, in one line.
    pub fn summary(&self) -> String {
        match self {
            Self::Filter(entry) => entry.summary.to_owned(),
            Self::TrueGeometry(entry) => {
                format!("`{}` told the true geometry of each run: what no filter can know", entry.name)
            }
            Self::Rts => {
                "`pose` run forwards and back over the whole run: what it would have believed, had it known the rest"
                    .to_owned()
            }
            Self::Smooth => {
                "the most likely path of the whole run, found afterwards: what no filter can know in time".to_owned()
            }
        }
    }

    /// Runs it over a drive. `known` is the same drive as the scoring wants it.
    pub fn score(&self, drive: &Drive, known: &ReferenceDrive) -> EstimatorResult {
        match self {
            Self::Filter(entry) => {
                let mut filter = (entry.build)(&filter_config(&drive.prior));
                EstimatorResult::from_filter(score(known, filter.as_mut()))
            }
            Self::TrueGeometry(entry) => {
                let config = FilterConfig {
                    geometry: drive.true_geometry,
                    calibration: Calibration::default(),
                    ..filter_config(&drive.prior)
                };
                EstimatorResult::from_filter(score(known, (entry.build)(&config).as_mut()))
            }
            Self::Rts => score_smoother(known, &filter_config(&drive.prior), rts).into(),
            Self::Smooth => score_smoother(known, &filter_config(&drive.prior), batch).into(),
        }
    }
}

/// There is no such estimator.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no estimator of a pose is called \"{name}\"; there are {known}")]
pub struct UnknownEstimator {
    name: String,
    known: String,
}
