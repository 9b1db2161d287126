//! `/v1/stream`: a first message, then updates, to any number of readers; commands come back.
//!
//! An update is serialized once for all readers. A slow reader misses messages, gets their number, and delays nobody.

use std::io::ErrorKind;
use std::sync::Arc;

use axum::Extension;
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message as Packet, Utf8Bytes, WebSocket, WebSocketUpgrade, close_code};
use axum::http::StatusCode;
use axum::response::Response;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{mpsc, oneshot};
use tokio::time::{interval, timeout};
use tungstenite::error::ProtocolError;

use super::app_state::{AppState, SubmittedCommand, refusal_response};
use super::connection_table::ConnectionSlot;
use super::guard::RequestAdmission;
use super::hub_task::{HubQuery, StreamStart};
use crate::counters::ServerCounter;
use crate::limits::{
    FAREWELL_TIMEOUT, MAX_MESSAGE_BYTES, MAX_WAITING_REFUSALS, PING_PERIOD, SEND_TIMEOUT, WRITE_BUFFER_BYTES,
};
use crate::model::{Message, Refusal};
use crate::token::AccessRole;

/// End of a message if none were missed.
const NONE_MISSED_SUFFIX: &str = "\"dropped\":0}";

pub(super) async fn open(
    State(app): State<Arc<AppState>>,
    Extension(connection): Extension<Arc<ConnectionSlot>>,
    Extension(admission): Extension<RequestAdmission>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(error) => return app.bad_request(error.status(), error.body_text()),
    };
    // Acquired here and not by the stream itself, which begins after the response.
    if !connection.become_reader(admission.role) {
        app.counts.increment(ServerCounter::TooManyClients);
        let why = "too many readers are here already; close one".to_owned();
        return refusal_response(StatusCode::SERVICE_UNAVAILABLE, why);
    }
    let open = connection.begin_request(admission.grant);
    upgrade
        .max_message_size(MAX_MESSAGE_BYTES)
        .max_frame_size(MAX_MESSAGE_BYTES)
        .max_write_buffer_size(WRITE_BUFFER_BYTES)
        .on_upgrade(move |socket| async move {
            serve(app, socket, admission.role, &connection).await;
            drop(open);
        })
}

