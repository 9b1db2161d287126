//! The table of faults: what each does to the observations, and the wiring that undoes it.

use posebridge_telemetry::{CameraUnit, GyroUnit, Wiring};
use serde::{Deserialize, Serialize};

/// Something that is connected, counted or configured wrongly.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum WiringFault {
    GyroInDegrees,
    /// The configuration says degrees per second.
    GyroInRadians,
    GyroReversed,
    WheelsSwapped,
    LeftWheelReversed,
    RightWheelReversed,
    BothWheelsReversed,
    /// The wheels report half of the way: too many ticks per turn are configured.
    WheelsReportHalf,
    /// The wheels report twice the way: too few ticks per turn are configured.
    WheelsReportDouble,
    /// The configured track width is twice the real one.
    TrackTooWide,
    /// The configured track width is half the real one.
    TrackTooNarrow,
    CameraInMillimeters,
    RadiiInMillimeters,
    TrackInMillimeters,
    RadiiAndTrackInMillimeters,
    /// The camera's y axis points down.
    CameraYDown,
}

impl WiringFault {
    pub const ALL: [Self; 16] = [
        Self::GyroInDegrees,
        Self::GyroInRadians,
        Self::GyroReversed,
        Self::WheelsSwapped,
        Self::LeftWheelReversed,
        Self::RightWheelReversed,
        Self::BothWheelsReversed,
        Self::WheelsReportHalf,
        Self::WheelsReportDouble,
        Self::TrackTooWide,
        Self::TrackTooNarrow,
        Self::CameraInMillimeters,
        Self::RadiiInMillimeters,
        Self::TrackInMillimeters,
        Self::RadiiAndTrackInMillimeters,
        Self::CameraYDown,
    ];

    /// What is wrong, as the end of a sentence.
    pub const fn conclusion(self) -> &'static str {
        match self {
            Self::GyroInDegrees => "the gyro reports degrees per second",
            Self::GyroInRadians => "the gyro reports radians per second",
            Self::GyroReversed => "the gyro's axis is reversed",
            Self::WheelsSwapped => "the left and the right wheel are swapped",
            Self::LeftWheelReversed => "the left wheel counts backwards",
            Self::RightWheelReversed => "the right wheel counts backwards",
            Self::BothWheelsReversed => "both wheels count backwards",
            Self::WheelsReportHalf => "the configured ticks per turn are twice as many as the wheels have",
            Self::WheelsReportDouble => "the configured ticks per turn are half as many as the wheels have",
            Self::TrackTooWide => "the configured track width is twice the real one",
            Self::TrackTooNarrow => "the configured track width is half the real one",
            Self::CameraInMillimeters => "the camera reports millimetres",
            Self::RadiiInMillimeters => "the wheel radii are given in millimetres",
            Self::TrackInMillimeters => "the track width is given in millimetres",
            Self::RadiiAndTrackInMillimeters => "wheel radii and track width are given in millimetres",
            Self::CameraYDown => "the y axis of the camera points down",
        }
    }

    /// The wiring that undoes the fault on a robot whose observations were corrected by `present`; `None` for a fault of the
    /// geometry.
    pub fn correct(self, present: Wiring) -> Option<Wiring> {
        let (left, right) = (present.left, present.right);
        Some(match self {
            Self::GyroInDegrees => Wiring { gyro_unit: GyroUnit::DegreesPerSecond, ..present },
            Self::GyroInRadians => Wiring { gyro_unit: GyroUnit::RadiansPerSecond, ..present },
            Self::GyroReversed => Wiring { gyro: present.gyro.toggled(), ..present },
            Self::WheelsSwapped => Wiring { wheels: present.wheels.toggled(), left: right, right: left, ..present },
            Self::LeftWheelReversed => Wiring { left: left.toggled(), ..present },
            Self::RightWheelReversed => Wiring { right: right.toggled(), ..present },
            Self::BothWheelsReversed => Wiring { left: left.toggled(), right: right.toggled(), ..present },
            Self::CameraInMillimeters => Wiring { camera_unit: CameraUnit::Millimeters, ..present },
            Self::CameraYDown => Wiring { camera_y: present.camera_y.toggled(), ..present },
            Self::WheelsReportHalf
            | Self::WheelsReportDouble
            | Self::TrackTooWide
            | Self::TrackTooNarrow
            | Self::RadiiInMillimeters
            | Self::TrackInMillimeters
            | Self::RadiiAndTrackInMillimeters => return None,
        })
    }

    /// The factor of the configured wheel radii, or of what one tick means, that undoes the fault.
    pub const fn travel_factor(self) -> f64 {
        match self {
            Self::WheelsReportHalf => 2.0,
            Self::WheelsReportDouble => 0.5,
            Self::RadiiInMillimeters | Self::RadiiAndTrackInMillimeters => 1e-3,
            Self::GyroInDegrees
            | Self::GyroInRadians
            | Self::GyroReversed
            | Self::WheelsSwapped
            | Self::LeftWheelReversed
            | Self::RightWheelReversed
            | Self::BothWheelsReversed
            | Self::TrackTooWide
            | Self::TrackTooNarrow
            | Self::CameraInMillimeters
            | Self::TrackInMillimeters
            | Self::CameraYDown => 1.0,
        }
    }

    /// The factor of the configured track width that undoes the fault.
    pub const fn track_factor(self) -> f64 {
        match self {
            Self::TrackTooWide => 0.5,
            Self::TrackTooNarrow => 2.0,
            Self::TrackInMillimeters | Self::RadiiAndTrackInMillimeters => 1e-3,
            Self::GyroInDegrees
            | Self::GyroInRadians
            | Self::GyroReversed
            | Self::WheelsSwapped
            | Self::LeftWheelReversed
            | Self::RightWheelReversed
            | Self::BothWheelsReversed
            | Self::WheelsReportHalf
            | Self::WheelsReportDouble
            | Self::CameraInMillimeters
            | Self::RadiiInMillimeters
            | Self::CameraYDown => 1.0,
        }
    }
}

