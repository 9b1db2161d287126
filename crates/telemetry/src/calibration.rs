//! The constants of a robot that a filter estimates, with their uncertainty.

/// A number with one standard deviation; a sigma of zero means that it is fixed and not estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UncertainValue {
    /// The number.
    pub value: f64,
    /// One standard deviation, in the number's own unit.
    pub sigma: f64,
}

/// The systematic errors of a robot and of the sensors that watch it: as a prior in a filter's configuration, as a result in
/// its report.
///
/// The true left wheel's radius is `r_L (1 + radius_scale - radius_difference / 2)`, the right one's
/// `r_R (1 + radius_scale + radius_difference / 2)`, the true track width `b (1 + track_scale)`, with the nominal geometry
/// r_L, r_R, b. For a robot that reports speeds or an odometer's pose the same numbers scale distance and turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Relative error of the mean wheel radius.
    pub radius_scale: UncertainValue,
    /// Relative difference of the wheels' radii, right minus left.
    pub radius_difference: UncertainValue,
    /// Relative error of the track width.
    pub track_scale: UncertainValue,
    /// Gyro bias, in rad/s.
    pub gyro_bias_rad_per_s: UncertainValue,
    /// Delay of a fix: how much earlier than its timestamp it was measured, in seconds.
    pub fix_delay_s: UncertainValue,
    /// Error of the tag's configured position, forward, in metres.
    pub tag_forward_m: UncertainValue,
    /// Error of the tag's configured position, to the left, in metres.
    pub tag_left_m: UncertainValue,
    /// Offset of each beacon's ranges, in metres; positive reads long.
    pub beacon_offset_m: UncertainValue,
    /// Relative error of each beacon's ranges.
    pub beacon_scale: UncertainValue,
    /// Offset of the robot camera's ranges to landmarks, in metres; positive reads long.
    pub landmark_offset_m: UncertainValue,
    /// Relative error of the camera's ranges to landmarks.
    pub landmark_scale: UncertainValue,
}
