//! Replies to a camera, rate-limited.

use posebridge_telemetry::{ChannelName, HostClock, TimeDelta, Timestamp};
use serde_json::json;

use super::schema::FieldError;

/// One complaint a second for each sender: a camera that is wrong thirty times a second does not need as many replies.
const ERROR_REPLY_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// When a sender was last sent an error, and how many were held back since.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ErrorReplies {
    last: Option<Timestamp<HostClock>>,
    suppressed: u64,
}

impl ErrorReplies {
    /// The error reply for line number `line` of a sender; `None` if another one has just been sent.
    pub(super) fn reply_to(&mut self, now: Timestamp<HostClock>, line: u64, flaw: &FieldError) -> Option<Vec<u8>> {
        if self.last.is_some_and(|last| now - last < ERROR_REPLY_PERIOD) {
            self.suppressed = self.suppressed.saturating_add(1);
            return None;
        }
        self.last = Some(now);
        let mut answer = json!({ "error": flaw.text, "line": line });
        if let Some(key) = flaw.key {
            answer["key"] = json!(key);
        }
        let unsaid = std::mem::take(&mut self.suppressed);
        if unsaid > 0 {
            answer["unsaid"] = json!(unsaid);
        }
        Some(encode_line(&answer))
    }
}

/// The question for a camera's time.
pub(super) fn time_request(request: i64) -> Vec<u8> {
    encode_line(&json!({ "time_request": request }))
}

/// The question for a fix.
pub(super) fn fix_request(camera: ChannelName, number: u64) -> Vec<u8> {
    encode_line(&json!({ "camera": camera.as_str(), "fix_request": number }))
}

fn encode_line(value: &serde_json::Value) -> Vec<u8> {
    let mut line = value.to_string().into_bytes();
    line.push(b'\n');
    line
}
