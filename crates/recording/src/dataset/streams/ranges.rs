//! Ranges to objects at known positions: landmarks with a bearing, radio beacons without.
//!
//! Several rows may share a timestamp: a camera sees more than one landmark in one image.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{BeaconId, LandmarkId, Meters, ObservationKind, Radians};

use super::super::bad_rows::{BadRowReason, RowError};
use super::super::error::LoadError;
use super::super::schema::{BeaconRanges, LandmarkSightings};
use super::super::table::DatasetTable;
use super::RowReader;

/// Which ids there are.
pub(in super::super) struct IdMapping {
    /// Turns the ids of the rows into those of the map, if they differ.
    pub(in super::super) ids: Option<BTreeMap<u32, u32>>,
    /// The ids of the map.
    pub(in super::super) known: BTreeSet<u32>,
}

impl IdMapping {
    /// The id as the map has it, known or not; an id that the table does not rename is taken as it is.
    fn map_id(&self, raw: u32) -> u32 {
        let ids = self.ids.as_ref();
        ids.and_then(|ids| ids.get(&raw).copied()).unwrap_or(raw)
    }

    fn resolve_id(&self, raw: u32) -> Result<u32, RowError> {
        let id = match &self.ids {
            None => Some(raw),
            Some(ids) => ids.get(&raw).copied(),
        };
        id.filter(|id| self.known.contains(id)).ok_or_else(|| RowError::new(BadRowReason::UnknownId, raw.to_string()))
    }
}

/// Limits outside which a range is rejected, in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct RangeLimits {
    min_m: f64,
    max_m: f64,
}

impl RangeLimits {
    pub(super) fn new(min_m: Option<f64>, max_m: Option<f64>) -> Self {
        Self { min_m: min_m.unwrap_or(f64::NEG_INFINITY), max_m: max_m.unwrap_or(f64::INFINITY) }
    }

    pub(super) fn check(self, range_m: f64) -> Result<Meters, RowError> {
        if range_m >= self.min_m && range_m <= self.max_m {
            return Ok(Meters(range_m));
        }
        let detail = format!("{range_m} m, the limits are {} to {}", self.min_m, self.max_m);
        Err(RowError::new(BadRowReason::OutOfRange, detail))
    }
}

/// Binds the columns of a `[[landmark_sightings]]` stream.
pub(in super::super) fn landmarks(
    stream: &LandmarkSightings,
    names: IdMapping,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let id = table.bind(&stream.id)?;
    let range = table.bind(&stream.range)?;
    let bearing = table.bind(&stream.bearing)?;
    let limits = RangeLimits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    let ignored: BTreeSet<u32> = stream.ignore.iter().copied().collect();
    Ok(Box::new(move |row, step| {
        step.require_in_order()?;
        let raw = id.read_id(row)?;
        if ignored.contains(&names.map_id(raw)) {
            return Ok(None);
        }
        Ok(Some(ObservationKind::Landmark {
            id: LandmarkId(names.resolve_id(raw)?),
            range: limits.check(range.read(row)?)?,
            bearing: Radians(bearing.read(row)?),
        }))
    }))
}

/// Binds the columns of a `[[beacon_ranges]]` stream.
pub(in super::super) fn beacons(
    stream: &BeaconRanges,
    names: IdMapping,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let id = table.bind(&stream.id)?;
    let range = table.bind(&stream.range)?;
    let limits = RangeLimits::new(stream.min_m.map(|m| m.0), stream.max_m.map(|m| m.0));
    Ok(Box::new(move |row, step| {
        step.require_in_order()?;
        Ok(Some(ObservationKind::BeaconRange {
            id: BeaconId(names.resolve_id(id.read_id(row)?)?),
            range: limits.check(range.read(row)?)?,
        }))
    }))
}
