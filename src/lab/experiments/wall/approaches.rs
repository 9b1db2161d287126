//! Approaches with every distance estimator, over many runs, on all cores.

use anyhow::Result;
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_lab::wall::{
    ApproachEstimator, GateSample, KalmanNoise, LinearExtrapolation, StopComparison, StopResult, StopSummary,
    WallKalman, compare_stops, summarise_stops,
};
use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::wall::{
    Approach, ApproachTask, DistanceEstimator, Gains, HostLink, RangeEstimate, RangeReading, WallScene, approach,
    approach_over_link,
};

use super::steps::StepResults;
use crate::lab::parallel::run_cases;

/// Process noise of the corrected filter with an identified drive, per step of 7.6 ms; docs/lab/wall.md section M5.
const MEASURED_DRIVE_PROCESS_M: f64 = 0.01;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DistanceSource {
    LastReading,
    Line,
    /// `range-kf` with the paper's noise.
    Faithful,
    /// `range-kf-corrected` with the reading noise identified from the steps.
    Corrected,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EstimatorPlacement {
    Brick,
    Host,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ApproachCase {
    pub(super) source: DistanceSource,
    pub(super) placement: EstimatorPlacement,
    pub(super) gains: Gains,
    pub(super) tuning: &'static str,
    pub(super) max_pwm: f64,
}

impl DistanceSource {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::LastReading => "last reading",
            Self::Line => "line through two",
            Self::Faithful => "range-kf",
            Self::Corrected => "range-kf-corrected",
        }
    }

    fn estimator(self, steps: &StepResults) -> Box<dyn ApproachEstimator> {
        let model = steps.all.model();
        match self {
            Self::LastReading => Box::new(LinearExtrapolation::HELD),
            Self::Line => Box::new(LinearExtrapolation::default()),
            Self::Faithful => Box::new(WallKalman::new(model, KalmanNoise::PAPER, RangeFilterVariant::Paper)),
            Self::Corrected => {
                let noise = KalmanNoise { process_m: MEASURED_DRIVE_PROCESS_M, range_m: steps.all.range_sigma_m };
                Box::new(WallKalman::new(model, noise, RangeFilterVariant::Corrected))
            }
        }
    }
}

impl EstimatorPlacement {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Brick => "brick",
            Self::Host => "host",
        }
    }
}

pub(super) struct ApproachResult {
    pub(super) case: ApproachCase,
    pub(super) stops: Vec<Option<StopResult>>,
    pub(super) summary: StopSummary,
    /// Compared with the line at the same tuned gains and the PWM of the step.
    pub(super) against_line: StopComparison,
    /// The first run, for the figures.
    pub(super) first: Approach,
    /// Its readings against their predictions.
    pub(super) gates: Vec<GateSample>,
}

/// Cases: the paper's gains, tuned gains, twice the PWM, all of it, and the host at the same ones.
fn cases(scene: &WallScene, model: WallApproachModel) -> Vec<ApproachCase> {
    use DistanceSource::{Corrected, Faithful, LastReading, Line};
    use EstimatorPlacement::{Brick, Host};
    let tuned = tuned(scene, model);
    let (most, fast) = (scene.approach.most_pwm, scene.approach.fast_pwm);
    let twice = 2.0 * most;
    let case = |source, placement, (tuning, gains), most_pwm| ApproachCase {
        source,
        placement,
        gains,
        tuning,
        max_pwm: most_pwm,
    };
    let (paper, tuned) = (("paper", scene.pid), ("tuned", tuned));
    let mut cases = Vec::new();
    for (gains, most_pwm) in [(paper, most), (tuned, most), (tuned, twice), (tuned, fast)] {
        for source in [LastReading, Line, Faithful, Corrected] {
            cases.push(case(source, Brick, gains, most_pwm));
        }
    }
    for most_pwm in [most, twice, fast] {
        for source in [Line, Faithful, Corrected] {
            cases.push(case(source, Host, tuned, most_pwm));
        }
    }
    cases
}

