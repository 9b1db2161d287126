//! The quickest message so far, renewed each hundred: one-way alignment as ArduPilot does it.
//!
//! # Model
//! ```text
//! z = received - remote
//! o = z               if z < o                     nothing arrives before it was sent
//! o = z - 500 ms      if received - (remote + o) > 500 ms      a lag that no link has
//! o = min of the last hundred z                    after each hundred messages
//! ```
//! Its offset is late by the smallest delay of the link.
//!
//! # Source
//! ArduPilot, libraries/AP_RTC/JitterCorrection.cpp.

use super::{ClockExchange, ClockMethod};

/// No message is taken to have been on its way for longer, s.
const MAX_LAG_S: f64 = 0.5;
/// Number of messages after which the offset is estimated again.
const RENEWAL_INTERVAL: u32 = 100;

/// One-way alignment by the smallest difference.
#[derive(Clone, Copy, Debug, Default)]
pub struct JitterCorrection {
    offset_s: Option<f64>,
    /// Smallest difference since the last renewal, and of how many.
    least_s: f64,
    count: u32,
}

impl ClockMethod for JitterCorrection {
    fn observe_exchange(&mut self, exchange: &ClockExchange) {
        let difference_s = exchange.received_s - exchange.remote_s;
        let offset_s = self.offset_s.map_or(difference_s, |offset_s| offset_s.min(difference_s));
        let mut offset_s = offset_s.max(difference_s - MAX_LAG_S);
        self.least_s = if self.count == 0 { difference_s } else { self.least_s.min(difference_s) };
        self.count += 1;
        if self.count == RENEWAL_INTERVAL {
            offset_s = self.least_s;
            self.count = 0;
        }
        self.offset_s = Some(offset_s);
    }

    fn offset_at(&self, _host_s: f64) -> Option<f64> {
        self.offset_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offset_after(delays_s: &[f64]) -> f64 {
        let mut method = JitterCorrection::default();
        for delay_s in delays_s {
            method.observe_exchange(&ClockExchange { sent_s: 0.0, remote_s: 10.0, received_s: 10.0 + delay_s });
        }
        method.offset_at(0.0).unwrap()
    }

    #[test]
    fn the_quickest_message_counts_until_it_is_too_long_ago() {
        assert!((offset_after(&[0.03, 0.02, 0.04]) - 0.02).abs() < 1e-12);
        let mut delays_s = vec![0.02];
        delays_s.extend([0.05; 99]);
        assert!((offset_after(&delays_s) - 0.02).abs() < 1e-12);
        delays_s.extend([0.05; 100]);
        assert!((offset_after(&delays_s) - 0.05).abs() < 1e-12);
    }

    #[test]
    fn no_lag_is_longer_than_half_a_second() {
        assert!((offset_after(&[0.02, 3.0]) - 2.5).abs() < 1e-12);
    }
}
