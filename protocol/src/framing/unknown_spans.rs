//! Frames with an unknown id, until their surroundings decide about them.
//!
//! Their checksum cannot be verified, so they never stop the scan: the search for verified frames goes on inside them. A claim is
//! accepted when a verified frame (or another accepted claim, or the end of all bytes) begins exactly where it ends and no
//! verified frame has begun inside it.

/// More claims than this at once are not kept: enough for a second of unknown telemetry at 50 Hz between two heartbeats,
/// and a bound on the memory (64 frames of at most 280 bytes).
const MAX_SPANS: usize = 64;

/// A claim: bytes `start..end` of the framer's buffer may be an unknown frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct UnknownSpan {
    pub(super) start: usize,
    pub(super) end: usize,
}

/// The undecided claims, in the order of their starts.
#[derive(Clone, Debug, Default)]
pub(super) struct UnknownSpans(Vec<UnknownSpan>);

impl UnknownSpans {
    pub(super) fn push(&mut self, claim: UnknownSpan) {
        if self.0.len() == MAX_SPANS {
            self.0.remove(0);
        }
        self.0.push(claim);
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn first_start(&self) -> Option<usize> {
        self.0.first().map(|claim| claim.start)
    }

    /// The unbroken chain of claims that ends exactly at `end`, first claim first; empty if there is none.
    pub(super) fn chain_to(&self, end: usize) -> Vec<UnknownSpan> {
        let mut chain = Vec::new();
        let mut end = end;
        // Of several claims with one end the longest is taken: a shorter one lies inside its payload.
        while let Some(claim) = self.0.iter().find(|claim| claim.end == end) {
            chain.push(*claim);
            end = claim.start;
        }
        chain.reverse();
        chain
    }

    /// Drops every claim that nothing can confirm any more, given that the scan stands at `cursor`.
    pub(super) fn prune(&mut self, cursor: usize) {
        let mut alive: Vec<UnknownSpan> = Vec::with_capacity(self.0.len());
        for &claim in self.0.iter().rev() {
            let open = claim.end >= cursor;
            if open || alive.iter().any(|later| later.start == claim.end) {
                alive.push(claim);
            }
        }
        alive.reverse();
        self.0 = alive;
    }

    /// Renumbers the claims after the first `gone` bytes of the buffer were dropped; no claim begins before them.
    pub(super) fn shift(&mut self, gone: usize) {
        for claim in &mut self.0 {
            claim.start -= gone;
            claim.end -= gone;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claims(list: &[(usize, usize)]) -> UnknownSpans {
        let mut claims = UnknownSpans::default();
        for &(start, end) in list {
            claims.push(UnknownSpan { start, end });
        }
        claims
    }

    #[test]
    fn a_chain_is_followed_back_to_its_first_claim() {
        let claims = claims(&[(3, 20), (7, 11), (20, 40), (25, 40)]);
        let chain = claims.chain_to(40);
        assert_eq!(chain, [UnknownSpan { start: 3, end: 20 }, UnknownSpan { start: 20, end: 40 }]);
        assert!(claims.chain_to(41).is_empty());
    }

    #[test]
    fn a_claim_lives_while_its_end_lies_ahead_or_another_claim_begins_there() {
        let mut kept = claims(&[(0, 12), (5, 9), (12, 30)]);
        kept.prune(14);
        assert_eq!(kept.first_start(), Some(0));
        kept.prune(31);
        assert!(kept.is_empty());
    }

    #[test]
    fn the_oldest_claim_gives_way_when_there_are_too_many() {
        let mut many = UnknownSpans::default();
        for start in 0..=MAX_SPANS {
            many.push(UnknownSpan { start, end: start + 12 });
        }
        assert_eq!(many.first_start(), Some(1));
    }
}
