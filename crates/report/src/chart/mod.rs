//! Figures of a run, as SVG text.
//!
//! A figure is a pure function from the layers of a run to a string. It writes no file, and it draws with its own small SVG writer at
//! sub-pixel precision, because error ellipses of millimetres in an arena of metres are a pixel or two wide. Any layer may be missing;
//! values that are not finite, or beyond [`MAX_COORDINATE_M`], are omitted, counted and mentioned in the picture.

pub mod accuracy;
mod axes;
pub mod error;
mod layers;
pub mod plot;
pub mod session;
mod strip;
mod svg;
pub mod track;

pub use self::accuracy::{AccuracyChart, AccuracyMark, AccuracyPanel, render_accuracy_chart};
pub use self::layers::{ComparedTrack, FixMark, MAX_COORDINATE_M, RunLayers, on_map};
pub use self::plot::{Axes, Curve, CurveShape, Plot, render_plot};
pub use self::svg::inline;
pub use posebridge_telemetry::Ellipse;

/// A figure that the command line can select.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    pub name: &'static str,
    pub doc: &'static str,
    pub render: fn(&RunLayers<'_>) -> String,
}

/// Adding one: a file in this folder and an entry here.
pub const FIGURES: &[Figure] = &[
    Figure {
        name: "track",
        doc: "Map of the ideal path, truth, odometry, estimate with 2-sigma ellipses, smoothed path and fixes; position error over time.",
        render: track::render,
    },
    Figure {
        name: "error",
        doc: "Position error of odometry, estimate and smoothed path over time, with the estimate's 2-sigma claim; logarithmic.",
        render: error::render,
    },
];
