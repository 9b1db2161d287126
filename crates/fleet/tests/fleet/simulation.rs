//! A fleet in virtual time. One seed gives one course of events. What must always hold is checked after every step.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_fleet::{
    ClaimReason, Input, Output, OwnershipEvent, OwnershipToken, QueryTarget, RobotName, RobotRole, StartState,
    StateSnapshot, StopReason,
};
use posebridge_telemetry::TimeDelta;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::network::{DEATH_DETECTION, MAX_DELAY, MIN_RECONNECT, Message, Micros, Pair, answer};
use crate::stations::{SimulatedRobot, SimulatedStation, Start, Waiting};

#[derive(Clone, Debug)]
pub(crate) enum Event {
    Tick {
        station: usize,
        run: u64,
    },
    Message {
        from: usize,
        to: usize,
        generation: u64,
        message: Message,
    },
    /// The cable is there again: what waited arrives.
    Flush {
        from: usize,
        to: usize,
        generation: u64,
    },
    /// The session ends unless the two have reached each other since.
    LeaseExpired {
        pair: (usize, usize),
        since: Micros,
    },
    DeathDetected {
        pair: (usize, usize),
        generation: u64,
    },
    Connect {
        pair: (usize, usize),
        generation: u64,
    },
    /// A shell tells its station something about sessions.
    Notice {
        station: usize,
        run: u64,
        input: Input,
    },
    /// The shell has waited long enough for the answers to its ping.
    PingExpired {
        station: usize,
        run: u64,
        ping: u64,
    },
    RobotSends {
        robot: usize,
    },
}

pub(crate) struct Simulation {
    pub(crate) now: Micros,
    pub(crate) rng: Pcg64,
    events: BTreeMap<(Micros, u64), Event>,
    event_count: u64,
    pub(crate) stations: Vec<SimulatedStation>,
    pub(crate) robots: Vec<SimulatedRobot>,
    robot_index: BTreeMap<RobotName, usize>,
    pub(crate) pairs: BTreeMap<(usize, usize), Pair>,
    /// Stations in different groups do not reach each other.
    pub(crate) group_of: Vec<u32>,
    /// States that owners publish may be lost.
    pub(crate) loses_states: bool,
    pub(crate) event_counts: BTreeMap<&'static str, u64>,
    pub(crate) violations: Vec<String>,
}

fn kind_of(event: &OwnershipEvent) -> &'static str {
    match event {
        OwnershipEvent::Started { reason, .. } => match reason {
            ClaimReason::Unowned => "claimed: unowned",
            ClaimReason::HandedOver(_) => "claimed: handed over",
            ClaimReason::OwnerVanished(_) => "claimed: owner vanished",
            ClaimReason::OwnerUnresponsive(_) => "claimed: owner unresponsive",
        },
        OwnershipEvent::Stopped { reason, .. } => match reason {
            StopReason::Replaced(_) => "stopped: replaced",
            StopReason::HandedOver(_) => "stopped: handed over",
            StopReason::Silent => "stopped: silent",
            StopReason::Frozen => "stopped: frozen",
            StopReason::Shutdown => "stopped: shutdown",
        },
        OwnershipEvent::Resumed { .. } => "resumed",
        OwnershipEvent::Frozen { .. } => "frozen",
        OwnershipEvent::EpochsExhausted { .. } => "epochs exhausted",
    }
}

pub(crate) fn pair_of(one: usize, other: usize) -> (usize, usize) {
    (one.min(other), one.max(other))
}