async fn serve(app: Arc<AppState>, socket: WebSocket, role: AccessRole, connection: &ConnectionSlot) {
    let (refuse, refusals) = mpsc::channel(MAX_WAITING_REFUSALS);
    let app_of_client = Arc::clone(&app);
    let mut client =
        StreamClient { app: app_of_client, socket, role, missed: 0, has_responded: true, refuse, refusals };
    let ended = tokio::select! {
        ended = client.run() => ended,
        // At once, also where a message is stuck on its way to the reader.
        () = connection.end().cancelled() => client.say_revoked().await,
    };
    connection.stop_reading();
    if ended == StreamEnd::Dropped {
        app.counts.increment(ServerCounter::ClientsDropped);
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StreamEnd {
    /// The reader left, or the station is stopping.
    Closed,
    /// The reader received nothing for too long, or violated the protocol.
    Dropped,
}

struct StreamClient {
    app: Arc<AppState>,
    socket: WebSocket,
    role: AccessRole,
    missed: u64,
    /// Whether it has sent anything since the last ping.
    has_responded: bool,
    /// What other stations refuse, while the stream goes on.
    refuse: mpsc::Sender<String>,
    refusals: mpsc::Receiver<String>,
}

impl StreamClient {
    async fn run(&mut self) -> StreamEnd {
        let rows = self.app.recording_rows().await;
        let (reply, answer) = oneshot::channel();
        drop(self.app.queries.send(HubQuery::Hello(rows, self.role, reply)).await);
        let Ok(StreamStart { hello, mut frames }) = answer.await else {
            return StreamEnd::Closed;
        };
        if let Err(farewell) = self.send(Packet::Text(hello)).await {
            return farewell;
        }
        let mut pings = interval(PING_PERIOD);
        pings.reset();
        loop {
            let closed = tokio::select! {
                packet = self.socket.recv() => self.on_packet(packet).await,
                frame = frames.recv() => self.forward_frame(frame).await,
                Some(why) = self.refusals.recv() => self.send_error(why).await,
                _ = pings.tick() => self.ping().await,
                () = self.app.stop.cancelled() => Err(StreamEnd::Closed),
            };
            if let Err(farewell) = closed {
                return farewell;
            }
        }
    }

    async fn on_packet(&mut self, packet: Option<Result<Packet, axum::Error>>) -> Result<(), StreamEnd> {
        self.has_responded = true;
        match packet {
            None | Some(Ok(Packet::Close(_))) => Err(StreamEnd::Closed),
            Some(Ok(Packet::Text(text))) => match self.app.submit_command(self.role, text.as_bytes()) {
                Ok(SubmittedCommand::Own(_)) => Ok(()),
                Ok(SubmittedCommand::Fleet(pending)) => {
                    let refuse = self.refuse.clone();
                    tokio::spawn(async move {
                        if let Err((_, why)) = pending.answer().await {
                            // A reader that takes none has more of them waiting.
                            drop(refuse.try_send(why));
                        }
                    });
                    Ok(())
                }
                Err((_, why)) => self.send_error(why).await,
            },
            Some(Ok(Packet::Binary(_))) => {
                self.app.counts.increment(ServerCounter::BadCommand);
                self.send_error("commands are JSON in text messages".to_owned()).await
            }
            Some(Ok(Packet::Ping(_) | Packet::Pong(_))) => Ok(()),
            Some(Err(error)) => Err(stream_end_of(error)),
        }
    }

    async fn forward_frame(&mut self, frame: Result<Utf8Bytes, RecvError>) -> Result<(), StreamEnd> {
        match frame {
            Ok(frame) => {
                let frame = with_missed(frame, self.missed);
                self.send(Packet::Text(frame)).await?;
                self.app.counts.increment(ServerCounter::FramesSent);
                Ok(())
            }
            Err(RecvError::Lagged(missed)) => {
                self.missed += missed;
                self.app.counts.add(ServerCounter::FramesMissed, missed);
                Ok(())
            }
            Err(RecvError::Closed) => Err(StreamEnd::Closed),
        }
    }

    async fn ping(&mut self) -> Result<(), StreamEnd> {
        if !std::mem::take(&mut self.has_responded) {
            return Err(StreamEnd::Dropped);
        }
        self.send(Packet::Ping(axum::body::Bytes::new())).await
    }

    async fn say_revoked(&mut self) -> StreamEnd {
        let frame = CloseFrame { code: close_code::POLICY, reason: "the token was revoked".into() };
        // The reader may not even read it.
        drop(timeout(FAREWELL_TIMEOUT, self.socket.send(Packet::Close(Some(frame)))).await);
        StreamEnd::Closed
    }

    async fn send_error(&mut self, error: String) -> Result<(), StreamEnd> {
        let text = serde_json::to_string(&Message::Error(Refusal { error }));
        self.send(Packet::Text(text.unwrap_or_default().into())).await
    }

    async fn send(&mut self, packet: Packet) -> Result<(), StreamEnd> {
        match timeout(SEND_TIMEOUT, self.socket.send(packet)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_closed)) => Err(StreamEnd::Closed),
            Err(_too_slow) => Err(StreamEnd::Dropped),
        }
    }
}

fn stream_end_of(error: axum::Error) -> StreamEnd {
    let cause = error.into_inner().downcast::<tungstenite::Error>();
    if cause.is_ok_and(|cause| is_disconnect(&cause)) { StreamEnd::Closed } else { StreamEnd::Dropped }
}

/// Whether the reader left without a close frame: a closed browser tab, or a sleeping computer.
fn is_disconnect(cause: &tungstenite::Error) -> bool {
    if let tungstenite::Error::Io(error) = cause {
        // A timeout of the system: the reader received nothing for too long.
        return error.kind() != ErrorKind::TimedOut;
    }
    matches!(
        cause,
        tungstenite::Error::ConnectionClosed
            | tungstenite::Error::AlreadyClosed
            | tungstenite::Error::Protocol(ProtocolError::ResetWithoutClosingHandshake)
    )
}

fn with_missed(frame: Utf8Bytes, missed: u64) -> Utf8Bytes {
    match (missed, frame.as_str().strip_suffix(NONE_MISSED_SUFFIX)) {
        (0, _) | (_, None) => frame,
        (_, Some(head)) => format!("{head}\"dropped\":{missed}}}").into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_is_told_how_many_messages_it_has_missed() {
        let frame = Message::Frame(Box::default());
        let text: Utf8Bytes = serde_json::to_string(&frame).unwrap().into();
        assert_eq!(with_missed(text.clone(), 0), text);
        let parsed: Message = serde_json::from_str(&with_missed(text, 17)).unwrap();
        let Message::Frame(parsed) = parsed else {
            panic!("a frame stays one");
        };
        assert_eq!(parsed.dropped, 17);
    }
}
