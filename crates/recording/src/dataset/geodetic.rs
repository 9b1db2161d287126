//! Latitude and longitude as metres east and north of an origin: the fixes of a satellite receiver, in the arena.
//!
//! ```text
//! N = a / sqrt(1 - e² sin² φ0)                  radius of curvature across the meridian, m
//! M = a (1 - e²) / (1 - e² sin² φ0)^(3/2)       along it, m
//! east = N cos φ0 (λ - λ0)      north = M (φ - φ0)
//! ```
//!
//! The ellipsoid is approximated by its tangent plane at the origin (φ0, λ0), without height. The error is about `east
//! * north * tan φ0 / M`: 4 mm at 150 m, 0.15 m at 1 km, both ways, at 43 degrees.
//!
//! Sources: a and e² of WGS 84, NIMA TR8350.2, 3rd edition, tables 3.1 and 3.3; the radii of curvature, J. P. Snyder,
//! Map Projections - A Working Manual, USGS Professional Paper 1395 (1987), pages 24 and 25.

use std::f64::consts::FRAC_PI_2;

use posebridge_telemetry::quantities::wrap_rad;

use super::bad_rows::{BadRowReason, RowError};

/// Half the equator's diameter, in metres (WGS 84).
const SEMI_MAJOR_AXIS_M: f64 = 6_378_137.0;
/// First eccentricity squared (WGS 84).
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_14e-3;

/// A flat arena around a point of the earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalPlane {
    latitude_rad: f64,
    longitude_rad: f64,
    /// Metres per radian of longitude.
    east_scale: f64,
    /// Metres per radian of latitude.
    north_scale: f64,
}

impl LocalPlane {
    /// The plane that touches the earth at a latitude and longitude, in radians.
    pub(super) fn new(latitude_rad: f64, longitude_rad: f64) -> Self {
        let (sin, cos) = latitude_rad.sin_cos();
        let flattened = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        Self {
            latitude_rad,
            longitude_rad,
            east_scale: SEMI_MAJOR_AXIS_M / flattened.sqrt() * cos,
            north_scale: SEMI_MAJOR_AXIS_M * (1.0 - ECCENTRICITY_SQUARED) / (flattened * flattened.sqrt()),
        }
    }

    /// Metres east and north of the origin; the short way around the earth.
    pub(super) fn project(&self, latitude_rad: f64, longitude_rad: f64) -> Result<(f64, f64), RowError> {
        if latitude_rad.abs() > FRAC_PI_2 {
            let detail = format!("a latitude of {} degrees", latitude_rad.to_degrees());
            return Err(RowError::new(BadRowReason::OutOfRange, detail));
        }
        Ok((
            self.east_scale * wrap_rad(longitude_rad - self.longitude_rad),
            self.north_scale * (latitude_rad - self.latitude_rad),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Metres per degree of longitude and of latitude.
    fn per_degree(latitude_deg: f64) -> (f64, f64) {
        let plane = LocalPlane::new(latitude_deg.to_radians(), 0.0);
        let degree = 1.0_f64.to_radians();
        (plane.east_scale * degree, plane.north_scale * degree)
    }

    #[test]
    fn a_degree_is_as_long_as_the_tables_say() {
        // Length of a degree on WGS 84 in km, to the metre, as geodetic tables print it.
        for (latitude_deg, east_m, north_m) in [
            (0.0, 111_320.0, 110_574.0),
            (15.0, 107_550.0, 110_649.0),
            (45.0, 78_847.0, 111_132.0),
            (60.0, 55_800.0, 111_412.0),
        ] {
            let (east, north) = per_degree(latitude_deg);
            assert!((east - east_m).abs() < 1.0, "{latitude_deg}: {east}");
            assert!((north - north_m).abs() < 1.0, "{latitude_deg}: {north}");
        }
    }

    #[test]
    fn the_date_line_is_no_journey_around_the_earth() {
        let plane = LocalPlane::new(0.0, 179.999_f64.to_radians());
        let (east, north) = plane.project(0.0, -179.999_f64.to_radians()).unwrap();
        assert!((east - 222.64).abs() < 0.01, "{east}");
        assert_eq!(north, 0.0);
    }

    #[test]
    fn there_is_nothing_behind_the_pole() {
        let plane = LocalPlane::new(0.5, 0.5);
        assert!(plane.project(91.0_f64.to_radians(), 0.5).is_err());
    }
}
