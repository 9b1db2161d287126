//! Reads one run of a foreign recording by its descriptor.
//!
//! The caller opens the files and resolves relative paths; this module converts their bytes to observations.

use std::collections::BTreeMap;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::rc::Rc;

use posebridge_telemetry::{
    Arena, BeaconId, BrickClock, DriveGeometry, LandmarkId, Meters, Observation, ObservationKind, Point2, Pose,
    SensorId, StartPose, TimeDelta, Timestamp, Wiring,
};

use super::descriptor::{Descriptor, ResolvedRun, RunStart, expand_template};
use super::observation_list::TimedObservation;
use super::run::{DatasetRun, LoadError, MAX_HELD_BYTES, TruthPose, WithheldFix};
use super::schema::{BodyVelocity, Fixes, IdMap, PointMap, SpeedInterval, StartSource, Stream, StreamOptions, Truth};
use super::streams::{RowClock, RowReader, positions, sensors};
use super::table::{DatasetTable, TableSource, TextLines, open_error, seconds_to_nanos};
use crate::ros2::bag::TopicTable;

/// The run to load, the robot's geometry, and the fixes to use.
#[derive(Clone, Copy, Debug)]
pub struct LoadOptions<'a> {
    /// The run's name, or a unique prefix of it.
    pub run: &'a str,
    /// Converts ticks and lengths of the wheels to rotation.
    pub geometry: DriveGeometry,
    /// Corrects wheels, gyro and fixes.
    pub wiring: Wiring,
    /// Passes every n-th fix to the filter, 0 for none; `None` takes the descriptor's number.
    pub use_every: Option<usize>,
}

/// Opens a file of a run.
pub type OpenFile<'o> = dyn FnMut(&Path) -> io::Result<Box<dyn Read>> + 'o;

/// Loads one run.
///
/// Pure but for `open`, which gets the path as written in the descriptor and opens the file, once for each stream. One line of it is in
/// memory. Observations are sorted by arrival; with equal arrivals, in the order of the stream kinds in docs/recordings.md.
///
/// # Errors
/// The run or a column is unknown, or a file cannot be opened or unpacked. Bad rows are no errors: they are in
/// [`DatasetRun::bad_rows`].
pub fn load(
    descriptor: &Descriptor,
    options: LoadOptions<'_>,
    open: &mut OpenFile<'_>,
) -> Result<DatasetRun, LoadError> {
    let mut loader = RunLoader {
        run: find_run(descriptor, options.run)?,
        options,
        files: TableCache { descriptor, open, tables: BTreeMap::new() },
        dataset_run: DatasetRun::default(),
        fix_poses: Vec::new(),
    };
    loader.dataset_run.name.clone_from(&loader.run.name);
    loader.load_maps()?;
    loader.load_streams()?;
    let RunLoader { run, dataset_run: mut out, fix_poses, files, .. } = loader;
    let detected = |table: &Rc<DatasetTable>| Some(format!("{}: {}", table.path, table.detected?));
    out.dialects = files.tables.values().filter_map(detected).collect();
    out.observations.sort();
    set_start_pose(&mut out, run.start, &fix_poses);
    Ok(out)
}

fn find_run<'a>(descriptor: &'a Descriptor, requested: &str) -> Result<&'a ResolvedRun, LoadError> {
    let runs = &descriptor.resolved;
    if let Some(exact) = runs.iter().find(|run| run.name == requested) {
        return Ok(exact);
    }
    let matches: Vec<_> = runs.iter().filter(|run| run.name.starts_with(requested)).collect();
    match matches.as_slice() {
        [only] => Ok(only),
        _ => Err(LoadError::Run {
            asked: requested.to_owned(),
            matches: matches.len(),
            known: descriptor.runs.join(", "),
        }),
    }
}

/// The files of a run, with their headers.
struct TableCache<'a> {
    descriptor: &'a Descriptor,
    open: &'a mut OpenFile<'a>,
    tables: BTreeMap<String, Rc<DatasetTable>>,
}

impl TableCache<'_> {
    /// The file entry `name` must exist; the descriptor's check guarantees it.
    fn table(&mut self, name: &str, run: &ResolvedRun) -> Result<Rc<DatasetTable>, LoadError> {
        if let Some(table) = self.tables.get(name) {
            return Ok(Rc::clone(table));
        }
        let template = |message: String| LoadError::Template { run: run.name.clone(), message };
        let Some(entry) = self.descriptor.raw.files.get(name) else {
            return Err(template(format!("there is no [files.{name}]")));
        };
        let path = expand_template(entry.path.get_ref(), &run.values).map_err(template)?;
        let source = TableSource { file: path, topic: entry.bag_topic() };
        let lines = self.lines(&source)?;
        let table = Rc::new(DatasetTable::new(source, lines, entry)?);
        self.tables.insert(name.to_owned(), Rc::clone(&table));
        Ok(table)
    }

    fn lines(&mut self, source: &TableSource) -> Result<TextLines, LoadError> {
        let path = source.name();
        let file = (self.open)(Path::new(&source.file)).map_err(|error| open_error(path.clone(), error))?;
        let Some(topic) = &source.topic else {
            return TextLines::open(&path, file);
        };
        let bag = |error| LoadError::Bag { path: path.clone(), source: error };
        let table = TopicTable::open(BufReader::new(file), topic).map_err(bag)?;
        TextLines::open(&path, Box::new(table))
    }
}

