//! Rounds of the square by every row, on all cores.

use posebridge_estimator::find_filter;
use posebridge_lab::end_errors::{
    EndErrorSummary, FilteredDrive, PairedDifference, count_nearer, paired_difference, run_filter, summarise_ends,
};
use posebridge_report::metrics::PoseError;
use posebridge_sim::frame_accelerometers::FrameAccelerometers;
use posebridge_sim::montecarlo::{Drive, Scenario};
use posebridge_telemetry::ObservationKind;

use crate::lab::drives::filter_config;
use crate::lab::parallel::run_all;

/// The end of the paper's own run, in x and y, m: what the fused ends are held against.
pub(super) const PAPER_END_M: (f64, f64) = (0.235, 0.32);
/// What is left of an accelerometer's bias after it was zeroed by eye, m/s²: 5 mg; docs/lab/indirect.md section M4.
const BIAS_SIGMA_M_PER_S2: f64 = 0.05;

/// Who estimates, from which sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FilterRow {
    pub(super) filter: &'static str,
    pub(super) sensors: SensorSet,
}

/// Which sensors are looked at, beside the wheels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SensorSet {
    /// None.
    Wheels,
    /// The accelerometers: the paper's.
    Accelerometers,
    /// Accelerometers and gyro.
    AccelerometersAndGyro,
}

impl SensorSet {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Wheels => "wheels",
            Self::Accelerometers => "+ accelerometers",
            Self::AccelerometersAndGyro => "+ gyro",
        }
    }

    /// Whether an observation of this kind is looked at; whatever else a robot says, such as fixes, is not.
    pub(super) const fn accepts(self, observed: &ObservationKind) -> bool {
        match observed {
            ObservationKind::WheelAngles { .. } => true,
            ObservationKind::WheelAccelerations { .. } => !matches!(self, Self::Wheels),
            ObservationKind::TurnRate(_) => matches!(self, Self::AccelerometersAndGyro),
            ObservationKind::OdometerPose(_)
            | ObservationKind::BodyVelocity { .. }
            | ObservationKind::Fix(_)
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::CompassHeading(_)
            | ObservationKind::Temperature(_) => false,
        }
    }
}

/// The rows, in the order of the table; the first is what the others are held against.
pub(super) const ROWS: [FilterRow; 5] = [
    row("odometry", SensorSet::Wheels),
    row("indirect", SensorSet::Accelerometers),
    row("indirect-feedback", SensorSet::Accelerometers),
    row("indirect", SensorSet::AccelerometersAndGyro),
    row("indirect-feedback", SensorSet::AccelerometersAndGyro),
];

const fn row(filter: &'static str, sensors: SensorSet) -> FilterRow {
    FilterRow { filter, sensors }
}

/// A row over all rounds.
pub(super) struct RowResult {
    pub(super) row: FilterRow,
    pub(super) ends: Vec<Option<PoseError>>,
    pub(super) summary: EndErrorSummary,
    /// Rounds in which it ends nearer than the wheels alone.
    pub(super) nearer_than_wheels: usize,
    /// Rounds in which it ends nearer than the other way to feed back, from the same sensors.
    pub(super) nearer_than_twin: Option<usize>,
    /// By how much its squared errors are smaller than those of the other way.
    pub(super) gain_on_twin: Option<PairedDifference>,
    /// The way of the first round.
    pub(super) path_m: Vec<(f64, f64)>,
}

/// Everything that was driven.
pub(super) struct RoundsResult {
    pub(super) rows: Vec<RowResult>,
    /// The true way of the first round; of a recording, where the camera saw it.
    pub(super) truth_m: Vec<(f64, f64)>,
}

/// Drives this number of rounds; `ended` is called once for each.
pub(super) fn drive_all(scenario: &Scenario, runs: u32, ended: impl FnMut()) -> RoundsResult {
    let jobs: Vec<u32> = (0..runs).collect();
    let rounds = run_all(&jobs, |run| round(scenario, *run), ended);
    let truth_m = draw_drive(scenario, 0).truth.iter().map(|pose| (pose.x.0, pose.y.0)).collect();
    evaluate(&ROWS, &rounds, truth_m)
}

/// What the courses of all rounds say of each row; `truth_m` is the path of the first round by an independent instrument.
pub(super) fn evaluate(wanted: &[FilterRow], rounds: &[Vec<FilteredDrive>], truth_m: Vec<(f64, f64)>) -> RoundsResult {
    let mut rows: Vec<RowResult> = Vec::new();
    for (index, row) in wanted.iter().copied().enumerate() {
        let courses = rounds.iter().filter_map(|round| round.get(index));
        let ends: Vec<Option<PoseError>> = courses.map(|course| course.end).collect();
        let first = rounds.first().and_then(|round| round.get(index));
        let of = |rows: &[RowResult], wanted: &dyn Fn(&FilterRow) -> bool| {
            let found = rows.iter().find(|found| wanted(&found.row));
            found.map(|found| count_nearer(&ends, &found.ends))
        };
        rows.push(RowResult {
            row,
            summary: summarise_ends(&ends, PAPER_END_M),
            nearer_than_wheels: of(&rows, &|other| other.sensors == SensorSet::Wheels).unwrap_or(0),
            nearer_than_twin: of(&rows, &|other| is_twin(other, row)),
            gain_on_twin: rows
                .iter()
                .find(|found| is_twin(&found.row, row))
                .and_then(|twin| paired_difference(&ends, &twin.ends)),
            path_m: first.map_or_else(Vec::new, |course| course.track_m.clone()),
            ends,
        });
    }
    RoundsResult { rows, truth_m }
}

/// Whether another row sees the same sensors by the other filter.
fn is_twin(other: &FilterRow, row: FilterRow) -> bool {
    other.sensors == row.sensors && other.filter != row.filter
}

/// Run `run` of the scenario, with its accelerometers on the frame.
fn draw_drive(scenario: &Scenario, run: u32) -> Drive {
    let drive = scenario.drive(run);
    let Some(settings) = scenario.accelerometer else {
        return drive;
    };
    let accelerometers = FrameAccelerometers {
        sigma_m_per_s2: settings.sigma_m_per_s2,
        bias_sigma_m_per_s2: BIAS_SIGMA_M_PER_S2,
        spacing: drive.prior.geometry.track_width,
    };
    accelerometers.add_to(drive, scenario.seed, run)
}

/// One round by every row.
fn round(scenario: &Scenario, run: u32) -> Vec<FilteredDrive> {
    let drive = draw_drive(scenario, run);
    let config = filter_config(&drive.prior);
    let Some(truth) = drive.truth.last().copied() else {
        return Vec::new();
    };
    let courses = ROWS.iter().filter_map(|row| {
        let mut filter = (find_filter(row.filter)?.build)(&config);
        let observations = drive.arrivals.iter().map(|arrival| &arrival.observation);
        let accepted = observations.filter(|observation| row.sensors.accepts(&observation.measurement));
        let course = run_filter(filter.as_mut(), accepted, truth);
        // Only the first round is drawn.
        let way_m = if run == 0 { course.track_m } else { Vec::new() };
        Some(FilteredDrive { track_m: way_m, ..course })
    });
    courses.collect()
}
