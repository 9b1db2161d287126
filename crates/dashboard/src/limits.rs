//! What the server lets anybody have. Beyond that it refuses and counts.

use std::time::Duration;

use posebridge_telemetry::Span;

/// Messages leave so often: 50 Hz, which is what a brick tells and an eye sees.
pub(crate) const TICK: Duration = Duration::from_millis(20);
/// What changes slowly is told so often.
pub(crate) const SECOND: Span = Span::from_millis(1_000);

/// Connections at a time, readers of the stream among them; a browser opens six. 1 024 file descriptors are a usual limit, and links and
/// recordings need some.
pub(crate) const MOST_CONNECTIONS: usize = 192;
/// Readers of the stream at a time: a class with a browser each.
pub(crate) const MOST_CLIENTS: usize = 64;
/// Whoever needs longer for the head of a request is let go; loopback takes a millisecond, a bad WLAN a second.
pub(crate) const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
/// Whoever needs longer for the body of a request is let go.
pub(crate) const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// A replay takes longer: a quarter of an hour of a usual brick in a debug build about half a minute.
pub(crate) const REPLAY_TIMEOUT: Duration = Duration::from_secs(300);
/// A reader that takes nothing for so long is let go: nobody looks at it.
pub(crate) const SEND_TIMEOUT: Duration = Duration::from_secs(10);
/// A reader is asked so often whether it is there.
pub(crate) const PING_PERIOD: Duration = Duration::from_secs(10);
/// The whole head of a request, in bytes; browsers send one.
pub(crate) const HEAD_BYTES: usize = 16 * 1024;
/// The body of a request or a message on the stream, in bytes; the longest command has two hundred.
pub(crate) const MESSAGE_BYTES: usize = 64 * 1024;
/// What may wait for a reader in its socket's buffer before it counts as slow, in bytes: some messages with the first one.
pub(crate) const WRITE_BUFFER_BYTES: usize = 4 * 1024 * 1024;
/// Messages that a reader may be behind before it misses some: a bit more than a second.
pub(crate) const WAITING_FRAMES: usize = 64;
/// Commands that the engine takes in a second from all pages and programs together: a key that is held sends five, and each is an input
/// that fusion waits for and the recording keeps.
pub(crate) const COMMANDS_PER_S: i64 = 50;
/// Commands that may come at once after a pause: a second's worth.
pub(crate) const COMMANDS_AT_ONCE: i64 = COMMANDS_PER_S;
/// Commands that wait for the shard, which takes them within a millisecond.
pub(crate) const WAITING_COMMANDS: usize = 64;
/// Questions that wait for the task that knows the state.
pub(crate) const WAITING_QUESTIONS: usize = 64;

/// The history of the first message.
pub(crate) const HISTORY: Span = Span::from_millis(60_000);
/// Points of each line in it: 20 a second.
pub(crate) const HISTORY_POINTS: usize = 1_200;
/// Points of each line of a recording that is looked at.
pub(crate) const REPLAY_POINTS: usize = 20_000;
/// What waits for a reader in the system's send buffer, in bytes: the less, the sooner one that hangs misses messages instead of
/// getting old ones; the first message of a long session is about as large.
pub(crate) const SOCKET_BUFFER_BYTES: usize = 256 * 1024;
