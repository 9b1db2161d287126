//! A robot whose wheels have stood for a while stands: what its accelerometers still sum up as speed is their error.
//!
//! The angle at rest tells of that error too, but only as it grows: the rounding of the counts hides a fraction of a degree. That the
//! rate itself is zero tells at once, so that a sum over a turn begins with the right rate and ends with it.
//!
//! # Model
//! ```text
//! dz = turn rate by accelerometers - 0 = c_w + creep / t        var(creep of angle)    = 2 var(rounding of the angle)
//! dz = speed by accelerometers     - 0 = c_v + creep / t        var(creep of distance) = 2 var(rounding of the distance)
//! t    how long no wheel has moved by a count: within that it may have crept from one edge of the count to the other
//! ```
//! # Source
//! Zero velocity updates: A. B. Chatfield, Fundamentals of High Accuracy Inertial Navigation, AIAA 1997, chapter 9. Paper 4 has none:
//! docs/maths/paper4.md section 3.

use super::error_state::{ACCELERATED_SPEED, ACCELERATED_TURN};
use super::nominal::Path;
use crate::models::differential_drive::WheelTravel;
use crate::update::{Scalar, use_scalar};

/// A robot that drives moves by a count sooner than that, s: 2.5 mm/s on LEGO wheels with counts of one degree.
const STANDS_AFTER_S: f64 = 0.2;

/// How long the wheels have stood, s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Stood(f64);

impl Stood {
    /// The wheels were watched for so long, and went so far.
    pub(super) fn watch(&mut self, dt_s: f64, travel: WheelTravel) {
        self.0 = if travel == WheelTravel::default() {
            self.0 + dt_s
        } else {
            0.0
        };
    }

    /// For some time nobody watched.
    pub(super) fn lose_sight(&mut self) {
        self.0 = 0.0;
    }

    /// How long, when it is long enough.
    fn stands_s(self) -> Option<f64> {
        (self.0 >= STANDS_AFTER_S).then_some(self.0)
    }
}

impl Path {
    /// Uses that the robot stands, if it does. Follows the comparison of a new sample with the path.
    pub(super) fn use_standstill(&mut self) {
        let Some(stood_s) = self.stood.stands_s() else {
            return;
        };
        let rounding = self.rounding();
        for (row, summed, variance) in [
            (
                ACCELERATED_TURN,
                self.accelerated.turn_rad_per_s,
                rounding.angle_rad2,
            ),
            (
                ACCELERATED_SPEED,
                self.accelerated.speed_m_per_s,
                rounding.distance_m2,
            ),
        ] {
            let scalar = Scalar {
                innovation: summed - self.errors[row],
                rows: [row],
                by_row: [1.0],
                variance: 2.0 * variance / (stood_s * stood_s),
            };
            use_scalar(
                &mut self.errors,
                &mut self.covariance,
                &scalar,
                f64::INFINITY,
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheels_stand_when_no_count_has_come_for_a_while() {
        let mut stood = Stood::default();
        let still = WheelTravel::default();
        let count = WheelTravel {
            left_m: 0.0,
            right_m: -0.000_5,
        };
        for (travel, stands_s) in [
            (still, None),
            (still, Some(0.2)),
            (count, None),
            (still, None),
        ] {
            stood.watch(0.1, travel);
            assert_eq!(stood.stands_s(), stands_s);
        }
        stood.watch(0.3, still);
        assert!(stood.stands_s().is_some());
        stood.lose_sight();
        assert_eq!(stood.stands_s(), None);
    }
}
