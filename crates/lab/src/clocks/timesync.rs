//! The TIMESYNC filter that autopilots and their bridges ship: offset and its change per sample, smoothed with falling gains.
//!
//! # Model
//! ```text
//! z  = (sent + received - 2 remote) / 2              measured offset, host - remote
//! used only if  received - sent < gate               10 ms as shipped
//!    and, once converged,  |z - o| <= 100 ms         after more than 5 others in a row all begins anew
//! o' = a z + (1 - a) (o + d)                         offset
//! d' = b (o' - o) + (1 - b) d                        its change per sample
//! a, b = 0.05 -> 0.003                               p = 1 - exp((1 - 1 / (1 - n / 500)) / 2) of the way after n samples
//! ```
//! It answers only once 500 samples were used.
//!
//! # Sources
//! PX4, src/lib/timesync; MAVROS, plugins/sys_time.cpp (the same filter, whose second gate is 10 ms by default).

use super::{ClockExchange, ClockMethod};

const INITIAL_GAIN: f64 = 0.05;
const FINAL_GAIN: f64 = 0.003;
/// Samples until it counts as converged.
const CONVERGENCE_SAMPLES: u32 = 500;
/// Once converged, samples further off are left out, s.
const MAX_DEVIATION_S: f64 = 0.1;
/// More of them in a row than this start it anew.
const MAX_DEVIATIONS: u32 = 5;

/// The filter, with its gate on the round trip.
#[derive(Clone, Copy, Debug)]
pub struct TimeSyncFilter {
    gate_s: f64,
    offset_s: f64,
    change_s: f64,
    samples: u32,
    deviations: u32,
}

impl TimeSyncFilter {
    /// A filter that uses round trips shorter than `gate_s`; infinite: all.
    pub const fn new(gate_s: f64) -> Self {
        Self { gate_s, offset_s: 0.0, change_s: 0.0, samples: 0, deviations: 0 }
    }

    const fn has_converged(&self) -> bool {
        self.samples >= CONVERGENCE_SAMPLES
    }

    /// Gain of offset and of its change, which are the same numbers.
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
}
