//! What goes back to a camera, and not too often.

use posebridge_telemetry::{ChannelName, HostClock, Span, Stamp};
use serde_json::json;

use super::schema::Flaw;

/// One complaint a second for each sender: a camera that is wrong thirty times a second need not hear it as often.
const COMPLAINT_PERIOD: Span = Span::from_millis(1_000);

/// When a sender was last told what is wrong, and how much was not told since.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Complaints {
    last: Option<Stamp<HostClock>>,
    unsaid: u64,
}

impl Complaints {
    /// What a sender is told of its line number `line`; `None` if it has just been told of another one.
    pub(super) fn about(&mut self, now: Stamp<HostClock>, line: u64, flaw: &Flaw) -> Option<Vec<u8>> {
        if self.last.is_some_and(|last| now - last < COMPLAINT_PERIOD) {
            self.unsaid = self.unsaid.saturating_add(1);
            return None;
        }
        self.last = Some(now);
        let mut answer = json!({ "error": flaw.text, "line": line });
        if let Some(key) = flaw.key {
            answer["key"] = json!(key);
        }
        let unsaid = std::mem::take(&mut self.unsaid);
        if unsaid > 0 {
            answer["unsaid"] = json!(unsaid);
        }
        Some(ended(&answer))
    }
}

/// The question for a camera's time.
pub(super) fn time_request(request: i64) -> Vec<u8> {
    ended(&json!({ "time_request": request }))
}

/// The question for a fix.
pub(super) fn fix_request(camera: ChannelName, number: u64) -> Vec<u8> {
    ended(&json!({ "camera": camera.as_str(), "fix_request": number }))
}

fn ended(value: &serde_json::Value) -> Vec<u8> {
    let mut line = value.to_string().into_bytes();
    line.push(b'\n');
    line
}
