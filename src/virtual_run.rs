//! Brick and station in one loop, in virtual time: no socket, no thread, no clock, the same every time.
//!
//! It drives the same simulation and the same pipeline as a live run. Between them stands a link that delivers at once, or one of
//! [`posebridge_sim::impairment`]. Used where two ways of steering or two links are compared on the same world, and by tests.

use std::collections::VecDeque;

use posebridge_pipeline::{BuildError, Pipeline, PipelineConfig};
use posebridge_protocol::framing::Framing;
use posebridge_sim::impairment::{Counters, End, Fate, ImpairedLink, LinkEvent, LinkKind, LinkProfile, LogEntry};
use posebridge_sim::{Doer, Scenario, Simulation};
use posebridge_telemetry::{
    Command, Event, HostClock, Input, LinkId, LinkState, Output, PeerId, Request, SimulatorCommand, Span, Stamp,
};

use crate::collect::Collector;

/// The brick still talks for this long after its path has ended.
const AFTERGLOW: Span = Span::from_millis(600);
/// A scenario that does not end by itself is ended here.
const LONGEST: Span = Span::from_millis(3_600_000);

/// Most units whose journeys are followed at a time; a link holds fewer.
const MOST_ON_THE_WAY: usize = 65_536;

/// What stands between brick and station.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VirtualLink {
    /// What the link is like.
    pub profile: LinkProfile,
    /// Seed of its randomness; that of the world is the scenario's.
    pub seed: u64,
    /// Probability that what is sent at once (one or more whole frames) is lost, on top of the profile's losses.
    pub extra_loss: f64,
    /// Delay of each direction on top of the profile's, in milliseconds.
    pub extra_delay_ms: f64,
    /// Rate error of the brick's clock instead of the scenario's, in parts per million; positive runs fast.
    pub brick_skew_ppm: Option<f64>,
}

/// What a link did in a virtual run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkTally {
    /// What became of the brick's bytes.
    pub to_station: Counters,
    /// What became of the station's bytes.
    pub to_brick: Counters,
    /// Times the link went down.
    pub outages: u64,
}

/// What a virtual run leaves behind.
///
/// How far the robot's own belief was off is in [`Simulation::truth`], how old each estimate was when the brick had it in
/// [`Simulation::received_estimates`], how far the station's estimate was off follows from [`Self::collector`] and the truth.
pub struct VirtualRun {
    /// The simulation with its truth.
    pub simulation: Simulation,
    /// What the station told.
    pub collector: Collector,
    /// What the link did; a link that delivers at once counts, too.
    pub link: LinkTally,
    /// How long each piece was on its way that arrived at the station.
    pub delays_to_station: Vec<Span>,
    /// How long each piece was on its way that arrived at the brick.
    pub delays_to_brick: Vec<Span>,
}

/// Runs a scenario against a pipeline whose first link is the brick's; the link delivers at once. A brick that does not share its link with
/// the camera leaves the second link to it, which delivers at once, too.
///
/// # Errors
/// The pipeline cannot be built.
pub fn run(scenario: Scenario, config: PipelineConfig) -> Result<VirtualRun, BuildError> {
    let link = ImpairedLink::new(&LinkProfile::default(), 0, Stamp::ZERO);
    run_on(scenario, config, link)
}

/// Runs a scenario against a pipeline whose first link is the brick's, over a link with faults.
///
/// What arrives at the station is given to the pipeline with the instant of its arrival; the brick, whose world advances in
/// steps of a millisecond, takes what has arrived since its last step. An outage is told to the pipeline as a port would tell it.
///
/// # Errors
/// The pipeline cannot be built.
pub fn run_over(
    mut scenario: Scenario,
    mut config: PipelineConfig,
    over: &VirtualLink,
) -> Result<VirtualRun, BuildError> {
    if let Some(skew_ppm) = over.brick_skew_ppm {
        scenario.brick.clock_skew_ppm = skew_ppm;
    }
    if let Some(link) = config.links.first_mut() {
        link.framing = match over.profile.kind {
            LinkKind::Stream => Framing::Stream,
            LinkKind::Datagram => Framing::Datagram,
        };
    }
    let profile = over.profile.clone().with_extra(over.extra_loss, over.extra_delay_ms);
    let link = ImpairedLink::new(&profile, over.seed, Stamp::ZERO);
    run_on(scenario, config, link)
}

/// What somebody sees who looks on at a run, in the order in which it happens.
#[derive(Clone, Copy, Debug)]
pub enum Seen<'a> {
    /// The pipeline is given this.
    Input(&'a Input),
    /// The pipeline tells this.
    Event(&'a Event),
}

/// Who looks on: sees what happens, and at which instant.
pub type Looker<'a> = dyn FnMut(Stamp<HostClock>, Seen<'_>) + 'a;

