//! `/v1/stream`: a first message, then what is new, to as many readers as there are; commands come back.
//!
//! What is new is written once for all. A reader that is slow misses messages, is told how many, and slows nobody.

use std::io::ErrorKind;
use std::sync::Arc;

use axum::Extension;
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message as Packet, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::Response;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::oneshot;
use tokio::time::{interval, timeout};
use tungstenite::error::ProtocolError;

use super::App;
use super::guard::refusal;
use super::hub_task::{Greeting, Question};
use super::seat::Seat;
use crate::counts::Count;
use crate::limits::{MESSAGE_BYTES, MOST_CLIENTS, PING_PERIOD, SEND_TIMEOUT, WRITE_BUFFER_BYTES};
use crate::model::{Message, Refusal};

/// How a message ends for who has missed none.
const NONE_MISSED: &str = "\"dropped\":0}";

/// Opens a stream.
pub(super) async fn open(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Seat>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(error) => return app.bad_request(error.status(), error.body_text()),
    };
    // Taken here and not by the stream itself, which begins only when the answer has gone.
    let Some(seat) = Seat::take(&app.readers, &app.counts, Count::Clients) else {
        app.counts.one(Count::TooManyClients);
        let why = format!("{MOST_CLIENTS} readers are here already; close one");
        return refusal(StatusCode::SERVICE_UNAVAILABLE, why);
    };
    upgrade
        .max_message_size(MESSAGE_BYTES)
        .max_frame_size(MESSAGE_BYTES)
        .max_write_buffer_size(WRITE_BUFFER_BYTES)
        .on_upgrade(move |socket| async move {
            serve(app, socket).await;
            drop((seat, connection));
        })
}

async fn serve(app: Arc<App>, socket: WebSocket) {
    let mut client = Client { app: Arc::clone(&app), socket, missed: 0, is_heard: true };
    if client.talk().await == Farewell::Dropped {
        app.counts.one(Count::ClientsDropped);
    }
}

/// How a stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Farewell {
    /// The reader or the station went.
    Left,
    /// The reader took nothing for too long, or sent what is no WebSocket.
    Dropped,
}

/// One reader.
struct Client {
    app: Arc<App>,
    socket: WebSocket,
    /// Messages that it has missed.
    missed: u64,
    /// It has said something since it was last asked.
    is_heard: bool,
}

impl Client {
    async fn talk(&mut self) -> Farewell {
        let rows = self.app.recording_rows().await;
        let (reply, answer) = oneshot::channel();
        drop(self.app.questions.send(Question::Hello(rows, reply)).await);
        let Ok(Greeting { hello, mut frames }) = answer.await else {
            return Farewell::Left;
        };
        if let Err(farewell) = self.send(Packet::Text(hello)).await {
            return farewell;
        }
        let mut pings = interval(PING_PERIOD);
        pings.reset();
        loop {
            let gone = tokio::select! {
                packet = self.socket.recv() => self.hear(packet).await,
                frame = frames.recv() => self.pass_on(frame).await,
                _ = pings.tick() => self.ask_whether_it_is_there().await,
                () = self.app.stop.cancelled() => Err(Farewell::Left),
            };
            if let Err(farewell) = gone {
                return farewell;
            }
        }
    }

    async fn hear(&mut self, packet: Option<Result<Packet, axum::Error>>) -> Result<(), Farewell> {
        self.is_heard = true;
        match packet {
            None | Some(Ok(Packet::Close(_))) => Err(Farewell::Left),
            Some(Ok(Packet::Text(text))) => match self.app.give(text.as_bytes()) {
                Ok(_) => Ok(()),
                Err((_, why)) => self.refuse(why).await,
            },
            Some(Ok(Packet::Binary(_))) => {
                self.app.counts.one(Count::BadCommand);
                self.refuse("commands are JSON in text messages".to_owned()).await
            }
            Some(Ok(Packet::Ping(_) | Packet::Pong(_))) => Ok(()),
            Some(Err(error)) => Err(farewell_of(error)),
        }
    }

    async fn pass_on(&mut self, frame: Result<Utf8Bytes, RecvError>) -> Result<(), Farewell> {
        match frame {
            Ok(frame) => {
                let frame = with_missed(frame, self.missed);
                self.send(Packet::Text(frame)).await?;
                self.app.counts.one(Count::FramesSent);
                Ok(())
            }
            Err(RecvError::Lagged(missed)) => {
                self.missed += missed;
                self.app.counts.add(Count::FramesMissed, missed);
                Ok(())
            }
            Err(RecvError::Closed) => Err(Farewell::Left),
        }
    }

    async fn ask_whether_it_is_there(&mut self) -> Result<(), Farewell> {
        if !std::mem::take(&mut self.is_heard) {
            return Err(Farewell::Dropped);
        }
        self.send(Packet::Ping(axum::body::Bytes::new())).await
    }

    async fn refuse(&mut self, error: String) -> Result<(), Farewell> {
        let text = serde_json::to_string(&Message::Error(Refusal { error }));
        self.send(Packet::Text(text.unwrap_or_default().into())).await
    }

    async fn send(&mut self, packet: Packet) -> Result<(), Farewell> {
        match timeout(SEND_TIMEOUT, self.socket.send(packet)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_gone)) => Err(Farewell::Left),
            Err(_too_slow) => Err(Farewell::Dropped),
        }
    }
}

/// How a stream ended that cannot be read any further.
fn farewell_of(error: axum::Error) -> Farewell {
    let cause = error.into_inner().downcast::<tungstenite::Error>();
    if cause.is_ok_and(|cause| has_gone(&cause)) { Farewell::Left } else { Farewell::Dropped }
}

/// Whether somebody just went: a browser whose tab is closed, or whose computer sleeps, says nothing.
fn has_gone(cause: &tungstenite::Error) -> bool {
    if let tungstenite::Error::Io(error) = cause {
        // Then the system gave up: nothing was taken for too long.
        return error.kind() != ErrorKind::TimedOut;
    }
    matches!(
        cause,
        tungstenite::Error::ConnectionClosed
            | tungstenite::Error::AlreadyClosed
            | tungstenite::Error::Protocol(ProtocolError::ResetWithoutClosingHandshake)
    )
}

/// A message for a reader that has missed some.
fn with_missed(frame: Utf8Bytes, missed: u64) -> Utf8Bytes {
    match (missed, frame.as_str().strip_suffix(NONE_MISSED)) {
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
        let told: Message = serde_json::from_str(&with_missed(text, 17)).unwrap();
        let Message::Frame(told) = told else {
            panic!("a frame stays one");
        };
        assert_eq!(told.dropped, 17);
    }
}