struct RunLoader<'a> {
    run: &'a ResolvedRun,
    options: LoadOptions<'a>,
    files: TableCache<'a>,
    dataset_run: DatasetRun,
    /// Of all fixes, used or not, for a start pose from fixes; otherwise empty.
    fix_poses: Vec<TimestampedPose>,
}

impl RunLoader<'_> {
    fn load_maps(&mut self) -> Result<(), LoadError> {
        let raw = &self.files.descriptor.raw;
        let (landmarks, beacons) = (raw.landmarks.as_ref(), raw.beacons.as_ref());
        if let Some(map) = landmarks {
            let points = self.load_points(map)?.into_iter();
            self.dataset_run.landmarks = points.map(|(id, at)| (LandmarkId(id), at)).collect();
        }
        if let Some(map) = beacons {
            let points = self.load_points(map)?.into_iter();
            self.dataset_run.beacons = points.map(|(id, at)| (BeaconId(id), at)).collect();
        }
        Ok(())
    }

    /// The points of a map; for a repeated id the first one counts.
    fn load_points(&mut self, map: &PointMap) -> Result<BTreeMap<u32, Point2<Arena>>, LoadError> {
        let table = self.files.table(map.file.get_ref(), self.run)?;
        let id = table.bind_optional(map.id.as_ref())?;
        let (x, y) = (table.bind(&map.x)?, table.bind(&map.y)?);
        let mut positions = BTreeMap::new();
        let mut number = 0_u32;
        let bad_rows = &mut self.dataset_run.bad_rows;
        table.for_each_row(self.files.lines(&table.source)?, |row| {
            let read_position = || {
                let id = match &id {
                    Some(column) => column.read_id(row)?,
                    None => number,
                };
                let at = Point2::new(Meters(x.read(row)?), Meters(y.read(row)?));
                Ok((id, at))
            };
            match read_position() {
                Ok((id, at)) => {
                    positions.entry(id).or_insert(at);
                }
                Err(fault) => bad_rows.add(&table.path, row.line, fault),
            }
            number = number.saturating_add(1);
            check_held((positions.len() * size_of::<(u32, Point2<Arena>)>()) as u64, &table.path, row.line)
        })?;
        Ok(positions)
    }

    fn load_streams(&mut self) -> Result<(), LoadError> {
        let raw = &self.files.descriptor.raw;
        let geometry = self.options.geometry;
        for stream in &raw.wheels {
            self.observe(stream, SensorId::WHEELS, |table| sensors::wheels(stream, geometry, table))?;
        }
        for stream in &raw.odometer {
            self.observe(stream, SensorId::ODOMETER, |table| positions::odometer(stream, table))?;
        }
        for stream in &raw.body_velocity {
            self.load_body_velocity(stream)?;
        }
        for stream in &raw.gyro {
            self.observe(stream, SensorId::GYRO, |table| sensors::gyro(stream, table))?;
        }
        for stream in &raw.accelerometers {
            self.observe(stream, SensorId::ACCELEROMETER, |table| sensors::accelerometers(stream, table))?;
        }
        self.load_ranges()?;
        for stream in &raw.compass {
            self.observe(stream, SensorId::COMPASS, |table| sensors::compass(stream, table))?;
        }
        for stream in &raw.temperature {
            self.observe(stream, SensorId::THERMOMETER, |table| sensors::temperature(stream, table))?;
        }
        for stream in &raw.fixes {
            self.load_fixes(stream)?;
        }
        for stream in &raw.truth {
            self.load_truth(stream)?;
        }
        Ok(())
    }

    fn load_ranges(&mut self) -> Result<(), LoadError> {
        let raw = &self.files.descriptor.raw;
        for stream in &raw.landmark_sightings {
            let names = sensors::IdMapping {
                ids: self.load_ids(stream.ids.as_ref())?,
                known: self.dataset_run.landmarks.iter().map(|(id, _)| id.0).collect(),
            };
            self.observe(stream, SensorId::LANDMARKS, |table| sensors::landmarks(stream, names, table))?;
        }
        for stream in &raw.beacon_ranges {
            let names =
                sensors::IdMapping { ids: None, known: self.dataset_run.beacons.iter().map(|(id, _)| id.0).collect() };
            self.observe(stream, SensorId::BEACONS, |table| sensors::beacons(stream, names, table))?;
        }
        for stream in &raw.wall_range {
            self.observe(stream, SensorId::RANGE, |table| sensors::wall_range(stream, table))?;
        }
        Ok(())
    }

    /// The mapping from ids of sightings to ids of the map, if the descriptor has one.
    fn load_ids(&mut self, map: Option<&IdMap>) -> Result<Option<BTreeMap<u32, u32>>, LoadError> {
        let Some(map) = map else {
            return Ok(None);
        };
        let table = self.files.table(map.file.get_ref(), self.run)?;
        let (from, to) = (table.bind(&map.from)?, table.bind(&map.to)?);
        let mut ids = BTreeMap::new();
        let bad_rows = &mut self.dataset_run.bad_rows;
        table.for_each_row(self.files.lines(&table.source)?, |row| {
            match (from.read_id(row), to.read_id(row)) {
                (Ok(from), Ok(to)) => {
                    ids.insert(from, to);
                }
                (Err(fault), _) | (_, Err(fault)) => bad_rows.add(&table.path, row.line, fault),
            }
            check_held((ids.len() * size_of::<(u32, u32)>()) as u64, &table.path, row.line)
        })?;
        Ok(Some(ids))
    }

    fn observe<S: Stream>(
        &mut self,
        stream: &S,
        sensor: SensorId,
        bind: impl FnOnce(&DatasetTable) -> Result<RowReader<ObservationKind>, LoadError>,
    ) -> Result<(), LoadError> {
        let common = stream.common();
        let LoadOptions { wiring, geometry, .. } = self.options;
        self.scan(&common, bind, |run, moment, observed| {
            let timed = timed_observation(&common, sensor, moment, wiring.correct(observed, &geometry));
            run.observations.push(&timed);
        })
    }

    /// Speeds hold from the timestamp of their observation on: a mean over the previous interval gets the timestamp of its beginning.
    fn load_body_velocity(&mut self, stream: &BodyVelocity) -> Result<(), LoadError> {
        let LoadOptions { wiring, geometry, .. } = self.options;
        let bind = |table: &DatasetTable| sensors::body_velocity(stream, geometry, table);
        if stream.interval == SpeedInterval::Next {
            return self.observe(stream, SensorId::ODOMETER, bind);
        }
        let common = stream.common();
        let mut begun = None;
        self.scan(&common, bind, |run, moment, observed| {
            // The interval of the first row lies before the recording.
            if let Some(stamp_nanos) = begun.replace(moment.stamp_nanos) {
                let mean = wiring.correct(observed, &geometry);
                let moment = RowTimes { stamp_nanos, ..moment };
                run.observations.push(&timed_observation(&common, SensorId::ODOMETER, moment, mean));
            }
        })
    }

    fn load_fixes(&mut self, stream: &Fixes) -> Result<(), LoadError> {
        let tag = self.run.tag.or(stream.tag).unwrap_or_default();
        let common = stream.common();
        let every = self.options.use_every.or(stream.use_every).unwrap_or(1);
        let first = stream.use_first.unwrap_or(0);
        let wiring = self.options.wiring;
        let is_start = matches!(self.run.start, Some(RunStart::Source { source: StartSource::Fixes, .. }));
        let (mut index, mut poses) = (0, Vec::new());
        self.scan(
            &common,
            |table| positions::fixes(stream, tag, table),
            |run, moment, fix| {
                let stamp = Timestamp::from_nanos(moment.stamp_nanos);
                let fix = wiring.correct_fix(fix);
                let withheld = WithheldFix { time: stamp, fix };
                poses.extend(pose_from_fix(&withheld).filter(|_| is_start));
                let is_used = index >= first && every > 0 && (index - first).is_multiple_of(every);
                if is_used {
                    let observed = ObservationKind::Fix(fix);
                    run.observations.push(&timed_observation(&common, SensorId::CAMERA, moment, observed));
                } else {
                    run.withheld.push(withheld);
                }
                index += 1;
            },
        )?;
        self.fix_poses.extend(poses);
        Ok(())
    }

    fn load_truth(&mut self, stream: &Truth) -> Result<(), LoadError> {
        self.scan(
            &stream.common(),
            |table| positions::truth(stream, table),
            |run, moment, (position, heading)| {
                let time = Timestamp::from_nanos(moment.stamp_nanos);
                run.truth.push(TruthPose { time, position, heading });
            },
        )
    }

    /// Passes the valid rows of a stream with their times, and counts the bad ones.
    fn scan<T>(
        &mut self,
        common: &StreamOptions<'_>,
        bind: impl FnOnce(&DatasetTable) -> Result<RowReader<T>, LoadError>,
        mut take: impl FnMut(&mut DatasetRun, RowTimes, T),
    ) -> Result<(), LoadError> {
        if !common.is_in(&self.run.name) {
            return Ok(());
        }
        let table = self.files.table(common.file.get_ref(), self.run)?;
        let mut reader = bind(&table)?;
        let mut clock = RowClock::new(table.max_gap_nanos);
        let shift_nanos = seconds_to_nanos(common.stamp_shift_s);
        let run = &mut self.dataset_run;
        table.for_each_row(self.files.lines(&table.source)?, |row| {
            let mut read = || {
                row.check_width()?;
                let stamp = table.time_nanos(row)?;
                let arrival_nanos = table.arrival(row)?.unwrap_or(stamp);
                let value = reader(row, clock.classify(stamp))?;
                clock.accept(stamp);
                let moment = RowTimes { stamp_nanos: stamp.saturating_add(shift_nanos), arrival_nanos };
                Ok(value.map(|value| (moment, value)))
            };
            match read() {
                Ok(Some((moment, value))) => take(run, moment, value),
                Ok(None) => {}
                Err(fault) => run.bad_rows.add(&table.path, row.line, fault),
            }
            check_held(run.held_bytes(), &table.path, row.line)
        })
    }
}

