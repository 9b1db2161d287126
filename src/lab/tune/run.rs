//! A run that is tuned on or held out, and what a filter makes of it.

use posebridge_estimator::{Filter, FilterConfig, FilterEntry};
use posebridge_lab::accuracy::{ReferenceDrive, score};
use posebridge_lab::tuning::{RunFit, SquaredErrors, TimeBlocks, fit_in_blocks, fit_run, offline_params};
use posebridge_recording::dataset::DatasetRun;
use posebridge_report::metrics::{add_to_tallies, summarise};
use posebridge_report::{PoseError, SourceTally, TimedPose};
use posebridge_telemetry::{BrickClock, Calibration, Estimate, Observation, Timestamp};

use crate::tools::score::{EstimateSource, Scorer};

/// What a run is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RunSet {
    /// The search sees it.
    Training,
    /// It is scored before and after.
    HeldOut,
}

/// What a run is held against.
pub(super) enum RunReference {
    /// Truth or withheld fixes of a recording.
    Recorded(Box<DatasetRun>),
    /// The truth of a simulated drive.
    Simulated(Box<ReferenceDrive>),
}

/// One run.
pub(super) struct TuneRun {
    pub(super) name: String,
    pub(super) set: RunSet,
    /// In the order of arrival.
    pub(super) observations: Vec<Observation>,
    pub(super) config: FilterConfig,
    pub(super) reference: RunReference,
}

/// What a filter made of a run.
pub(super) struct RunScore {
    pub(super) name: String,
    pub(super) set: RunSet,
    /// As the search sees it: what the filter learns on line switched off.
    pub(super) fit: RunFit,
    /// Of the filter as it runs live, against truth or withheld fixes.
    pub(super) position_rms_m: Option<f64>,
    /// Of the filter as it runs live.
    pub(super) sources: Vec<SourceTally>,
}

impl TuneRun {
    /// The likelihood of the run, with what the filter does about its noise on line switched off.
    pub(super) fn fit(&self, entry: &FilterEntry, mut config: FilterConfig) -> RunFit {
        config.params = offline_params(config.params);
        fit_run(&self.observations, (entry.build)(&config).as_mut())
    }

    /// The same, each block of time by itself.
    pub(super) fn fit_in_blocks(
        &self,
        entry: &FilterEntry,
        mut config: FilterConfig,
        blocks: &TimeBlocks,
    ) -> Vec<RunFit> {
        config.params = offline_params(config.params);
        fit_in_blocks(&self.observations, (entry.build)(&config).as_mut(), blocks)
    }

    /// The squared position errors of the filter as it runs live, each block of time by itself; empty sums where nothing is known
    /// of where the robot was.
    pub(super) fn squares_in_blocks(
        &self,
        entry: &FilterEntry,
        config: &FilterConfig,
        blocks: &TimeBlocks,
    ) -> Vec<SquaredErrors> {
        let mut live = (entry.build)(config);
        let mut squares = vec![SquaredErrors::default(); blocks.count()];
        let mut add = |stamp, error: &PoseError| {
            if let Some(squares) = squares.get_mut(blocks.index(stamp)) {
                squares.add(error.position_m());
            }
        };
        match &self.reference {
            RunReference::Simulated(known) => {
                score_steps(known, live.as_mut(), |truth, error| add(truth.time, error));
            }
            RunReference::Recorded(run) => {
                let mut scorer = Scorer::new(run, &config.calibration);
                for observation in &self.observations {
                    live.observe(observation);
                    let scored_count = scorer.errors.len();
                    scorer.on_observation(&observation.measurement, observation.stamp, &FilterEstimates(&*live));
                    for error in scorer.errors.iter().skip(scored_count) {
                        add(observation.stamp, error);
                    }
                }
            }
        }
        squares
    }

    /// The likelihood as the search sees it, and the error of the filter as it runs live.
    pub(super) fn score(&self, entry: &FilterEntry, config: FilterConfig) -> RunScore {
        let mut live = (entry.build)(&config);
        let (position_rms_m, sources) = match &self.reference {
            RunReference::Simulated(known) => {
                let score = score(known, live.as_mut());
                (score.position_rms_m(), score.sources().to_vec())
            }
            RunReference::Recorded(run) => self.score_against(run, &config.calibration, live.as_mut()),
        };
        RunScore { name: self.name.clone(), set: self.set, fit: self.fit(entry, config), position_rms_m, sources }
    }

    fn score_against(
        &self,
        run: &DatasetRun,
        prior: &Calibration,
        live: &mut dyn Filter,
    ) -> (Option<f64>, Vec<SourceTally>) {
        let mut scorer = Scorer::new(run, prior);
        let mut sources = Vec::new();
        for observation in &self.observations {
            add_to_tallies(&mut sources, &live.observe(observation));
            scorer.on_observation(&observation.measurement, observation.stamp, &FilterEstimates(&*live));
        }
        scorer.finish(&FilterEstimates(&*live));
        (summarise(&scorer.errors).position_rms_m, sources)
    }
}

/// Gives a drive to a filter as it arrives, and returns its error at the end of each step that counts.
fn score_steps(drive: &ReferenceDrive, filter: &mut dyn Filter, mut error: impl FnMut(&TimedPose, &PoseError)) {
    let mut arrivals = drive.arrivals.iter().peekable();
    for (step, truth) in drive.truth.iter().enumerate() {
        while let Some(arrival) = arrivals.next_if(|arrival| arrival.step <= step) {
            filter.observe(&arrival.observation);
        }
        let estimate = filter.estimate_at(truth.time);
        if let Some(estimate) = estimate.filter(|estimate| step >= drive.scored_from && estimate.validity.position) {
            error(truth, &PoseError::of_estimate(&estimate, truth.pose));
        }
    }
}

/// A filter as the scoring asks it.
struct FilterEstimates<'a>(&'a dyn Filter);

impl EstimateSource for FilterEstimates<'_> {
    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        self.0.estimate_at(stamp)
    }
    fn calibration(&self) -> Option<Calibration> {
        self.0.calibration()
    }
    fn latest(&self) -> Option<Timestamp<BrickClock>> {
        self.0.latest_time()
    }
}
