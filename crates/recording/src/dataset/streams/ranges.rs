//! Ranges to things with known places: landmarks with a bearing, radio beacons without.
//!
//! Several rows may share a stamp here: a camera sees more than one landmark in one image.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{BeaconId, LandmarkId, Meters, Observed, Radians};

use super::super::bad_rows::{Fault, Reason};
use super::super::load::LoadError;
use super::super::schema::{BeaconRanges, LandmarkSightings};
use super::super::table::Table;
use super::Reader;

/// Which ids there are.
pub(in super::super) struct Names {
    /// Turns the ids of the rows into those of the map, if they differ.
    pub(in super::super) ids: Option<BTreeMap<u32, u32>>,
    /// The ids of the map.
    pub(in super::super) known: BTreeSet<u32>,
}

impl Names {
    /// The id as the map has it, known or not; an id that the table does not rename is taken as it is.
    fn renamed(&self, raw: u32) -> u32 {
        let ids = self.ids.as_ref();
        ids.and_then(|ids| ids.get(&raw).copied()).unwrap_or(raw)
    }

    fn resolve(&self, raw: u32) -> Result<u32, Fault> {
        let id = match &self.ids {
            None => Some(raw),
            Some(ids) => ids.get(&raw).copied(),
        };
        id.filter(|id| self.known.contains(id)).ok_or_else(|| Fault::new(Reason::UnknownId, raw.to_string()))
    }
}

/// Limits outside which a range is not believed, in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    min_m: f64,
    max_m: f64,
}

impl Limits {
    pub(super) fn new(min_m: Option<f64>, max_m: Option<f64>) -> Self {
        Self { min_m: min_m.unwrap_or(f64::NEG_INFINITY), max_m: max_m.unwrap_or(f64::INFINITY) }
    }

    pub(super) fn check(self, range_m: f64) -> Result<Meters, Fault> {
        if range_m >= self.min_m && range_m <= self.max_m {
            return Ok(Meters(range_m));
        }
        let detail = format!("{range_m} m, the limits are {} to {}", self.min_m, self.max_m);
        Err(Fault::new(Reason::OutOfRange, detail))
    }
}

/// Binds the columns of a `[[landmark_sightings]]` stream.
pub(in super::super) fn landmarks(
    stream: &LandmarkSightings,
    names: Names,
    table: &Table,
) -> Result<Reader<Observed>, LoadError> {
    let id = table.bind(&stream.id)?;
    let range = table.bind(&stream.range)?;
    let bearing = table.bind(&stream.bearing)?;
    let limits = Limits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    let ignored: BTreeSet<u32> = stream.ignore.iter().copied().collect();
    Ok(Box::new(move |row, step| {
        step.in_order()?;
        let raw = id.read_id(row)?;
        if ignored.contains(&names.renamed(raw)) {
            return Ok(None);
        }
        Ok(Some(Observed::Landmark {
            id: LandmarkId(names.resolve(raw)?),
            range: limits.check(range.read(row)?)?,
            bearing: Radians(bearing.read(row)?),
        }))
    }))
}

/// Binds the columns of a `[[beacon_ranges]]` stream.
pub(in super::super) fn beacons(
    stream: &BeaconRanges,
    names: Names,
    table: &Table,
) -> Result<Reader<Observed>, LoadError> {
    let id = table.bind(&stream.id)?;
    let range = table.bind(&stream.range)?;
    let limits = Limits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    Ok(Box::new(move |row, step| {
        step.in_order()?;
        Ok(Some(Observed::BeaconRange {
            id: BeaconId(names.resolve(id.read_id(row)?)?),
            range: limits.check(range.read(row)?)?,
        }))
    }))
}
