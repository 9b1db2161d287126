//! What comes from the network, as inputs: callbacks of the session. Each is short, and none waits.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use posebridge_fleet::{
    ClockExchange, FleetEstimate, FleetKey, Input, OwnershipToken, QueryId, RobotName, StateNotice, StateQuestion,
    StateReply, StationReport, decode_message, encode_message,
};
use zenoh::Session;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable, Reply};
use zenoh::sample::{Locality, Sample, SampleKind};

use crate::io::{CommandReply, FleetCommand, FleetEvent};
use crate::session_state::{ReportPurpose, ReportRound, SessionState, lock};

/// All that a session listens to, for as long as this is kept.
pub(crate) struct Subscriptions {
    _subscribers: Vec<Subscriber<()>>,
    _queryables: Vec<Queryable<()>>,
    _presence: LivelinessToken,
}

impl Subscriptions {
    pub(crate) fn declare(session: &Session, shared: &Arc<SessionState>) -> Result<Self, zenoh::Error> {
        let keys = &shared.keys;
        let own = keys.build(&FleetKey::Station(shared.station.clone()));
        // First what answers others, then what tells them that somebody is there.
        let queryables = vec![
            queryable(session, shared, own.clone(), |shared, query| answer_with_report(shared, &query))?,
            queryable(session, shared, keys.all_states(), on_state_question)?,
            queryable(session, shared, keys.all_commands(), on_command)?,
        ];
        let subscribers = vec![
            token_subscriber(session, shared, keys.all_stations(), on_station_token)?,
            token_subscriber(session, shared, keys.all_tokens(), on_ownership_token)?,
            subscriber(session, shared, keys.all_states(), on_state)?,
            subscriber(session, shared, keys.all_estimates(), on_estimate)?,
            subscriber(session, shared, keys.all_fixes(), on_fix)?,
        ];
        let presence = session.liveliness().declare_token(own).wait()?;
        Ok(Self { _subscribers: subscribers, _queryables: queryables, _presence: presence })
    }
}

fn subscriber(
    session: &Session,
    shared: &Arc<SessionState>,
    key: String,
    handle: fn(&SessionState, &Sample),
) -> Result<Subscriber<()>, zenoh::Error> {
    let shared = Arc::clone(shared);
    let declared = session.declare_subscriber(key).allowed_origin(Locality::Remote);
    declared.callback(move |sample| handle(&shared, &sample)).wait()
}

fn token_subscriber(
    session: &Session,
    shared: &Arc<SessionState>,
    key: String,
    handle: fn(&SessionState, &Sample),
) -> Result<Subscriber<()>, zenoh::Error> {
    let shared = Arc::clone(shared);
    let liveliness = session.liveliness();
    liveliness.declare_subscriber(key).history(true).callback(move |sample| handle(&shared, &sample)).wait()
}

fn queryable(
    session: &Session,
    shared: &Arc<SessionState>,
    key: String,
    handle: fn(&SessionState, Query),
) -> Result<Queryable<()>, zenoh::Error> {
    let shared = Arc::clone(shared);
    let declared = session.declare_queryable(key).allowed_origin(Locality::Remote);
    declared.callback(move |query| handle(&shared, query)).wait()
}

fn key_of(shared: &SessionState, text: &str) -> Option<FleetKey> {
    let parsed = shared.keys.parse(text);
    if let Err(error) = &parsed {
        shared.count_invalid(&format!("the key `{text}`: {error}"));
    }
    parsed.ok()
}

fn on_station_token(shared: &SessionState, sample: &Sample) {
    let Some(FleetKey::Station(station)) = key_of(shared, sample.key_expr().as_str()) else { return };
    if station == shared.station {
        return;
    }
    let mut stations = lock(&shared.stations);
    match sample.kind() {
        SampleKind::Put => {
            let is_first = stations.is_empty();
            if !stations.insert(station.clone()) {
                return;
            }
            drop(stations);
            lock(&shared.table).add_station(station.clone());
            shared.emit_input(Input::StationAppeared(station));
            if is_first {
                shared.command(FleetCommand::Confirm);
            }
        }
        SampleKind::Delete => {
            if !stations.remove(&station) {
                return;
            }
            let is_last = stations.is_empty();
            drop(stations);
            shared.drop_questions(&station);
            shared.emit_input(Input::StationVanished(station));
            if is_last {
                shared.emit_input(Input::FleetDisconnected);
            }
        }
    }
}

