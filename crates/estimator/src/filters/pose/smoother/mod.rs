//! Iterated Rauch-Tung-Striebel smoother: the pose filter run forwards over a complete recording and back again. What changes in the
//! state is augmented by a copy c of its value one step ago, so that the filter itself gives their joint covariance:
//!
//! ```text
//! x_k^s = c_k + C (x_(k+1)^s - x_(k+1))          C = Cov(c_k, x_(k+1)) Cov(x_(k+1))^-1
//! P_k^s = Cov(c_k) + C (P_(k+1)^s - Cov(x_(k+1))) C'
//! ```
//! It needs no Jacobian of what lies between, and takes every observation and every state of the filter. The first pass is the
//! filter's. Later ones leave out the observations that contradict all others, and set the pose where it jumped.
//!
//! Source: Rauch, Tung, Striebel (1965); Roumeliotis and Burdick (2002) for the copied state; docs/maths/pose.md section 11.

mod backward;
mod forward;
mod verdict;

use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::PI;

use nalgebra::DMatrix;
use posebridge_telemetry::{Calibration, FusionOutcome, Observation, StartPose, TimeDelta};

use self::backward::{SmoothedStep, published, smoother_gain};
use self::forward::{ForwardPass, ForwardStep, PassPlan, RecordedRun};
use self::verdict::judge;
use super::layout::{FORWARD, HEADING, LEFT};
use super::state::{PoseState, arena_pose};
use crate::filter::FilterConfig;
use crate::models::lie::Se2;
use crate::numerics::chi_square::chi_square_gates;
use crate::params::Params;
use crate::smoother::{Convergence, SmoothedPose};

/// Rows of an augmented state: of a robot with few constants, and of the largest filter.
const SMALL_ROWS: usize = 32;
const LARGE_ROWS: usize = 96;
/// States of a forward pass that are kept at a time; those between the beginnings of such segments are computed again on the way back.
const SEGMENT_STEPS: usize = 256;
/// Most passes.
pub const MAX_PASSES: u32 = 12;
/// From this pass on observations are only left out and not taken back, so that the search ends.
const LAST_READMISSION_PASS: u32 = 6;
/// The path has converged when no pose moves by more of its sigma.
const CONVERGED_SIGMAS: f64 = 0.01;
/// A pose that is set without being known: a hundred metres, and any direction.
const UNKNOWN_POSITION_M: f64 = 100.0;

/// The result of all passes.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothing {
    /// After each motion reading and each absolute observation, in the order of time.
    pub poses: Vec<SmoothedPose>,
    /// The smoothed constants.
    pub calibration: Calibration,
    /// Sum of the squared residuals of the absolute observations over their noise; of those left out, the gate.
    pub cost: f64,
    pub used: usize,
    pub rejected: usize,
    pub passes: u32,
    pub convergence: Convergence,
}

/// Smooths a run with at most `max_passes`; no poses mean that nothing moved.
pub fn smooth_with_passes(config: &FilterConfig, observations: &[Observation], max_passes: u32) -> Smoothing {
    let run = RecordedRun::new(config, observations);
    if run.rows.count() <= SMALL_ROWS {
        smooth_with_rows::<SMALL_ROWS>(run, config, max_passes)
    } else {
        smooth_with_rows::<LARGE_ROWS>(run, config, max_passes)
    }
}

/// The states of a run, each with the observations up to `lag` later; poses in the order of time.
pub fn smooth_with_lag(config: &FilterConfig, observations: &[Observation], lag: TimeDelta) -> Smoothing {
    let run = RecordedRun::new(config, observations);
    if run.rows.count() <= SMALL_ROWS {
        lagged::<SMALL_ROWS>(&run, config, lag)
    } else {
        lagged::<LARGE_ROWS>(&run, config, lag)
    }
}

fn first_plan<const N: usize>(run: &RecordedRun, config: &FilterConfig) -> PassPlan<N> {
    PassPlan {
        initial: PoseState::initial(config, &run.context.layout),
        is_used: vec![true; run.entries.len()],
        resets: BTreeMap::new(),
    }
}

