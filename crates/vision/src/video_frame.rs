//! When and where a picture stands in a recorded video.

/// A picture of a video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoFrame {
    /// The first is 0.
    pub number: u64,
    /// Since the first, by the rate of the video.
    pub time_s: f64,
    /// Where the frame begins in the file, bytes.
    pub offset: u64,
}

/// Frames per second, as a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRate {
    numerator: u32,
    denominator: u32,
}

impl FrameRate {
    /// `None` if either is zero: the rate is unknown.
    pub(crate) const fn new(numerator: u32, denominator: u32) -> Option<Self> {
        if numerator == 0 || denominator == 0 { None } else { Some(Self { numerator, denominator }) }
    }

    pub fn frames_per_second(self) -> f64 {
        f64::from(self.numerator) / f64::from(self.denominator)
    }

    /// Of the frame with this number, since the first.
    pub(crate) fn time_s(self, number: u64) -> f64 {
        number as f64 * f64::from(self.denominator) / f64::from(self.numerator)
    }
}
