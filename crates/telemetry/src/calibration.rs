//! What a filter learns about a robot while it drives, and how well it knows it.

/// A number with one standard deviation; a sigma of zero means that it is taken as given and not estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known {
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
    pub radius_scale: Known,
    /// Relative difference of the wheels' radii, right minus left.
    pub radius_difference: Known,
    /// Relative error of the track width.
    pub track_scale: Known,
    /// Gyro bias, in rad/s.
    pub gyro_bias_rad_per_s: Known,
    /// How much earlier than its stamp a fix was true, in seconds.
    pub fix_delay_s: Known,
    /// Where the tag is, forward of where the fix says, in metres.
    pub tag_forward_m: Known,
    /// Where the tag is, to the left of where the fix says, in metres.
    pub tag_left_m: Known,
    /// A beacon's range reads long by this: an offset of each beacon for itself, in metres.
    pub beacon_offset_m: Known,
    /// Relative error of each beacon's ranges.
    pub beacon_scale: Known,
    /// The range to a landmark reads long by this: an offset of the robot's own camera, in metres.
    pub landmark_offset_m: Known,
    /// Relative error of the camera's ranges to landmarks.
    pub landmark_scale: Known,
}
