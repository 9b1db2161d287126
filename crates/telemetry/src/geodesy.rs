//! The arena on the Earth: geodetic positions to and from the plane that touches the ellipsoid at the arena's origin.
//!
//! ```text
//! x = (lon - lon0) (N + h) cos lat0        N = a / sqrt(1 - e² sin² lat0)
//! y = (lat - lat0) (M + h)                 M = a (1 - e²) / (1 - e² sin² lat0)^(3/2)
//! ```
//! The arena's x is east and its y north. The linear formula is wrong by about d² / 2R: 8 cm at a distance of 1 km.
//!
//! Source: WGS 84, NIMA TR8350.2 (2000), sections 3.2 and 7.

use std::f64::consts::TAU;

use crate::quantities::{Meters, Radians};
use crate::spaces::{Arena, Point2};

/// Semi-major axis.
const A_M: f64 = 6_378_137.0;
/// First eccentricity squared.
const E2: f64 = 6.694_379_990_14e-3;
/// Nearer to a pole than this, east is no direction.
const MAX_LATITUDE_RAD: f64 = 1.57;

/// Latitude and longitude on the ellipsoid of WGS 84.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeodeticPoint {
    /// North positive.
    pub latitude: Radians,
    /// East positive.
    pub longitude: Radians,
}

/// Where on the Earth the arena's origin lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeodeticOrigin {
    point: GeodeticPoint,
    /// Above mean sea level.
    altitude: Meters,
}

impl GeodeticOrigin {
    /// `None` for a point that is not on the Earth, or too near to a pole.
    pub fn new(point: GeodeticPoint, altitude: Meters) -> Option<Self> {
        let is_on_earth = point.latitude.0.abs() <= MAX_LATITUDE_RAD && point.longitude.0.abs() <= TAU;
        (is_on_earth && altitude.0.abs() <= A_M).then_some(Self { point, altitude })
    }

    pub const fn point(&self) -> GeodeticPoint {
        self.point
    }

    pub const fn altitude(&self) -> Meters {
        self.altitude
    }

    pub fn to_arena(&self, point: GeodeticPoint) -> Point2<Arena> {
        let [east_m_per_rad, north_m_per_rad] = self.meters_per_radian();
        // The shorter way around the Earth.
        let east_rad = (point.longitude.0 - self.point.longitude.0 + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
        let north_rad = point.latitude.0 - self.point.latitude.0;
        Point2::new(Meters(east_rad * east_m_per_rad), Meters(north_rad * north_m_per_rad))
    }

    pub fn to_geodetic(&self, point: Point2<Arena>) -> GeodeticPoint {
        let [east_m_per_rad, north_m_per_rad] = self.meters_per_radian();
        let longitude_rad = self.point.longitude.0 + point.x.0 / east_m_per_rad;
        GeodeticPoint {
            latitude: Radians(self.point.latitude.0 + point.y.0 / north_m_per_rad),
            longitude: Radians((longitude_rad + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU),
        }
    }

    /// East, then north.
    fn meters_per_radian(&self) -> [f64; 2] {
        let (sin, cos) = self.point.latitude.0.sin_cos();
        let w2 = 1.0 - E2 * sin * sin;
        let prime_vertical_m = A_M / w2.sqrt();
        let meridian_m = A_M * (1.0 - E2) / (w2 * w2.sqrt());
        [(prime_vertical_m + self.altitude.0) * cos, meridian_m + self.altitude.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(latitude: f64, longitude: f64) -> GeodeticPoint {
        GeodeticPoint { latitude: Radians(latitude.to_radians()), longitude: Radians(longitude.to_radians()) }
    }

    /// Lengths of a degree of latitude and of longitude on WGS 84, to the metre, from the table of the National
    /// Geospatial-Intelligence Agency's "Length of a Degree" calculator.
    #[test]
    fn a_degree_has_its_published_length() {
        for (latitude, north_m, east_m) in
            [(0.0, 110_574.0, 111_320.0), (45.0, 111_132.0, 78_847.0), (60.0, 111_412.0, 55_800.0)]
        {
            let origin = GeodeticOrigin::new(degrees(latitude, 10.0), Meters(0.0)).unwrap();
            let moved = origin.to_arena(degrees(latitude + 1e-3, 10.0 + 1e-3));
            assert!((moved.y.0 * 1e3 - north_m).abs() < 1.0, "{latitude}: {moved:?}");
            assert!((moved.x.0 * 1e3 - east_m).abs() < 1.0, "{latitude}: {moved:?}");
        }
    }

    #[test]
    fn a_point_comes_back_also_across_the_date_line() {
        let origin = GeodeticOrigin::new(degrees(-17.0, 179.9999), Meters(400.0)).unwrap();
        let there = degrees(-17.001, -179.9998);
        let moved = origin.to_arena(there);
        assert!(moved.x.0 > 0.0 && moved.x.0 < 50.0, "{moved:?}");
        let back = origin.to_geodetic(moved);
        assert!(
            (back.latitude.0 - there.latitude.0).abs() < 1e-12 && (back.longitude.0 - there.longitude.0).abs() < 1e-12
        );
        assert_eq!(GeodeticOrigin::new(degrees(90.0, 0.0), Meters(0.0)), None);
        assert_eq!(GeodeticOrigin::new(degrees(f64::NAN, 0.0), Meters(0.0)), None);
    }
}