fn check_held(bytes: u64, path: &str, line: usize) -> Result<(), LoadError> {
    if bytes > MAX_HELD_BYTES { Err(LoadError::TooMuch { path: path.to_owned(), line }) } else { Ok(()) }
}

#[derive(Clone, Copy, Debug)]
struct RowTimes {
    stamp_nanos: i64,
    arrival_nanos: i64,
}

fn timed_observation(
    common: &StreamOptions<'_>,
    sensor: SensorId,
    moment: RowTimes,
    observed: ObservationKind,
) -> TimedObservation {
    TimedObservation {
        arrival: Timestamp::from_nanos(moment.arrival_nanos),
        observation: Observation {
            sensor: common.sensor.map_or(sensor, SensorId),
            stamp: Timestamp::from_nanos(moment.stamp_nanos),
            stamp_sigma: TimeDelta::from_secs_f64(common.stamp_sigma_s),
            measurement: observed,
        },
    }
}

/// Sets the start of `run`, if the descriptor has one; `fixes` are the poses of all of its fixes, used or not.
///
/// A start from the files is the last true pose or fix before the first observation. Without one it is the first after it, and earlier
/// observations are dropped, because the start already contains their motion.
fn set_start_pose(run: &mut DatasetRun, start: Option<RunStart>, fixes: &[TimestampedPose]) {
    match start {
        None => {}
        Some(RunStart::Pose(pose)) => run.start = Some(pose),
        Some(RunStart::Source { source, position_sigma_m, heading_sigma_rad }) => {
            let poses = match source {
                StartSource::Truth => truth_poses(run),
                StartSource::Fixes => fixes.to_vec(),
            };
            let Some((stamp, pose)) = first_pose(run, &poses) else {
                return;
            };
            run.start = Some(StartPose { pose, position_sigma_m, heading_sigma_rad });
            run.observations.retain(|timed| timed.observation.stamp >= stamp);
            run.withheld.retain(|withheld| withheld.time >= stamp);
        }
    }
}