/// The differential gain cancels the drive's lag: kd = kp m / d, from the step test.
fn tuned(scene: &WallScene, model: WallApproachModel) -> Gains {
    let kp = scene.approach.tuned_kp_pwm_per_m;
    Gains { kp_pwm_per_m: kp, ki_pwm_per_m_s: 0.0, kd_pwm_s_per_m: kp / model.rate_per_s() }
}

/// Runs each case `runs` times.
pub(super) fn drive_all(
    scene: &WallScene,
    steps: &StepResults,
    runs: u32,
    link: &LinkProfile,
) -> Result<Vec<ApproachResult>> {
    let cases = cases(scene, steps.all.model());
    let run = |case: &ApproachCase, run| drive(scene, steps, link, *case, run);
    let approaches = run_cases(&cases, |_| runs, "approaches", run)?;
    let driven = cases.into_iter().zip(approaches).map(|(case, approaches)| {
        let stops: Vec<Option<StopResult>> = approaches.iter().map(|(approach, _)| stopped(scene, approach)).collect();
        let (first, gates) = approaches.into_iter().next().unwrap_or_default();
        ApproachResult {
            case,
            summary: summarise_stops(&stops),
            stops,
            against_line: StopComparison::default(),
            first,
            gates,
        }
    });
    let mut driven: Vec<ApproachResult> = driven.collect();
    compare(&mut driven);
    Ok(driven)
}

fn compare(driven: &mut [ApproachResult]) {
    let line = driven.iter().find(|driven| {
        let case = driven.case;
        case.source == DistanceSource::Line && case.tuning == "tuned"
    });
    let Some(line) = line.map(|line| line.stops.clone()) else {
        return;
    };
    for driven in driven {
        driven.against_line = compare_stops(&driven.stops, &line);
    }
}

fn drive(
    scene: &WallScene,
    steps: &StepResults,
    link: &LinkProfile,
    case: ApproachCase,
    run: u32,
) -> (Approach, Vec<GateSample>) {
    let task = ApproachTask { gains: case.gains, max_pwm: case.max_pwm, run };
    let mut on_car =
        EstimatorAdapter { estimator: case.source.estimator(steps), reference_pwm: scene.car.reference_pwm };
    let driven = match case.placement {
        EstimatorPlacement::Brick => approach(scene, &task, &mut on_car),
        EstimatorPlacement::Host => {
            let link = HostLink { profile: link.clone(), seed: scene.seed.wrapping_add(u64::from(run)) };
            approach_over_link(scene, &task, &link, &mut on_car)
        }
    };
    // Only the first run is drawn.
    let gates = if run == 0 { on_car.estimator.gates().to_vec() } else { Vec::new() };
    (driven, gates)
}

fn stopped(scene: &WallScene, approach: &Approach) -> Option<StopResult> {
    let stop = approach.stop?;
    Some(StopResult {
        error_m: stop.distance_m - scene.approach.target_m,
        time_s: stop.at_s,
        approach_m_per_s: (scene.approach.start_m - stop.distance_m) / stop.at_s,
    })
}

/// Adapts an estimator of the analysis to the simulator's interface.
struct EstimatorAdapter {
    estimator: Box<dyn ApproachEstimator>,
    reference_pwm: f64,
}

impl DistanceEstimator for EstimatorAdapter {
    fn on_reading(&mut self, reading: RangeReading) {
        self.estimator.observe_range(reading.at_s, reading.range_m);
    }

    fn on_command(&mut self, at_s: f64, pwm: f64) {
        self.estimator.observe_input(at_s, pwm / self.reference_pwm);
    }

    fn estimate_at(&mut self, at_s: f64) -> Option<RangeEstimate> {
        let estimate = self.estimator.estimate(at_s)?;
        Some(RangeEstimate { distance_m: estimate.distance_m, towards_m_per_s: estimate.towards_m_per_s })
    }
}