fn smooth_with_rows<const N: usize>(mut run: RecordedRun, config: &FilterConfig, max_passes: u32) -> Smoothing {
    let gates = chi_square_gates(config.params.gate_probability);
    let jumps = run.observer_jumps();
    let mut plan = first_plan::<N>(&run, config);
    let mut pass = Pass::run(&run, &plan, config, gates);
    let mut best = pass.smoothing(1);
    plan.resets = pass.resets(&run, &jumps);
    if config.start.is_none()
        && let Some(start) = pass.start()
    {
        plan.initial.initialize_pose(&start);
    }
    plan.initial.noise_scales = pass.noise_scales;
    run.forget_observer_jumps();
    // What is used is decided between the passes, and the noise of a source is that of the whole run.
    run.context.set_params(&Params { adapt_gain: 0.0, gate_probability: 1.0, ..config.params });
    for passes in 2..=max_passes {
        let has_changed = pass.choose(&mut plan.is_used, gates, config, passes);
        let before = std::mem::take(&mut pass.smoothed);
        let next = Pass::run(&run, &plan, config, gates);
        if !next.is_finite() {
            break;
        }
        let moved_sigmas = next.largest_move(&before);
        let is_settled = !has_changed && moved_sigmas < CONVERGED_SIGMAS;
        pass = next;
        let mut found = pass.smoothing(passes);
        found.convergence =
            if is_settled { Convergence::Converged } else { Convergence::Moving { sigmas: moved_sigmas, has_changed } };
        if is_settled {
            return found;
        }
        // The first pass leaves the noise of the motion to explain what later ones leave out: their costs do not compare.
        if passes == 2 || found.cost < best.cost {
            best = found;
        }
        best.passes = passes;
    }
    best
}

/// A change of the pose that no motion explains: the filter found its pose, or another one.
struct PoseJump {
    entry: usize,
    step: usize,
    /// As believed before, at the instant of the jump.
    believed: Se2,
    /// The step after which the new pose counts; `None` for the whole run until then.
    since: Option<usize>,
    was_located: bool,
}

/// The result of one pass forwards and back.
struct Pass<const N: usize> {
    poses: Vec<SmoothedPose>,
    calibration: Calibration,
    /// The smoothed poses of mid-axle.
    smoothed: Vec<Se2>,
    /// The smoothed sigmas of the pose: forward, left, turn.
    sigmas: Vec<[f64; 3]>,
    /// The filter's poses.
    filtered: Vec<Se2>,
    jumps: Vec<PoseJump>,
    entries: Vec<usize>,
    /// Of the entries that are absolute observations.
    nis: BTreeMap<usize, (usize, Option<f64>)>,
    noise_scales: super::noise_scales::NoiseScales,
    cost: f64,
    used: usize,
    rejected: usize,
}

impl<const N: usize> Pass<N> {
    fn run(run: &RecordedRun, plan: &PassPlan<N>, config: &FilterConfig, gates: [f64; 3]) -> Self {
        let mut pass = Self {
            poses: Vec::new(),
            calibration: config.calibration,
            smoothed: Vec::new(),
            sigmas: Vec::new(),
            filtered: Vec::new(),
            jumps: Vec::new(),
            entries: Vec::new(),
            nis: BTreeMap::new(),
            noise_scales: plan.initial.noise_scales,
            cost: 0.0,
            used: 0,
            rejected: 0,
        };
        let segments = pass.forwards(run, plan);
        pass.backwards(run, segments, gates);
        pass
    }

    /// Returns the pass at the beginning of each segment.
    fn forwards<'a>(&mut self, run: &'a RecordedRun, plan: &'a PassPlan<N>) -> Vec<ForwardPass<'a, N>> {
        let mut forward = ForwardPass::new(run, plan);
        let mut segments = vec![forward.clone()];
        let mut before = plan.initial;
        let mut last_used = None;
        while let Some(step) = forward.next_step() {
            let index = self.filtered.len();
            self.note_jump(run, &before, &step, last_used);
            match step.outcome {
                Some(FusionOutcome::Accepted | FusionOutcome::PoseReset) => {
                    self.used += 1;
                    last_used = Some(index);
                }
                Some(FusionOutcome::Unused) | None => {}
                Some(_) => self.rejected += 1,
            }
            self.filtered.push(step.state.pose);
            self.entries.push(step.entry);
            self.noise_scales = step.state.noise_scales;
            before = *step.state;
            if forward.steps().is_multiple_of(SEGMENT_STEPS) {
                segments.push(forward.clone());
            }
        }
        segments
    }

