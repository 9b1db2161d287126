//! The parameters of one participant, as ground stations list, read and set them.
//!
//! It keeps names and the values that stand. Which values make sense is the owner's business: a set comes out as a wish, and what
//! stands afterwards is told to all who listen, whether it was fulfilled or not. All values are 32-bit floats, for which bytewise and
//! C-cast encoding are the same. A name is understood in capitals or not: people type either, and some ground stations know no others.
//!
//! A list goes out one value at a time, so that a slow link is not flooded; who asks while one goes out has it go on until all values
//! were sent once more. What was never asked for on a link is not told there: a brick has no use for it.
//!
//! # Source
//! MAVLink guide, "Parameter Protocol"; common.xml, PARAM_REQUEST_READ, PARAM_REQUEST_LIST, PARAM_SET and PARAM_VALUE.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, ComponentId, Span, Stamp};

use super::SessionOutput;
use crate::message::Message;

/// Time between two values of a list: 37 bytes each, a sixth of a line of 115 200 baud.
const PACE: Span = Span::from_millis(20);

/// A name, at most sixteen bytes, and the value that stands.
#[derive(Clone, Debug, PartialEq)]
struct Parameter {
    name: String,
    value: f32,
}

/// A list that is going out.
#[derive(Clone, Copy, Debug)]
struct Listing<C: Clock> {
    next: usize,
    left: usize,
    due: Stamp<C>,
}

/// The later of an instant and one before which nothing may go out, if there is one.
fn not_before<C: Clock>(now: Stamp<C>, earliest: Option<Stamp<C>>) -> Stamp<C> {
    earliest.map_or(now, |earliest| earliest.max(now))
}

/// What is offered on one link.
#[derive(Debug)]
pub(super) struct Parameters<C: Clock> {
    offered: Vec<Parameter>,
    listing: Option<Listing<C>>,
    /// Before it no other value of a list goes out, not even of the next list.
    earliest: Option<Stamp<C>>,
    /// Somebody on this link has asked for some of them.
    is_asked: bool,
}

impl<C: Clock> Parameters<C> {
    pub(super) const fn none() -> Self {
        Self { offered: Vec::new(), listing: None, earliest: None, is_asked: false }
    }

    /// Offers these, in this order. The order must not change afterwards: ground stations ask by index.
    pub(super) fn offer(&mut self, named: impl Iterator<Item = (String, f32)>) {
        let named = named.map(|(name, value)| Parameter { name, value });
        // An index has sixteen bits, signed in a request.
        self.offered = named.take(i16::MAX as usize).collect();
    }

    /// Takes a request that arrived at `now` from `by`; what is to be done about it.
    pub(super) fn handle(
        &mut self,
        now: Stamp<C>,
        (own, by): (Address, Address),
        message: &Message,
    ) -> Option<SessionOutput<C>> {
        if self.offered.is_empty() {
            return None;
        }
        #[expect(
            clippy::wildcard_enum_match_arm,
            reason = "the session gives every message; most are about something else"
        )]
        match message {
            Message::ParamRequestList { target } if is_for(own, *target) => {
                self.list(now);
                None
            }
            Message::ParamRequestRead { target, name, index } if is_for(own, *target) => {
                self.is_asked = true;
                match self.position(name, *index) {
                    Some(index) => self.value(index).map(SessionOutput::Send),
                    None => unknown(own, (by, *target), name, *index),
                }
            }
            Message::ParamSet { target, name, value } if is_for(own, *target) => {
                self.is_asked = true;
                match self.position(name, -1) {
                    Some(index) => Some(SessionOutput::ParameterWish { by, index, value: *value }),
                    None => unknown(own, (by, *target), name, -1),
                }
            }
            Message::ParamSetUnsupported { target, name, kind } if is_for(own, *target) => {
                self.is_asked = true;
                match self.position(name, -1) {
                    Some(index) => Some(SessionOutput::ParameterUnsupported { by, index, kind: *kind }),
                    None => unknown(own, (by, *target), name, -1),
                }
            }
            _ => None,
        }
    }

    /// This value stands from now on; what to tell those who listen.
    pub(super) fn stand(&mut self, index: usize, value: f32) -> Option<Message> {
        self.offered.get_mut(index)?.value = value;
        self.is_asked.then(|| self.value(index))?
    }

    /// The next value of the list, if one is due.
    pub(super) fn due(&mut self, now: Stamp<C>) -> Option<Message> {
        let listing = self.listing.filter(|listing| listing.due <= now)?;
        let count = self.offered.len();
        let due = now + PACE;
        self.earliest = Some(due);
        self.listing = (listing.left > 1).then(|| Listing {
            next: (listing.next + 1) % count.max(1),
            left: listing.left - 1,
            due,
        });
        self.value(listing.next)
    }

    /// When [`Self::due`] has something.
    pub(super) fn deadline(&self) -> Option<Stamp<C>> {
        self.listing.map(|listing| listing.due)
    }

    /// The clock was set back.
    pub(super) fn set_back(&mut self, fall: Span) {
        self.earliest = self.earliest.map(|earliest| earliest - fall);
        if let Some(listing) = &mut self.listing {
            listing.due = listing.due - fall;
        }
    }

    fn list(&mut self, now: Stamp<C>) {
        self.is_asked = true;
        let due = not_before(now, self.earliest);
        let (next, due) = self.listing.map_or((0, due), |listing| (listing.next, listing.due));
        self.listing = Some(Listing { next, left: self.offered.len(), due });
    }

    fn position(&self, name: &str, index: i16) -> Option<usize> {
        // The guide: an index of -1 says that the name counts.
        if index == -1 {
            let known = |known: &Parameter| known.name.eq_ignore_ascii_case(name);
            return self.offered.iter().position(known);
        }
        let index = usize::try_from(index).ok()?;
        (index < self.offered.len()).then_some(index)
    }

    fn value(&self, index: usize) -> Option<Message> {
        let Parameter { name, value } = self.offered.get(index)?;
        Some(Message::ParamValue {
            name: name.clone(),
            value: *value,
            count: self.offered.len() as u16,
            index: index as u16,
        })
    }
}

/// Ours, or for all components of our system; "everybody" is not answered for, lest a whole class starts to send.
fn is_for(own: Address, target: Address) -> bool {
    target.system == own.system && (target.component == own.component || target.component == ComponentId(0))
}

/// Nobody answers for a parameter that he does not have; but who meant us alone should know why nothing comes.
fn unknown<C: Clock>(
    own: Address,
    (by, target): (Address, Address),
    name: &str,
    index: i16,
) -> Option<SessionOutput<C>> {
    let asked = if index == -1 { name.to_owned() } else { index.to_string() };
    (target == own).then_some(SessionOutput::ParameterUnknown { by, asked })
}
