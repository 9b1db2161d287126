//! The colours and strokes of the figures.
//!
//! The colours are those of M. Okabe and K. Ito, Color Universal Design (2008), which stay apart for colour-blind
//! readers. Each layer also differs in line style or mark, so that a grey print can be read.

use super::svg::Stroke;

pub(super) const BLACK: &str = "#000000";
pub(super) const ORANGE: &str = "#E69F00";
pub(super) const SKY_BLUE: &str = "#56B4E9";
pub(super) const BLUISH_GREEN: &str = "#009E73";
pub(super) const BLUE: &str = "#0072B2";
pub(super) const VERMILLION: &str = "#D55E00";
pub(super) const REDDISH_PURPLE: &str = "#CC79A7";

pub(super) const INK: &str = "#222222";
pub(super) const FAINT_INK: &str = "#666666";

pub(super) const GRID: Stroke = Stroke::solid("#E6E6E6", 1.0);
pub(super) const BORDER: Stroke = Stroke::solid("#888888", 1.0);
pub(super) const DETAIL_FRAME: Stroke = Stroke::solid(INK, 1.0);
pub(super) const IDEAL: Stroke = Stroke::dashed("#8C8C8C", 1.3, "7 5");
pub(super) const TRUTH: Stroke = Stroke::solid(BLACK, 2.6);
pub(super) const ODOMETRY: Stroke = Stroke::dashed(VERMILLION, 1.8, "9 2.5");
pub(super) const ESTIMATE: Stroke = Stroke::solid(BLUE, 1.5);
pub(super) const SMOOTHED: Stroke = Stroke::dashed(ORANGE, 1.8, "3 2.5");
pub(super) const ELLIPSE: Stroke = Stroke::solid(SKY_BLUE, 0.9);
pub(super) const CLAIM: Stroke = Stroke::solid(SKY_BLUE, 1.1);
pub(super) const REJECTED: Stroke = Stroke::solid(REDDISH_PURPLE, 1.6);
pub(super) const LATE: Stroke = Stroke::solid(ORANGE, 1.4);
/// Where something lies in 95 of 100 cases.
pub(super) const EXPECTED: Stroke = Stroke::dashed(FAINT_INK, 1.1, "5 3");
/// A mean over a window.
pub(super) const MEAN: Stroke = Stroke::solid(VERMILLION, 1.8);

/// How much of the fill of an ellipse or a band covers what is under it.
pub(super) const FILL_OPACITY: f64 = 0.25;