fn on_ownership_token(shared: &SessionState, sample: &Sample) {
    let Some(FleetKey::Ownership { robot, token }) = key_of(shared, sample.key_expr().as_str()) else { return };
    if token.station == shared.station {
        return;
    }
    shared.emit_input(match sample.kind() {
        SampleKind::Put => {
            shared.command(FleetCommand::ExpectRobot(robot.clone()));
            Input::TokenAppeared { robot, token }
        }
        SampleKind::Delete => Input::TokenVanished { robot, token },
    });
}

fn on_state(shared: &SessionState, sample: &Sample) {
    let Some(FleetKey::State { robot }) = key_of(shared, sample.key_expr().as_str()) else { return };
    match decode_message::<StateNotice>(&sample.payload().to_bytes()) {
        Ok(StateNotice { from, reception, state }) => {
            shared.emit_input(Input::StatePublished { from, robot, reception, state });
        }
        Err(error) => shared.count_invalid(&error),
    }
}

fn on_estimate(shared: &SessionState, sample: &Sample) {
    let now = shared.timer.now();
    let Some(FleetKey::Estimate { robot }) = key_of(shared, sample.key_expr().as_str()) else { return };
    match FleetEstimate::decode(&sample.payload().to_bytes()) {
        Ok(estimate) => lock(&shared.table).push_estimate(now, &robot, estimate),
        Err(error) => shared.count_invalid(&error),
    }
}

fn on_fix(shared: &SessionState, sample: &Sample) {
    if let Some(key) = key_of(shared, sample.key_expr().as_str()) {
        let bytes = sample.payload().to_bytes().into_owned();
        shared.emit(FleetEvent::Fix { key, bytes });
    }
}

fn on_state_question(shared: &SessionState, query: Query) {
    let Some(FleetKey::State { robot }) = key_of(shared, query.key_expr().as_str()) else { return };
    let payload = query.payload().map(|payload| payload.to_bytes().into_owned());
    match decode_message::<StateQuestion>(&payload.unwrap_or_default()) {
        Ok(question) => {
            let StateQuestion { from, to, id, heard_for } = question;
            if to.is_none_or(|to| to == shared.station) {
                shared.keep_question(&from, id, query);
                shared.emit_input(Input::StateQuery { from, robot, id, heard_for });
            }
        }
        Err(error) => shared.count_invalid(&error),
    }
}

fn on_command(shared: &SessionState, query: Query) {
    let Some(FleetKey::Command { robot }) = key_of(shared, query.key_expr().as_str()) else { return };
    let request = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
    shared.emit(FleetEvent::Command { robot, request, reply: CommandReply(query) });
}

fn answer_with_report(shared: &SessionState, query: &Query) {
    let report = StationReport {
        from: shared.station.clone(),
        host_time: shared.timer.now(),
        tokens: lock(&shared.own_tokens).iter().cloned().collect(),
    };
    let key = shared.keys.build(&FleetKey::Station(shared.station.clone()));
    if let Err(error) = query.reply(key, encode_message(&report)).wait() {
        tracing::debug!(%error, "a sign of life is not sent");
    }
}

pub(crate) fn on_report(round: &ReportRound, reply: &Reply) {
    let shared = &round.shared;
    let received = shared.timer.now();
    let Ok(sample) = reply.result() else {
        round.failures.fetch_add(1, Ordering::Relaxed);
        return;
    };
    match decode_message::<StationReport>(&sample.payload().to_bytes()) {
        Ok(StationReport { from, host_time, tokens }) => {
            let exchange = ClockExchange { sent: round.sent, received, remote: host_time };
            lock(&shared.table).push_exchange(&from, exchange);
            if round.purpose == ReportPurpose::Confirmation {
                for (robot, epoch) in tokens {
                    let token = OwnershipToken { epoch, station: from.clone() };
                    shared.emit_input(Input::TokenAppeared { robot, token });
                }
            }
            round.answers.fetch_add(1, Ordering::Relaxed);
        }
        Err(error) => shared.count_invalid(&error),
    }
}

pub(crate) fn on_state_reply(shared: &SessionState, robot: &RobotName, id: QueryId, reply: &Reply) {
    // A time-out is the protocol's own.
    let Ok(sample) = reply.result() else { return };
    match decode_message::<StateReply>(&sample.payload().to_bytes()) {
        Ok(StateReply { from, answer }) => {
            shared.emit_input(Input::StateAnswer { from, robot: robot.clone(), id, answer });
        }
        Err(error) => shared.count_invalid(&error),
    }
}
