//! Who may speak for a robot on a link with `pin`: the ids of a robot or a camera belong to whom used them first.
//!
//! A pin is set by the first message with an observation, and held while its owner is heard at least every half minute. Then every frame
//! with those ids from somebody else is refused, whatever it says. Without `pin` [`crate::sender_identity`] and [`crate::camera_table`] go
//! by what senders do.

use std::collections::BTreeMap;
use std::net::IpAddr;

use posebridge_protocol::routing::{MAX_PEERS, ROUTE_LIFETIME};
use posebridge_telemetry::{Address, HostClock, PeerId, TimeDelta, Timestamp};

/// What an owner is known by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinPolicy {
    /// Its peer: a UDP port or a TCP connection.
    First,
    /// Its network address: it may come back from another port.
    Address,
    /// Its signature: nothing unsigned is used.
    Key,
}

/// Silence after which others may use the ids.
const RELEASE_TIMEOUT: TimeDelta = ROUTE_LIFETIME;
/// A refusal that lasts is told again after this time.
const REPORT_PERIOD: TimeDelta = TimeDelta::from_millis(30_000);

/// A message: the ids that its sender claims, and what it cannot choose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IdentityClaim {
    pub(crate) ids: Address,
    /// It speaks for a robot.
    pub(crate) has_observation: bool,
    pub(crate) peer: PeerId,
    /// `None` where the transport has no addresses.
    pub(crate) host: Option<IpAddr>,
    /// It has a signature, which was verified.
    pub(crate) is_signed: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PinVerdict {
    Admitted,
    /// `is_new` if it has not been told lately.
    Refused {
        owner: Option<IpAddr>,
        is_new: bool,
    },
}

#[derive(Debug)]
pub(crate) struct SenderPins {
    policy: PinPolicy,
    owners: BTreeMap<Address, Owner>,
}

#[derive(Clone, Copy, Debug)]
struct Owner {
    /// `None` after the link was lost: it numbers its peers anew.
    peer: Option<PeerId>,
    host: Option<IpAddr>,
    last_seen: Timestamp<HostClock>,
    reported: Option<Timestamp<HostClock>>,
}

impl SenderPins {
    pub(crate) const fn new(policy: PinPolicy) -> Self {
        Self { policy, owners: BTreeMap::new() }
    }

    /// Whether a second camera of a robot is refused: everybody can invent ids, and pins know only those that were used.
    pub(crate) fn keeps_first_camera(&self) -> bool {
        self.policy != PinPolicy::Key
    }

    /// The link was lost: an owner that is known by its peer alone is forgotten.
    pub(crate) fn handle_link_loss(&mut self) {
        match self.policy {
            PinPolicy::First => self.owners.clear(),
            PinPolicy::Address | PinPolicy::Key => self.owners.values_mut().for_each(|owner| owner.peer = None),
        }
    }

    pub(crate) fn check(&mut self, now: Timestamp<HostClock>, claim: IdentityClaim) -> PinVerdict {
        let IdentityClaim { ids, has_observation, peer, host, is_signed } = claim;
        let is_full = self.owners.len() >= MAX_PEERS;
        let Some(owner) = self.owners.get_mut(&ids) else {
            let may_own = self.policy != PinPolicy::Key || is_signed;
            if has_observation && may_own && !is_full {
                self.owners.insert(ids, Owner { peer: Some(peer), host, last_seen: now, reported: None });
            }
            let is_admitted = !has_observation || (may_own && !is_full);
            return if is_admitted { PinVerdict::Admitted } else { PinVerdict::Refused { owner: None, is_new: false } };
        };
        let is_owner = match self.policy {
            PinPolicy::First => owner.peer == Some(peer),
            PinPolicy::Address => owner.peer == Some(peer) || (owner.host.is_some() && owner.host == host),
            PinPolicy::Key => is_signed,
        };
        let is_released = self.policy != PinPolicy::Key && now - owner.last_seen > RELEASE_TIMEOUT;
        if is_owner || is_released {
            *owner = Owner { peer: Some(peer), host, last_seen: now, ..*owner };
            return PinVerdict::Admitted;
        }
        let is_new = owner.reported.is_none_or(|reported| now - reported >= REPORT_PERIOD);
        if is_new {
            owner.reported = Some(now);
        }
        PinVerdict::Refused { owner: owner.host, is_new }
    }
}
