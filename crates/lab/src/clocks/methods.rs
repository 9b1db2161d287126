//! The interface of clock alignment methods, and the methods.

use posebridge_station::clock::Endpoint;
use posebridge_station::clock::align::ClockAligner;
use posebridge_station::clock::bounds::{ClockBounds, LinearOffset};
use posebridge_telemetry::{BrickClock, Timestamp};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockExchange {
    /// Departure of the request, host clock.
    pub sent_s: f64,
    /// Timestamp of the reply, remote clock.
    pub remote_s: f64,
    /// Arrival of the reply, host clock.
    pub received_s: f64,
}

pub trait ClockMethod {
    /// A one-way method uses only the timestamp and its arrival.
    fn observe_exchange(&mut self, exchange: &ClockExchange);

    /// Host minus remote time at a host time, s; `None` without an estimate.
    fn offset_at(&self, host_s: f64) -> Option<f64>;
}

/// Uses the arrival as the time of the timestamp.
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

// The TIMESYNC filter that autopilots and their bridges ship: offset and its change per sample, smoothed with falling gains.
//
// # Model
// ```text
// z  = (sent + received - 2 remote) / 2              measured offset, host - remote
// used only if  received - sent < gate               10 ms as shipped
//    and, once converged,  |z - o| <= 100 ms         after more than 5 others in a row all begins anew
// o' = a z + (1 - a) (o + d)                         offset
// d' = b (o' - o) + (1 - b) d                        its change per sample
// a, b = 0.05 -> 0.003                               p = 1 - exp((1 - 1 / (1 - n / 500)) / 2) of the way after n samples
// ```
// It answers only once 500 samples were used.
//
// # Sources
// PX4, src/lib/timesync; MAVROS, plugins/sys_time.cpp (the same filter, whose second gate is 10 ms by default).

const INITIAL_GAIN: f64 = 0.05;
const FINAL_GAIN: f64 = 0.003;
const CONVERGENCE_SAMPLES: u32 = 500;
const MAX_DEVIATION_S: f64 = 0.1;
/// More consecutive deviations restart the filter.
const MAX_DEVIATIONS: u32 = 5;

#[derive(Clone, Copy, Debug)]
pub struct TimeSyncFilter {
    gate_s: f64,
    offset_s: f64,
    change_s: f64,
    samples: u32,
    deviations: u32,
}

impl TimeSyncFilter {
    /// Uses round trips shorter than `gate_s`; infinity uses all.
    pub const fn new(gate_s: f64) -> Self {
        Self { gate_s, offset_s: 0.0, change_s: 0.0, samples: 0, deviations: 0 }
    }

    const fn has_converged(&self) -> bool {
        self.samples >= CONVERGENCE_SAMPLES
    }

    /// Gain of the offset and of its rate; both are equal.
    fn gain(&self) -> f64 {
        if self.has_converged() {
            return FINAL_GAIN;
        }
        let progress = f64::from(self.samples) / f64::from(CONVERGENCE_SAMPLES);
        let share = 1.0 - (0.5 * (1.0 - 1.0 / (1.0 - progress))).exp();
        share * FINAL_GAIN + (1.0 - share) * INITIAL_GAIN
    }

    fn add(&mut self, measured_s: f64) {
        if self.samples == 0 {
            self.offset_s = measured_s;
        } else {
            let (gain, before_s) = (self.gain(), self.offset_s);
            self.offset_s = gain * measured_s + (1.0 - gain) * (before_s + self.change_s);
            self.change_s = gain * (self.offset_s - before_s) + (1.0 - gain) * self.change_s;
        }
        self.samples = self.samples.saturating_add(1);
    }
}

impl ClockMethod for TimeSyncFilter {
    fn observe_exchange(&mut self, exchange: &ClockExchange) {
        if exchange.received_s - exchange.sent_s >= self.gate_s {
            return;
        }
        let measured_s = 0.5 * (exchange.sent_s + exchange.received_s) - exchange.remote_s;
        if self.has_converged() && (measured_s - self.offset_s).abs() > MAX_DEVIATION_S {
            self.deviations += 1;
            if self.deviations > MAX_DEVIATIONS {
                *self = Self::new(self.gate_s);
            }
            return;
        }
        self.deviations = 0;
        self.add(measured_s);
    }

    fn offset_at(&self, _host_s: f64) -> Option<f64> {
        self.has_converged().then_some(self.offset_s)
    }
}

// The quickest message so far, renewed each hundred: one-way alignment as ArduPilot does it.
//
// # Model
// ```text
// z = received - remote
// o = z               if z < o                     nothing arrives before it was sent
// o = z - 500 ms      if received - (remote + o) > 500 ms      a lag that no link has
// o = min of the last hundred z                    after each hundred messages
// ```
// Its offset is late by the smallest delay of the link.
//
// # Source
// ArduPilot, libraries/AP_RTC/JitterCorrection.cpp.

