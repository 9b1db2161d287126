//! Who has a stream link: bytes of several peers would mix in one scanner, so one peer at a time is heard.

use std::collections::BTreeMap;

use posebridge_link::PeerId;
use posebridge_telemetry::{HostClock, LinkId, Span, Stamp};

/// A peer that has been silent for this long gives the link up: two missed heartbeats.
const SILENCE: Span = Span::from_millis(2_000);

/// The peer that each stream link listens to.
#[derive(Debug, Default)]
pub struct Speakers {
    by_link: BTreeMap<LinkId, (PeerId, Stamp<HostClock>)>,
}

impl Speakers {
    /// Whether bytes that a peer sent now are to be heard. The first peer has the link until it falls silent; a brick that calls again
    /// has a new number and is heard once its old connection is silent.
    pub fn hears(&mut self, link: LinkId, peer: PeerId, now: Stamp<HostClock>) -> bool {
        let speaker = self.by_link.entry(link).or_insert((peer, now));
        if speaker.0 != peer && now - speaker.1 >= SILENCE {
            tracing::warn!(
                link = link.0,
                "another peer takes this link over: the one before is silent"
            );
            *speaker = (peer, now);
        }
        if speaker.0 == peer {
            speaker.1 = now;
        }
        speaker.0 == peer
    }

    /// The link is down: whoever comes first has it next.
    pub fn forget(&mut self, link: LinkId) {
        self.by_link.remove(&link);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_peer_is_heard_only_when_the_first_is_silent() {
        let mut speakers = Speakers::default();
        let (link, brick, other) = (LinkId(0), PeerId(1), PeerId(2));
        let at = Stamp::from_millis;
        assert!(speakers.hears(link, brick, at(0)));
        assert!(!speakers.hears(link, other, at(100)), "the brick speaks");
        assert!(speakers.hears(link, brick, at(1_900)));
        assert!(
            !speakers.hears(link, other, at(2_100)),
            "it has just spoken"
        );
        assert!(speakers.hears(link, other, at(4_000)), "it is silent");
        assert!(!speakers.hears(link, brick, at(4_100)));
    }

    #[test]
    fn after_a_loss_the_first_to_come_is_heard_at_once() {
        let mut speakers = Speakers::default();
        assert!(speakers.hears(LinkId(0), PeerId(1), Stamp::from_millis(0)));
        speakers.forget(LinkId(0));
        assert!(speakers.hears(LinkId(0), PeerId(2), Stamp::from_millis(10)));
    }
}
