//! The state that request handlers share, and their common responses.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use axum::Json;
use axum::body::Body;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::guard::RequestGuard;
use super::hub_task::{HubQuery, Topic};
use crate::api::{HostClockSource, ReplayLoader};
use crate::assets::Assets;
use crate::cameras::CameraSource;
use crate::command::{self, CommandContext, CommandRequest, FleetRequest, ParsedCommand};
use crate::counters::{ServerCounter, ServerCounters};
use crate::fleet::{FleetReply, FleetRobotCommand, FleetSource};
use crate::limits::{COMMANDS_PER_S, FLEET_ANSWER_TIMEOUT};
use crate::model::{RecordingRow, Refusal};
use crate::recordings::RecordingFolder;
use crate::taps::CommandSubmitter;
use crate::token::AccessRole;

/// Why there is no list of robots of a fleet, and no command for one.
pub(super) const NO_FLEET: &str = "this station is in no fleet; `posebridge run --fleet NAME` starts one that is";

pub(crate) struct AppState {
    pub(crate) guard: RequestGuard,
    pub(crate) counts: Arc<ServerCounters>,
    pub(crate) queries: mpsc::Sender<HubQuery>,
    pub(crate) commands: CommandSubmitter,
    /// For all clients together.
    pub(crate) command_rate: RateLimiter,
    pub(crate) command_context: CommandContext,
    pub(crate) clock: Arc<HostClockSource>,
    pub(crate) recordings: RecordingFolder,
    pub(crate) assets: Assets,
    pub(crate) cameras: Vec<CameraSource>,
    /// `None` for a station that is in no fleet.
    pub(crate) fleet: Option<FleetSource>,
    pub(crate) replay: Box<ReplayLoader>,
    /// One replay at a time, because it takes a core.
    pub(crate) replay_slot: Arc<Semaphore>,
    pub(crate) stop: CancellationToken,
}

/// The status and the reason of a rejection.
pub(super) type Rejection = (StatusCode, String);

/// A command that was sent.
pub(super) enum SubmittedCommand {
    /// To the engine; the log says what becomes of it.
    Own(&'static str),
    /// To the owner of a robot of the fleet.
    Fleet(PendingCommand),
}

/// A command that another station has not answered yet.
pub(super) struct PendingCommand {
    name: &'static str,
    answer: oneshot::Receiver<Result<(), String>>,
    counts: Arc<ServerCounters>,
}

impl PendingCommand {
    /// Waits for the answer; returns the command's name.
    pub(super) async fn answer(self) -> Result<&'static str, Rejection> {
        let result = match timeout(FLEET_ANSWER_TIMEOUT, self.answer).await {
            Ok(Ok(result)) => result,
            Ok(Err(_dropped)) => Err("this station is ending".to_owned()),
            Err(_elapsed) => Err("the station that owns the robot does not answer; try again".to_owned()),
        };
        result.map(|()| self.name).map_err(|why| {
            self.counts.increment(ServerCounter::FleetCommand);
            (StatusCode::BAD_GATEWAY, why)
        })
    }
}

impl AppState {
    /// Sends a command of somebody with this role to the station, or to the owner of a robot of the fleet.
    pub(super) fn submit_command(&self, role: AccessRole, text: &[u8]) -> Result<SubmittedCommand, Rejection> {
        if role != AccessRole::Operator {
            self.counts.increment(ServerCounter::WrongRole);
            let why = "this token only lets you look; a command needs the token of an operator".to_owned();
            return Err((StatusCode::FORBIDDEN, why));
        }
        let request = command::parse_request(text).and_then(|request| {
            match &request {
                CommandRequest::Own(ParsedCommand { name, command, .. }) => {
                    self.command_context.validate(name, command)?;
                }
                // Its owner knows what its robot has.
                CommandRequest::Fleet(_) => {}
            }
            Ok(request)
        });
        let bad_command = |why: String| {
            self.counts.increment(ServerCounter::BadCommand);
            (StatusCode::BAD_REQUEST, why)
        };
        let request = request.map_err(|error| bad_command(error.to_string()))?;
        if !self.command_rate.admits((self.clock)()) {
            self.counts.increment(ServerCounter::CommandRate);
            let why = format!("more than {COMMANDS_PER_S} commands a second come to this station; try again");
            return Err((StatusCode::SERVICE_UNAVAILABLE, why));
        }
        match request {
            CommandRequest::Own(parsed) => {
                let sent = self.commands.submit(parsed.input());
                sent.map_err(|why| (StatusCode::SERVICE_UNAVAILABLE, why.to_owned()))?;
                Ok(SubmittedCommand::Own(parsed.name))
            }
            CommandRequest::Fleet(FleetRequest { name, robot, command }) => {
                let fleet = self.fleet.as_ref().ok_or_else(|| bad_command(NO_FLEET.to_owned()))?;
                let (reply, answer) = FleetReply::pair();
                (fleet.send)(FleetRobotCommand { robot, command, reply });
                let counts = Arc::clone(&self.counts);
                Ok(SubmittedCommand::Fleet(PendingCommand { name, answer, counts }))
            }
        }
    }

