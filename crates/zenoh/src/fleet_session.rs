//! A station's session with its fleet: a thread that owns it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, TrySendError};
use posebridge_fleet::{
    Epoch, FleetKey, FleetKeys, FleetName, FleetTable, Input, OwnershipToken, QueryId, RobotName, StateQuestion,
    StateReply, StationId, encode_message,
};
use posebridge_link::HostTimer;
use tokio::sync::mpsc;
use zenoh::Session;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{ConsolidationMode, Query, QueryTarget};
use zenoh::sample::Locality;

use crate::connection::{Connection, ConnectionError};
use crate::publishers::Publishers;
use crate::subscriptions::{Subscriptions, on_report, on_state_reply};

/// Publications that wait for the network; more are dropped.
const MAX_PUBLICATIONS: usize = 8_192;
/// Events that wait for the station; more are dropped.
const MAX_EVENTS: usize = 65_536;
/// How often clocks are compared.
const EXCHANGE_PERIOD: Duration = Duration::from_secs(1);
/// How long a station may take to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);
/// How long the owner of a robot may take to answer a command.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(2);
/// Questions of others that wait for an answer.
const MAX_QUESTIONS: usize = 4_096;

/// What a station says to its fleet. These are carried out in their order.
pub enum FleetCommand {
    DeclareToken {
        robot: RobotName,
        epoch: Epoch,
    },
    WithdrawToken {
        robot: RobotName,
        epoch: Epoch,
    },
    Ask {
        robot: RobotName,
        question: StateQuestion,
    },
    Answer {
        to: StationId,
        robot: RobotName,
        id: QueryId,
        reply: StateReply,
    },
    /// Ask all stations for a sign of life.
    Confirm,
    /// Send a command of an operator to the robot's owner; gives the owner's answer, or why there is none.
    SendCommand {
        robot: RobotName,
        request: Vec<u8>,
        reply: Box<dyn FnOnce(Result<Vec<u8>, String>) + Send + Sync>,
    },
}

/// Bytes for everyone who listens; dropped while the network is too slow.
pub struct Publication {
    pub key: FleetKey,
    pub bytes: Vec<u8>,
}

/// What a station learns from its fleet.
pub enum FleetEvent {
    Ownership(Input),
    /// A camera's fix of a robot, from another station.
    Fix {
        key: FleetKey,
        bytes: Vec<u8>,
    },
    /// An operator's command from another station.
    Command {
        robot: RobotName,
        request: Vec<u8>,
        reply: CommandReply,
    },
}

/// Answers a command of another station. Without an answer the operator is told that there is none.
pub struct CommandReply(pub(crate) Query);

impl CommandReply {
    /// Sends the answer.
    pub fn send(self, answer: Vec<u8>) {
        let sent = self.0.reply(self.0.key_expr().clone(), answer).wait();
        if let Err(error) = sent {
            tracing::warn!(%error, "an answer to a command is not sent");
        }
    }
}

/// Since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionCounts {
    pub published: u64,
    /// Publications that the network or the session was too slow for.
    pub dropped: u64,
    /// Events that the station was too slow for.
    pub missed: u64,
    /// Messages that are none.
    pub invalid: u64,
}

/// What callbacks of the session share with its thread.
pub(crate) struct Shared {
    pub(crate) station: StationId,
    pub(crate) keys: FleetKeys,
    pub(crate) timer: HostTimer,
    pub(crate) table: Arc<Mutex<FleetTable>>,
    events: mpsc::Sender<FleetEvent>,
    pub(crate) own_tokens: Mutex<BTreeSet<(RobotName, Epoch)>>,
    pub(crate) stations: Mutex<BTreeSet<StationId>>,
    questions: Mutex<BTreeMap<(StationId, QueryId), Query>>,
    commands: Sender<FleetCommand>,
    pub(crate) published: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) missed: AtomicU64,
    pub(crate) invalid: AtomicU64,
}