/// What is assumed of a robot: no fault, or one. It turns what was observed into what would have been without the fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypothesis {
    /// From the left and the right counter to the left and the right wheel, rows first.
    wheels: [[f64; 2]; 2],
    /// Of travel.
    pub(super) travel_factor: f64,
    /// Of the turn by the wheels, for the same travel.
    turn_factor: f64,
    pub(super) gyro_factor: f64,
    pub(super) camera_factor: f64,
    /// -1 mirrors the camera's picture.
    pub(super) camera_y_sign: f64,
    /// The wheels' turn alone says nothing without the correction: one wheel is reversed.
    pub(super) has_broken_turn: bool,
}

impl Hypothesis {
    pub(super) const CORRECT: Self = Self {
        wheels: [[1.0, 0.0], [0.0, 1.0]],
        travel_factor: 1.0,
        turn_factor: 1.0,
        gyro_factor: 1.0,
        camera_factor: 1.0,
        camera_y_sign: 1.0,
        has_broken_turn: false,
    };

    pub(super) fn of_fault(fault: WiringFault) -> Self {
        let base =
            Self { travel_factor: fault.travel_factor(), turn_factor: 1.0 / fault.track_factor(), ..Self::CORRECT };
        match fault {
            WiringFault::GyroInDegrees => Self { gyro_factor: 1.0_f64.to_radians(), ..base },
            WiringFault::GyroInRadians => Self { gyro_factor: 1.0_f64.to_degrees(), ..base },
            WiringFault::GyroReversed => Self { gyro_factor: -1.0, ..base },
            WiringFault::WheelsSwapped => Self { wheels: [[0.0, 1.0], [1.0, 0.0]], ..base },
            WiringFault::LeftWheelReversed => Self { wheels: [[-1.0, 0.0], [0.0, 1.0]], has_broken_turn: true, ..base },
            WiringFault::RightWheelReversed => {
                Self { wheels: [[1.0, 0.0], [0.0, -1.0]], has_broken_turn: true, ..base }
            }
            WiringFault::BothWheelsReversed => Self { wheels: [[-1.0, 0.0], [0.0, -1.0]], ..base },
            WiringFault::CameraInMillimeters => Self { camera_factor: 1e-3, ..base },
            WiringFault::CameraYDown => Self { camera_y_sign: -1.0, ..base },
            WiringFault::WheelsReportHalf
            | WiringFault::WheelsReportDouble
            | WiringFault::TrackTooWide
            | WiringFault::TrackTooNarrow
            | WiringFault::RadiiInMillimeters
            | WiringFault::TrackInMillimeters
            | WiringFault::RadiiAndTrackInMillimeters => base,
        }
    }

    /// Forward travel and turn of the body for the travel of both wheels as counted.
    pub(super) fn body_motion(&self, [left_m, right_m]: [f64; 2], track_m: f64) -> [f64; 2] {
        let travel =
            self.wheels.map(|[from_left, from_right]| self.travel_factor * (from_left * left_m + from_right * right_m));
        [0.5 * (travel[0] + travel[1]), self.turn_factor * (travel[1] - travel[0]) / track_m]
    }

    /// Whether it turns the turn by the wheels around, and no more: a swap, or two reversed wheels.
    pub(super) fn reverses_turn(&self) -> bool {
        !self.has_broken_turn && self.wheels[1][1] <= 0.0
    }

    /// By how much an error of a counted wheel grows in the turn.
    pub(super) fn turn_gain(&self) -> f64 {
        self.travel_factor * self.turn_factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Polarity, WheelOrder};

    #[test]
    fn each_hypothesis_undoes_its_fault() {
        let motion = |fault: WiringFault| Hypothesis::of_fault(fault).body_motion([0.1, 0.3], 0.1);
        let close = |found: [f64; 2], expected: [f64; 2]| {
            assert!(
                found.iter().zip(expected).all(|(one, other)| (one - other).abs() < 1e-9),
                "{found:?} {expected:?}"
            );
        };
        close(motion(WiringFault::WheelsSwapped), [0.2, -2.0]);
        close(motion(WiringFault::LeftWheelReversed), [0.1, 4.0]);
        close(motion(WiringFault::RightWheelReversed), [-0.1, -4.0]);
        close(motion(WiringFault::BothWheelsReversed), [-0.2, -2.0]);
        close(motion(WiringFault::WheelsReportHalf), [0.4, 4.0]);
        close(motion(WiringFault::TrackTooWide), [0.2, 4.0]);
        close(motion(WiringFault::TrackInMillimeters), [0.2, 2_000.0]);
        close(motion(WiringFault::RadiiAndTrackInMillimeters), [2e-4, 2.0]);
    }

    #[test]
    fn a_fault_found_twice_over_is_no_fault() {
        let present = Wiring { left: Polarity::Reversed, ..Wiring::default() };
        for fault in [WiringFault::WheelsSwapped, WiringFault::BothWheelsReversed, WiringFault::GyroReversed] {
            let once = fault.correct(present).unwrap();
            assert_ne!(once, present);
            assert_eq!(fault.correct(once), Some(present));
        }
        // The left wheel of the corrected observations is the right counter.
        let swapped = WiringFault::WheelsSwapped.correct(present).unwrap();
        assert_eq!(
            (swapped.wheels, swapped.left, swapped.right),
            (WheelOrder::Swapped, Polarity::Normal, Polarity::Reversed)
        );
        assert_eq!(WiringFault::TrackTooWide.correct(present), None);
    }
}