    fn note_jump(&mut self, run: &RecordedRun, before: &PoseState<N>, step: &ForwardStep<N>, last_used: Option<usize>) {
        let is_found = step.state.is_located && !before.is_located;
        if !is_found && step.outcome != Some(FusionOutcome::PoseReset) {
            return;
        }
        let mut believed = *before;
        believed.advance(run.entries[step.entry].stamp, &run.context);
        let put_down = before.carried_at.and_then(|carried| {
            let later = self.entries.iter().rposition(|entry| run.entries[*entry].stamp <= carried);
            later.filter(|_| before.is_located)
        });
        let since = if before.is_located { last_used.max(put_down) } else { None };
        self.jumps.push(PoseJump {
            entry: step.entry,
            step: self.filtered.len(),
            believed: believed.pose,
            since,
            was_located: before.is_located,
        });
    }

    fn backwards(&mut self, run: &RecordedRun, segments: Vec<ForwardPass<'_, N>>, gates: [f64; 3]) {
        let mut later: Option<(SmoothedStep, Box<PoseState<N>>)> = None;
        for mut forward in segments.into_iter().rev() {
            let steps: Vec<ForwardStep<N>> = std::iter::from_fn(|| forward.next_step()).take(SEGMENT_STEPS).collect();
            for step in steps.into_iter().rev() {
                let smoothed = match &later {
                    None => SmoothedStep::last(&step.state, &run.rows),
                    Some((smoothed, after)) => {
                        smoothed.back(after, &step.state, &smoother_gain(after, &run.rows), &run.rows)
                    }
                };
                self.add(run, &step, &smoothed.state(&step.state, &run.rows), gates);
                later = Some((smoothed, step.state));
            }
        }
        self.poses.reverse();
        self.smoothed.reverse();
        self.sigmas.reverse();
    }

    /// Adds a smoothed state; the first one is the last of the run.
    fn add(&mut self, run: &RecordedRun, step: &ForwardStep<N>, smoothed: &PoseState<N>, gates: [f64; 3]) {
        if self.smoothed.is_empty() {
            self.calibration = smoothed.calibration(&self.calibration, &run.context.layout);
        }
        self.smoothed.push(smoothed.pose);
        self.sigmas.push([FORWARD, LEFT, HEADING].map(|row| smoothed.covariance[(row, row)].max(0.0).sqrt()));
        self.poses.extend(published(smoothed, &run.context));
        let Some(outcome) = step.outcome else { return };
        let was_used = matches!(outcome, FusionOutcome::Accepted | FusionOutcome::PoseReset);
        if let Some(verdict) = judge(smoothed, &run.entries[step.entry], outcome, &run.context) {
            self.nis.insert(step.entry, (verdict.components, verdict.left_out_nis));
            self.cost += if was_used { verdict.residual } else { gates[verdict.components - 1] };
        }
    }

    /// Chooses what the next pass uses; returns whether that has changed.
    fn choose(&self, is_used: &mut [bool], gates: [f64; 3], config: &FilterConfig, pass: u32) -> bool {
        let mut has_changed = false;
        for (entry, (components, nis)) in &self.nis {
            // With Student's t an outlier has little weight, and none is left out.
            let fits = config.params.student_dof > 0.0 || nis.is_none_or(|nis| nis <= gates[components - 1]);
            let next = fits && (is_used[*entry] || pass < LAST_READMISSION_PASS);
            has_changed |= next != is_used[*entry];
            is_used[*entry] = next;
        }
        has_changed
    }

    /// The smoothed pose before a jump, at a step.
    fn moved_back(&self, jump: &PoseJump, step: usize) -> Option<StartPose> {
        let found = *self.smoothed.get(jump.step)?;
        let pose = found.compose(jump.believed.inverse()).compose(*self.filtered.get(step)?);
        Some(StartPose {
            pose: arena_pose(pose),
            position_sigma_m: UNKNOWN_POSITION_M,
            heading_sigma_rad: PI / 3.0_f64.sqrt(),
        })
    }

    /// The start of a run that began without a pose, by the first one that was found.
    fn start(&self) -> Option<StartPose> {
        self.moved_back(self.jumps.first().filter(|jump| !jump.was_located)?, 0)
    }

