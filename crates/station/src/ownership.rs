//! Robots that one station of a fleet owns: taking one over, giving it away, and its state for the others.
//!
//! Which station owns a robot is decided elsewhere and comes as an input. A stand-by robot is one of another station: this one decodes and
//! fuses what it hears of it, shows it to its viewers, and sends it nothing (`Transmitter`).

use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Ownership, RobotId, severity};

use crate::ownership_status::OwnershipStatus;
use crate::robot::Robot;
use crate::robot_snapshot::SavedThermometer;
use crate::sender_identity::RobotIndex;
use crate::station::Station;

impl Station {
    /// Everything of a robot that its next estimates depend on, for a station with the same configuration of it, which continues bit for
    /// bit. `None` if there is no such robot. Call it when [`poll`](Self::poll) has returned `None`.
    pub fn robot_state(&self, robot: RobotId) -> Option<Vec<u8>> {
        let robot = self.robots.get(self.robots.find_or_first(robot)?);
        let config = self.config.robot_config(robot.block());
        Some(robot.save(config, self.thermometers.save(robot.id())))
    }

    pub(crate) fn handle_ownership(&mut self, robot: RobotId, ownership: &Ownership) {
        match self.robots.find_or_first(robot) {
            Some(index) => self.set_ownership(index, ownership),
            None => self.await_robot(robot, ownership),
        }
    }

    fn set_ownership(&mut self, index: RobotIndex, ownership: &Ownership) {
        let status = OwnershipStatus::from(ownership);
        let was_standby = self.robots.get(index).ownership().is_standby();
        if let Ownership::Owner { state: Some(snapshot), .. } = ownership {
            let robot = self.robots.get(index);
            let (id, block) = (robot.id(), robot.block());
            match robot.read_snapshot(snapshot, self.config.robot_config(block)) {
                Ok(restored) => {
                    self.restore_thermometers(id, block, restored.thermometers());
                    self.robots.get_mut(index).set_restored(restored);
                }
                Err(why) => self.report_unused_state(id, &why),
            }
        }
        self.robots.set_ownership(index, status);
        let robot = self.robots.get(index);
        let (id, wire_address) = (robot.id(), robot.wire_address);
        self.report_ownership(id, status);
        if status.is_standby() {
            self.interrupt_mission(index, "another station took the robot over");
        } else if was_standby {
            self.robots.get_mut(index).publisher.restart();
            // What it was asked for while it was another's, and the time, it is asked for now.
            for link in self.link_ids() {
                if self.router.are_redundant(link, id.link) {
                    self.sessions.handle_peer_restart(self.time.now, link, wire_address);
                }
            }
        }
    }

    /// Prepares a robot that is not heard yet.
    fn await_robot(&mut self, id: RobotId, ownership: &Ownership) {
        let Some(mut prepared) = self.robots.prepare(id, &self.config) else {
            let text = format!("robot {id}: more robots than station.max_robots: its owner is not noted");
            self.report_own_text(severity::WARNING, text);
            return;
        };
        let status = OwnershipStatus::from(ownership);
        if let Ownership::Owner { state: Some(snapshot), .. } = ownership {
            let config = self.config.robot_config(prepared.robot.block());
            match prepared.robot.read_snapshot(snapshot, config) {
                Ok(restored) => {
                    self.restore_thermometers(id, prepared.robot.block(), restored.thermometers());
                    prepared.robot.set_restored(restored);
                    prepared.has_state = true;
                }
                Err(why) => self.report_unused_state(id, &why),
            }
        }
        prepared.robot.ownership = status;
        self.robots.keep_prepared(id, prepared);
        self.report_ownership(id, status);
    }

    /// Those of them that can be; the others begin anew.
    fn restore_thermometers(&mut self, id: RobotId, block: Option<usize>, saved: &[SavedThermometer]) {
        let refused = self.thermometers.restore(id, self.config.robot_config(block), saved);
        if refused > 0 {
            let text = format!("robot {id}: {refused} thermometers of its state from another station are not used");
            self.report_own_text(severity::WARNING, text);
        }
    }

    fn report_unused_state(&mut self, id: RobotId, why: &str) {
        self.report_own_text(
            severity::WARNING,
            format!("robot {id}: its state from another station is not used: {why}"),
        );
    }

    fn report_ownership(&mut self, id: RobotId, status: OwnershipStatus) {
        let text = match status {
            OwnershipStatus::Standby { epoch } => {
                format!("robot {id}: another station owns it (epoch {epoch}): it is heard here, and sent nothing")
            }
            OwnershipStatus::Owner { .. } | OwnershipStatus::Unmanaged => {
                format!("robot {id}: this station owns it (epoch {})", status.epoch())
            }
        };
        self.report_own_text(severity::NOTICE, text);
    }

    /// Says of frames for stand-by robots that they were not passed on, once for each time that a robot becomes one.
    pub(crate) fn report_withheld_frames(&mut self) {
        for Endpoint { link, peer } in std::mem::take(&mut self.outputs.withheld) {
            let Some(index) = self.robots.take_first_withheld(link, peer) else {
                continue;
            };
            let robot = self.robots.get(index);
            let why = robot.owned_elsewhere();
            let text = format!("robot {}: what is sent to it here is not passed on: {why}", robot.id());
            self.report_own_text(severity::WARNING, text);
        }
    }
}

impl Robot {
    /// Whether this station owns it.
    pub const fn ownership(&self) -> OwnershipStatus {
        self.ownership
    }

    /// Why a stand-by robot is not commanded.
    pub(crate) fn owned_elsewhere(&self) -> String {
        format!("another station owns the robot (epoch {})", self.ownership.epoch())
    }
}
