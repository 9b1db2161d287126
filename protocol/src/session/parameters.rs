//! The parameters of one participant, as ground stations list, read and set them (MAVLink guide, "Parameter Protocol").
//!
//! The owner validates values: a set is passed on as a request, and the resulting value is sent to all listeners. All values
//! are 32-bit floats, for which bytewise and C-cast encoding are the same. Names are case-insensitive: some ground stations
//! know only capitals. A list is sent one value at a time, so that a slow link is not flooded; a request during a list
//! extends it until all values were sent once more.
//!
//! Who asks for `_HASH_CHECK` gets a checksum over names and values, by which a ground station knows that the values that it keeps are
//! still right; setting it ends the list, because the rest is known. It is PX4's: over each name and the four bytes of its value, by
//! rising name. PX4 sends it unasked before a list, too. Here it is not: a ground station uses it only of PX4, and would show it
//! among the parameters of any other vehicle.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, ComponentId, TimeDelta, Timestamp};

use super::file_server::crc32;
use super::output::SessionOutput;
use crate::dialect::services::PARAM_HASH_NAME;
use crate::message::Message;

/// Time between two values of a list: 37 bytes each, a sixth of a line of 115 200 baud for each participant that is listed.
const LIST_INTERVAL: TimeDelta = TimeDelta::from_millis(20);

#[derive(Clone, Debug, PartialEq)]
struct OfferedParameter {
    name: String,
    value: f32,
}

#[derive(Clone, Copy, Debug)]
struct ParameterListing<C: Clock> {
    next: usize,
    remaining: usize,
    due: Timestamp<C>,
}

#[derive(Debug)]
pub(super) struct ParameterServer<C: Clock> {
    offered: Vec<OfferedParameter>,
    listing: Option<ParameterListing<C>>,
    /// No value of any list is sent before this.
    next_allowed: Option<Timestamp<C>>,
    was_requested: bool,
}

impl<C: Clock> ParameterServer<C> {
    pub(super) const fn none() -> Self {
        Self { offered: Vec::new(), listing: None, next_allowed: None, was_requested: false }
    }

    /// Offers these parameters. Their order must not change afterwards: ground stations request by index.
    pub(super) fn offer(&mut self, named: impl Iterator<Item = (String, f32)>) {
        let named = named.map(|(name, value)| OfferedParameter { name, value });
        // An index has sixteen bits, signed in a request.
        self.offered = named.take(i16::MAX as usize).collect();
    }

    pub(super) fn offered(&self) -> impl Iterator<Item = (String, f32)> {
        self.offered.iter().map(|offered| (offered.name.clone(), offered.value))
    }

    /// Handles a request that arrived at `now` from `by`; returns the resulting outputs.
    #[expect(clippy::wildcard_enum_match_arm, reason = "most messages are about something else")]
    pub(super) fn handle(
        &mut self,
        now: Timestamp<C>,
        own: Address,
        by: Address,
        message: &Message,
    ) -> Option<SessionOutput<C>> {
        let (target, requested) = match message {
            Message::ParamRequestList { target } => (*target, None),
            Message::ParamRequestRead { target, name, index } => (*target, Some((name, *index))),
            Message::ParamSet { target, name, .. } | Message::ParamSetUnsupported { target, name, .. } => {
                (*target, Some((name, -1)))
            }
            _ => return None,
        };
        if self.offered.is_empty() || !is_for(own, target) {
            return None;
        }
        self.was_requested = true;
        let Some((name, index)) = requested else {
            self.list(now);
            return None;
        };
        if index == -1 && name == PARAM_HASH_NAME {
            if matches!(message, Message::ParamRequestRead { .. }) {
                return Some(SessionOutput::Send(self.hash()));
            }
            // No answer: it would be taken for another checksum to compare.
            self.listing = None;
            return None;
        }
        let Some(known) = self.find(name, index) else {
            // There is no reply for a parameter that a component does not have; but a request to us alone is reported.
            let requested = if index == -1 { name.clone() } else { index.to_string() };
            return (target == own).then_some(SessionOutput::ParameterUnknown { by, requested });
        };
        match message {
            Message::ParamSet { value, .. } => {
                Some(SessionOutput::ParameterSetRequested { by, index: known, value: *value })
            }
            Message::ParamSetUnsupported { kind, .. } => {
                Some(SessionOutput::ParameterUnsupported { by, index: known, kind: *kind })
            }
            _ => self.value(known).map(SessionOutput::Send),
        }
    }

    pub(super) fn set_value(&mut self, index: usize, value: f32) -> Option<Message> {
        self.offered.get_mut(index)?.value = value;
        self.was_requested.then(|| self.value(index))?
    }

    pub(super) fn stop_listing(&mut self) {
        self.listing = None;
    }

    pub(super) fn due(&mut self, now: Timestamp<C>) -> Option<Message> {
        let listing = self.listing.filter(|listing| listing.due <= now)?;
        let count = self.offered.len();
        let due = now + LIST_INTERVAL;
        self.next_allowed = Some(due);
        self.listing = (listing.remaining > 1).then(|| ParameterListing {
            next: (listing.next + 1) % count.max(1),
            remaining: listing.remaining - 1,
            due,
        });
        self.value(listing.next)
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<C>> {
        self.listing.map(|listing| listing.due)
    }

    pub(super) fn shift_clock(&mut self, fall: TimeDelta) {
        self.next_allowed = self.next_allowed.map(|earliest| earliest - fall);
        if let Some(listing) = &mut self.listing {
            listing.due = listing.due - fall;
        }
    }

    fn list(&mut self, now: Timestamp<C>) {
        let due = self.next_allowed.map_or(now, |earliest| earliest.max(now));
        let (next, due) = self.listing.map_or((0, due), |listing| (listing.next, listing.due));
        self.listing = Some(ParameterListing { next, remaining: self.offered.len(), due });
    }

    fn find(&self, name: &str, index: i16) -> Option<usize> {
        // The guide: with an index of -1 the name counts.
        if index == -1 {
            let known = |known: &OfferedParameter| known.name.eq_ignore_ascii_case(name);
            return self.offered.iter().position(known);
        }
        let index = usize::try_from(index).ok()?;
        (index < self.offered.len()).then_some(index)
    }

    fn hash(&self) -> Message {
        let mut by_name: Vec<&OfferedParameter> = self.offered.iter().collect();
        by_name.sort_unstable_by(|one, other| one.name.cmp(&other.name));
        let hash = by_name.iter().fold(0, |crc, offered| {
            let crc = crc32(crc, offered.name.as_bytes());
            crc32(crc, &offered.value.to_le_bytes())
        });
        Message::ParamHash { hash, count: self.offered.len() as u16 }
    }

    pub(super) fn value(&self, index: usize) -> Option<Message> {
        let OfferedParameter { name, value } = self.offered.get(index)?;
        Some(Message::ParamValue {
            name: name.clone(),
            value: *value,
            count: self.offered.len() as u16,
            index: index as u16,
        })
    }
}

/// Ours, or for all components of our system; requests to all systems get no reply, or a whole class would start to
/// send.
fn is_for(own: Address, target: Address) -> bool {
    target.system == own.system && (target.component == own.component || target.component == ComponentId(0))
}
