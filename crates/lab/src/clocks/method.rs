//! What every method of clock alignment is given and asked.

/// One answered time request, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockExchange {
    /// When the request left, host clock.
    pub sent_s: f64,
    /// What the answering clock showed, remote clock.
    pub remote_s: f64,
    /// When the answer arrived, host clock.
    pub received_s: f64,
}

/// A way to find how a remote clock runs against the host's.
pub trait ClockMethod {
    /// Learns from an answered request. A one-way method looks only at the stamp and its arrival.
    fn observe_exchange(&mut self, exchange: &ClockExchange);

    /// Host minus remote at a host instant, s; `None` while it has nothing to say.
    fn offset_at(&self, host_s: f64) -> Option<f64>;
}
