//! The result of a run in a few lines: what every command that evaluates a run prints first.

use std::fmt::Write as _;

use posebridge_telemetry::Estimate;

use super::colour::Colour;
use super::metrics::{ErrorSummary, FilterVerdict};
use super::tables::{degrees, millimetres, wrapped};

/// What a run came to.
#[derive(Clone, Debug)]
pub struct RunAnswer<'a> {
    /// Against the truth; empty without one.
    pub errors: &'a ErrorSummary,
    /// What the estimate is compared with, such as "the brick's own odometry", and its errors.
    pub baseline: Option<(&'a str, &'a ErrorSummary)>,
    /// The pose at the end, for a run without truth.
    pub last: Option<&'a Estimate>,
    pub verdict: FilterVerdict,
    /// The steps of a filter of one quantity, in words.
    pub quantity: Option<String>,
    /// Keys of the constants that were learned.
    pub learned: Vec<&'a str>,
}

impl RunAnswer<'_> {
    /// Pose, verdict and what was learned, or the steps of a filter that makes no poses; lines of 80 columns.
    pub fn text(&self, colour: Colour) -> String {
        let quantity = self.quantity.as_ref().map(|steps| wrapped("quantity   ", steps));
        if let Some(quantity) = quantity.as_ref().filter(|_| self.last.is_none()) {
            return quantity.clone();
        }
        let finding = self.verdict.finding.as_text();
        let verdict = wrapped("filter     ", &self.verdict.to_string());
        let mut text = wrapped("pose       ", &self.pose());
        text += &verdict.replacen(finding, &colour.paint(self.verdict.tone(), finding), 1);
        if !self.learned.is_empty() {
            text += &wrapped("learned    ", &self.learned.join(", "));
        }
        text + &quantity.unwrap_or_default()
    }

    fn pose(&self) -> String {
        let Some(rms_m) = self.errors.position_rms_m else { return self.last_pose() };
        // Writing to a String cannot fail.
        let mut text = format!("{} mm off (rms)", millimetres(Some(rms_m)));
        if self.errors.heading_rms_rad.is_some() {
            let _ = write!(text, ", {} degrees", degrees(self.errors.heading_rms_rad));
        }
        let baseline = self.baseline.and_then(|(name, errors)| Some((name, errors.position_rms_m?)));
        let Some((name, baseline_m)) = baseline else { return text };
        let ratio = baseline_m / rms_m;
        let (factor, word) = if ratio >= 1.0 { (ratio, "better") } else { (1.0 / ratio, "worse") };
        if factor.is_finite() {
            let _ = write!(text, "; {factor:.1} times {word} than {name} ({} mm)", millimetres(Some(baseline_m)));
        }
        text
    }

    fn last_pose(&self) -> String {
        match self.last {
            Some(last) => final_pose_text(last) + "; no truth is known",
            None => "none: no estimate was made".to_owned(),
        }
    }
}

/// Where a robot was at the end, and how well that is known.
pub fn final_pose_text(last: &Estimate) -> String {
    let position = last.pose.origin();
    // Writing to a String cannot fail.
    let mut text = format!("x {:.3} m, y {:.3} m", position.x.0, position.y.0);
    if last.validity.heading || last.is_relative() {
        let _ = write!(text, ", heading {:.1} degrees", last.pose.heading.rad().to_degrees());
    }
    text += " at the end";
    if let Some(ellipse) = last.ellipse_95() {
        let _ = write!(text, ", ± {:.3} m (95 %)", ellipse.semi_major_m);
    }
    if last.is_relative() {
        text += ", relative to where it started";
    }
    text
}
