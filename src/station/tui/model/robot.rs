//! What is known of one robot.

use std::collections::BTreeMap;

use posebridge_dashboard::model::{
    CalibrationRow, ErrorsRow, EstimatePoint, FixPoint, FusionPoint, RobotFrame, TruthPoint,
};
use posebridge_report::RecentNis;

use super::RecentPoints;

/// A robot has a handful of sensors; more than this is not a robot but nonsense.
const MAX_SOURCES: usize = 32;

/// One robot.
#[derive(Clone, Debug, Default)]
pub struct Robot {
    /// Link, system and component.
    pub id: String,
    /// Its configured name, if it has one.
    pub name: Option<String>,
    /// Its estimates.
    pub estimates: RecentPoints<EstimatePoint>,
    /// Fixes of it.
    pub fixes: RecentPoints<FixPoint>,
    /// Where it really was, if it is one of several simulated robots.
    pub truth: RecentPoints<TruthPoint>,
    /// How far odometry and estimate are from that.
    pub errors: Option<ErrorsRow>,
    /// Its sensors, by their names.
    pub sources: BTreeMap<String, SourceModel>,
    /// What was learned about it.
    pub calibration: Vec<CalibrationRow>,
}

/// One of its sensors.
#[derive(Clone, Debug, Default)]
pub struct SourceModel {
    /// Number of observations that came.
    pub count: u64,
    /// Number of observations that the gate rejected.
    pub gated: u64,
    /// The NIS of those that were used.
    pub nis: RecentNis,
    /// What became of the last one.
    pub last_verdict: String,
}

impl Robot {
    pub(super) fn new(id: &str) -> Self {
        Self { id: id.to_owned(), ..Self::default() }
    }

    /// What people read: the name, else the id.
    pub fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.id)
    }

    pub(super) fn on_frame(&mut self, part: &RobotFrame) {
        if part.name.is_some() {
            self.name.clone_from(&part.name);
        }
        if part.errors.is_some() {
            self.errors.clone_from(&part.errors);
        }
        for estimate in &part.estimates {
            self.estimates.push(estimate.t_s, estimate.clone());
        }
        for fix in &part.fixes {
            self.fixes.push(fix.t_s, fix.clone());
        }
        for record in &part.fusion {
            self.on_fusion(record);
        }
        if let Some(calibration) = &part.calibration {
            // A history has one row a second for each; the last one counts.
            for row in calibration {
                match self.calibration.iter_mut().find(|kept| kept.name == row.name) {
                    Some(kept) => kept.clone_from(row),
                    None => self.calibration.push(row.clone()),
                }
            }
        }
    }

    fn on_fusion(&mut self, record: &FusionPoint) {
        let is_known = self.sources.contains_key(&record.sensor);
        if !is_known && self.sources.len() >= MAX_SOURCES {
            return;
        }
        let source = self.sources.entry(record.sensor.clone()).or_default();
        source.count += 1;
        source.last_verdict.clone_from(&record.verdict);
        match record.verdict.as_str() {
            "gated" => source.gated += 1,
            "accepted" | "slip" => {
                let nis = record.nis.get().unwrap_or(f64::NAN);
                source.nis.push(nis, u64::from(record.dof));
            }
            _ => {}
        }
    }
}
