//! The station's part in a fleet: which robots it serves, what it says to other stations, and what it learns from them.
//!
//! [`Ownership`] decides; [`FleetSession`] is the network. This connects both with the engine: what the fleet decides becomes
//! inputs of the engine, and is recorded with the others.

mod camera_fixes;
mod fleet_rows;
mod operator_commands;
mod robot_names;
mod state_schedule;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result};
use posebridge_dashboard::{FleetRobotCommand, FleetSource, OperatorTokens};
use posebridge_fleet::{
    AnswerContent, ClockNote, ClockOffset, Epoch, FleetEstimate, FleetKey, FleetName, FleetStation, FleetTable,
    IdentityNote, Output, Ownership, OwnershipConfig, QueryTarget, Reception, RobotName, RobotRole, SavedState,
    SharedFix, StartState, StateAnswer, StateNotice, StateQuestion, StateReply, StateSnapshot, StationId, StationName,
    decode_message, encode_message,
};
use posebridge_link::HostTimer;
use posebridge_station::Station;
use posebridge_telemetry::{
    Estimate, Event, HostClock, Input, LinkState, ObservationKind, OutsideFix, Ownership as EngineOwnership, RobotId,
    RobotSnapshot, TimeDelta, Timestamp, severity,
};
use posebridge_zenoh::{Connection, FleetCommand, FleetSession, Publication, Scouting, SessionCounts};

use self::camera_fixes::FixExchange;
use self::fleet_rows::{OwnStation, fleet_state};
use self::operator_commands::{OperatorCommands, own_input};
use self::robot_names::RobotNames;
use self::state_schedule::StateSchedule;
use crate::config::{Config, FleetSettings};

/// Stations of a fleet that are known at a time.
const MAX_STATIONS: usize = 64;
/// Robots of a fleet that are known at a time.
const MAX_ROBOTS: usize = 16_384;

/// What reaches a station from its fleet, or from an operator who commands the fleet.
pub enum FleetEvent {
    Network(posebridge_zenoh::FleetEvent),
    Operator(FleetRobotCommand),
}

/// How often the clocks of the other stations are noted.
const NOTE_PERIOD: TimeDelta = TimeDelta::from_millis(10_000);

/// The connection of a station loop with its fleet.
pub struct Fleet {
    name: FleetName,
    station: StationId,
    ownership: Ownership,
    session: FleetSession,
    table: Arc<Mutex<FleetTable>>,
    names: RobotNames,
    estimates: BTreeMap<RobotId, EstimateStream>,
    states: StateSchedule,
    fixes: FixExchange,
    operators: OperatorCommands,
    timer: HostTimer,
    /// Inputs for the engine that were not taken yet.
    inputs: Vec<Input>,
    next_cleaning: Timestamp<HostClock>,
    next_notes: Timestamp<HostClock>,
}

/// The numbers of the estimates of one robot, by this station as its owner.
#[derive(Clone, Copy, Debug)]
struct EstimateStream {
    epoch: Epoch,
    next: u32,
}

impl Fleet {
    /// Connects the station, if its configuration names a fleet. Waits until it listens, not until somebody answers.
    pub fn start(config: &Config, timer: HostTimer) -> Result<Option<Self>> {
        let Some(settings) = config.fleet.checked(&config.robots)? else {
            return Ok(None);
        };
        let station = station_id(&settings)?;
        let table = Arc::new(Mutex::new(FleetTable::new(MAX_ROBOTS, MAX_STATIONS)));
        let FleetSettings { fleet, join, listen, multicast, zenoh_config, state_interval, .. } = settings;
        let scouting = if multicast { Scouting::Multicast } else { Scouting::Off };
        let connection = Connection { join, listen, scouting, zenoh_config };
        let session = FleetSession::start(connection, fleet.clone(), station.clone(), timer, Arc::clone(&table));
        let session = session.with_context(|| format!("joining the fleet `{fleet}`"))?;
        tracing::info!(%fleet, %station, "in the fleet");
        let limits = OwnershipConfig {
            max_robots: MAX_ROBOTS,
            max_stations: MAX_STATIONS,
            state_interval,
            ..OwnershipConfig::default()
        };
        Ok(Some(Self {
            name: fleet,
            ownership: Ownership::new(limits, station.clone(), timer.now_with_sleep()),
            names: RobotNames::new(config, &station.name),
            station,
            session,
            table,
            estimates: BTreeMap::new(),
            states: StateSchedule::default(),
            fixes: FixExchange::new(config),
            operators: OperatorCommands::new(),
            timer,
            inputs: Vec::new(),
            next_cleaning: Timestamp::ZERO,
            next_notes: Timestamp::ZERO,
        }))
    }

