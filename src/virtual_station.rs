//! Simulated brick and station in one loop in virtual time: no socket, no thread, no clock, and deterministic.
//! It runs the same simulation and the same station as a live run, over a link without delay or one of [`posebridge_sim::impairment`].
//! `lab links`, the comparison of steerings after a run, and tests use it.

use std::collections::VecDeque;

use posebridge_protocol::framing::TransportKind;
use posebridge_sim::impairment::{
    ByteOutcome, Counters, ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkKind, LinkProfile, LogEntry,
};
use posebridge_sim::{CommandExecutor, Scenario, Simulation};
use posebridge_station::{BuildError, Station, StationConfig};
use posebridge_telemetry::{
    Command, Event, HostClock, Input, LinkId, LinkState, Output, PeerId, Request, SimulatorCommand, TimeDelta,
    Timestamp,
};

use crate::station::event_collector::EventCollector;

const LINGER_AFTER_END: TimeDelta = TimeDelta::from_millis(600);
/// Limit for a scenario that does not end by itself.
const MAX_DURATION: TimeDelta = TimeDelta::from_millis(3_600_000);

/// Limit of the units in transit that are tracked for their delays; a link holds fewer.
const MAX_IN_TRANSIT: usize = 65_536;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct VirtualLink {
    pub profile: LinkProfile,
    /// Seed of the link; the world uses the scenario's.
    pub seed: u64,
    /// Probability that a send (one or more whole frames) is lost, in addition to the profile's losses.
    pub extra_loss: f64,
    /// Additional delay of each direction.
    pub extra_delay_ms: f64,
    /// Rate error of the brick's clock instead of the scenario's; positive runs fast.
    pub brick_skew_ppm: Option<f64>,
}

/// Counters of both directions of a link over a virtual run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkTotals {
    pub to_station: Counters,
    pub to_brick: Counters,
    pub outages: u64,
}

/// The result of a virtual run: the simulation has the true path and the odometry, and the estimates that the brick received with their
/// ages; the collector has the station's events.
pub struct VirtualRun {
    pub simulation: Simulation,
    pub collector: EventCollector,
    pub link: LinkTotals,
    pub delays_to_station: Vec<TimeDelta>,
    pub delays_to_brick: Vec<TimeDelta>,
}

/// Runs a scenario against a station whose first link is the brick's, without delay. The second link is the camera's if the brick does
/// not share its own.
pub fn run(scenario: Scenario, config: StationConfig) -> Result<VirtualRun, BuildError> {
    let link = ImpairedLink::new(&LinkProfile::default(), 0, Timestamp::ZERO);
    run_on(scenario, config, link)
}

/// Like [`run`], over an impaired link.
///
/// The station gets bytes at the instant of their arrival; the brick, whose world advances in steps of a millisecond, gets the bytes
/// since its last step. The station gets an outage as a live link reports it.
pub fn run_over_link(
    mut scenario: Scenario,
    mut config: StationConfig,
    over: &VirtualLink,
) -> Result<VirtualRun, BuildError> {
    if let Some(skew_ppm) = over.brick_skew_ppm {
        scenario.brick.clock_skew_ppm = skew_ppm;
    }
    if let Some(link) = config.links.first_mut() {
        link.framing = match over.profile.kind {
            LinkKind::Stream => TransportKind::Stream,
            LinkKind::Datagram => TransportKind::Datagram,
        };
    }
    let profile = over.profile.clone().with_extra(over.extra_loss, over.extra_delay_ms);
    let link = ImpairedLink::new(&profile, over.seed, Timestamp::ZERO);
    run_on(scenario, config, link)
}

#[derive(Clone, Copy, Debug)]
pub enum RunEvent<'a> {
    Input(&'a Input),
    Event(&'a Event),
}

/// Called with each event and its instant.
pub type RunObserver<'a> = dyn FnMut(Timestamp<HostClock>, RunEvent<'_>) + 'a;

/// Commands, limits and observer of a run.
pub struct RunScript<'a> {
    /// Commands for the station with their world times, in time order. The resulting requests to the brick are executed.
    pub commands: &'a [(TimeDelta, Command)],
    pub until: TimeDelta,
    /// Time for which the brick still sends after the end of its path.
    pub linger: TimeDelta,
    /// Called with every input and event.
    pub observer: &'a mut RunObserver<'a>,
}