    /// Where the pose is set in later passes: before the first observation that belongs to the new one.
    fn resets(&self, run: &RecordedRun, observer_jumps: &[usize]) -> BTreeMap<usize, StartPose> {
        let mut resets = BTreeMap::new();
        for jump in &self.jumps {
            let since = if observer_jumps.contains(&jump.entry) { jump.step.checked_sub(1) } else { jump.since };
            let next = match since {
                Some(since) => self.entries.get(since + 1).copied().unwrap_or(run.entries.len()),
                // The start that was given is wrong.
                None if jump.was_located => 0,
                None => continue,
            };
            if let Some(start) = self.moved_back(jump, since.unwrap_or(0)) {
                resets.insert(next, start);
            }
        }
        resets
    }

    /// The largest move of a pose since another pass, in sigmas.
    fn largest_move(&self, others: &[Se2]) -> f64 {
        let pairs = self.smoothed.iter().zip(others).zip(&self.sigmas);
        pairs.fold(0.0, |largest, ((now, before), sigmas)| {
            let moved = before.between(*now).log();
            let in_sigmas =
                moved.iter().zip(sigmas).map(|(moved, sigma)| if *sigma > 0.0 { moved.abs() / sigma } else { 0.0 });
            in_sigmas.fold(largest, f64::max)
        })
    }

    fn is_finite(&self) -> bool {
        let of_pose =
            |pose: &SmoothedPose| pose.pose.x.0 + pose.pose.y.0 + pose.covariance.iter().flatten().sum::<f64>();
        self.poses.iter().map(of_pose).sum::<f64>().is_finite()
    }

    fn smoothing(&self, passes: u32) -> Smoothing {
        Smoothing {
            poses: self.poses.clone(),
            calibration: self.calibration,
            cost: self.cost,
            used: self.used,
            rejected: self.rejected,
            passes,
            convergence: Convergence::SinglePass,
        }
    }
}

fn lagged<const N: usize>(run: &RecordedRun, config: &FilterConfig, lag: TimeDelta) -> Smoothing {
    let plan = first_plan::<N>(run, config);
    let mut forward = ForwardPass::new(run, &plan);
    let mut window: VecDeque<(ForwardStep<N>, DMatrix<f64>)> = VecDeque::new();
    let mut smoothing = Smoothing {
        poses: Vec::new(),
        calibration: config.calibration,
        cost: 0.0,
        used: 0,
        rejected: 0,
        passes: 1,
        convergence: Convergence::SinglePass,
    };
    while let Some(step) = forward.next_step() {
        match step.outcome {
            Some(FusionOutcome::Accepted | FusionOutcome::PoseReset) => smoothing.used += 1,
            Some(FusionOutcome::Unused) | None => {}
            Some(_) => smoothing.rejected += 1,
        }
        smoothing.calibration = step.state.calibration(&config.calibration, &run.context.layout);
        let now = run.entries[step.entry].stamp;
        let gain = smoother_gain(&step.state, &run.rows);
        window.push_back((step, gain));
        // Later observations of this instant belong to it as well.
        let is_last = run.entries.get(forward.next_entry()).is_none_or(|next| next.stamp > now);
        let due = window.iter().take_while(|(step, _)| is_last && now - run.entries[step.entry].stamp >= lag).count();
        smoothing.poses.extend(first_smoothed(run, &window, due));
        window.drain(..due);
    }
    smoothing.poses.extend(first_smoothed(run, &window, window.len()));
    smoothing
}

/// The first steps of a window, given all of it.
fn first_smoothed<const N: usize>(
    run: &RecordedRun,
    window: &VecDeque<(ForwardStep<N>, DMatrix<f64>)>,
    count: usize,
) -> Vec<SmoothedPose> {
    let mut poses = Vec::new();
    let mut later: Option<(SmoothedStep, &ForwardStep<N>, &DMatrix<f64>)> = None;
    for (index, (step, gain)) in window.iter().enumerate().rev().take(if count == 0 { 0 } else { window.len() }) {
        let smoothed = match later {
            None => SmoothedStep::last(&step.state, &run.rows),
            Some((smoothed, after, gain)) => smoothed.back(&after.state, &step.state, gain, &run.rows),
        };
        if index < count {
            poses.extend(published(&smoothed.state(&step.state, &run.rows), &run.context));
        }
        later = Some((smoothed, step, gain));
    }
    poses.reverse();
    poses
}
