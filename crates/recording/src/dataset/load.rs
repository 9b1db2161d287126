//! Reads one run of a foreign recording, as its descriptor says.
//!
//! The caller opens the files and decides where relative paths start; here their bytes become observations.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::rc::Rc;

use posebridge_telemetry::{
    Arena, BeaconId, DriveGeometry, LandmarkId, Meters, Observation, Observed, Point2, SensorId, Span, Stamp,
};

use super::descriptor::{Descriptor, ResolvedRun, fill};
use super::run::{Run, Timed, TruthPose, Withheld};
use super::schema::{BodyVelocity, Common, Fixes, IdMap, PlacesMap, SpeedInterval, Stream, Truth};
use super::start;
use super::streams::{Clock, Reader, plain, positions, ranges, wheels};
use super::table::{Table, seconds_to_nanos, text_of};

/// Which run to load, and how.
#[derive(Clone, Copy, Debug)]
pub struct LoadOptions<'a> {
    /// The run's name, or a beginning of it that no other run has.
    pub run: &'a str,
    /// Turns ticks and lengths of the wheels into rotation.
    pub geometry: DriveGeometry,
    /// Which of the fixes the filter gets: every n-th, 0 for none; `None` takes the descriptor's number.
    pub use_every: Option<usize>,
}

/// Why a run cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// No run, or more than one, goes by this name.
    #[error("{matches} runs begin with `{asked}`: use one of: {known}")]
    Run {
        /// What was asked for.
        asked: String,
        /// How many runs begin so.
        matches: usize,
        /// The names of all runs.
        known: String,
    },
    /// A file path names a value that the run does not have.
    #[error("run `{run}`: {message}")]
    Template {
        /// The run.
        run: String,
        /// What is wrong.
        message: String,
    },
    /// A file could not be read.
    #[error("cannot read {path}: say with --data where the recordings lie")]
    Open {
        /// The file, as the descriptor names it.
        path: String,
        /// What the system says.
        source: io::Error,
    },
    /// A file could not be unpacked.
    #[error("{path} is damaged or not gzip")]
    Gzip {
        /// The file.
        path: String,
        /// What the unpacker says.
        source: io::Error,
    },
    /// A file is larger than any recording of a small robot.
    #[error("{path} unpacks to more than 1 GiB")]
    TooLarge {
        /// The file.
        path: String,
    },
    /// A column's name is not in the header line.
    #[error("{path}: there is no column `{column}`, the header has: {known}")]
    NoColumn {
        /// The file.
        path: String,
        /// The name that the descriptor gives.
        column: String,
        /// The names in the header.
        known: String,
    },
}

/// Loads one run.
///
/// Pure but for `open`, which is given the path as the descriptor names it and returns the file's bytes. Observations
/// come sorted by arrival; where arrivals are equal, in the order of the stream kinds in docs/recordings.md.
///
/// # Errors
/// When the run or a column is unknown, or a file cannot be opened or unpacked. Bad rows are no errors: they are in
/// [`Run::bad_rows`].
pub fn load(
    descriptor: &Descriptor,
    options: LoadOptions<'_>,
    open: &mut dyn FnMut(&Path) -> io::Result<Vec<u8>>,
) -> Result<Run, LoadError> {
    let mut loader = Loader {
        run: find(descriptor, options.run)?,
        options,
        files: Files { descriptor, open, texts: BTreeMap::new() },
        out: Run::default(),
        all_fixes: Vec::new(),
    };
    loader.out.name.clone_from(&loader.run.name);
    loader.maps()?;
    loader.streams()?;
    let Loader { run, mut out, all_fixes, .. } = loader;
    start::place(&mut out, run.start, &all_fixes);
    out.observations.sort_by_key(|timed| timed.arrival);
    Ok(out)
}

fn find<'a>(descriptor: &'a Descriptor, asked: &str) -> Result<&'a ResolvedRun, LoadError> {
    let runs = &descriptor.resolved;
    if let Some(exact) = runs.iter().find(|run| run.name == asked) {
        return Ok(exact);
    }
    let matches: Vec<_> = runs.iter().filter(|run| run.name.starts_with(asked)).collect();
    match matches.as_slice() {
        [only] => Ok(only),
        _ => Err(LoadError::Run { asked: asked.to_owned(), matches: matches.len(), known: descriptor.runs.join(", ") }),
    }
}

/// The files of a run, each opened once.
struct Files<'a> {
    descriptor: &'a Descriptor,
    open: &'a mut dyn FnMut(&Path) -> io::Result<Vec<u8>>,
    texts: BTreeMap<String, Rc<Table>>,
}