/// A poisoned lock has whole content: nothing that holds one panics half-way.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Hands an event to the station, or counts it.
    pub(crate) fn emit(&self, event: FleetEvent) {
        if self.events.try_send(event).is_err() {
            self.missed.fetch_add(1, Ordering::Relaxed);
        }
    }

    pub(crate) fn emit_input(&self, input: Input) {
        self.emit(FleetEvent::Ownership(input));
    }

    pub(crate) fn request_confirmation(&self) {
        // The thread has ended: so has the session.
        drop(self.commands.send(FleetCommand::Confirm));
    }

    /// Keeps a question until the station has decided.
    pub(crate) fn keep_question(&self, from: &StationId, id: QueryId, query: Query) {
        let mut questions = lock(&self.questions);
        if questions.len() >= MAX_QUESTIONS {
            // The oldest of a station: its asker has given up long ago.
            questions.pop_first();
        }
        questions.insert((from.clone(), id), query);
    }

    /// Questions of a station that left.
    pub(crate) fn drop_questions(&self, of: &StationId) {
        lock(&self.questions).retain(|(from, _), _| from != of);
    }

    pub(crate) fn count_invalid(&self, what: &dyn std::fmt::Display) {
        if self.invalid.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!("the fleet sent {what}; further ones are counted only");
        }
    }
}

/// The session of a station with its fleet. It ends when this is dropped, and withdraws all tokens.
pub struct FleetSession {
    shared: Arc<Shared>,
    commands: Option<Sender<FleetCommand>>,
    publications: Sender<Publication>,
    events: mpsc::Receiver<FleetEvent>,
    thread: Option<JoinHandle<()>>,
}

impl FleetSession {
    /// Opens the session, waits until it listens, and starts its thread.
    pub fn start(
        connection: Connection,
        fleet: FleetName,
        station: StationId,
        timer: HostTimer,
        table: Arc<Mutex<FleetTable>>,
    ) -> Result<Self, ConnectionError> {
        let (commands, waiting) = crossbeam_channel::unbounded();
        let (publications, waiting_publications) = crossbeam_channel::bounded(MAX_PUBLICATIONS);
        let (events, receiver) = mpsc::channel(MAX_EVENTS);
        let (opened, result) = crossbeam_channel::bounded(1);
        let shared = Arc::new(Shared {
            station,
            keys: FleetKeys::new(fleet),
            timer,
            table,
            events,
            own_tokens: Mutex::default(),
            stations: Mutex::default(),
            questions: Mutex::default(),
            commands: commands.clone(),
            published: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            missed: AtomicU64::new(0),
            invalid: AtomicU64::new(0),
        });
        let for_thread = Arc::clone(&shared);
        let work = move || {
            let session = connection.open().and_then(|session| {
                let subscriptions = Subscriptions::declare(&session, &for_thread);
                Ok((session, subscriptions.map_err(|error| ConnectionError::Open(error.to_string()))?))
            });
            match session {
                Ok((session, subscriptions)) => {
                    drop(opened.send(Ok(())));
                    SessionThread::new(session, subscriptions, for_thread).run(&waiting, &waiting_publications);
                }
                Err(error) => drop(opened.send(Err(error))),
            }
        };
        let thread = std::thread::Builder::new().name("fleet".to_owned()).spawn(work);
        let thread = thread.map_err(|error| ConnectionError::Open(error.to_string()))?;
        result.recv().map_err(|_ended| ConnectionError::Open("its thread died".to_owned()))??;
        Ok(Self { shared, commands: Some(commands), publications, events: receiver, thread: Some(thread) })
    }

    pub fn send(&self, command: FleetCommand) {
        if let Some(commands) = &self.commands
            && commands.send(command).is_err()
        {
            tracing::error!("the thread of the fleet's session died");
        }
    }