/// What is done in a run, and who looks on.
pub struct Deeds<'a> {
    /// What the pipeline is told to do at which world time, in the order of time. What it asks to be done to the brick is done.
    pub commands: &'a [(Span, Command)],
    /// The run ends then, if not before.
    pub until: Span,
    /// Sees everything.
    pub look: &'a mut Looker<'a>,
}

/// Runs a scenario as [`run`] does, while somebody gives commands.
///
/// # Errors
/// The pipeline cannot be built.
pub fn run_with(scenario: Scenario, config: PipelineConfig, deeds: Deeds<'_>) -> Result<VirtualRun, BuildError> {
    let link = ImpairedLink::new(&LinkProfile::default(), 0, Stamp::ZERO);
    let Deeds { commands, until, look } = deeds;
    let mut session = Session::new(scenario, config, link)?;
    session.commands = commands.iter().copied().collect();
    session.look = Some(look);
    Ok(session.drive(until))
}

fn run_on(scenario: Scenario, config: PipelineConfig, link: ImpairedLink) -> Result<VirtualRun, BuildError> {
    Ok(Session::new(scenario, config, link)?.drive(LONGEST))
}

/// Brick, link and station.
struct Session<'a> {
    id: LinkId,
    /// The camera's own link, where it has one.
    camera: Option<LinkId>,
    pipeline: Pipeline,
    simulation: Simulation,
    collector: Collector,
    link: ImpairedLink,
    outages: u64,
    to_station: Journeys,
    to_brick: Journeys,
    /// What is still to be told to the pipeline, and when.
    commands: VecDeque<(Span, Command)>,
    /// What the pipeline has asked to be done to the link.
    asked_of_link: VecDeque<SimulatorCommand>,
    /// Until when the cable is out.
    unplugged_until: Option<Span>,
    look: Option<&'a mut Looker<'a>>,
}

/// How long what was offered in one direction was on its way.
#[derive(Debug, Default)]
struct Journeys {
    /// What may still arrive: number of the unit, and when it was offered.
    begun: VecDeque<(u64, Stamp<HostClock>)>,
    delays: Vec<Span>,
}

impl Journeys {
    fn begin(&mut self, unit: u64, at: Stamp<HostClock>) {
        if self.begun.len() >= MOST_ON_THE_WAY {
            self.begun.pop_front();
        }
        self.begun.push_back((unit, at));
    }

    /// Takes what the link's log says.
    fn follow(&mut self, log: &[LogEntry]) {
        for entry in log {
            let Fate::Delivered { at } = entry.fate else {
                continue;
            };
            if let Ok(index) = self.begun.binary_search_by_key(&entry.unit, |begun| begun.0) {
                self.delays.extend(self.begun.get(index).map(|begun| at - begun.1));
            }
        }
    }
}