/// Upper bound of the assumed one-way delay.
const MAX_LAG_S: f64 = 0.5;
/// Messages between two estimates of the offset.
const RENEWAL_INTERVAL: u32 = 100;

#[derive(Clone, Copy, Debug, Default)]
pub struct JitterCorrection {
    offset_s: Option<f64>,
    /// Smallest difference since the last renewal, and the number of messages.
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

/// A larger decrease of the timestamp means a restarted clock.
const RESTART_S: f64 = 1.0;

/// The highest line below all arrivals of the window; late by the link's smallest delay.
///
/// Source: Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements" (INFOCOM 2002).
#[derive(Clone, Debug, Default)]
pub struct OneWayHull {
    bounds: ClockBounds,
    latest_s: Option<f64>,
    line: Option<LinearOffset>,
}

impl ClockMethod for OneWayHull {
    fn observe_exchange(&mut self, exchange: &ClockExchange) {
        let remote_s = exchange.remote_s;
        if self.latest_s.is_some_and(|youngest_s| remote_s < youngest_s - RESTART_S) {
            *self = Self::default();
        }
        self.latest_s = Some(remote_s);
        self.bounds.add_arrival(remote_s, exchange.received_s);
        self.bounds.discard_before(remote_s);
        self.line = self.bounds.one_way_offset(remote_s, 0.0);
    }

    fn offset_at(&self, host_s: f64) -> Option<f64> {
        let line = self.line?;
        // host = remote + offset + slope (remote - at), solved for host - remote.
        Some((line.offset_s + line.slope * (host_s - line.at_s)) / (1.0 + line.slope))
    }
}

/// The station's own alignment; see [`ClockAligner`].
#[derive(Clone, Debug, Default)]
pub struct TwoWayHulls {
    aligner: ClockAligner<BrickClock>,
}

impl ClockMethod for TwoWayHulls {
    fn observe_exchange(&mut self, exchange: &ClockExchange) {
        let remote_nanos = (exchange.remote_s * 1e9).round() as i64;
        self.aligner.observe_exchange(
            Endpoint::default(),
            Timestamp::from_secs_f64(exchange.sent_s),
            Timestamp::from_secs_f64(exchange.received_s),
            remote_nanos,
        );
    }

    fn offset_at(&self, host_s: f64) -> Option<f64> {
        let (remote, _) = self.aligner.remote_at(Timestamp::from_secs_f64(host_s))?;
        Some(host_s - remote.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An exchange with a symmetric path and a clock that is `ahead_s` ahead.
    fn exchange(k: u32, round_trip_s: f64, ahead_s: f64) -> ClockExchange {
        let sent_s = f64::from(k) * 0.1;
        ClockExchange { sent_s, remote_s: sent_s + 0.5 * round_trip_s + ahead_s, received_s: sent_s + round_trip_s }
    }

    #[test]
    fn its_gains_fall_along_the_sigmoid() {
        let gain_after = |samples| TimeSyncFilter { samples, ..TimeSyncFilter::new(1.0) }.gain();
        assert_eq!(gain_after(0), 0.05);
        // Half-way: exp(-1/2) of the initial gain is left.
        let expected = 0.003 + 0.047 * (-0.5_f64).exp();
        assert!((gain_after(250) - expected).abs() < 1e-15);
        assert_eq!(gain_after(500), 0.003);
    }

    #[test]
    fn it_answers_after_500_samples_within_its_gate() {
        let mut filter = TimeSyncFilter::new(0.010);
        for k in 0..500 {
            assert_eq!(filter.offset_at(0.0), None, "sample {k}");
            filter.observe_exchange(&exchange(k, 0.011, 3.0));
            filter.observe_exchange(&exchange(k, 0.009, 3.0));
        }
        assert!((filter.offset_at(0.0).unwrap() + 3.0).abs() < 1e-12);
    }

    #[test]
    fn six_deviations_in_a_row_start_it_anew_and_five_do_not() {
        let mut filter = TimeSyncFilter::new(0.010);
        (0..500).for_each(|k| filter.observe_exchange(&exchange(k, 0.005, 3.0)));
        (0..5).for_each(|k| filter.observe_exchange(&exchange(k, 0.005, 4.0)));
        filter.observe_exchange(&exchange(0, 0.005, 3.0));
        (0..5).for_each(|k| filter.observe_exchange(&exchange(k, 0.005, 4.0)));
        assert!(filter.offset_at(0.0).is_some());
        filter.observe_exchange(&exchange(0, 0.005, 4.0));
        assert_eq!(filter.offset_at(0.0), None);
    }

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
