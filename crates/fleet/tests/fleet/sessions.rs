//! Sessions of a simulated fleet: how they begin and end, and what goes over them.

use posebridge_fleet::Input;
use rand::RngExt;

use crate::network::{Direction, LEASE, MAX_RECONNECT, MIN_RECONNECT, Message, Micros};
use crate::simulation::{Event, Simulation, pair_of};
use crate::stations::Waiting;

impl Simulation {
    pub(crate) fn is_wired(&self, (one, other): (usize, usize)) -> bool {
        self.group_of[one] == self.group_of[other]
    }

    pub(crate) fn is_reachable(&self, pair: (usize, usize)) -> bool {
        self.is_wired(pair) && self.stations[pair.0].is_running() && self.stations[pair.1].is_running()
    }

    pub(crate) fn update_reachability(&mut self) {
        let now = self.now;
        let pairs: Vec<_> = self.pairs.keys().copied().collect();
        for pair in pairs {
            let is_reachable = self.is_reachable(pair);
            let state = self.pairs.get_mut(&pair).expect("a pair");
            if is_reachable && state.unreachable_since.take().is_some() {
                state.reachable_since = now;
            } else if !is_reachable && state.unreachable_since.is_none() {
                state.unreachable_since = Some(now);
                self.schedule(LEASE, Event::LeaseExpired { pair, since: now });
            }
        }
    }

    pub(crate) fn connect_later(&mut self, pair: (usize, usize)) {
        let delay = self.rng.random_range(MIN_RECONNECT..MAX_RECONNECT);
        let generation = self.pairs[&pair].generation;
        self.schedule(delay, Event::Connect { pair, generation });
    }

    pub(crate) fn open_session(&mut self, pair: (usize, usize)) {
        let now = self.now;
        let state = self.pairs.get_mut(&pair).expect("a pair");
        state.generation += 1;
        state.up_since = Some(now);
        state.directions = [Direction::default(), Direction::default()];
        for (from, to) in [pair, (pair.1, pair.0)] {
            let hello = Message::Hello(self.stations[from].id.clone());
            self.send(from, to, hello);
            for (robot, token) in self.stations[from].declared.clone() {
                self.send(from, to, Message::TokenAppeared(robot, token));
            }
            self.send(from, to, Message::AllListed);
        }
    }

    /// Both ends learn that the tokens of the other are gone.
    pub(crate) fn close_session(&mut self, pair: (usize, usize)) {
        let state = self.pairs.get_mut(&pair).expect("a pair");
        state.generation += 1;
        state.directions = [Direction::default(), Direction::default()];
        if state.up_since.take().is_none() {
            return;
        }
        let listed = std::mem::take(&mut state.listed);
        for ((station, other), tokens) in [pair, (pair.1, pair.0)].into_iter().zip(listed) {
            if !self.stations[station].is_alive {
                continue;
            }
            self.stations[station].listed_peers.remove(&other);
            let mut inputs: Vec<Input> =
                tokens.into_iter().map(|(robot, token)| Input::TokenVanished { robot, token }).collect();
            inputs.push(Input::StationVanished(self.stations[other].id.clone()));
            let is_last = self.pairs_of(station).iter().all(|pair| self.pairs[pair].up_since.is_none());
            if is_last {
                inputs.push(Input::FleetDisconnected);
            }
            let delay = self.delay();
            let run = self.stations[station].run;
            for input in inputs {
                if self.stations[station].frozen_since.is_some() {
                    self.stations[station].waiting.push_back(Waiting::Input(input));
                } else {
                    self.schedule(delay, Event::Notice { station, run, input });
                }
            }
        }
        self.connect_later(pair);
    }