impl Session<'_> {
    fn new(scenario: Scenario, config: PipelineConfig, link: ImpairedLink) -> Result<Self, BuildError> {
        let camera = config.links.get(1).map(|link| link.id);
        Ok(Self {
            id: config.links.first().map_or(LinkId(0), |link| link.id),
            camera: camera.filter(|_| !scenario.brick.personality.shares_link_with_camera()),
            pipeline: Pipeline::new(config, Stamp::ZERO)?,
            simulation: Simulation::new(scenario),
            collector: Collector::default(),
            link,
            outages: 0,
            to_station: Journeys::default(),
            to_brick: Journeys::default(),
            commands: VecDeque::new(),
            asked_of_link: VecDeque::new(),
            unplugged_until: None,
            look: None,
        })
    }

    /// Lets the brick drive until its path ends, at the longest until then.
    fn drive(mut self, until: Span) -> VirtualRun {
        self.tell(Stamp::ZERO, self.id, LinkState::Up);
        if let Some(camera) = self.camera {
            self.tell(Stamp::ZERO, camera, LinkState::Up);
        }
        self.pass_to(Stamp::ZERO);
        let mut ends_at = until;
        while self.simulation.elapsed() < ends_at {
            self.step();
            if self.simulation.is_finished() && ends_at == until {
                ends_at = until.min(self.simulation.elapsed() + AFTERGLOW);
            }
        }
        VirtualRun {
            link: LinkTally {
                to_station: self.link.counters(End::Station),
                to_brick: self.link.counters(End::Brick),
                outages: self.outages,
            },
            simulation: self.simulation,
            collector: self.collector,
            delays_to_station: self.to_station.delays,
            delays_to_brick: self.to_brick.delays,
        }
    }

    /// Gives the commands whose time has come, and does to the link what was asked for.
    fn obey(&mut self, now: Stamp<HostClock>) {
        let elapsed = self.simulation.elapsed();
        while let Some((at, command)) = self.commands.front().copied()
            && at <= elapsed
        {
            self.commands.pop_front();
            self.give(now, &Input::Command(command));
        }
        while let Some(command) = self.asked_of_link.pop_front() {
            self.change_link(now, &command);
        }
        if self.unplugged_until.take_if(|back| *back <= elapsed).is_some() {
            self.simulation.reopen_link();
            self.tell(now, self.id, LinkState::Up);
        }
    }

    fn change_link(&mut self, now: Stamp<HostClock>, command: &SimulatorCommand) {
        match command {
            SimulatorCommand::LinkProfile(name) => {
                let profile = name.and_then(|name| LinkProfile::bundled(name.as_str()).ok());
                let seed = self.simulation.scenario().seed;
                self.link = ImpairedLink::new(&profile.unwrap_or_default(), seed, now);
            }
            SimulatorCommand::PullCable { duration } => {
                self.unplugged_until = Some(self.simulation.elapsed() + *duration);
                self.outages += 1;
                self.tell(now, self.id, LinkState::Down);
            }
            SimulatorCommand::Kidnap { .. }
            | SimulatorCommand::Slip { .. }
            | SimulatorCommand::Camera(_)
            | SimulatorCommand::CameraDelay { .. }
            | SimulatorCommand::GyroBiasStep { .. }
            | SimulatorCommand::Steering(_)
            | SimulatorCommand::Drive { .. }
            | SimulatorCommand::Path => {}
        }
    }

    /// A step of the world, and all that happens until its end.
    fn step(&mut self) {
        self.simulation.step();
        let now = Stamp::<HostClock>::ZERO + self.simulation.elapsed();
        self.obey(now);
        self.pass_to(now);
        while let Some(bytes) = self.simulation.poll() {
            if self.unplugged_until.is_some() {
                continue;
            }
            let unit = self.link.offer(End::Brick, now, &bytes);
            self.to_station.begin(unit, now);
            self.pass_to(now);
        }
        while let Some((link, bytes)) = self.camera.zip(self.simulation.poll_camera()) {
            let peer = PeerId::default();
            self.give(now, &Input::Bytes { link, peer, bytes });
            self.pass_to(now);
        }
        if self.pipeline.deadline().is_some_and(|deadline| deadline <= now) {
            self.give(now, &Input::Tick);
            self.pass_to(now);
        }
    }

    /// Lets the link do what it does until `now`, each thing at its instant: an answer leaves when the question has arrived.
    fn pass_to(&mut self, now: Stamp<HostClock>) {
        while let Some(at) = self.link.deadline().filter(|at| *at <= now) {
            while let Some(event) = self.link.poll(at) {
                self.take(event);
            }
        }
        self.to_station.follow(&self.link.take_log(End::Station));
        self.to_brick.follow(&self.link.take_log(End::Brick));
    }

    fn take(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::Arrived { end, delivery } => match end {
                End::Brick => self.simulation.receive(&delivery.bytes),
                End::Station => self
                    .give(delivery.at, &Input::Bytes { link: self.id, peer: PeerId::default(), bytes: delivery.bytes }),
            },
            LinkEvent::Down { at } => {
                self.outages += 1;
                self.tell(at, self.id, LinkState::Down);
            }
            LinkEvent::Up { at } => {
                self.simulation.reopen_link();
                self.tell(at, self.id, LinkState::Up);
            }
        }
    }

    fn tell(&mut self, at: Stamp<HostClock>, link: LinkId, state: LinkState) {
        self.give(at, &Input::Link { link, state });
    }

    fn give(&mut self, at: Stamp<HostClock>, input: &Input) {
        if let Some(look) = &mut self.look {
            look(at, Seen::Input(input));
        }
        self.pipeline.handle(at, input);
        while let Some(output) = self.pipeline.poll() {
            match output {
                Output::Transmit { .. } if self.unplugged_until.is_some() => {}
                Output::Transmit { link, bytes, .. } if self.camera == Some(link) => {
                    self.simulation.receive_camera(&bytes);
                }
                Output::Transmit { bytes, .. } => {
                    let unit = self.link.offer(End::Station, at, &bytes);
                    self.to_brick.begin(unit, at);
                }
                Output::Event(event) => {
                    if let Some(look) = &mut self.look {
                        look(at, Seen::Event(&event));
                    }
                    self.collector.take(&event);
                }
                Output::Request(Request::Simulator(command)) => match self.simulation.carry_out(&command) {
                    Doer::World => {}
                    Doer::Link => self.asked_of_link.push_back(command),
                },
                // There is no file to write.
                Output::Request(
                    Request::SaveParameters { .. } | Request::StartRecording { .. } | Request::StopRecording,
                ) => {}
            }
        }
    }
}
