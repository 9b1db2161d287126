//! The figures of a report: one session, or one run, over time.
//!
//! Each is a pure function from samples to a narrow SVG document (`strip`). Times are seconds since the session began, by the host's
//! clock, so that all figures of a page and its list of events agree; units are SI and become millimetres and degrees on the axes.

mod innovations;
mod path;

use posebridge_telemetry::{Estimate, FusionOutcome, FusionRecord, LinkCounter, LinkHealth};

use super::axes::{CLAIM, ESTIMATE, ValueRange};
use super::plot::{Axes, Curve, CurveShape, curve_stroke};
use super::strip::render_strip;
use crate::metrics::PoseError;
use crate::metrics::sources::variance;
use crate::track::PoseTrack;

pub use self::innovations::render_innovations;
pub use self::path::render_path;

/// Error of an estimate, and its claimed error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorSample {
    pub t_s: f64,
    /// Distance between estimated and true position.
    pub position_m: f64,
    /// Twice the claimed distance root mean square.
    pub position_claim_m: f64,
    /// Wrapped.
    pub heading_rad: f64,
    /// Twice the claimed standard deviation.
    pub heading_claim_rad: f64,
}

impl ErrorSample {
    /// The error of an estimate made at `t_s`, against the truth at its own timestamp; `None` without truth, or if its position is
    /// invalid.
    pub fn from_estimate(t_s: f64, estimate: &Estimate, truth: &PoseTrack) -> Option<Self> {
        let error = PoseError::of_estimate(estimate, truth.at(estimate.stamp)?);
        let sample = Self {
            t_s,
            position_m: error.dx_m.hypot(error.dy_m),
            position_claim_m: 2.0 * estimate.x_sigma_m().hypot(estimate.y_sigma_m()),
            heading_rad: error.heading_rad.unwrap_or(f64::NAN),
            heading_claim_rad: 2.0 * estimate.heading_sigma_rad(),
        };
        (estimate.validity.position && sample.position_m.is_finite()).then_some(sample)
    }
}

/// One attempt to fuse an observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InnovationSample {
    pub t_s: f64,
    /// Observed minus predicted, SI units; unused components are zero.
    pub innovation: [f64; 3],
    /// Claimed, one standard deviation, SI units.
    pub sigma: [f64; 3],
    pub nis: f64,
    /// 0 without a prediction.
    pub degrees_of_freedom: u8,
    /// False if the gate rejected it.
    pub is_used: bool,
}

impl InnovationSample {
    /// `None` if the observation did not reach the gate, or there was no prediction.
    pub fn from_record(t_s: f64, record: &FusionRecord) -> Option<Self> {
        let is_used = match record.outcome {
            FusionOutcome::Accepted | FusionOutcome::Slip => true,
            FusionOutcome::Gated => false,
            FusionOutcome::TooOld
            | FusionOutcome::Malformed
            | FusionOutcome::Rebased
            | FusionOutcome::PoseReset
            | FusionOutcome::Unused => {
                return None;
            }
        };
        let sigma = [0, 1, 2].map(|component| variance(record, component).max(0.0).sqrt());
        (record.degrees_of_freedom > 0).then_some(Self {
            t_s,
            innovation: record.innovation,
            sigma,
            nis: record.nis,
            degrees_of_freedom: record.degrees_of_freedom,
            is_used,
        })
    }
}

/// All fusion attempts of one sensor.
#[derive(Clone, Copy, Debug, Default)]
pub struct InnovationSeries<'a> {
    pub name: &'a str,
    /// As named by [`posebridge_telemetry::ObservationKind::kind`].
    pub kind: &'a str,
    pub samples: &'a [InnovationSample],
}

/// The estimate of one systematic error at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSample {
    pub t_s: f64,
    /// In the unit of the key's suffix; a ratio without one.
    pub value: f64,
    /// One standard deviation.
    pub sigma: f64,
}

/// The estimates of one systematic error over time.
#[derive(Clone, Copy, Debug, Default)]
pub struct CalibrationSeries<'a> {
    /// Key in the configuration.
    pub key: &'a str,
    pub samples: &'a [CalibrationSample],
}

/// The health of a link at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkSample {
    pub t_s: f64,
    /// Counters since the session began.
    pub health: LinkHealth,
}

/// An alignment of the brick's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockSample {
    pub t_s: f64,
    /// Brick time minus host time.
    pub offset_s: f64,
    /// Rate of the brick's clock relative to the host's, minus one.
    pub skew_ppm: f64,
    /// Bound of the offset's error.
    pub uncertainty_s: f64,
    /// Of the time exchange behind the alignment.
    pub round_trip_s: Option<f64>,
}

