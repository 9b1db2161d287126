//! The upload of a plan from a ground station, item by item.
//!
//! The vehicle asks for each item and repeats a request that is not answered. The plan of before stays until the last item is there and every
//! item can be driven. Source: MAVLink guide, "Mission Protocol" (sequence of an upload, timeouts and retries, out-of-sequence items).

use posebridge_protocol::dialect::plan_items::PlanStep;
use posebridge_protocol::message::MissionItem;
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Address, HostClock, TimeDelta, Timestamp};

/// The guide's recommended timeout, and its number of retries.
const RETRY_INTERVAL: TimeDelta = TimeDelta::from_millis(1_500);
const MAX_RETRIES: u8 = 5;

/// A ground station that transfers a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PlanClient {
    pub(crate) endpoint: Endpoint,
    pub(crate) address: Address,
}

/// An item with what a robot does for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlannedItem {
    /// As it was sent.
    pub(crate) item: MissionItem,
    pub(crate) step: PlanStep,
}

#[derive(Debug)]
pub(crate) struct PlanUpload {
    pub(crate) client: PlanClient,
    count: usize,
    items: Vec<PlannedItem>,
    retries: u8,
    /// When the request is repeated.
    due: Timestamp<HostClock>,
}

/// What follows from an item, or from the time.
#[derive(Debug, PartialEq)]
pub(crate) enum UploadProgress {
    /// Nothing: an item that was there before, or too early for a repetition.
    Unchanged,
    /// Ask for an item.
    Request {
        sequence: u16,
    },
    Complete(Vec<PlannedItem>),
    /// The client is silent.
    GivenUp,
}

impl PlanUpload {
    /// Asks for the first of `count` items, at least one.
    pub(crate) fn begin(now: Timestamp<HostClock>, client: PlanClient, count: u16) -> (Self, UploadProgress) {
        let count = usize::from(count);
        let upload = Self { client, count, items: Vec::new(), retries: 0, due: now + RETRY_INTERVAL };
        let first = upload.request();
        (upload, first)
    }

    /// The number of the item that is expected.
    pub(crate) fn expected(&self) -> u16 {
        // The count has 16 bits.
        self.items.len() as u16
    }

    /// Takes the expected item.
    pub(crate) fn push(&mut self, now: Timestamp<HostClock>, item: PlannedItem) -> UploadProgress {
        self.items.push(item);
        self.retries = 0;
        self.due = now + RETRY_INTERVAL;
        if self.items.len() == self.count {
            return UploadProgress::Complete(std::mem::take(&mut self.items));
        }
        self.request()
    }

    /// An item with another number than the expected one. One that is there already answers a repeated request, and another request for the next
    /// would double all that follow.
    pub(crate) fn handle_unexpected(&self, sequence: u16) -> UploadProgress {
        if sequence < self.expected() { UploadProgress::Unchanged } else { self.request() }
    }

    pub(crate) fn advance(&mut self, now: Timestamp<HostClock>) -> UploadProgress {
        if now < self.due {
            return UploadProgress::Unchanged;
        }
        if self.retries >= MAX_RETRIES {
            return UploadProgress::GivenUp;
        }
        self.retries += 1;
        self.due = now + RETRY_INTERVAL;
        self.request()
    }

    pub(crate) const fn deadline(&self) -> Timestamp<HostClock> {
        self.due
    }

    fn request(&self) -> UploadProgress {
        UploadProgress::Request { sequence: self.expected() }
    }
}
