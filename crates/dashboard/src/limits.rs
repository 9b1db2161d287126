//! The limits of the server. Requests beyond them are rejected and counted.

use std::time::Duration;

use posebridge_telemetry::{AdmissionLimits, TimeDelta};

/// 50 Hz: the rate of a brick, and enough for the eye.
pub(crate) const TICK: Duration = Duration::from_millis(20);
/// Of slowly changing data.
pub(crate) const SECOND: TimeDelta = TimeDelta::from_millis(1_000);

/// Most connections, readers of the stream included; a browser opens six. The usual limit is 1 024 file descriptors,
/// and links and recordings need some. A quarter is left for others than the largest client.
pub(crate) const CONNECTION_LIMITS: AdmissionLimits = AdmissionLimits { total: 256, per_client: 192 };
/// Most readers of the stream: a class with a browser each, perhaps all behind one address.
pub(crate) const READER_LIMITS: AdmissionLimits = AdmissionLimits { total: 80, per_client: 64 };
/// Places among those for readers who may give commands.
pub(crate) const OPERATOR_READERS: usize = 8;
/// Between two looks at the file of tokens.
pub(crate) const TOKEN_FILE_PERIOD: Duration = Duration::from_secs(1);
/// For the last message to a reader whose token was revoked.
pub(crate) const FAREWELL_TIMEOUT: Duration = Duration::from_millis(100);
/// Timeout for the head of a request; loopback takes a millisecond, a bad WLAN a second.
pub(crate) const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
pub(crate) const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout for a replay: a quarter of an hour of a usual brick takes about half a minute in a debug build.
pub(crate) const REPLAY_TIMEOUT: Duration = Duration::from_mins(5);
/// A reader that receives nothing for this long is disconnected.
pub(crate) const SEND_TIMEOUT: Duration = Duration::from_secs(10);
pub(crate) const PING_PERIOD: Duration = Duration::from_secs(10);
/// Browsers send about 1 KiB.
pub(crate) const MAX_HEAD_BYTES: usize = 16 * 1024;
/// Largest body of a request or message on the stream, in bytes; the longest command has two hundred.
pub(crate) const MAX_MESSAGE_BYTES: usize = 64 * 1024;
/// Write buffer of a reader's socket before it counts as slow: some messages and the first one.
pub(crate) const WRITE_BUFFER_BYTES: usize = 4 * 1024 * 1024;
/// Lag after which a reader misses messages: a bit more than a second.
pub(crate) const MAX_WAITING_FRAMES: usize = 64;
/// Commands per second from all clients together: a held key sends five, and each is an input that delays fusion and is recorded.
pub(crate) const COMMANDS_PER_S: i64 = 50;
/// One second's worth, after a pause.
pub(crate) const COMMAND_BURST: i64 = COMMANDS_PER_S;
/// Most commands that wait for the station loop, which reads them within a millisecond.
pub(crate) const MAX_WAITING_COMMANDS: usize = 64;
/// For the answer of the station that owns a robot.
pub(crate) const FLEET_ANSWER_TIMEOUT: Duration = Duration::from_secs(2);
/// Refusals of other stations that wait for a reader of the stream; more are dropped.
pub(crate) const MAX_WAITING_REFUSALS: usize = 16;
pub(crate) const MAX_WAITING_QUERIES: usize = 64;

pub(crate) const HISTORY_DURATION: TimeDelta = TimeDelta::from_millis(60_000);
/// Of each line: 20 a second.
pub(crate) const MAX_HISTORY_POINTS: usize = 1_200;
pub(crate) const MAX_REPLAY_POINTS: usize = 20_000;
/// Send buffer of the system for a reader, in bytes: with a small one a hanging reader misses messages instead of
/// getting old ones; the first message of a long session is about as large.
pub(crate) const SOCKET_BUFFER_BYTES: usize = 256 * 1024;
