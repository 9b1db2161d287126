//! Dead reckoning from a loaded run, written from the textbook without the estimator, for comparison with the published
//! figures.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use posebridge_recording::dataset::{DatasetRun, Descriptor, LoadOptions, load};
use posebridge_telemetry::{DriveGeometry, Meters, ObservationKind, Radians};

pub(crate) fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

pub(crate) fn descriptor(name: &str) -> Descriptor {
    let path = repository().join("config/recordings").join(name);
    let text = std::fs::read_to_string(&path).unwrap();
    Descriptor::from_toml(&text).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// The geometry of a `[robot]` table.
pub(crate) fn geometry(robot: &toml::Table) -> DriveGeometry {
    let number = |key: &str| robot[key].as_float().unwrap();
    DriveGeometry {
        left_wheel_radius: Meters(number("left_wheel_radius_m")),
        right_wheel_radius: Meters(number("right_wheel_radius_m")),
        track_width: Meters(number("track_width_m")),
        tick: Radians(TAU / number("ticks_per_turn")),
    }
}

pub(crate) fn load_from(data: &Path, descriptor: &Descriptor, options: LoadOptions<'_>) -> DatasetRun {
    let mut open = |path: &Path| {
        let file = std::fs::File::open(data.join(path))?;
        Ok(Box::new(file) as Box<dyn std::io::Read>)
    };
    load(descriptor, options, &mut open).unwrap()
}

/// A pose on the plane: x, y in metres, heading in radians.
pub(crate) type Pose = [f64; 3];

/// Motion between two wheel observations.
pub(crate) struct MotionStep {
    from_nanos: i64,
    to_nanos: i64,
    from: Pose,
    forward_m: f64,
    turn_rad: f64,
}

impl MotionStep {
    pub(crate) fn contains(&self, nanos: i64) -> bool {
        self.from_nanos < nanos && nanos <= self.to_nanos
    }

    /// The pose at an instant of the step, the wheels turning evenly.
    pub(crate) fn at(&self, nanos: i64) -> Pose {
        let part = (nanos - self.from_nanos) as f64 / (self.to_nanos - self.from_nanos) as f64;
        advance(self.from, part * self.forward_m, part * self.turn_rad)
    }
}

/// The motion between the wheel observations, by the midpoint model.
pub(crate) fn motion(run: &DatasetRun, geometry: DriveGeometry) -> Vec<MotionStep> {
    let start = run.start.unwrap().pose;
    let mut from = [start.x.0, start.y.0, start.heading.rad()];
    let mut last: Option<(i64, f64, f64)> = None;
    let mut steps = Vec::new();
    for timed in run.observations.iter() {
        let ObservationKind::WheelAngles { left, right } = timed.observation.measurement else {
            continue;
        };
        let to_nanos = timed.observation.stamp.as_nanos();
        if let Some((from_nanos, last_left, last_right)) = last {
            let left_m = (left.0 - last_left) * geometry.left_wheel_radius.0;
            let right_m = (right.0 - last_right) * geometry.right_wheel_radius.0;
            let step = MotionStep {
                from_nanos,
                to_nanos,
                from,
                forward_m: f64::midpoint(left_m, right_m),
                turn_rad: (right_m - left_m) / geometry.track_width.0,
            };
            from = step.at(to_nanos);
            steps.push(step);
        }
        last = Some((to_nanos, left.0, right.0));
    }
    steps
}

/// The poses at the wheel observations.
pub(crate) fn dead_reckoning(run: &DatasetRun, geometry: DriveGeometry) -> Vec<(i64, Pose)> {
    let steps = motion(run, geometry);
    let first = steps.first().map(|step| (step.from_nanos, step.from));
    let ends = steps.iter().map(|step| (step.to_nanos, step.at(step.to_nanos)));
    first.into_iter().chain(ends).collect()
}

pub(crate) fn advance([x, y, heading]: Pose, forward_m: f64, turn_rad: f64) -> Pose {
    let (sin, cos) = (heading + turn_rad / 2.0).sin_cos();
    [x + forward_m * cos, y + forward_m * sin, heading + turn_rad]
}

/// The pose at an instant between two others, linearly.
pub(crate) fn pose_at(poses: &[(i64, Pose)], nanos: i64) -> Option<Pose> {
    let behind = poses.partition_point(|(stamp, _)| *stamp < nanos);
    let (t1, b) = *poses.get(behind)?;
    if t1 == nanos {
        return Some(b);
    }
    let (t0, a) = *poses.get(behind.checked_sub(1)?)?;
    let part = (nanos - t0) as f64 / (t1 - t0) as f64;
    Some(std::array::from_fn(|i| a[i] + part * (b[i] - a[i])))
}

#[derive(Debug, Default)]
pub(crate) struct PathErrorStatistics {
    pub(crate) rms_m: f64,
    pub(crate) max_m: f64,
    pub(crate) end_m: f64,
    pub(crate) heading_rms_deg: f64,
}

impl PathErrorStatistics {
    /// Adds another run's errors with a weight, for a mean.
    pub(crate) fn add(&mut self, other: &Self, weight: f64) {
        self.rms_m += weight * other.rms_m;
        self.max_m += weight * other.max_m;
        self.end_m += weight * other.end_m;
        self.heading_rms_deg += weight * other.heading_rms_deg;
    }
}

/// Errors against the truth of the run, at the stamps of the truth.
pub(crate) fn against_truth(run: &DatasetRun, poses: &[(i64, Pose)]) -> PathErrorStatistics {
    let mut errors = PathErrorStatistics::default();
    let (mut count, mut squares, mut heading_squares) = (0.0, 0.0, 0.0);
    for truth in &run.truth {
        let Some([x, y, heading]) = pose_at(poses, truth.time.as_nanos()) else {
            continue;
        };
        let error = (x - truth.position.x.0).hypot(y - truth.position.y.0);
        if let Some(true_heading) = truth.heading {
            let off = (heading - true_heading.rad() + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
            heading_squares += off.to_degrees().powi(2);
        }
        count += 1.0;
        squares += error * error;
        errors.max_m = errors.max_m.max(error);
        errors.end_m = error;
    }
    errors.rms_m = f64::sqrt(squares / count);
    errors.heading_rms_deg = f64::sqrt(heading_squares / count);
    errors
}