    /// When to call [`Self::advance`], on the clock of the station.
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        // Both clocks run alike except while the computer sleeps, when nothing is called.
        let ahead = self.timer.now_with_sleep() - self.timer.now();
        self.ownership.deadline().map(|deadline| deadline - ahead)
    }

    /// Takes the time, and with it what has come from the network. Call it before each input of a robot, so that a station that was
    /// frozen knows it before it sends.
    pub fn advance(&mut self) {
        self.give(posebridge_fleet::Input::Tick);
        while let Some(event) = self.session.try_next_event() {
            self.handle_network(event);
        }
        while let Some(command) = self.operators.try_next() {
            self.send_operator_command(command);
        }
        let now = self.timer.now();
        if now >= self.next_cleaning {
            self.next_cleaning = now + TimeDelta::from_millis(1_000);
            self.table().forget_old(now);
        }
        if now >= self.next_notes {
            self.next_notes = now + NOTE_PERIOD;
            self.note_clocks(now);
        }
    }

    /// Writes into the recording how the clocks of other stations differ from this one's: `posebridge merge` reads it.
    fn note_clocks(&mut self, now: Timestamp<HostClock>) {
        let stations = self.table().stations(now);
        let clocks = stations.into_iter().filter_map(|FleetStation { id: station, clock, .. }| {
            let ClockOffset { offset, uncertainty } = clock?;
            Some(ClockNote { station, offset, uncertainty }.to_string())
        });
        let identity = IdentityNote { station: self.station.clone() }.to_string();
        let notes = [identity].into_iter().chain(clocks);
        self.inputs.extend(notes.map(|text| Input::Report { severity: severity::DEBUG, text }));
    }

    /// The next event of the network or of an operator.
    pub async fn next_event(&mut self) -> FleetEvent {
        tokio::select! {
            event = self.session.next_event() => FleetEvent::Network(event),
            command = self.operators.next() => FleetEvent::Operator(command),
        }
    }

    pub fn handle(&mut self, event: FleetEvent) {
        match event {
            FleetEvent::Network(event) => self.handle_network(event),
            FleetEvent::Operator(command) => self.send_operator_command(command),
        }
    }

    /// Sends a camera's fix to the owner of the robot with the tag, if that is another station.
    pub fn share_fix(&mut self, tag: u32, fix: &OutsideFix) {
        let Some(robot) = self.fixes.robot_of(tag) else { return };
        let owner = self.ownership.owner(robot);
        if owner.is_some_and(|owner| owner.station != self.station) {
            let robot = robot.clone();
            if let Some(publication) = self.fixes.publication(&self.station, robot, fix) {
                self.session.publish(publication);
            }
        }
    }

    fn handle_network(&mut self, event: posebridge_zenoh::FleetEvent) {
        use posebridge_zenoh::FleetEvent as NetworkEvent;
        match event {
            NetworkEvent::Ownership(input) => self.give_about_robot(input),
            NetworkEvent::Fix { key, bytes } => self.receive_fix(&key, &bytes),
            NetworkEvent::Command { robot, request, reply } => {
                // A robot of another station: that one answers.
                if let Some(robot) = self.owned_robot(&robot) {
                    self.inputs.extend(self.operators.accept(robot, &request, reply));
                }
            }
        }
    }

    fn receive_fix(&mut self, key: &FleetKey, bytes: &[u8]) {
        let FleetKey::Fix { robot: name, .. } = key else { return };
        let Some(robot) = self.owned_robot(name) else { return };
        let now = self.timer.now();
        let shared = match decode_message::<SharedFix>(bytes) {
            Ok(shared) => shared,
            Err(error) => {
                tracing::warn!(robot = %name, "a fix of another station is not used: {error}");
                return;
            }
        };
        let offset = self.table().offset(now, &shared.from);
        if let Some(fix) = self.fixes.receive(name, &shared, offset) {
            self.inputs.push(Input::OutsideFix { robot, fix });
        }
    }

    fn send_operator_command(&mut self, FleetRobotCommand { robot, command, reply }: FleetRobotCommand) {
        let name = match RobotName::new(&robot) {
            Ok(name) => name,
            Err(error) => {
                reply.send(Err(format!("`{robot}` is the name of no robot of a fleet: {error}")));
                return;
            }
        };
        match self.owned_robot(&name) {
            Some(robot) => {
                let answer = own_input(robot, &command).map(|input| self.inputs.push(input));
                reply.send(answer);
            }
            None => self.session.send(self.operators.request(name, command, reply)),
        }
    }

    /// The robot's id, if this station owns it and sends it estimates.
    fn owned_robot(&self, robot: &RobotName) -> Option<RobotId> {
        match self.ownership.role(robot) {
            RobotRole::Owner(_) => self.names.id(robot),
            RobotRole::None | RobotRole::StandBy | RobotRole::Paused(_) => None,
        }
    }

    /// Whether an estimate may be sent now: not if this station stood still since [`Self::advance`].
    pub fn may_send(&self) -> bool {
        self.ownership.is_awake(self.timer.now_with_sleep())
    }

    /// Takes an input of the engine with its events: which robots were heard, and the estimates of those that are owned here.
    pub fn observe(&mut self, station: &Station, now: Timestamp<HostClock>, input: &Input, events: &[Event]) {
        if let Input::Link { link, state: LinkState::Down } = input {
            for robot in self.names.on_link(*link) {
                self.give(posebridge_fleet::Input::RobotLinkClosed { robot });
            }
        }
        let mut last_heard = None;
        for event in events {
            if let Some(robot) = heard_robot(event).filter(|robot| last_heard != Some(*robot)) {
                last_heard = Some(robot);
                self.hear(station, robot);
            }
            if let Event::EstimateUpdated { robot, estimate } = event {
                self.publish_estimate(now, *robot, estimate);
            }
        }
    }

    fn publish_estimate(&mut self, now: Timestamp<HostClock>, robot: RobotId, estimate: &Estimate) {
        let Some(name) = self.names.name(robot).cloned() else { return };
        let RobotRole::Owner(epoch) = self.ownership.role(&name) else { return };
        let stream = self.estimates.entry(robot).or_insert(EstimateStream { epoch, next: 0 });
        if stream.epoch != epoch {
            *stream = EstimateStream { epoch, next: 0 };
        }
        let estimate = FleetEstimate::new(epoch, stream.next, now, estimate);
        stream.next = stream.next.wrapping_add(1);
        self.table().set_own_estimate(now, &name, estimate);
        let bytes = estimate.encode().to_vec();
        self.session.publish(Publication { key: FleetKey::Estimate { robot: name }, bytes });
    }

    /// The next input for the engine; call it until `None`, with all outputs of the engine polled before.
    pub fn next_input(&mut self, station: &Station) -> Option<Input> {
        while self.inputs.is_empty() {
            let output = self.ownership.poll()?;
            self.carry_out(station, output);
        }
        Some(self.inputs.remove(0))
    }

    /// Gives the robots back before the program ends.
    pub fn shut_down(&mut self, station: &Station) {
        self.give(posebridge_fleet::Input::Shutdown);
        while self.next_input(station).is_some() {}
        self.report_losses();
    }

    /// Says what was lost in this session, if anything was.
    fn report_losses(&self) {
        let SessionCounts { published, dropped, missed, invalid } = self.session.counts();
        let (lost_fixes, unaligned_fixes) = self.fixes.losses();
        if dropped + missed + invalid + lost_fixes + unaligned_fixes > 0 {
            tracing::warn!(
                published,
                dropped,
                missed,
                invalid,
                lost_fixes,
                unaligned_fixes,
                "the fleet's network or this computer was too slow for some messages"
            );
        }
    }

    /// What viewers show of the fleet, and the way of their commands.
    pub fn source(&self) -> FleetSource {
        let (fleet, station, timer) = (self.name.clone(), self.station.clone(), self.timer);
        let (table, ids) = (Arc::clone(&self.table), self.names.shared_ids());
        let state = move || {
            // Copies, so that the station never waits for a viewer.
            let table = table.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let robots = ids.lock().unwrap_or_else(PoisonError::into_inner).clone();
            fleet_state(&OwnStation { id: &station, fleet: &fleet, robots: &robots }, &table, timer.now())
        };
        FleetSource { name: self.name.to_string(), state: Arc::new(state), send: Arc::new(self.operators.submitter()) }
    }

    /// The tokens by which other stations' operators may command robots of this station.
    pub fn set_operator_tokens(&mut self, tokens: OperatorTokens) {
        self.operators.set_tokens(tokens);
    }

    fn table(&self) -> MutexGuard<'_, FleetTable> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn hear(&mut self, station: &Station, robot: RobotId) {
        self.names.add(station, robot);
        if let Some(robot) = self.names.name(robot).cloned() {
            self.give(posebridge_fleet::Input::RobotHeard { robot });
        }
    }

    fn give(&mut self, input: posebridge_fleet::Input) {
        self.ownership.handle(self.timer.now_with_sleep(), input);
    }

    /// An input of the network, after which the table shows who owns the robot.
    fn give_about_robot(&mut self, input: posebridge_fleet::Input) {
        use posebridge_fleet::Input as FleetInput;
        let robot = match &input {
            FleetInput::TokenAppeared { robot, .. } | FleetInput::TokenVanished { robot, .. } => Some(robot.clone()),
            FleetInput::StationVanished(station) => {
                self.table().remove_station(self.timer.now(), station);
                None
            }
            FleetInput::RobotHeard { .. }
            | FleetInput::RobotLinkClosed { .. }
            | FleetInput::StationAppeared(_)
            | FleetInput::StateQuery { .. }
            | FleetInput::StateAnswer { .. }
            | FleetInput::StatePublished { .. }
            | FleetInput::FleetConfirmed
            | FleetInput::FleetDisconnected
            | FleetInput::Shutdown
            | FleetInput::Tick => None,
        };
        self.give(input);
        if let Some(robot) = robot {
            self.show_owner(&robot);
        }
    }

    fn show_owner(&self, robot: &RobotName) {
        self.table().set_owner(self.timer.now(), robot, self.ownership.owner(robot));
    }

    fn carry_out(&mut self, station: &Station, output: Output) {
        match output {
            Output::DeclareToken { robot, epoch } => {
                self.show_owner(&robot);
                self.session.send(FleetCommand::DeclareToken { robot, epoch });
            }
            Output::WithdrawToken { robot, epoch } => {
                self.show_owner(&robot);
                self.session.send(FleetCommand::WithdrawToken { robot, epoch });
            }
            Output::QueryState { robot, target, id, heard_for } => {
                let to = match target {
                    QueryTarget::Owner(owner) => Some(owner),
                    QueryTarget::Everyone => None,
                };
                let question = StateQuestion { from: self.station.clone(), to, id, heard_for };
                self.session.send(FleetCommand::Ask { robot, question });
            }
            Output::AnswerState { to, robot, id, content } => {
                let answer = match content {
                    AnswerContent::Serving { epoch, heard_ago, silent_in } => {
                        StateAnswer::Serving { epoch, heard_ago, silent_in }
                    }
                    AnswerContent::HandOver { epoch } => StateAnswer::HandOver(self.save_state(station, &robot, epoch)),
                    AnswerContent::Promised => StateAnswer::Promised,
                    AnswerContent::NotOwner { owner, highest_epoch, state } => {
                        StateAnswer::NotOwner { owner, highest_epoch, state }
                    }
                };
                let reply = StateReply { from: self.station.clone(), answer };
                self.session.send(FleetCommand::Answer { to, robot, id, reply });
            }
            Output::PublishState { robot, epoch, reception } => self.publish_state(station, robot, epoch, reception),
            Output::ConfirmFleet => self.session.send(FleetCommand::Confirm),
            Output::Start { robot, epoch, state } => self.start_robot(&robot, epoch, state),
            Output::Stop { robot } => {
                let epoch = self.ownership.owner(&robot).map_or(0, |owner| u64::from(owner.epoch.get()));
                self.push_ownership(&robot, EngineOwnership::Standby { epoch });
            }
            Output::Event(event) => {
                tracing::info!("{event}");
                let text = format!("fleet: {event}");
                self.inputs.push(Input::Report { severity: severity::NOTICE, text });
            }
        }
    }

    fn start_robot(&mut self, robot: &RobotName, epoch: Epoch, state: StartState) {
        let received = match state {
            StartState::Cold | StartState::Kept => None,
            StartState::Received(snapshot) => self.receive_state(robot, &snapshot),
        };
        let epoch = u64::from(epoch.get());
        self.push_ownership(robot, EngineOwnership::Owner { epoch, state: received });
    }

    fn push_ownership(&mut self, robot: &RobotName, ownership: EngineOwnership) {
        if let Some(robot) = self.names.id(robot) {
            self.inputs.push(Input::Ownership { robot, ownership });
        }
    }

    /// The state of another station, for the engine. The offset of its clock is that of the exchanges with it, else what the state's age
    /// says, which is wrong by the time that the state was on its way.
    fn receive_state(&self, robot: &RobotName, snapshot: &StateSnapshot) -> Option<RobotSnapshot> {
        let saved = match decode_message::<SavedState>(&snapshot.bytes) {
            Ok(saved) => saved,
            Err(error) => {
                tracing::warn!(%robot, "it starts without the state of its last owner: {error}");
                return None;
            }
        };
        let now = self.timer.now();
        let measured = self.table().offset(now, &saved.station).map(|measured| measured.offset);
        let clock_offset = measured.unwrap_or(saved.saved_at + snapshot.age - now);
        Some(RobotSnapshot { bytes: saved.engine_state, clock_offset })
    }

    fn publish_state(&mut self, station: &Station, robot: RobotName, epoch: Epoch, reception: Reception) {
        let now = self.timer.now();
        if reception == Reception::Heard && !self.states.is_due(now, &robot) {
            return;
        }
        let state = self.save_state(station, &robot, epoch);
        self.states.record(now, &robot, state.bytes.len());
        let notice = StateNotice { from: self.station.clone(), reception, state };
        let bytes = encode_message(&notice);
        self.session.publish(Publication { key: FleetKey::State { robot }, bytes });
    }

    /// Empty for a robot that the engine does not know any more; the new owner then starts cold.
    fn save_state(&self, station: &Station, robot: &RobotName, epoch: Epoch) -> StateSnapshot {
        let engine_state = self.names.id(robot).and_then(|id| station.robot_state(id)).unwrap_or_default();
        let saved = SavedState { station: self.station.clone(), saved_at: self.timer.now(), engine_state };
        StateSnapshot { epoch, age: TimeDelta::ZERO, bytes: encode_message(&saved) }
    }
}

/// The id of this run: a station that was restarted is another one.
fn station_id(settings: &FleetSettings) -> Result<StationId> {
    let name = if let Some(name) = &settings.station {
        name.clone()
    } else {
        let system = rustix::system::uname();
        let host = system.nodename().to_string_lossy();
        StationName::new(&host)
            .with_context(|| format!("this computer's name `{host}` cannot be the station's: set `fleet.station`"))?
    };
    let mut instance = [0; 8];
    getrandom::fill(&mut instance).context("a random number for the station's id")?;
    Ok(StationId { name, instance: u64::from_le_bytes(instance) })
}

/// The robot that an event shows to be there: its own telemetry, and not what a camera sees of it.
fn heard_robot(event: &Event) -> Option<RobotId> {
    if let Event::RobotDetected { robot } = event {
        return Some(*robot);
    }
    let Event::ObservationAligned { robot, observation, .. } = event else { return None };
    (!matches!(observation.measurement, ObservationKind::Fix(_))).then_some(*robot)
}
