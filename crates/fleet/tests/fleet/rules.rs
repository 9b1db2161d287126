//! What must hold at every step, and what must hold when everything is quiet.

use posebridge_fleet::{Epoch, EpochFence, FenceDecision, OwnershipToken, RobotName, RobotRole};
use posebridge_telemetry::Timestamp;

use crate::network::{MAX_DELAY, Micros};
use crate::simulation::Simulation;

/// An owner that was replaced may go on for as long as a message takes. Two delays, because messages of one sender wait for each other.
const WINDOW: Micros = 2 * MAX_DELAY + 10_000;
/// A shorter freeze goes unnoticed, as a longer delay does.
const FREEZE_LIMIT: Micros = 250_000;
/// A station that was frozen and then reaches nobody serves again after this time.
const REJOIN_GRACE: Micros = 2_000_000;

impl Simulation {
    /// No two owners have seen each other's token.
    pub(crate) fn check_owners(&mut self, station: usize, robot: &RobotName) {
        let token_of = |station: usize| match self.stations[station].ownership.role(robot) {
            RobotRole::Owner(epoch) => Some(OwnershipToken { epoch, station: self.stations[station].id.clone() }),
            RobotRole::None | RobotRole::StandBy | RobotRole::Paused(_) => None,
        };
        let Some(own) = token_of(station) else { return };
        for other in (0..self.stations.len()).filter(|other| *other != station) {
            let Some(token) = token_of(other).filter(|_| self.stations[other].is_alive) else { continue };
            let sees = |station: usize, token: &OwnershipToken| {
                self.stations[station].seen.contains(&(robot.clone(), token.clone()))
            };
            if sees(station, &token) && sees(other, &own) {
                self.violations.push(format!("{}: {own:?} and {token:?} both own {robot} and know it", self.now));
                return;
            }
        }
    }

    /// No owner sends who must know that he was replaced.
    pub(crate) fn check_estimate(&mut self, station: usize, robot: usize, own: &OwnershipToken) {
        let name = &self.robots[robot].name;
        let sender = &self.stations[station];
        let claimed = self.robots[robot].starts.iter().find(|start| start.token == *own).map(|start| start.time);
        let mut late = None;
        for start in self.robots[robot].starts.iter().filter(|start| start.token > *own) {
            let other = &self.stations[start.station];
            let holds = other.is_alive && other.declared.contains(&(name.clone(), start.token.clone()));
            if !holds || start.station == station {
                continue;
            }
            let must_know = self
                .connected_since(station, start.station)
                .map(|since| since.max(start.time).max(sender.awake_since) + WINDOW);
            // Replaced while it was frozen, and not yet connected again.
            let was_frozen = sender.last_freeze > FREEZE_LIMIT
                && self.now < sender.awake_since + REJOIN_GRACE
                && sender.peers_at_freeze.contains(&start.token.station)
                && claimed.is_some_and(|claimed| claimed < sender.awake_since)
                && start.time <= sender.awake_since
                && start.time >= sender.awake_since - sender.last_freeze
                && self.reachable_since(station, start.station).is_some_and(|since| since <= sender.awake_since);
            if must_know.is_some_and(|time| self.now > time) || was_frozen {
                late = Some(format!("{}: {own:?} sends {name} an estimate after {start:?}", self.now));
            }
        }
        self.violations.extend(late);
    }

    pub(crate) fn robot_receives(&mut self, station: usize, robot: usize, epoch: Epoch) {
        let now = self.now;
        let robot = &mut self.robots[robot];
        match robot.fence.check(Timestamp::from_micros(now), epoch) {
            FenceDecision::Accepted => {
                let forgets_at = |last: Micros| last + EpochFence::FORGET_AFTER.as_nanos() / 1_000;
                if let Some((highest, last)) = robot.highest
                    && epoch < highest
                    && now < forgets_at(last)
                {
                    self.violations.push(format!("{now}: {} accepts {epoch} after {highest}", robot.name));
                }
                robot.highest = Some((epoch, now));
                robot.accepted += 1;
                robot.first_accepted_after.get_or_insert(now);
                robot.last_accepted.insert(station, now);
            }
            FenceDecision::Stale { .. } => robot.dropped += 1,
        }
    }

    /// In a fleet that is whole and quiet: one owner, known to all, and it hears the robot.
    pub(crate) fn check_agreement(&mut self) {
        for robot in 0..self.robots.len() {
            let name = self.robots[robot].name.clone();
            let is_heard = self.robots[robot].heard_by.iter().any(|station| self.stations[*station].is_alive);
            let owners = self.owners(robot);
            let alive: Vec<_> = self.stations.iter().filter(|station| station.is_alive).collect();
            let views: Vec<_> = alive.iter().map(|station| station.ownership.owner(&name)).collect();
            let is_agreed = views.windows(2).all(|pair| pair[0] == pair[1]);
            let expected = usize::from(is_heard);
            let is_served = !is_heard || owners.iter().all(|owner| self.robots[robot].heard_by.contains(owner));
            if owners.len() > 1 || owners.len() < expected || !is_agreed || !is_served {
                let heard_by = &self.robots[robot].heard_by;
                let problem = format!("{}: {name} heard by {heard_by:?}: owners {owners:?}, views {views:?}", self.now);
                self.violations.push(problem);
            }
        }
    }

    /// Every robot that is heard has accepted an estimate lately.
    pub(crate) fn check_service(&mut self) {
        for robot in &self.robots {
            let is_heard = robot.heard_by.iter().any(|station| self.stations[*station].is_alive);
            let limit = self.now - 2 * robot.period - MAX_DELAY;
            if is_heard && robot.last_accepted().is_none_or(|last| last < limit) {
                let problem = format!("{}: {} accepts nothing since {:?}", self.now, robot.name, robot.last_accepted());
                self.violations.push(problem);
            }
        }
    }
}