type TimestampedPose = (Timestamp<BrickClock>, Pose<Arena>);

fn truth_poses(run: &DatasetRun) -> Vec<TimestampedPose> {
    let poses = run.truth.iter();
    poses
        .filter_map(|truth| {
            let heading = truth.heading?;
            let pose = Pose::new(truth.position.x, truth.position.y, heading);
            Some((truth.time, pose))
        })
        .collect()
}

/// The body's pose from a fix with a heading, corrected for the tag's lever arm.
fn pose_from_fix(fix: &WithheldFix) -> Option<TimestampedPose> {
    let WithheldFix { time: stamp, fix } = fix;
    let heading = fix.heading?;
    let turn = Pose::<Arena>::new(Meters(0.0), Meters(0.0), heading);
    let arm: Point2<Arena> = turn * fix.tag_in_body;
    let (x, y) = (fix.position.x - arm.x, fix.position.y - arm.y);
    Some((*stamp, Pose::new(x, y, heading)))
}

fn first_pose(run: &DatasetRun, poses: &[TimestampedPose]) -> Option<TimestampedPose> {
    let stamps = run.observations.iter().map(|timed| timed.observation.stamp);
    let first = stamps.min()?;
    let before = poses.iter().rev().find(|(stamp, _)| *stamp <= first);
    before.or_else(|| poses.first()).copied()
}