/// Like [`run`], with commands and an observer.
pub fn run_with(scenario: Scenario, config: StationConfig, script: RunScript<'_>) -> Result<VirtualRun, BuildError> {
    let link = ImpairedLink::new(&LinkProfile::default(), 0, Timestamp::ZERO);
    let RunScript { commands, until, linger, observer } = script;
    let mut session = VirtualSession::new(scenario, config, link)?;
    session.commands = commands.iter().copied().collect();
    session.observer = Some(observer);
    Ok(session.drive(until, linger))
}

fn run_on(scenario: Scenario, config: StationConfig, link: ImpairedLink) -> Result<VirtualRun, BuildError> {
    Ok(VirtualSession::new(scenario, config, link)?.drive(MAX_DURATION, LINGER_AFTER_END))
}

struct VirtualSession<'a> {
    id: LinkId,
    /// Of a camera that does not share the brick's link.
    camera: Option<LinkId>,
    station: Station,
    simulation: Simulation,
    collector: EventCollector,
    link: ImpairedLink,
    outages: u64,
    to_station: TransitTimes,
    to_brick: TransitTimes,
    commands: VecDeque<(TimeDelta, Command)>,
    /// Commands of the station to the link, for the next step.
    pending_link_commands: VecDeque<SimulatorCommand>,
    unplugged_until: Option<TimeDelta>,
    observer: Option<&'a mut RunObserver<'a>>,
}

#[derive(Debug, Default)]
struct TransitTimes {
    /// Number of each unit that may still arrive, and the time of its offer.
    in_transit: VecDeque<(u64, Timestamp<HostClock>)>,
    delays: Vec<TimeDelta>,
}

impl TransitTimes {
    fn begin(&mut self, unit: u64, at: Timestamp<HostClock>) {
        if self.in_transit.len() >= MAX_IN_TRANSIT {
            self.in_transit.pop_front();
        }
        self.in_transit.push_back((unit, at));
    }

    /// Processes the deliveries in the link's log.
    fn follow(&mut self, log: &[LogEntry]) {
        for entry in log {
            let ByteOutcome::Delivered { at } = entry.outcome else {
                continue;
            };
            if let Ok(index) = self.in_transit.binary_search_by_key(&entry.unit, |begun| begun.0) {
                self.delays.extend(self.in_transit.get(index).map(|begun| at - begun.1));
            }
        }
    }
}

