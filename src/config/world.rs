//! `[world]`: where landmarks, beacons and walls stand in the arena.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use posebridge_telemetry::{Arena, ArenaMap, BeaconId, LandmarkId, Meters, Point2, Wall};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What stands in the arena.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct WorldConfig {
    /// Points that a robot's camera can tell apart.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub landmarks: Vec<NumberedPlace>,
    /// Radio beacons.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub beacons: Vec<NumberedPlace>,
    /// Walls that a range sensor can meet.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub walls: Vec<WallPlace>,
}

/// The place of a landmark or of a beacon.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct NumberedPlace {
    /// The number under which it is seen.
    pub id: u32,
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
}

/// A straight wall between two points.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct WallPlace {
    /// One end.
    pub from: PointPlace,
    /// The other end.
    pub to: PointPlace,
}

/// A point of the arena.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, expecting = "a table { x_m, y_m }")]
pub struct PointPlace {
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
}

impl WorldConfig {
    /// In the vocabulary's type.
    ///
    /// # Errors
    /// A number is not finite, an id is there twice, or a wall has no length; the message names the key.
    pub fn checked(&self) -> Result<ArenaMap> {
        let landmarks = parse_points("landmarks", &self.landmarks)?;
        let beacons = parse_points("beacons", &self.beacons)?;
        let walls = self.walls.iter().enumerate().map(|(index, place)| {
            let key = format!("walls, number {}", index + 1);
            let (from, to) = (parse_point(&key, place.from)?, parse_point(&key, place.to)?);
            ensure!(from != to, "`[world]` {key}: it has no length");
            Ok(Wall { from, to })
        });
        Ok(ArenaMap {
            landmarks: by_id(&landmarks, LandmarkId),
            beacons: by_id(&beacons, BeaconId),
            walls: walls.collect::<Result<_>>()?,
        })
    }
}

fn parse_points(key: &str, places: &[NumberedPlace]) -> Result<BTreeMap<u32, Point2<Arena>>> {
    let mut known = BTreeMap::new();
    for &NumberedPlace { id, x_m, y_m } in places {
        let at = parse_point(&format!("{key}, id {id}"), PointPlace { x_m, y_m })?;
        ensure!(known.insert(id, at).is_none(), "`[world]` {key}: the id {id} is there twice");
    }
    Ok(known)
}

fn by_id<K: Ord>(places: &BTreeMap<u32, Point2<Arena>>, id: fn(u32) -> K) -> BTreeMap<K, Point2<Arena>> {
    places.iter().map(|(key, at)| (id(*key), *at)).collect()
}

fn parse_point(key: &str, place: PointPlace) -> Result<Point2<Arena>> {
    let PointPlace { x_m, y_m } = place;
    ensure!(x_m.is_finite() && y_m.is_finite(), "`[world]` {key}: it lies at ({x_m}, {y_m}): both must be finite");
    Ok(Point2::new(Meters(x_m), Meters(y_m)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world(text: &str) -> Result<ArenaMap> {
        toml::from_str::<WorldConfig>(text).unwrap().checked()
    }

    #[test]
    fn places_and_walls_reach_the_filter() {
        let world = world(
            "landmarks = [{ id = 6, x_m = 1.0, y_m = 2.0 }]\n\
             beacons = [{ id = 0, x_m = -1.0, y_m = 0.5 }]\n\
             walls = [{ from = { x_m = 0.0, y_m = 0.0 }, to = { x_m = 2.0, y_m = 0.0 } }]\n",
        )
        .unwrap();
        assert_eq!(world.landmarks[&LandmarkId(6)], Point2::new(Meters(1.0), Meters(2.0)));
        assert_eq!(world.beacons[&BeaconId(0)], Point2::new(Meters(-1.0), Meters(0.5)));
        assert_eq!(world.walls[0].to, Point2::new(Meters(2.0), Meters(0.0)));
    }

    #[test]
    fn what_cannot_stand_there_is_named() {
        let refused = |text: &str| world(text).unwrap_err().to_string();
        assert_eq!(
            refused("beacons = [{ id = 1, x_m = 0.0, y_m = 0.0 }, { id = 1, x_m = 1.0, y_m = 0.0 }]"),
            "`[world]` beacons: the id 1 is there twice"
        );
        assert_eq!(
            refused("walls = [{ from = { x_m = 1.0, y_m = 0.0 }, to = { x_m = 1.0, y_m = 0.0 } }]"),
            "`[world]` walls, number 1: it has no length"
        );
        assert_eq!(
            refused("landmarks = [{ id = 3, x_m = nan, y_m = 0.0 }]"),
            "`[world]` landmarks, id 3: it lies at (NaN, 0): both must be finite"
        );
    }
}