    pub(crate) fn send(&mut self, from: usize, to: usize, message: Message) {
        let (now, delay) = (self.now, self.delay());
        let state = self.pairs.get_mut(&pair_of(from, to)).expect("a pair");
        if state.up_since.is_none() {
            return;
        }
        let generation = state.generation;
        let direction = &mut state.directions[usize::from(from > to)];
        direction.last_arrival = direction.last_arrival.max(now + delay);
        let wait = direction.last_arrival - now;
        self.schedule(wait, Event::Message { from, to, generation, message });
    }

    pub(crate) fn arrive(&mut self, from: usize, to: usize, generation: u64, message: Message) {
        let pair = pair_of(from, to);
        let is_wired = self.is_wired(pair);
        let state = self.pairs.get_mut(&pair).expect("a pair");
        let stalled = &mut state.directions[usize::from(from > to)].stalled;
        if state.generation != generation {
            return;
        }
        if !is_wired || !stalled.is_empty() {
            stalled.push(message);
            return;
        }
        self.receive(from, to, generation, message);
    }

    pub(crate) fn receive(&mut self, from: usize, to: usize, generation: u64, message: Message) {
        let station = &mut self.stations[to];
        if station.frozen_since.is_some() {
            station.waiting.push_back(Waiting::Message { from, generation, message });
            return;
        }
        let listed = |simulation: &mut Self| {
            let state = simulation.pairs.get_mut(&pair_of(from, to)).expect("a pair");
            (state.generation == generation).then_some(to > from).map(usize::from)
        };
        if !station.is_alive {
            return;
        }
        // Of a session that has ended meanwhile, of which the tokens are gone.
        let Some(end) = listed(self) else { return };
        let listed = &mut self.pairs.get_mut(&pair_of(from, to)).expect("a pair").listed[end];
        let input = match message {
            Message::Hello(station) => Input::StationAppeared(station),
            Message::TokenAppeared(robot, token) => {
                listed.insert((robot.clone(), token.clone()));
                Input::TokenAppeared { robot, token }
            }
            Message::TokenVanished(robot, token) => {
                listed.remove(&(robot.clone(), token.clone()));
                Input::TokenVanished { robot, token }
            }
            Message::AllListed => {
                self.stations[to].listed_peers.insert(from);
                Input::FleetConfirmed
            }
            Message::Ping(ping) => return self.send(to, from, Message::Pong(ping)),
            Message::Pong(ping) => {
                let station = &mut self.stations[to];
                if station.ping == ping && station.pongs_missing.remove(&from) && station.pongs_missing.is_empty() {
                    self.finish_ping(to);
                }
                return;
            }
            Message::Query(from, robot, id, heard_for) => Input::StateQuery { from, robot, id, heard_for },
            Message::Answer(from, robot, id, answer) => Input::StateAnswer { from, robot, id, answer },
            Message::State(from, robot, reception, state) => Input::StatePublished { from, robot, reception, state },
        };
        self.notify(to, input);
    }

    pub(crate) fn notify(&mut self, station: usize, input: Input) {
        if self.stations[station].frozen_since.is_some() {
            self.stations[station].waiting.push_back(Waiting::Input(input));
        } else if self.stations[station].is_alive {
            self.give(station, input);
        }
    }

    pub(crate) fn finish_ping(&mut self, station: usize) {
        self.stations[station].ping += 1;
        self.stations[station].pongs_missing.clear();
        let is_connected = !self.stations[station].listed_peers.is_empty();
        self.give(station, if is_connected { Input::FleetConfirmed } else { Input::FleetDisconnected });
    }

    /// Since when two stations have a session and run.
    pub(crate) fn connected_since(&self, one: usize, other: usize) -> Option<Micros> {
        let up_since = self.pairs[&pair_of(one, other)].up_since?;
        self.reachable_since(one, other).map(|since| since.max(up_since))
    }

    /// Since when the cable is there and both run.
    pub(crate) fn reachable_since(&self, one: usize, other: usize) -> Option<Micros> {
        let pair = pair_of(one, other);
        self.is_reachable(pair).then(|| self.pairs[&pair].reachable_since)
    }
}
