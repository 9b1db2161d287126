//! A station's session with its fleet: a thread that owns it.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, TrySendError};
use posebridge_fleet::{
    Epoch, FleetKey, FleetKeys, FleetName, FleetTable, OwnershipToken, QueryId, RobotName, StateQuestion, StateReply,
    StationId, encode_message,
};
use posebridge_link::HostTimer;
use tokio::sync::mpsc;
use zenoh::Session;
use zenoh::Wait as _;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::Locality;

use crate::connection::{Connection, ConnectionError};
use crate::io::{AnswerReceiver, FleetCommand, FleetEvent, Publication, SessionCounts};
use crate::publishers::Publishers;
use crate::session_state::{ReportPurpose, ReportRound, SessionState, lock};
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
/// Robots of others whose keys are declared; messages of further ones cost more.
const MAX_EXPECTED: usize = 16_384;

/// The session of a station with its fleet. It ends when this is dropped, and withdraws all tokens.
pub struct FleetSession {
    shared: Arc<SessionState>,
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
        let shared = Arc::new(SessionState {
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
        let SessionState { published, dropped, missed, invalid, .. } = &*self.shared;
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
    shared: Arc<SessionState>,
    publishers: Publishers,
    tokens: BTreeMap<(RobotName, Epoch), LivelinessToken>,
    /// Robots whose keys are declared.
    expected: BTreeMap<RobotName, [KeyExpr<'static>; 2]>,
    _subscriptions: Subscriptions,
}

impl SessionThread {
    fn new(session: Session, subscriptions: Subscriptions, shared: Arc<SessionState>) -> Self {
        let publishers = Publishers::new(session.clone(), shared.keys.clone());
        Self {
            session,
            shared,
            publishers,
            tokens: BTreeMap::new(),
            expected: BTreeMap::new(),
            _subscriptions: subscriptions,
        }
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
            FleetCommand::ExpectRobot(robot) => self.expect_robot(robot),
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

    /// Declares the keys of a robot. Otherwise Zenoh compares the key of each message with all that it knows: with 500 robots that took 70 % of
    /// the time of a station.
    fn expect_robot(&mut self, robot: RobotName) -> Result<(), zenoh::Error> {
        if self.expected.contains_key(&robot) || self.expected.len() >= MAX_EXPECTED {
            return Ok(());
        }
        let declare = |key: FleetKey| self.session.declare_keyexpr(self.shared.keys.build(&key)).wait();
        let estimates = declare(FleetKey::Estimate { robot: robot.clone() })?;
        let states = declare(FleetKey::State { robot: robot.clone() })?;
        self.expected.insert(robot, [estimates, states]);
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

    fn send_command(&self, robot: RobotName, request: Vec<u8>, reply: AnswerReceiver) -> Result<(), zenoh::Error> {
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
struct WaitingOperator(Option<AnswerReceiver>);

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
