//! Pictures of a run, as SVG text.
//!
//! A figure is a pure function from the layers of a run to a string. It writes no file, and it draws with its own small
//! SVG writer at sub-pixel precision, because error ellipses of millimetres in an arena of metres are a pixel or two
//! wide. Any layer may be missing; values that are not finite, or beyond [`FARTHEST_DRAWN_M`], are left out, counted
//! and mentioned in the picture.

pub mod accuracy;
mod canvas;
mod detail;
pub mod error;
mod inline;
mod layers;
mod legend;
mod palette;
mod panel;
pub mod plot;
pub mod session;
mod strip;
mod svg;
mod thin;
pub mod track;

use posebridge_telemetry::{Arena, BrickClock, Estimate, Point2, Stamp, Verdict};

use crate::track::Track;

pub use accuracy::{AccuracyChart, AccuracyMark, AccuracyPanel, accuracy_chart};
pub use inline::inline;
pub use plot::{Axes, Curve, Plot, Shape, plot};
pub use posebridge_telemetry::Ellipse;

/// Coordinates beyond this are left out, in metres: no arena is wider, and a diverged filter must not hide the rest.
pub const FARTHEST_DRAWN_M: f64 = 1e6;

/// A fix as the figures show it: where it was, and what the filter made of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixMark {
    /// The instant that it spoke of.
    pub stamp: Stamp<BrickClock>,
    /// The observed position.
    pub position: Point2<Arena>,
    /// What became of it.
    pub verdict: Verdict,
}

/// What one run left behind, as layers for the figures; any of them may be empty or `None`.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunLayers<'a> {
    /// The scenario or the recording, for people; any text.
    pub title: &'a str,
    /// The path that the robot should follow.
    pub ideal: &'a [Point2<Arena>],
    /// Where the robot really was.
    pub truth: Option<&'a Track>,
    /// Where the brick alone believed it was.
    pub odometry: Option<&'a Track>,
    /// Where the station believed it was, in the order of time.
    pub estimates: &'a [Estimate],
    /// Where it must have been, by everything that was observed, before and after.
    pub smoothed: Option<&'a Track>,
    /// The fixes that came from outside.
    pub fixes: &'a [FixMark],
}

/// A picture that the command line can name.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    /// Its name, in lower case.
    pub name: &'static str,
    /// What it shows, in one sentence.
    pub doc: &'static str,
    /// Draws it; returns a whole SVG document.
    pub render: fn(&RunLayers<'_>) -> String,
}

/// Every figure. To add one: a file beside this one and a line here.
pub const FIGURES: &[Figure] = &[track::TRACK, error::ERROR];