impl VirtualSession<'_> {
    fn new(scenario: Scenario, config: StationConfig, link: ImpairedLink) -> Result<Self, BuildError> {
        let camera = config.links.get(1).map(|link| link.id);
        Ok(Self {
            id: config.links.first().map_or(LinkId(0), |link| link.id),
            camera: camera.filter(|_| !scenario.brick.personality.shares_link_with_camera()),
            station: Station::new(config, Timestamp::ZERO)?,
            simulation: Simulation::new(scenario),
            collector: EventCollector::default(),
            link,
            outages: 0,
            to_station: TransitTimes::default(),
            to_brick: TransitTimes::default(),
            commands: VecDeque::new(),
            pending_link_commands: VecDeque::new(),
            unplugged_until: None,
            observer: None,
        })
    }

    /// Drives to the end of the path and then for `linger`, but not beyond `until`.
    fn drive(mut self, until: TimeDelta, linger: TimeDelta) -> VirtualRun {
        self.report_link_state(Timestamp::ZERO, self.id, LinkState::Up);
        if let Some(camera) = self.camera {
            self.report_link_state(Timestamp::ZERO, camera, LinkState::Up);
        }
        self.advance_to(Timestamp::ZERO);
        let mut ends_at = until;
        while self.simulation.elapsed() < ends_at {
            self.step();
            if self.simulation.is_finished() && ends_at == until {
                ends_at = until.min(self.simulation.elapsed() + linger);
            }
        }
        VirtualRun {
            link: LinkTotals {
                to_station: self.link.counters(LinkEnd::Station),
                to_brick: self.link.counters(LinkEnd::Brick),
                outages: self.outages,
            },
            simulation: self.simulation,
            collector: self.collector,
            delays_to_station: self.to_station.delays,
            delays_to_brick: self.to_brick.delays,
        }
    }

    /// Executes the commands that are due, and impairs the link.
    fn run_due_commands(&mut self, now: Timestamp<HostClock>) {
        let elapsed = self.simulation.elapsed();
        while let Some((at, command)) = self.commands.front().copied()
            && at <= elapsed
        {
            self.commands.pop_front();
            self.push_input(now, &Input::Command(command));
        }
        while let Some(command) = self.pending_link_commands.pop_front() {
            self.change_link(now, &command);
        }
        if self.unplugged_until.take_if(|back| *back <= elapsed).is_some() {
            self.simulation.reopen_link();
            self.report_link_state(now, self.id, LinkState::Up);
        }
    }

    fn change_link(&mut self, now: Timestamp<HostClock>, command: &SimulatorCommand) {
        if let SimulatorCommand::PullCable { duration } = command {
            self.unplugged_until = Some(self.simulation.elapsed() + *duration);
            self.outages += 1;
            self.report_link_state(now, self.id, LinkState::Down);
        } else if let SimulatorCommand::LinkProfile(name) = command {
            let profile = name.and_then(|name| LinkProfile::bundled(name.as_str()).ok());
            let seed = self.simulation.scenario().seed;
            self.link = ImpairedLink::new(&profile.unwrap_or_default(), seed, now);
        }
    }

    /// One step of the world, with all events until its end.
    fn step(&mut self) {
        self.simulation.step();
        let now = Timestamp::<HostClock>::ZERO + self.simulation.elapsed();
        self.run_due_commands(now);
        self.advance_to(now);
        while let Some(bytes) = self.simulation.poll() {
            if self.unplugged_until.is_some() {
                continue;
            }
            let unit = self.link.offer(LinkEnd::Brick, now, &bytes);
            self.to_station.begin(unit, now);
            self.advance_to(now);
        }
        while let Some((link, bytes)) = self.camera.zip(self.simulation.poll_camera()) {
            let peer = PeerId::default();
            self.push_input(now, &Input::Bytes { link, peer, bytes });
            self.advance_to(now);
        }
        if self.station.deadline().is_some_and(|deadline| deadline <= now) {
            self.push_input(now, &Input::Tick);
            self.advance_to(now);
        }
    }

    /// Delivers all units due until `now` at their instants, so that an answer leaves when the question has arrived.
    fn advance_to(&mut self, now: Timestamp<HostClock>) {
        while let Some(at) = self.link.deadline().filter(|at| *at <= now) {
            while let Some(event) = self.link.poll(at) {
                self.on_link_event(event);
            }
        }
        self.to_station.follow(&self.link.take_log(LinkEnd::Station));
        self.to_brick.follow(&self.link.take_log(LinkEnd::Brick));
    }

    fn on_link_event(&mut self, event: ImpairedLinkEvent) {
        match event {
            ImpairedLinkEvent::Arrived { end, delivery } => match end {
                LinkEnd::Brick => self.simulation.receive(&delivery.bytes),
                LinkEnd::Station => self.push_input(
                    delivery.at,
                    &Input::Bytes { link: self.id, peer: PeerId::default(), bytes: delivery.bytes },
                ),
            },
            ImpairedLinkEvent::Down { at } => {
                self.outages += 1;
                self.report_link_state(at, self.id, LinkState::Down);
            }
            ImpairedLinkEvent::Up { at } => {
                self.simulation.reopen_link();
                self.report_link_state(at, self.id, LinkState::Up);
            }
        }
    }

    fn report_link_state(&mut self, at: Timestamp<HostClock>, link: LinkId, state: LinkState) {
        self.push_input(at, &Input::Link { link, state });
    }

    fn push_input(&mut self, at: Timestamp<HostClock>, input: &Input) {
        if let Some(observe) = &mut self.observer {
            observe(at, RunEvent::Input(input));
        }
        self.station.handle(at, input);
        while let Some(output) = self.station.poll() {
            match output {
                Output::Transmit { .. } if self.unplugged_until.is_some() => {}
                Output::Transmit { link, bytes, .. } if self.camera == Some(link) => {
                    self.simulation.receive_camera(&bytes);
                }
                Output::Transmit { bytes, .. } => {
                    let unit = self.link.offer(LinkEnd::Station, at, &bytes);
                    self.to_brick.begin(unit, at);
                }
                Output::Event(event) => {
                    if let Some(observe) = &mut self.observer {
                        observe(at, RunEvent::Event(&event));
                    }
                    self.collector.on_event(&event);
                }
                Output::Request(Request::Simulator { command, .. }) => match self.simulation.execute(&command) {
                    CommandExecutor::Simulation => {}
                    CommandExecutor::Link => self.pending_link_commands.push_back(command),
                },
                // There is no file to write, and no other station.
                Output::Request(
                    Request::SaveParameters { .. }
                    | Request::StartRecording { .. }
                    | Request::StopRecording
                    | Request::ShareFix { .. },
                ) => {}
            }
        }
    }
}