    /// Never waits.
    pub fn publish(&self, publication: Publication) {
        match self.publications.try_send(publication) {
            Ok(()) => {}
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.shared.dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// The next event; pending while there is none.
    pub async fn next_event(&mut self) -> FleetEvent {
        match self.events.recv().await {
            Some(event) => event,
            None => std::future::pending().await,
        }
    }

    pub fn try_next_event(&mut self) -> Option<FleetEvent> {
        self.events.try_recv().ok()
    }

    pub fn counts(&self) -> SessionCounts {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let Shared { published, dropped, missed, invalid, .. } = &*self.shared;
        SessionCounts {
            published: read(published),
            dropped: read(dropped),
            missed: read(missed),
            invalid: read(invalid),
        }
    }
}

impl Drop for FleetSession {
    fn drop(&mut self) {
        self.commands = None;
        let (closed, _) = crossbeam_channel::bounded(0);
        // Both channels have to end for the thread to see the end of one.
        self.publications = closed;
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

struct SessionThread {
    session: Session,
    shared: Arc<Shared>,
    publishers: Publishers,
    tokens: BTreeMap<(RobotName, Epoch), LivelinessToken>,
    _subscriptions: Subscriptions,
}

impl SessionThread {
    fn new(session: Session, subscriptions: Subscriptions, shared: Arc<Shared>) -> Self {
        let publishers = Publishers::new(session.clone(), shared.keys.clone());
        Self { session, shared, publishers, tokens: BTreeMap::new(), _subscriptions: subscriptions }
    }

    /// Until the station's end of the publications is dropped. What decides ownership goes first.
    fn run(mut self, commands: &Receiver<FleetCommand>, publications: &Receiver<Publication>) {
        let exchanges = crossbeam_channel::tick(EXCHANGE_PERIOD);
        loop {
            while let Ok(command) = commands.try_recv() {
                self.execute(command);
            }
            crossbeam_channel::select! {
                recv(commands) -> command => {
                    if let Ok(command) = command {
                        self.execute(command);
                    }
                }
                recv(publications) -> publication => match publication {
                    Ok(publication) => self.publish(publication),
                    Err(_ended) => break,
                },
                recv(exchanges) -> _ => self.ask_for_reports(ReportPurpose::Clock),
            }
        }
        while let Ok(command) = commands.try_recv() {
            self.execute(command);
        }
        self.tokens.clear();
        if let Err(error) = self.session.close().wait() {
            tracing::warn!(%error, "the fleet's session did not close");
        }
    }

    fn execute(&mut self, command: FleetCommand) {
        let done = match command {
            FleetCommand::DeclareToken { robot, epoch } => self.declare_token(robot, epoch),
            FleetCommand::WithdrawToken { robot, epoch } => {
                let claim = (robot, epoch);
                lock(&self.shared.own_tokens).remove(&claim);
                self.tokens.remove(&claim).map_or(Ok(()), |token| token.undeclare().wait())
            }
            FleetCommand::Ask { robot, question } => self.ask(robot, &question),
            FleetCommand::Answer { to, robot, id, reply } => self.answer(to, robot, id, &reply),
            FleetCommand::Confirm => {
                self.ask_for_reports(ReportPurpose::Confirmation);
                Ok(())
            }
            FleetCommand::SendCommand { robot, request, reply } => self.send_command(robot, request, reply),
        };
        if let Err(error) = done {
            tracing::warn!(%error, "the fleet's session did not do what it had to");
        }
    }

    fn declare_token(&mut self, robot: RobotName, epoch: Epoch) -> Result<(), zenoh::Error> {
        let token = OwnershipToken { epoch, station: self.shared.station.clone() };
        let key = self.shared.keys.build(&FleetKey::Ownership { robot: robot.clone(), token });
        lock(&self.shared.own_tokens).insert((robot.clone(), epoch));
        let declared = self.session.liveliness().declare_token(key).wait()?;
        self.tokens.insert((robot, epoch), declared);
        Ok(())
    }

    fn ask(&self, robot: RobotName, question: &StateQuestion) -> Result<(), zenoh::Error> {
        let key = self.shared.keys.build(&FleetKey::State { robot: robot.clone() });
        let (shared, id) = (Arc::clone(&self.shared), question.id);
        self.session
            .get(key)
            .payload(encode_message(question))
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .allowed_destination(Locality::Remote)
            .timeout(ANSWER_TIMEOUT)
            .callback(move |reply| on_state_reply(&shared, &robot, id, &reply))
            .wait()
    }

    fn answer(&self, to: StationId, robot: RobotName, id: QueryId, reply: &StateReply) -> Result<(), zenoh::Error> {
        let Some(query) = lock(&self.shared.questions).remove(&(to, id)) else {
            return Ok(());
        };
        let key = self.shared.keys.build(&FleetKey::State { robot });
        query.reply(key, encode_message(reply)).wait()
    }

    /// Asks all stations for a sign of life.
    fn ask_for_reports(&self, purpose: ReportPurpose) {
        let round = ReportRound {
            shared: Arc::clone(&self.shared),
            purpose,
            sent: self.shared.timer.now(),
            answers: AtomicU64::new(0),
            failures: AtomicU64::new(0),
        };
        let asked = self
            .session
            .get(self.shared.keys.all_stations())
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .allowed_destination(Locality::Remote)
            .timeout(ANSWER_TIMEOUT)
            .callback(move |reply| on_report(&round, &reply))
            .wait();
        if let Err(error) = asked {
            tracing::warn!(%error, "the other stations are not asked for a sign of life");
        }
    }

    fn send_command(
        &self,
        robot: RobotName,
        request: Vec<u8>,
        reply: Box<dyn FnOnce(Result<Vec<u8>, String>) + Send + Sync>,
    ) -> Result<(), zenoh::Error> {
        let key = self.shared.keys.build(&FleetKey::Command { robot });
        let waiting = Mutex::new(WaitingOperator(Some(reply)));
        self.session
            .get(key)
            .payload(request)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .allowed_destination(Locality::Remote)
            .timeout(COMMAND_TIMEOUT)
            .callback(move |reply| {
                if let Ok(sample) = reply.result() {
                    lock(&waiting).tell(Ok(sample.payload().to_bytes().into_owned()));
                }
            })
            .wait()
    }

    fn publish(&mut self, publication: Publication) {
        let Publication { key, bytes } = publication;
        match self.publishers.publish(&key, bytes) {
            Ok(()) => self.shared.published.fetch_add(1, Ordering::Relaxed),
            Err(error) => {
                tracing::debug!(%error, "not published");
                self.shared.dropped.fetch_add(1, Ordering::Relaxed)
            }
        };
    }
}

/// Who waits for the answer to a command. Dropped without one, it tells that there is none.
struct WaitingOperator(Option<Box<dyn FnOnce(Result<Vec<u8>, String>) + Send + Sync>>);

impl WaitingOperator {
    fn tell(&mut self, answer: Result<Vec<u8>, String>) {
        if let Some(reply) = self.0.take() {
            reply(answer);
        }
    }
}

impl Drop for WaitingOperator {
    fn drop(&mut self) {
        self.tell(Err("no station that owns the robot answered".to_owned()));
    }
}

/// What signs of life are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReportPurpose {
    /// To compare clocks.
    Clock,
    /// To know all tokens.
    Confirmation,
}

/// One question to all stations. Zenoh drops it when all have answered or the time is over.
pub(crate) struct ReportRound {
    pub(crate) shared: Arc<Shared>,
    pub(crate) purpose: ReportPurpose,
    pub(crate) sent: posebridge_telemetry::Timestamp<posebridge_telemetry::HostClock>,
    pub(crate) answers: AtomicU64,
    /// Stations that did not answer in time.
    pub(crate) failures: AtomicU64,
}

impl Drop for ReportRound {
    fn drop(&mut self) {
        if self.purpose == ReportPurpose::Clock {
            return;
        }
        if self.answers.load(Ordering::Relaxed) > 0 {
            self.shared.emit_input(Input::FleetConfirmed);
        } else if self.failures.load(Ordering::Relaxed) == 0 && lock(&self.shared.stations).is_empty() {
            self.shared.emit_input(Input::FleetDisconnected);
        } else {
            // Somebody is connected and does not answer yet: the station asks again.
        }
    }
}
