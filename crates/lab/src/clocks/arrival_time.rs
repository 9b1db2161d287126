//! No alignment at all: a message is of the instant at which it arrived.

use super::{ClockExchange, ClockMethod};

/// Takes the arrival for the instant of the stamp.
#[derive(Clone, Copy, Debug, Default)]
pub struct ArrivalTime {
    last_offset_s: Option<f64>,
}

impl ClockMethod for ArrivalTime {
    fn observe_exchange(&mut self, exchange: &ClockExchange) {
        self.last_offset_s = Some(exchange.received_s - exchange.remote_s);
    }

    fn offset_at(&self, _host_s: f64) -> Option<f64> {
        self.last_offset_s
    }
}
