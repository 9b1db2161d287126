//! Rounds of the square by every row, on all cores.

use posebridge_analysis::ends::{Course, EndSummary, Paired, nearer, paired, run_course, summarise_ends};
use posebridge_analysis::metrics::PoseError;
use posebridge_estimator::filter_named;
use posebridge_sim::frame_accelerometers::FrameAccelerometers;
use posebridge_sim::montecarlo::{Drive, Scenario};
use posebridge_telemetry::Observed;

use crate::drawn::filter_config;
use crate::parallel::run_all;

/// The end of the paper's own run, in x and y, m: what the fused ends are held against.
pub(super) const PAPER_END_M: (f64, f64) = (0.235, 0.32);
/// What is left of an accelerometer's bias after it was zeroed by eye, m/s²: 5 mg; docs/maths/paper4.md section 4.
const BIAS_SIGMA_M_PER_S2: f64 = 0.05;

/// Who estimates, from which sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Row {
    pub(super) filter: &'static str,
    pub(super) sensors: Sensors,
}

/// Which sensors are looked at, beside the wheels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sensors {
    /// None.
    Wheels,
    /// The accelerometers: the paper's.
    Accelerometers,
    /// Accelerometers and gyro.
    AccelerometersAndGyro,
}

impl Sensors {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Wheels => "wheels",
            Self::Accelerometers => "+ accelerometers",
            Self::AccelerometersAndGyro => "+ gyro",
        }
    }

    /// Whether an observation of this kind is looked at; whatever else a robot says, such as fixes, is not.
    pub(super) const fn hears(self, observed: &Observed) -> bool {
        match observed {
            Observed::WheelAngles { .. } => true,
            Observed::WheelAccelerations { .. } => !matches!(self, Self::Wheels),
            Observed::TurnRate(_) => matches!(self, Self::AccelerometersAndGyro),
            Observed::OdometerPose(_)
            | Observed::BodyVelocity { .. }
            | Observed::Fix(_)
            | Observed::Landmark { .. }
            | Observed::BeaconRange { .. }
            | Observed::WallRange(_)
            | Observed::CompassHeading(_)
            | Observed::Temperature(_) => false,
        }
    }
}

/// The rows, in the order of the table; the first is what the others are held against.
pub(super) const ROWS: [Row; 5] = [
    row("odometry", Sensors::Wheels),
    row("indirect", Sensors::Accelerometers),
    row("indirect-feedback", Sensors::Accelerometers),
    row("indirect", Sensors::AccelerometersAndGyro),
    row("indirect-feedback", Sensors::AccelerometersAndGyro),
];

const fn row(filter: &'static str, sensors: Sensors) -> Row {
    Row { filter, sensors }
}

/// A row over all rounds.
pub(super) struct RowFound {
    pub(super) row: Row,
    pub(super) ends: Vec<Option<PoseError>>,
    pub(super) summary: EndSummary,
    /// Rounds in which it ends nearer than the wheels alone.
    pub(super) nearer_than_wheels: usize,
    /// Rounds in which it ends nearer than the other way to feed back, from the same sensors.
    pub(super) nearer_than_twin: Option<usize>,
    /// By how much its squared errors are smaller than those of the other way.
    pub(super) gain_on_twin: Option<Paired>,
    /// The way of the first round.
    pub(super) way_m: Vec<(f64, f64)>,
}

/// Everything that was driven.
pub(super) struct Found {
    pub(super) rows: Vec<RowFound>,
    /// The true way of the first round; of a recording, where the camera saw it.
    pub(super) truth_m: Vec<(f64, f64)>,
}

/// Drives so many rounds; `ended` is called once for each.
pub(super) fn drive_all(scenario: &Scenario, runs: u32, ended: impl FnMut()) -> Found {
    let jobs: Vec<u32> = (0..runs).collect();
    let rounds = run_all(&jobs, |run| round(scenario, *run), ended);
    let truth_m = drawn(scenario, 0).truth.iter().map(|pose| (pose.x.0, pose.y.0)).collect();
    found_of(&ROWS, &rounds, truth_m)
}

/// What the courses of all rounds say of each row; `truth_m` is the way of the first round as somebody else saw it.
pub(super) fn found_of(wanted: &[Row], rounds: &[Vec<Course>], truth_m: Vec<(f64, f64)>) -> Found {
    let mut rows: Vec<RowFound> = Vec::new();
    for (index, row) in wanted.iter().copied().enumerate() {
        let courses = rounds.iter().filter_map(|round| round.get(index));
        let ends: Vec<Option<PoseError>> = courses.map(|course| course.end).collect();
        let first = rounds.first().and_then(|round| round.get(index));
        let of = |rows: &[RowFound], wanted: &dyn Fn(&Row) -> bool| {
            let found = rows.iter().find(|found| wanted(&found.row));
            found.map(|found| nearer(&ends, &found.ends))
        };
        rows.push(RowFound {
            row,
            summary: summarise_ends(&ends, PAPER_END_M),
            nearer_than_wheels: of(&rows, &|other| other.sensors == Sensors::Wheels).unwrap_or(0),
            nearer_than_twin: of(&rows, &|other| is_twin(other, row)),
            gain_on_twin: rows.iter().find(|found| is_twin(&found.row, row)).and_then(|twin| paired(&ends, &twin.ends)),
            way_m: first.map_or_else(Vec::new, |course| course.way_m.clone()),
            ends,
        });
    }
    Found { rows, truth_m }
}

/// Whether another row sees the same sensors by the other filter.
fn is_twin(other: &Row, row: Row) -> bool {
    other.sensors == row.sensors && other.filter != row.filter
}

/// Run `run` of the scenario, with its accelerometers on the frame.
fn drawn(scenario: &Scenario, run: u32) -> Drive {
    let drive = scenario.drive(run);
    let Some(settings) = scenario.accelerometer else {
        return drive;
    };
    let accelerometers = FrameAccelerometers {
        sigma_m_per_s2: settings.sigma_m_per_s2,
        bias_sigma_m_per_s2: BIAS_SIGMA_M_PER_S2,
        spacing: drive.told.geometry.track_width,
    };
    accelerometers.mounted_on(drive, scenario.seed, run)
}

/// One round by every row.
fn round(scenario: &Scenario, run: u32) -> Vec<Course> {
    let drive = drawn(scenario, run);
    let config = filter_config(&drive.told);
    let Some(truth) = drive.truth.last().copied() else {
        return Vec::new();
    };
    let courses = ROWS.iter().filter_map(|row| {
        let mut filter = (filter_named(row.filter)?.build)(&config);
        let observations = drive.arrivals.iter().map(|arrival| &arrival.observation);
        let seen = observations.filter(|observation| row.sensors.hears(&observation.observed));
        let course = run_course(filter.as_mut(), seen, truth);
        // Only the first round is drawn.
        let way_m = if run == 0 { course.way_m } else { Vec::new() };
        Some(Course { way_m, ..course })
    });
    courses.collect()
}
