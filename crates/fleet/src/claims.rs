//! How a station becomes the owner of a robot, and how it ceases to be.

use crate::epoch::{Epoch, OwnershipToken};
use crate::event::{ClaimReason, OwnershipEvent, StopReason};
use crate::io::{Output, Reception, StartState};
use crate::names::RobotName;
use crate::ownership::Ownership;
use crate::robot_entry::{Owner, RetiringToken, Role, StandBy};

impl Ownership {
    /// Does what is due for the robot.
    pub(crate) fn advance_robot(&mut self, robot: &RobotName) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        if let Some(retiring) = entry.retiring
            && retiring.withdraw_at <= self.now
        {
            entry.retiring = None;
            self.outputs.push_back(Output::WithdrawToken { robot: robot.clone(), epoch: retiring.epoch });
        }
        match &entry.role {
            Role::Bystander | Role::Suspended { .. } => {}
            Role::StandBy(stand_by) => {
                // The answer may be a hand-over already.
                let is_waiting = stand_by.query.as_ref().is_some_and(|query| query.expires > self.now);
                match entry.reception.at(self.now, &self.config) {
                    Reception::Silent if !is_waiting => entry.role = Role::Bystander,
                    Reception::Silent | Reception::Heard => self.advance_stand_by(robot),
                }
            }
            Role::Owner(_) => self.advance_owner(robot),
            Role::Promised { until, .. } => {
                if *until <= self.now {
                    // Nobody has claimed.
                    self.withdraw(robot);
                    self.stand_by_if_heard(robot);
                }
            }
        }
    }

    fn advance_owner(&mut self, robot: &RobotName) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let reception = entry.reception.at(self.now, &self.config);
        let Role::Owner(owner) = &entry.role else { return };
        let epoch = owner.epoch;
        if entry.release_at(owner, &self.config) <= self.now {
            self.stop(robot, epoch, StopReason::Silent);
            self.withdraw(robot);
            return;
        }
        let fell_silent = owner.reception == Reception::Heard && reception == Reception::Silent;
        if fell_silent || owner.next_publication <= self.now {
            let Role::Owner(owner) = &mut entry.role else { return };
            owner.reception = reception;
            owner.next_publication = self.now + self.config.state_interval;
            self.outputs.push_back(Output::PublishState { robot: robot.clone(), epoch, reception });
        }
    }

    /// Claims the next epoch, and starts.
    pub(crate) fn claim(&mut self, robot: &RobotName, reason: ClaimReason) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let epoch = entry.highest_epoch.map_or(Epoch::FIRST, Epoch::next);
        let token = OwnershipToken { epoch, station: self.station.clone() };
        if let Some(rival) = entry.tokens.last().filter(|rival| **rival > token) {
            let holder = rival.station.clone();
            entry.role = Role::StandBy(StandBy::new(self.now + self.config.max_query_backoff, &self.config));
            let event = OwnershipEvent::EpochsExhausted { robot: robot.clone(), holder };
            self.outputs.push_back(Output::Event(event));
            return;
        }
        let state = entry.start_state(self.now);
        let reception = entry.reception.at(self.now, &self.config);
        entry.highest_epoch = Some(epoch);
        entry.epoch_known_at = Some(self.now);
        entry.last_owned = Some(epoch);
        entry.role = Role::Owner(Owner {
            epoch,
            since: self.now,
            next_publication: self.now + self.config.state_interval,
            reception,
        });
        if let Some(retiring) = entry.retiring.take() {
            self.outputs.push_back(Output::WithdrawToken { robot: robot.clone(), epoch: retiring.epoch });
        }
        self.outputs.push_back(Output::DeclareToken { robot: robot.clone(), epoch });
        self.outputs.push_back(Output::Start { robot: robot.clone(), epoch, state });
        self.outputs.push_back(Output::Event(OwnershipEvent::Started { robot: robot.clone(), epoch, reason }));
    }

    /// Somebody else owns the robot. The token stays for a while, so that nobody misses it before he has heard of the new one.
    pub(crate) fn yield_to(&mut self, robot: &RobotName, winner: OwnershipToken) {
        let Some(entry) = self.robots.get(robot) else { return };
        match entry.role {
            Role::Owner(Owner { epoch, .. }) => self.stop(robot, epoch, StopReason::Replaced(winner)),
            Role::Suspended { epoch, .. } => {
                let reason = StopReason::Replaced(winner);
                let event = OwnershipEvent::Stopped { robot: robot.clone(), epoch, reason };
                self.outputs.push_back(Output::Event(event));
            }
            Role::Promised { .. } | Role::Bystander | Role::StandBy(_) => {}
        }
        self.retire(robot);
        self.stand_by_if_heard(robot);
    }

    /// Ends a suspension.
    pub(crate) fn resume(&mut self) {
        for robot in self.robots.names(|entry| matches!(entry.role, Role::Suspended { .. })) {
            let Some(entry) = self.robots.get_mut(&robot) else { continue };
            let Role::Suspended { epoch, since } = entry.role else { continue };
            if self.last_join.is_some_and(|join| join >= since) {
                // The sessions were lost: owners may have come and gone meanwhile.
                self.retire(&robot);
                self.stand_by_if_heard(&robot);
                continue;
            }
            let owner = Owner { epoch, since: self.now, next_publication: self.now, reception: Reception::Heard };
            entry.role = Role::Owner(owner);
            let state = StartState::Kept;
            self.outputs.push_back(Output::Start { robot: robot.clone(), epoch, state });
            self.outputs.push_back(Output::Event(OwnershipEvent::Resumed { robot: robot.clone(), epoch }));
        }
    }

    /// Tells the shell that an owner stops; the caller sets the role.
    pub(crate) fn stop(&mut self, robot: &RobotName, epoch: Epoch, reason: StopReason) {
        self.outputs.push_back(Output::Stop { robot: robot.clone() });
        self.outputs.push_back(Output::Event(OwnershipEvent::Stopped { robot: robot.clone(), epoch, reason }));
    }

    /// Withdraws every token for the robot at once.
    pub(crate) fn withdraw(&mut self, robot: &RobotName) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let retiring = entry.retiring.take().map(|retiring| retiring.epoch);
        for epoch in retiring.into_iter().chain(entry.own_epoch()) {
            self.outputs.push_back(Output::WithdrawToken { robot: robot.clone(), epoch });
        }
        entry.role = Role::Bystander;
    }

    /// Withdraws the token after a while; the caller sets the role.
    fn retire(&mut self, robot: &RobotName) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        let Some(epoch) = entry.own_epoch() else { return };
        let withdraw_at = self.now + self.config.withdrawal_delay;
        if let Some(earlier) = entry.retiring.replace(RetiringToken { epoch, withdraw_at }) {
            self.outputs.push_back(Output::WithdrawToken { robot: robot.clone(), epoch: earlier.epoch });
        }
    }

    fn stand_by_if_heard(&mut self, robot: &RobotName) {
        let Some(entry) = self.robots.get_mut(robot) else { return };
        entry.role = match entry.reception.at(self.now, &self.config) {
            Reception::Heard => Role::StandBy(StandBy::new(self.now, &self.config)),
            Reception::Silent => Role::Bystander,
        };
        self.advance_stand_by(robot);
    }
}