impl Files<'_> {
    /// The table of the file entry `name`, which the descriptor's check has found to exist.
    fn table(&mut self, name: &str, run: &ResolvedRun) -> Result<Rc<Table>, LoadError> {
        if let Some(table) = self.texts.get(name) {
            return Ok(Rc::clone(table));
        }
        let template = |message: String| LoadError::Template { run: run.name.clone(), message };
        let Some(entry) = self.descriptor.raw.files.get(name) else {
            return Err(template(format!("there is no [files.{name}]")));
        };
        let path = fill(entry.path.get_ref(), &run.values).map_err(template)?;
        let bytes = (self.open)(Path::new(&path)).map_err(|source| LoadError::Open { path: path.clone(), source })?;
        let text = text_of(&path, bytes)?;
        let table = Rc::new(Table::new(path, text, entry)?);
        self.texts.insert(name.to_owned(), Rc::clone(&table));
        Ok(table)
    }
}

/// A run while it is being read.
struct Loader<'a> {
    run: &'a ResolvedRun,
    options: LoadOptions<'a>,
    files: Files<'a>,
    out: Run,
    /// All fixes, used or not, for a start that comes from them.
    all_fixes: Vec<Withheld>,
}

impl Loader<'_> {
    fn maps(&mut self) -> Result<(), LoadError> {
        let raw = &self.files.descriptor.raw;
        let (landmarks, beacons) = (raw.landmarks.as_ref(), raw.beacons.as_ref());
        if let Some(map) = landmarks {
            let points = self.places(map)?.into_iter();
            self.out.landmarks = points.map(|(id, at)| (LandmarkId(id), at)).collect();
        }
        if let Some(map) = beacons {
            let points = self.places(map)?.into_iter();
            self.out.beacons = points.map(|(id, at)| (BeaconId(id), at)).collect();
        }
        Ok(())
    }

    /// The places of a map; where an id comes again, its first place stands.
    fn places(&mut self, map: &PlacesMap) -> Result<BTreeMap<u32, Point2<Arena>>, LoadError> {
        let table = self.files.table(map.file.get_ref(), self.run)?;
        let id = table.bind_some(map.id.as_ref())?;
        let (x, y) = (table.bind(&map.x)?, table.bind(&map.y)?);
        let mut places = BTreeMap::new();
        for (number, row) in table.rows().enumerate() {
            let place = || {
                let id = match &id {
                    Some(column) => column.read_id(&row)?,
                    None => number as u32,
                };
                let at = Point2::new(Meters(x.read(&row)?), Meters(y.read(&row)?));
                Ok((id, at))
            };
            match place() {
                Ok((id, at)) => {
                    places.entry(id).or_insert(at);
                }
                Err(fault) => self.out.bad_rows.add(&table.path, row.line, fault),
            }
        }
        Ok(places)
    }

    /// Reads every stream of the descriptor that this run has.
    fn streams(&mut self) -> Result<(), LoadError> {
        let raw = &self.files.descriptor.raw;
        let geometry = self.options.geometry;
        for stream in &raw.wheels {
            self.observe(stream, SensorId::WHEELS, |table| wheels::bind(stream, geometry, table))?;
        }
        for stream in &raw.odometer {
            self.observe(stream, SensorId::ODOMETER, |table| positions::odometer(stream, table))?;
        }
        for stream in &raw.body_velocity {
            self.body_velocity(stream)?;
        }
        for stream in &raw.gyro {
            self.observe(stream, SensorId::GYRO, |table| plain::gyro(stream, table))?;
        }
        for stream in &raw.accelerometers {
            self.observe(stream, SensorId::ACCELEROMETER, |table| plain::accelerometers(stream, table))?;
        }
        self.ranges()?;
        for stream in &raw.compass {
            self.observe(stream, SensorId::COMPASS, |table| plain::compass(stream, table))?;
        }
        for stream in &raw.temperature {
            self.observe(stream, SensorId::THERMOMETER, |table| plain::temperature(stream, table))?;
        }
        for stream in &raw.fixes {
            self.fixes(stream)?;
        }
        for stream in &raw.truth {
            self.truth(stream)?;
        }
        Ok(())
    }

    fn ranges(&mut self) -> Result<(), LoadError> {
        let raw = &self.files.descriptor.raw;
        for stream in &raw.landmark_sightings {
            let names = ranges::Names {
                ids: self.ids(stream.ids.as_ref())?,
                known: self.out.landmarks.iter().map(|(id, _)| id.0).collect(),
            };
            self.observe(stream, SensorId::LANDMARKS, |table| ranges::landmarks(stream, names, table))?;
        }
        for stream in &raw.beacon_ranges {
            let names = ranges::Names { ids: None, known: self.out.beacons.iter().map(|(id, _)| id.0).collect() };
            self.observe(stream, SensorId::BEACONS, |table| ranges::beacons(stream, names, table))?;
        }
        for stream in &raw.wall_range {
            self.observe(stream, SensorId::RANGE, |table| plain::wall_range(stream, table))?;
        }
        Ok(())
    }

    /// The table that turns the ids of sightings into those of the map, if the descriptor has one.
    fn ids(&mut self, map: Option<&IdMap>) -> Result<Option<BTreeMap<u32, u32>>, LoadError> {
        let Some(map) = map else {
            return Ok(None);
        };
        let table = self.files.table(map.file.get_ref(), self.run)?;
        let (from, to) = (table.bind(&map.from)?, table.bind(&map.to)?);
        let mut ids = BTreeMap::new();
        for row in table.rows() {
            match (from.read_id(&row), to.read_id(&row)) {
                (Ok(from), Ok(to)) => {
                    ids.insert(from, to);
                }
                (Err(fault), _) | (_, Err(fault)) => {
                    self.out.bad_rows.add(&table.path, row.line, fault);
                }
            }
        }
        Ok(Some(ids))
    }

    /// Reads one stream into observations of a sensor.
    fn observe<S: Stream>(
        &mut self,
        stream: &S,
        sensor: SensorId,
        bind: impl FnOnce(&Table) -> Result<Reader<Observed>, LoadError>,
    ) -> Result<(), LoadError> {
        let common = stream.common();
        let items = self.scan(&common, bind)?;
        let timed = items.into_iter().map(|(moment, observed)| timed(&common, sensor, moment, observed));
        self.out.observations.extend(timed);
        Ok(())
    }

    /// Speeds hold from the stamp of their observation on: a mean over the interval before goes to that one's beginning.
    fn body_velocity(&mut self, stream: &BodyVelocity) -> Result<(), LoadError> {
        let before = self.out.observations.len();
        let geometry = self.options.geometry;
        self.observe(stream, SensorId::ODOMETER, |table| plain::body_velocity(stream, geometry, table))?;
        if stream.interval == SpeedInterval::Previous && self.out.observations.len() > before {
            let mut means = self.out.observations.split_off(before);
            for row in (1..means.len()).rev() {
                means[row].observation.stamp = means[row - 1].observation.stamp;
            }
            // The interval of the first row lies before the recording.
            self.out.observations.extend(means.into_iter().skip(1));
        }
        Ok(())
    }

    fn fixes(&mut self, stream: &Fixes) -> Result<(), LoadError> {
        let tag = self.run.tag.or(stream.tag).unwrap_or_default();
        let common = stream.common();
        let items = self.scan(&common, |table| positions::fixes(stream, tag, table))?;
        let every = self.options.use_every.or(stream.use_every).unwrap_or(1);
        let first = stream.use_first.unwrap_or(0);
        for (index, (moment, fix)) in items.into_iter().enumerate() {
            let stamp = Stamp::from_nanos(moment.stamp_nanos);
            let withheld = Withheld { stamp, fix };
            self.all_fixes.push(withheld);
            let is_used = index >= first && every > 0 && (index - first).is_multiple_of(every);
            if is_used {
                let observed = Observed::Fix(fix);
                let timed = timed(&common, SensorId::CAMERA, moment, observed);
                self.out.observations.push(timed);
            } else {
                self.out.withheld.push(withheld);
            }
        }
        Ok(())
    }

    fn truth(&mut self, stream: &Truth) -> Result<(), LoadError> {
        let items = self.scan(&stream.common(), |table| positions::truth(stream, table))?;
        let poses = items.into_iter().map(|(moment, (position, heading))| TruthPose {
            stamp: Stamp::from_nanos(moment.stamp_nanos),
            position,
            heading,
        });
        self.out.truth.extend(poses);
        Ok(())
    }

    /// Goes through the rows of one stream: what is good comes back with its times, what is bad is counted.
    fn scan<T>(
        &mut self,
        common: &Common<'_>,
        bind: impl FnOnce(&Table) -> Result<Reader<T>, LoadError>,
    ) -> Result<Vec<(Moment, T)>, LoadError> {
        if !common.is_in(&self.run.name) {
            return Ok(Vec::new());
        }
        let table = self.files.table(common.file.get_ref(), self.run)?;
        let mut reader = bind(&table)?;
        let mut clock = Clock::new(table.max_gap_nanos);
        let shift_nanos = seconds_to_nanos(common.stamp_shift_s);
        let mut items = Vec::new();
        for row in table.ordered_rows() {
            let mut read = || {
                let stamp = table.stamp(&row)?;
                let arrival_nanos = table.arrival(&row)?.unwrap_or(stamp);
                let value = reader(&row, clock.step(stamp))?;
                clock.accept(stamp);
                let moment = Moment { stamp_nanos: stamp.saturating_add(shift_nanos), arrival_nanos };
                Ok(value.map(|value| (moment, value)))
            };
            match read() {
                Ok(item) => items.extend(item),
                Err(fault) => self.out.bad_rows.add(&table.path, row.line, fault),
            }
        }
        Ok(items)
    }
}

/// The two times of a row, on the data's time base.
#[derive(Clone, Copy, Debug)]
struct Moment {
    stamp_nanos: i64,
    arrival_nanos: i64,
}

fn timed(common: &Common<'_>, sensor: SensorId, moment: Moment, observed: Observed) -> Timed {
    Timed {
        arrival: Stamp::from_nanos(moment.arrival_nanos),
        observation: Observation {
            sensor: common.sensor.map_or(sensor, SensorId),
            stamp: Stamp::from_nanos(moment.stamp_nanos),
            stamp_sigma: Span::from_secs_f64(common.stamp_sigma_s),
            observed,
        },
    }
}
