//! The set-up checklists of a session's robots, fed with the events of the station.

use posebridge_dashboard::model::SetupRow;
use posebridge_report::setup_checklist::{ChecklistItem, SetupChecklist};
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, RobotId, Timestamp};

use super::per_robot::PerRobot;

/// A robot, or `None` before any was heard, and the steps of its set-up.
pub type RobotSetup = (Option<RobotId>, Vec<ChecklistItem>);

/// The checklist of each robot, or of the robot that has not been heard yet.
pub struct SetupChecklists {
    robots: PerRobot<SetupChecklist>,
}

impl Default for SetupChecklists {
    fn default() -> Self {
        Self { robots: PerRobot::new(SetupChecklist::default) }
    }
}

impl SetupChecklists {
    pub fn observe(&mut self, now: Timestamp<HostClock>, events: &[Event]) {
        for event in events {
            self.robots.push(event, |checklist, event| checklist.observe(now, event));
        }
    }

    pub fn items(&self, now: Timestamp<HostClock>, station: &Station) -> Vec<RobotSetup> {
        let of_robot = |robot: Option<RobotId>, checklist: &SetupChecklist| {
            let engine = station.robots().iter().find(|engine| Some(engine.id()) == robot);
            let wiring = engine.and_then(|engine| engine.wiring_findings().last()).map(ToString::to_string);
            (robot, checklist.items(now, wiring))
        };
        self.robots.entries().iter().map(|entry| of_robot(entry.robot, &entry.value)).collect()
    }

    pub fn rows(&self, now: Timestamp<HostClock>, station: &Station) -> Vec<SetupRow> {
        let rows = self.items(now, station).into_iter().flat_map(|(robot, items)| {
            let robot = robot.map(RobotId::path).unwrap_or_default();
            items.into_iter().map(move |item| SetupRow {
                robot: robot.clone(),
                step: item.step.as_text().to_owned(),
                state: item.state.as_text().to_owned(),
                figure: item.figure,
                advice: item.advice.to_owned(),
            })
        });
        rows.collect()
    }
}