    pub(super) async fn recording_rows(&self) -> Vec<RecordingRow> {
        let (reply, answer) = oneshot::channel();
        // Without the hub nothing is being recorded.
        drop(self.queries.send(HubQuery::Recording(reply)).await);
        let current = answer.await.ok().flatten();
        let recordings = self.recordings.clone();
        let listed = tokio::task::spawn_blocking(move || recordings.list(current.as_deref()));
        listed.await.unwrap_or_default()
    }

    pub(super) async fn recording_path(&self, name: &str) -> Option<PathBuf> {
        let (recordings, name) = (self.recordings.clone(), name.to_owned());
        let looked = tokio::task::spawn_blocking(move || recordings.path(&name));
        looked.await.ok().flatten()
    }

    /// What the hub says, and `rest` behind it.
    pub(super) async fn text(&self, topic: Topic, kind: &'static str, rest: &str) -> Response {
        let (reply, answer) = oneshot::channel();
        drop(self.queries.send(HubQuery::Text(topic, reply)).await);
        answer.await.map_or_else(
            |_closed| refusal_response(StatusCode::SERVICE_UNAVAILABLE, "the station is ending".to_owned()),
            |text| with_content_type(kind, (text + rest).into()),
        )
    }

    pub(super) fn bad_request(&self, status: StatusCode, why: String) -> Response {
        self.counts.increment(ServerCounter::BadRequest);
        refusal_response(status, why)
    }

    pub(super) fn wrong_method(&self) -> Response {
        let why = "wrong method: commands are posted to /v1/commands, everything else is got".to_owned();
        self.bad_request(StatusCode::METHOD_NOT_ALLOWED, why)
    }

    pub(super) fn not_found(&self, why: &str) -> Response {
        self.counts.increment(ServerCounter::NotFound);
        refusal_response(StatusCode::NOT_FOUND, why.to_owned())
    }
}

pub(super) fn refusal_response(status: StatusCode, error: String) -> Response {
    (status, Json(Refusal { error })).into_response()
}

pub(super) fn with_content_type(kind: &'static str, body: Body) -> Response {
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

/// Limits the rate of requests, and allows a burst after a pause.
///
/// Stores the instant at which the next request would be due at an even rate (the generic cell rate algorithm, ITU-T
/// I.371).
#[derive(Debug)]
pub(crate) struct RateLimiter {
    period: TimeDelta,
    /// How much earlier than due a request may come.
    slack: TimeDelta,
    due_nanos: AtomicI64,
}

impl RateLimiter {
    pub(crate) const fn new(per_s: i64, at_once: i64) -> Self {
        let period_nanos = 1_000_000_000 / per_s;
        Self {
            period: TimeDelta::from_nanos(period_nanos),
            slack: TimeDelta::from_nanos(period_nanos * (at_once - 1)),
            due_nanos: AtomicI64::new(0),
        }
    }

    /// Whether a request may come now; if so, it is counted.
    pub(crate) fn admits(&self, now: Timestamp<HostClock>) -> bool {
        let due = |due_nanos| {
            let due = Timestamp::from_nanos(due_nanos).max(now);
            (due - now <= self.slack).then(|| (due + self.period).as_nanos())
        };
        let taken = self.due_nanos.fetch_update(Ordering::Relaxed, Ordering::Relaxed, due);
        taken.is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn so_many_come_at_once_and_then_so_many_a_second() {
        let rate = RateLimiter::new(50, 10);
        let admitted = |from_ms: i64, to_ms: i64| {
            let instants = (from_ms..to_ms).map(Timestamp::from_millis);
            instants.filter(|now| rate.admits(*now)).count()
        };
        let at_once = (0..20).filter(|_| rate.admits(Timestamp::ZERO)).count();
        assert_eq!(at_once, 10);
        assert_eq!(admitted(1, 10_001), 500);
        // A pause earns no more than one burst.
        let later = Timestamp::from_millis(60_000);
        assert_eq!((0..100).filter(|_| rate.admits(later)).count(), 10);
    }
}