/// The display unit of a number by the suffix of its key, and the factor from SI.
///
/// `gyro_bias_rad_per_s` is shown in degrees per second, a length in millimetres, a time in milliseconds, a ratio in per cent.
pub fn display_unit(key: &str) -> (&'static str, f64) {
    if key.ends_with("_rad_per_s") {
        ("deg/s", 1f64.to_degrees())
    } else if key.ends_with("_rad") {
        ("deg", 1f64.to_degrees())
    } else if key.ends_with("_deg") {
        ("deg", 1.0)
    } else if key.ends_with("_m") {
        ("mm", 1e3)
    } else if key.ends_with("_s") {
        ("ms", 1e3)
    } else {
        ("%", 100.0)
    }
}

/// Share of the values within the axis range, so that an initial transient does not compress the rest.
const SHOWN_SHARE: f64 = 0.995;

/// The `SHOWN_SHARE` quantile of the absolute values with a margin; `None` without finite values other than zero.
fn high_quantile(sizes: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sizes: Vec<f64> = sizes.map(f64::abs).filter(|size| size.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let index = ((sizes.len() as f64 - 1.0) * SHOWN_SHARE).floor() as usize;
    let size = sizes.get(index).copied().filter(|size| *size > 0.0)?;
    Some(size * 1.15)
}

/// From zero to that quantile.
fn range_from_zero(sizes: impl Iterator<Item = f64>) -> Option<ValueRange> {
    high_quantile(sizes).map(|high| ValueRange { low: 0.0, high })
}

/// Symmetric about zero.
fn symmetric_range(sizes: impl Iterator<Item = f64>) -> Option<ValueRange> {
    high_quantile(sizes).map(|high| ValueRange { low: -high, high })
}

/// A panel over time; `y` is its range if it is not that of the curves.
fn panel(y_name: &str, height_px: f64, y: Option<ValueRange>, curves: impl IntoIterator<Item = Curve>) -> Axes {
    Axes { y, ..Axes::new("time [s]", y_name, height_px, curves) }
}

const CLOCK_PX: f64 = 100.0;
const ERROR_PX: f64 = 150.0;
const LINK_PX: f64 = 92.0;
const S_TO_MS: f64 = 1e3;
const M_TO_MM: f64 = 1e3;

/// Draws the change of the clock's offset, the skew and the uncertainty; returns a whole SVG document.
pub fn render_clock(title: &str, samples: &[ClockSample]) -> String {
    // The change, because the offset itself is as large as the brick has been running.
    let first_s = samples.first().map_or(0.0, |first| first.offset_s);
    let change_ms = |sample: &ClockSample| (sample.offset_s - first_s) * S_TO_MS;
    let change = samples.iter().map(|one| (one.t_s, change_ms(one)));
    let bounds = samples.iter().map(|one| {
        let (middle, half_width) = (change_ms(one), one.uncertainty_s * S_TO_MS);
        (one.t_s, middle - half_width, middle + half_width)
    });
    let offset = [
        Curve::new("its bounds", CurveShape::Band(bounds.collect())).with_stroke(&CLAIM),
        Curve::line("change of the offset", change).with_stroke(&ESTIMATE),
    ];
    let skew = samples.iter().map(|one| (one.t_s, one.skew_ppm));
    let skew = [Curve::line("the brick's clock is fast by", skew).with_stroke(curve_stroke(3))];
    let bound = samples.iter().map(|one| (one.t_s, one.uncertainty_s * S_TO_MS));
    let round_trip: Vec<(f64, f64)> =
        samples.iter().filter_map(|one| Some((one.t_s, one.round_trip_s? * S_TO_MS))).collect();
    let sizes: Vec<f64> = bound.clone().chain(round_trip.iter().copied()).map(|one| one.1).collect();
    let uncertainty = [
        Curve::new("round trip", CurveShape::Specks(round_trip)).with_stroke(&ESTIMATE),
        Curve::line("uncertainty", bound).with_stroke(curve_stroke(1)),
    ];
    let panels = [
        panel("[ms]", CLOCK_PX, None, offset),
        panel("[ppm]", CLOCK_PX, None, skew),
        panel("[ms]", CLOCK_PX, range_from_zero(sizes.into_iter()), uncertainty),
    ];
    render_strip(title, &panels)
}

/// Draws position and heading error with the estimate's 2-sigma claims; returns a whole SVG document.
pub fn render_errors(title: &str, samples: &[ErrorSample]) -> String {
    let position = samples.iter().map(|sample| (sample.t_s, sample.position_m * M_TO_MM));
    let claim = samples.iter().map(|sample| (sample.t_s, 0.0, sample.position_claim_m * M_TO_MM));
    let sizes = samples.iter().flat_map(|sample| [sample.position_m, sample.position_claim_m]);
    let range = range_from_zero(sizes.map(|size| size * M_TO_MM));
    let position = panel("position error [mm]", ERROR_PX, range, error_curves(claim.collect(), position.collect()));
    // A heading that may not be used has no error.
    let known = || samples.iter().filter(|sample| sample.heading_rad.is_finite());
    let heading = known().map(|sample| (sample.t_s, sample.heading_rad.to_degrees()));
    let claim = known().map(|sample| {
        let claim = sample.heading_claim_rad.to_degrees();
        (sample.t_s, -claim, claim)
    });
    let sizes = known().flat_map(|sample| [sample.heading_rad, sample.heading_claim_rad]);
    let range = symmetric_range(sizes.map(f64::to_degrees));
    let heading = panel("heading error [deg]", ERROR_PX, range, error_curves(claim.collect(), heading.collect()));
    render_strip(title, &[position, heading])
}

/// A claim as a band, and the error over it.
fn error_curves(claim: Vec<(f64, f64, f64)>, error: Vec<(f64, f64)>) -> [Curve; 2] {
    [
        Curve::new("its 2-sigma claim", CurveShape::Band(claim)).with_stroke(&CLAIM),
        Curve::line("error", error).with_stroke(&ESTIMATE),
    ]
}

const TRAFFIC_COUNTERS: [LinkCounter; 2] = [LinkCounter::FRAMES_IN, LinkCounter::FRAMES_OUT];

const ERROR_COUNTERS: [LinkCounter; 9] = [
    LinkCounter::FRAMES_LOST,
    LinkCounter::CHECKSUM_ERRORS,
    LinkCounter::TIMEOUTS,
    LinkCounter { label: "unknown", ..LinkCounter::UNKNOWN_IDS },
    LinkCounter::REJECTED_FRAMES,
    LinkCounter::DUPLICATES,
    LinkCounter::RATE_LIMITED,
    LinkCounter::UNSENT,
    LinkCounter::RECONNECTS,
];

const GARBAGE_COUNTERS: [LinkCounter; 1] = [LinkCounter::GARBAGE_BYTES];

/// Draws traffic, errors, latency and queue of a link; returns a whole SVG document. Counters that stay at zero have no curve.
pub fn render_link(title: &str, samples: &[LinkSample]) -> String {
    let mut panels = vec![rates("frames/s", &TRAFFIC_COUNTERS, samples)];
    for (name, counters) in [("per second", &ERROR_COUNTERS[..]), ("bytes/s", &GARBAGE_COUNTERS[..])] {
        let panel = rates(name, counters, samples);
        if !panel.curves.is_empty() {
            panels.push(panel);
        }
    }
    let single = |y_name, name, points: Vec<(f64, f64)>| {
        panel(y_name, LINK_PX, None, [Curve::line(name, points).with_stroke(curve_stroke(2))])
    };
    let round_trips: Vec<(f64, f64)> =
        samples.iter().filter_map(|sample| Some((sample.t_s, sample.health.round_trip?.as_millis_f64()))).collect();
    if !round_trips.is_empty() {
        panels.push(single("[ms]", "round trip", round_trips));
    }
    if samples.iter().any(|sample| sample.health.port.queued_frames > 0) {
        let queued = samples.iter().map(|sample| (sample.t_s, f64::from(sample.health.port.queued_frames)));
        panels.push(single("frames", "waiting to be sent", queued.collect()));
    }
    render_strip(title, &panels)
}

/// Rates of counters that only grow: differences over time. A missing frame that arrives late reduces its count, which is not a
/// negative loss.
fn rates(y_name: &str, counters: &[LinkCounter], samples: &[LinkSample]) -> Axes {
    let last = samples.last();
    let happened = |counter: &&LinkCounter| last.is_some_and(|last| (counter.read)(&last.health) > 0);
    let curves = counters.iter().filter(happened).enumerate().map(|(index, counter)| {
        let rate = samples.windows(2).filter_map(|pair| {
            let [before, after] = pair else { return None };
            let elapsed_s = after.t_s - before.t_s;
            let grown = (counter.read)(&after.health).saturating_sub((counter.read)(&before.health));
            (elapsed_s > 0.0).then(|| (after.t_s, grown as f64 / elapsed_s))
        });
        Curve::line(counter.label, rate).with_stroke(curve_stroke(index + 1))
    });
    panel(y_name, LINK_PX, None, curves)
}

/// Draws a panel for each systematic error that the filter estimates; returns a whole SVG document.
pub fn learning(title: &str, all: &[CalibrationSeries<'_>]) -> String {
    let panels = all.iter().map(|series| {
        let (unit, factor) = display_unit(series.key);
        let value = series.samples.iter().map(|one| (one.t_s, one.value * factor));
        let band = series.samples.iter().map(|one| {
            let (value, half_width) = (one.value * factor, 2.0 * one.sigma * factor);
            (one.t_s, value - half_width, value + half_width)
        });
        let curves = [
            Curve::new("2 sigma", CurveShape::Band(band.collect())).with_stroke(&CLAIM),
            Curve::line(series.key, value).with_stroke(&ESTIMATE),
        ];
        panel(&format!("[{unit}]"), LINK_PX, None, curves)
    });
    render_strip(title, &panels.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::TimeDelta;

    use super::*;

    #[test]
    fn a_key_tells_the_unit_that_people_read() {
        let unit = |key| display_unit(key).0;
        assert_eq!(unit("gyro_bias_rad_per_s"), "deg/s");
        assert_eq!(unit("fix_delay_s"), "ms");
        assert_eq!(unit("tag_forward_m"), "mm");
        assert_eq!(unit("track_scale"), "%");
    }

    #[test]
    fn a_moment_at_the_start_leaves_the_axis() {
        let mut sizes = vec![1.0; 1_000];
        sizes[0] = 500.0;
        sizes[1] = f64::NAN;
        assert_eq!(range_from_zero(sizes.into_iter()).unwrap().high, 1.15);
        assert_eq!(range_from_zero([0.0, 0.0].into_iter()), None);
        assert_eq!(symmetric_range(std::iter::empty()), None);
    }

    #[test]
    fn the_offset_is_shown_as_its_change() {
        let samples = [(0.0, 5000.0), (10.0, 5000.02)].map(|(t_s, offset_s)| ClockSample {
            t_s,
            offset_s,
            skew_ppm: 2000.0,
            uncertainty_s: 0.000_5,
            round_trip_s: None,
        });
        let svg = render_clock("clock", &samples);
        assert!(svg.contains(">20</text>") && svg.contains(">change of the offset</text>"), "{svg}");
        assert!(!svg.contains("5000"), "{svg}");
    }

    #[test]
    fn errors_are_in_millimetres_and_degrees() {
        let sample = |t_s: f64| ErrorSample {
            t_s,
            position_m: 0.004,
            position_claim_m: 0.008,
            heading_rad: 0.01,
            heading_claim_rad: 0.02,
        };
        let svg = render_errors("run", &[sample(0.0), sample(5.0)]);
        let unknown = ErrorSample { heading_rad: f64::NAN, ..sample(6.0) };
        assert!(!render_errors("run", &[sample(0.0), unknown]).contains("left out"));
        // The claims reach 8 mm and 1.1 degrees.
        assert!(svg.contains(">8</text>") && svg.contains(">1</text>"), "{svg}");
        assert_eq!(svg.matches("<polygon").count(), 4, "two bands, two legends");
        assert!(render_errors("none", &[]).contains("nothing to show"));
    }

    fn sample(t_s: f64, frames_in: u64, frames_lost: u64) -> LinkSample {
        LinkSample {
            t_s,
            health: LinkHealth {
                frames_in,
                frames_lost,
                round_trip: Some(TimeDelta::from_millis(31)),
                ..LinkHealth::default()
            },
        }
    }

    #[test]
    fn rates_are_differences_over_time_and_what_never_happened_is_not_there() {
        let svg = render_link("link 0", &[sample(1.0, 50, 0), sample(2.0, 100, 4), sample(4.0, 200, 2)]);
        assert!(svg.contains(">received</text>") && svg.contains(">lost</text>"));
        assert!(svg.contains(">round trip</text>"));
        assert!(!svg.contains(">sent</text>") && !svg.contains("garbage") && !svg.contains("waiting"));
        let panel = rates("", &TRAFFIC_COUNTERS, &[sample(1.0, 50, 0), sample(3.0, 150, 0)]);
        let CurveShape::Line(points) = &panel.curves[0].shape else { panic!("a rate is a line") };
        assert_eq!(points, &[(3.0, 50.0)]);
    }

    #[test]
    fn a_frame_that_comes_late_is_no_negative_loss() {
        let panel = rates("", &ERROR_COUNTERS, &[sample(1.0, 0, 5), sample(2.0, 0, 2)]);
        let CurveShape::Line(points) = &panel.curves[0].shape else { panic!("a rate is a line") };
        assert_eq!(points, &[(2.0, 0.0)]);
    }

    #[test]
    fn a_bias_is_shown_in_degrees_with_its_band() {
        let samples =
            [0.0, 10.0].map(|t_s| CalibrationSample { t_s, value: 1f64.to_radians(), sigma: 0.5f64.to_radians() });
        let svg = learning("robot", &[CalibrationSeries { key: "gyro_bias_rad_per_s", samples: &samples }]);
        assert!(svg.contains("[deg/s]") && svg.contains(">2.0</text>"), "{svg}");
    }
}