impl Simulation {
    /// The stations start within half a second; nobody hears a robot before the caller says so.
    pub(crate) fn new(seed: u64, station_count: usize, periods: &[Micros]) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let stations = (0..station_count)
            .map(|index| SimulatedStation::new(index, rng.random(), 0, rng.random_range(0..1_000_000_000)))
            .collect();
        let robots: Vec<_> = periods
            .iter()
            .enumerate()
            .map(|(index, period)| SimulatedRobot::new(index, *period, BTreeSet::new()))
            .collect();
        let mut simulation = Self {
            now: 0,
            rng,
            events: BTreeMap::new(),
            event_count: 0,
            stations,
            robot_index: robots.iter().enumerate().map(|(index, robot)| (robot.name.clone(), index)).collect(),
            robots,
            pairs: BTreeMap::new(),
            group_of: vec![0; station_count],
            loses_states: true,
            event_counts: BTreeMap::new(),
            violations: Vec::new(),
        };
        for one in 0..station_count {
            for other in one + 1..station_count {
                simulation.pairs.insert((one, other), Pair::default());
                simulation.connect_later((one, other));
            }
        }
        for robot in 0..simulation.robots.len() {
            let phase = simulation.rng.random_range(0..simulation.robots[robot].period);
            simulation.schedule(phase, Event::RobotSends { robot });
        }
        for station in 0..station_count {
            simulation.drain(station);
        }
        simulation
    }

    pub(crate) fn run_for(&mut self, duration: Micros) {
        let end = self.now + duration;
        while let Some(entry) = self.events.first_entry() {
            if entry.key().0 > end {
                break;
            }
            let ((time, _), event) = entry.remove_entry();
            self.now = time;
            self.step(event);
        }
        self.now = end;
    }

    pub(crate) fn kill(&mut self, station: usize) {
        self.stations[station].is_alive = false;
        self.stations[station].frozen_since = None;
        for pair in self.pairs_of(station) {
            let generation = self.pairs[&pair].generation;
            if self.is_wired(pair) {
                self.schedule(DEATH_DETECTION, Event::DeathDetected { pair, generation });
            }
        }
        self.update_reachability();
    }

    /// Starts a dead station again, without its memory.
    pub(crate) fn restart(&mut self, station: usize) {
        for pair in self.pairs_of(station) {
            // The sessions of the dead process are closed by the new one at the latest.
            self.close_session(pair);
        }
        let run = self.stations[station].run + 1;
        let (instance, offset) = (self.rng.random(), self.rng.random_range(0..1_000_000_000));
        self.stations[station] = SimulatedStation::new(station, instance, self.now, offset);
        self.stations[station].run = run;
        for pair in self.pairs_of(station) {
            self.connect_later(pair);
        }
        self.update_reachability();
        self.drain(station);
    }

    pub(crate) fn freeze(&mut self, station: usize) {
        let reachable =
            (0..self.stations.len()).filter(|other| *other != station && self.is_reachable(pair_of(station, *other)));
        let mut peers: BTreeSet<_> = reachable.map(|other| self.stations[other].id.clone()).collect();
        let state = &mut self.stations[station];
        peers.retain(|peer| state.is_confirmed && state.peers.contains(peer));
        state.peers_at_freeze = peers;
        state.frozen_since = Some(self.now);
        self.update_reachability();
    }

    pub(crate) fn wake(&mut self, station: usize) {
        let Some(since) = self.stations[station].frozen_since.take() else { return };
        self.stations[station].last_freeze = self.now - since;
        self.stations[station].awake_since = self.now;
        self.update_reachability();
        for pair in self.pairs_of(station) {
            if self.pairs[&pair].up_since.is_none() {
                self.connect_later(pair);
            }
        }
        let waiting = std::mem::take(&mut self.stations[station].waiting);
        let robots = std::mem::take(&mut self.stations[station].robots_waiting);
        // Sometimes a robot is read before the network, against the advice.
        let is_robot_first = self.rng.random_range(0..4) == 0;
        if is_robot_first && let Some(robot) = robots.front() {
            self.robot_arrives(station, robot);
        }
        // The end of a session is noticed a little later.
        let delay = self.rng.random_range(0..MAX_DELAY);
        for item in waiting {
            match item {
                Waiting::Input(input) => {
                    let run = self.stations[station].run;
                    self.schedule(delay, Event::Notice { station, run, input });
                }
                Waiting::Message { from, generation, message } => self.receive(from, station, generation, message),
            }
        }
        for robot in robots {
            self.robot_arrives(station, &robot);
        }
        self.give(station, Input::Tick);
    }

    /// Stations with different numbers do not reach each other any more.
    pub(crate) fn partition(&mut self, group_of: Vec<u32>) {
        self.group_of = group_of;
        self.update_reachability();
        let pairs: Vec<_> = self.pairs.keys().copied().collect();
        for pair in pairs {
            if !self.is_wired(pair) {
                continue;
            }
            let generation = self.pairs[&pair].generation;
            if self.pairs[&pair].up_since.is_none() {
                self.connect_later(pair);
            }
            for (from, to) in [pair, (pair.1, pair.0)] {
                let delay = self.delay();
                self.schedule(delay, Event::Flush { from, to, generation });
            }
        }
    }

    pub(crate) fn heal(&mut self) {
        self.partition(vec![0; self.stations.len()]);
    }

    /// From now on these stations hear the robot.
    pub(crate) fn move_robot(&mut self, robot: usize, heard_by: &[usize]) {
        self.robots[robot].heard_by = heard_by.iter().copied().collect();
    }

    /// The link breaks that the robot was heard on.
    pub(crate) fn close_link(&mut self, robot: usize, station: usize) {
        let robot = self.robots[robot].name.clone();
        let input = Input::RobotLinkClosed { robot };
        if self.stations[station].is_running() {
            self.give(station, input);
        } else if self.stations[station].is_alive {
            self.stations[station].waiting.push_back(Waiting::Input(input));
        }
    }

    /// Notes the first estimate that each robot accepts from now on.
    pub(crate) fn watch_robots(&mut self) {
        for robot in &mut self.robots {
            robot.first_accepted_after = None;
        }
    }

    pub(crate) fn is_whole(&self) -> bool {
        let are_running = |(one, other): (usize, usize)| self.stations[one].is_alive && self.stations[other].is_alive;
        self.stations.iter().all(|station| station.frozen_since.is_none())
            && self.pairs.iter().all(|(pair, state)| !are_running(*pair) || state.up_since.is_some())
    }

    /// The stations that send this robot estimates.
    pub(crate) fn owners(&self, robot: usize) -> Vec<usize> {
        let robot = &self.robots[robot].name;
        let is_owner = |station: &usize| {
            let station = &self.stations[*station];
            station.is_running() && matches!(station.ownership.role(robot), RobotRole::Owner(_))
        };
        (0..self.stations.len()).filter(is_owner).collect()
    }

    pub(crate) fn schedule(&mut self, delay: Micros, event: Event) {
        self.event_count += 1;
        self.events.insert((self.now + delay, self.event_count), event);
    }

    pub(crate) fn delay(&mut self) -> Micros {
        // Mostly short ones, as on a network.
        let longest = if self.rng.random_range(0..3) == 0 { MAX_DELAY } else { 5_000 };
        self.rng.random_range(100..=longest)
    }

    pub(crate) fn pairs_of(&self, station: usize) -> Vec<(usize, usize)> {
        self.pairs.keys().copied().filter(|(one, other)| *one == station || *other == station).collect()
    }

    fn step(&mut self, event: Event) {
        match event {
            Event::Tick { station, run } => {
                if self.stations[station].run == run && self.stations[station].next_tick == Some(self.now) {
                    self.stations[station].next_tick = None;
                    if self.stations[station].is_running() {
                        self.give(station, Input::Tick);
                    }
                }
            }
            Event::Message { from, to, generation, message } => self.arrive(from, to, generation, message),
            Event::Flush { from, to, generation } => {
                let pair = pair_of(from, to);
                let is_wired = self.is_wired(pair);
                let state = self.pairs.get_mut(&pair).expect("a pair");
                if is_wired && state.generation == generation {
                    let stalled = std::mem::take(&mut state.directions[usize::from(from > to)].stalled);
                    for message in stalled {
                        self.receive(from, to, generation, message);
                    }
                }
            }
            Event::LeaseExpired { pair, since } => {
                if self.pairs[&pair].unreachable_since == Some(since) {
                    self.close_session(pair);
                }
            }
            Event::DeathDetected { pair, generation } => {
                if self.pairs[&pair].generation == generation {
                    self.close_session(pair);
                }
            }
            Event::Connect { pair, generation } => {
                let state = &self.pairs[&pair];
                if state.generation == generation && state.up_since.is_none() && self.is_reachable(pair) {
                    let is_awake = |station: usize| self.now > self.stations[station].awake_since + MIN_RECONNECT;
                    if is_awake(pair.0) && is_awake(pair.1) {
                        self.open_session(pair);
                    } else {
                        self.connect_later(pair);
                    }
                }
            }
            Event::Notice { station, run, input } => {
                let is_connected = self.pairs_of(station).iter().any(|pair| self.pairs[pair].up_since.is_some());
                let is_outdated = input == Input::FleetDisconnected && is_connected;
                if self.stations[station].run == run && !is_outdated {
                    self.notify(station, input);
                }
            }
            Event::PingExpired { station, run, ping } => {
                let state = &self.stations[station];
                let has_answer = state.pongs_missing.len() < state.pings;
                if state.run == run && state.ping == ping && state.is_running() && (has_answer || state.pings == 0) {
                    self.finish_ping(station);
                }
            }
            Event::RobotSends { robot } => self.robot_sends(robot),
        }
    }

    fn robot_sends(&mut self, robot: usize) {
        let SimulatedRobot { name, period, loss_percent, heard_by, .. } = self.robots[robot].clone();
        for station in heard_by {
            if loss_percent > 0 && self.rng.random_range(0..100) < loss_percent {
                continue;
            }
            let state = &mut self.stations[station];
            if state.is_running() {
                self.robot_arrives(station, &name);
            } else if state.is_alive && state.robots_waiting.len() < 8 {
                state.robots_waiting.push_back(name.clone());
            }
        }
        let jitter = self.rng.random_range(-period / 20..=period / 20);
        self.robots[robot].next_message = self.now + period + jitter;
        self.schedule(period + jitter, Event::RobotSends { robot });
    }

    /// The message is processed, and answered if this station owns the robot. Sometimes the estimate of the last message leaves first.
    fn robot_arrives(&mut self, station: usize, robot: &RobotName) {
        if self.rng.random_range(0..4) == 0 {
            self.send_estimate(station, robot);
        }
        self.give(station, Input::RobotHeard { robot: robot.clone() });
        self.send_estimate(station, robot);
    }

    fn send_estimate(&mut self, station: usize, name: &RobotName) {
        let sender = &self.stations[station];
        let Some(epoch) = sender.ownership.permit(sender.clock(self.now), name) else { return };
        let robot = self.robot_index[name];
        self.check_estimate(station, robot, &OwnershipToken { epoch, station: sender.id.clone() });
        self.robot_receives(station, robot, epoch);
    }

    /// One input, and everything that follows from it at this station.
    pub(crate) fn give(&mut self, station: usize, input: Input) {
        let state = &mut self.stations[station];
        let mut robots = BTreeSet::new();
        match &input {
            Input::TokenAppeared { robot, token } => {
                state.seen.insert((robot.clone(), token.clone()));
                robots.insert(robot.clone());
            }
            Input::TokenVanished { robot, token } => {
                state.seen.remove(&(robot.clone(), token.clone()));
            }
            Input::StationAppeared(peer) => _ = state.peers.insert(peer.clone()),
            Input::StationVanished(peer) => _ = state.peers.remove(peer),
            Input::FleetConfirmed => state.is_confirmed = true,
            Input::FleetDisconnected => state.is_confirmed = false,
            Input::RobotHeard { .. }
            | Input::RobotLinkClosed { .. }
            | Input::StateQuery { .. }
            | Input::StateAnswer { .. }
            | Input::StatePublished { .. }
            | Input::Shutdown
            | Input::Tick => {}
        }
        let clock = state.clock(self.now);
        state.ownership.handle(clock, input);
        robots.extend(self.drain(station));
        for robot in robots {
            self.check_owners(station, &robot);
        }
    }

    fn drain(&mut self, station: usize) -> BTreeSet<RobotName> {
        let mut started = BTreeSet::new();
        while let Some(output) = self.stations[station].ownership.poll() {
            if let Output::Start { robot, .. } = &output {
                started.insert(robot.clone());
            }
            self.execute(station, output);
        }
        let state = &mut self.stations[station];
        let deadline = state.ownership.deadline();
        let tick = deadline.map(|deadline| (deadline.as_nanos() + 999).div_euclid(1_000) - state.clock_offset);
        let tick = tick.map(|tick| tick.max(self.now));
        if let Some(tick) = tick
            && state.next_tick.is_none_or(|next| tick < next || next < self.now)
        {
            state.next_tick = Some(tick);
            let run = state.run;
            self.schedule(tick - self.now, Event::Tick { station, run });
        }
        started
    }

    fn execute(&mut self, station: usize, output: Output) {
        let id = self.stations[station].id.clone();
        let others: Vec<usize> = (0..self.stations.len()).filter(|other| *other != station).collect();
        match output {
            Output::DeclareToken { robot, epoch } => {
                let token = OwnershipToken { epoch, station: id };
                self.stations[station].declared.insert((robot.clone(), token.clone()));
                for other in others {
                    self.send(station, other, Message::TokenAppeared(robot.clone(), token.clone()));
                }
            }
            Output::WithdrawToken { robot, epoch } => {
                let token = OwnershipToken { epoch, station: id };
                if !self.stations[station].declared.remove(&(robot.clone(), token.clone())) {
                    self.violations.push(format!("{} withdraws {token:?} of {robot}, not declared", self.now));
                }
                for other in others {
                    self.send(station, other, Message::TokenVanished(robot.clone(), token.clone()));
                }
            }
            Output::QueryState { robot, target, id: query, heard_for } => {
                for other in others {
                    let is_asked = match &target {
                        QueryTarget::Owner(owner) => *owner == self.stations[other].id,
                        QueryTarget::Everyone => true,
                    };
                    if is_asked {
                        self.send(station, other, Message::Query(id.clone(), robot.clone(), query, heard_for));
                    }
                }
            }
            Output::AnswerState { to, robot, id: query, content } => {
                if let Some(asker) = others.into_iter().find(|other| self.stations[*other].id == to) {
                    self.send(station, asker, Message::Answer(id, robot, query, answer(content, vec![1; 20])));
                }
            }
            Output::PublishState { robot, epoch, reception } => {
                let state = StateSnapshot { epoch, age: TimeDelta::ZERO, bytes: vec![2; 20] };
                for other in others {
                    // States may be lost where a queue is full.
                    if !self.loses_states || self.rng.random_range(0..20) != 0 {
                        let message = Message::State(id.clone(), robot.clone(), reception, state.clone());
                        self.send(station, other, message);
                    }
                }
            }
            Output::ConfirmFleet => {
                self.stations[station].ping += 1;
                let ping = self.stations[station].ping;
                let connected: BTreeSet<usize> = others
                    .into_iter()
                    .filter(|other| self.pairs[&pair_of(station, *other)].up_since.is_some())
                    .collect();
                self.stations[station].pings = connected.len();
                self.stations[station].pongs_missing.clone_from(&connected);
                for other in connected {
                    self.send(station, other, Message::Ping(ping));
                }
                let run = self.stations[station].run;
                self.schedule(300_000, Event::PingExpired { station, run, ping });
            }
            Output::Start { robot, epoch, state } => {
                let token = OwnershipToken { epoch, station: id };
                let has_state = state != StartState::Cold;
                let index = self.robot_index[&robot];
                self.robots[index].starts.push(Start { time: self.now, station, token, has_state });
            }
            Output::Event(event) => *self.event_counts.entry(kind_of(&event)).or_default() += 1,
            Output::Stop { .. } => {}
        }
    }
}
