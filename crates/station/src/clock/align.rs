//! Alignment of one remote clock with the host's: stamps in, instants with their uncertainty out.

use posebridge_estimator::RestoreError;
use posebridge_estimator::saved::finite;
use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp, clock::Clock};
use serde::{Deserialize, Serialize};

use super::Endpoint;
use super::bounds::{ClockBounds, LinearOffset, SavedBounds};
use super::conversion::ClockConversion;
use super::unwrap::{UnwrapOutcome, Unwrapper};
use crate::host_times::ShiftHostTimes;

/// Assumed smallest delay of a link whose far end never replies, s: half of a Bluetooth link's usual round trip.
const ONE_WAY_DELAY_S: f64 = 0.010;
/// Number of replies before the two-way line replaces the one-way line.
const MIN_ANSWERS: u32 = 3;
/// Time after the first message without a reply after which the one-way line is used.
const ONE_WAY_AFTER: TimeDelta = TimeDelta::from_millis(1_500);
/// Messages between two exchanges tighten the bounds as well; the line is fitted again this often for them, remote s.
const REFIT_S: f64 = 0.5;

/// Largest step of a brick's counter: nxtOSEK and leJOS tick each millisecond, slow schedulers each 10 ms.
const MAX_STEP_S: f64 = 0.020;

/// The alignment of one remote clock `C`.
#[derive(Clone, Debug)]
pub struct ClockAligner<C: Clock> {
    unwrapper: Unwrapper,
    bounds: ClockBounds,
    /// First stamp and first arrival: instants are kept relative to them, so that `f64` seconds resolve nanoseconds.
    origin: Option<(Timestamp<C>, Timestamp<HostClock>)>,
    /// The last fitted line, towards which the conversion turns.
    linear_offset: Option<LinearOffset>,
    conversion: ClockConversion,
    /// Latest stamp so far, relative.
    latest_s: f64,
    answers: u32,
    round_trip: Option<TimeDelta>,
    /// Greatest common divisor of all stamps: the step of the remote counter.
    step_micros: u64,
    /// The alignment was contradicted and reset since the last call.
    is_contradicted: bool,
}

/// The result of a time request and its reply.
#[derive(Clone, Copy, Debug)]
pub struct ExchangeOutcome<C: Clock> {
    pub has_restarted: bool,
    /// It contradicts the alignment so much that this starts again.
    pub is_contradicted: bool,
    /// `None` while the clock is not aligned.
    pub alignment: Option<Alignment<C>>,
}

/// The alignment of a clock after a time exchange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment<C: Clock> {
    /// The remote instant for which it holds.
    pub remote: Timestamp<C>,
    /// The same instant on the host.
    pub host: Timestamp<HostClock>,
    /// Remote minus host at that instant.
    pub offset: TimeDelta,
    /// Rate of the remote clock against the host's, minus one.
    pub skew_ppm: f64,
    pub skew_uncertainty_ppm: f64,
    pub uncertainty: TimeDelta,
    pub round_trip: TimeDelta,
}

/// An instant on both clocks, relative to the origin.
#[derive(Clone, Copy, Debug)]
struct ClockPoint {
    remote_s: f64,
    host_s: f64,
}

/// An alignment as it is kept elsewhere.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct SavedAligner<C: Clock> {
    unwrapper: Unwrapper,
    bounds: SavedBounds,
    origin: Option<(Timestamp<C>, Timestamp<HostClock>)>,
    linear_offset: Option<LinearOffset>,
    conversion: ClockConversion,
    #[serde(deserialize_with = "finite")]
    latest_s: f64,
    answers: u32,
    round_trip: Option<TimeDelta>,
    step_micros: u64,
    is_contradicted: bool,
}

impl<C: Clock> ShiftHostTimes for SavedAligner<C> {
    /// All but these is relative to the origin.
    fn shift_host_times(&mut self, by: TimeDelta) {
        self.unwrapper.shift_host_times(by);
        if let Some((_, host)) = &mut self.origin {
            host.shift_host_times(by);
        }
    }
}

impl<C: Clock> Default for ClockAligner<C> {
    fn default() -> Self {
        Self {
            unwrapper: Unwrapper::default(),
            bounds: ClockBounds::default(),
            origin: None,
            linear_offset: None,
            conversion: ClockConversion::default(),
            latest_s: 0.0,
            answers: 0,
            round_trip: None,
            step_micros: 0,
            is_contradicted: false,
        }
    }
}

impl<C: Clock> ClockAligner<C> {
    /// Stamps of several endpoints are kept by the numbers that these have here. To a station where the numbers mean others, or nothing, an
    /// endpoint is a new one of a clock that it knows.
    pub fn save(&self) -> SavedAligner<C> {
        SavedAligner {
            unwrapper: self.unwrapper.clone(),
            bounds: self.bounds.save(),
            origin: self.origin,
            linear_offset: self.linear_offset,
            conversion: self.conversion.clone(),
            latest_s: self.latest_s,
            answers: self.answers,
            round_trip: self.round_trip,
            step_micros: self.step_micros,
            is_contradicted: self.is_contradicted,
        }
    }

    pub fn restored(saved: SavedAligner<C>) -> Result<Self, RestoreError> {
        saved.unwrapper.check()?;
        saved.conversion.check()?;
        Ok(Self {
            unwrapper: saved.unwrapper,
            bounds: ClockBounds::restored(saved.bounds)?,
            origin: saved.origin,
            linear_offset: saved.linear_offset,
            conversion: saved.conversion,
            latest_s: saved.latest_s,
            answers: saved.answers,
            round_trip: saved.round_trip,
            step_micros: saved.step_micros,
            is_contradicted: saved.is_contradicted,
        })
    }

    /// Records the arrival of a message with this stamp from `endpoint`.
    pub fn observe_arrival(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> UnwrapOutcome<C> {
        let unwrapped = self.unwrap_stamp(endpoint, stamp, arrival);
        if let UnwrapOutcome::Continued(remote) | UnwrapOutcome::Restarted(remote) = unwrapped {
            let meeting = self.bound_above(remote, arrival);
            let is_due = self.linear_offset.is_none_or(|line| meeting.remote_s - line.at_s >= REFIT_S);
            if is_due && !self.fit(meeting) {
                self.restart(remote, arrival);
            }
        }
        unwrapped
    }

    /// Records a duplicate of an earlier message, from `endpoint`: it bounds the clock as well.
    pub fn observe_copy(&mut self, endpoint: Endpoint, stamp: WireStamp, arrival: Timestamp<HostClock>) {
        if let Some(remote) = self.unwrapper.unwrap_copy(endpoint, stamp, arrival) {
            self.bound_above(remote, arrival);
        }
    }

    /// The instant of a stamp that may be long past, such as that of a fix that the robot relays: it neither bounds the
    /// clock nor indicates a restart. `None` before any other stamp of this clock.
    pub fn nearest_instant(&self, stamp: WireStamp) -> Option<Timestamp<C>> {
        self.unwrapper.nearest(stamp)
    }

    /// Records a request that was sent at `sent`, whose reply with the remote clock's `remote_nanos` came from `endpoint` at
    /// `received`. A reply from before its request only counts as a message that arrived.
    pub fn observe_exchange(
        &mut self,
        endpoint: Endpoint,
        sent: Timestamp<HostClock>,
        received: Timestamp<HostClock>,
        remote_nanos: i64,
    ) -> ExchangeOutcome<C> {
        let stamp = WireStamp::Micros64(u64::try_from(remote_nanos.div_euclid(1_000)).unwrap_or(0));
        let mut alignment = None;
        let unwrapped = if received < sent {
            self.observe_arrival(endpoint, stamp, received)
        } else {
            let unwrapped = self.unwrap_stamp(endpoint, stamp, received);
            if let UnwrapOutcome::Continued(remote) | UnwrapOutcome::Restarted(remote) = unwrapped {
                let meeting = self.bound_above(remote, received);
                self.add_answer(remote, sent, received);
                if self.answers >= MIN_ANSWERS && !self.fit(meeting) {
                    self.restart(remote, received);
                    self.add_answer(remote, sent, received);
                }
                alignment = self.alignment(remote, received - sent);
            }
            unwrapped
        };
        ExchangeOutcome {
            has_restarted: matches!(unwrapped, UnwrapOutcome::Restarted(_)),
            is_contradicted: self.take_contradiction(),
            alignment,
        }
    }

    /// The host's instant of an unwrapped stamp, with its uncertainty. Instants keep the order of their stamps,
    /// whatever was learned in between; see [`ClockConversion`].
    pub fn host_at(&self, remote: Timestamp<C>) -> Option<(Timestamp<HostClock>, TimeDelta)> {
        let (remote_zero, host_zero) = self.origin?;
        let since = remote - remote_zero;
        let offset_s = self.conversion.offset_at(since.as_secs_f64())?;
        Some((
            host_zero + since + TimeDelta::from_secs_f64(offset_s),
            self.uncertainty_at(since.as_secs_f64(), offset_s)?,
        ))
    }

    /// The remote instant of an instant on the host, with its uncertainty. The inverse of [`Self::host_at`]; a future
    /// instant is a prediction and may change.
    pub fn remote_at(&self, host: Timestamp<HostClock>) -> Option<(Timestamp<C>, TimeDelta)> {
        let (remote_zero, host_zero) = self.origin?;
        let since_s = (host - host_zero).as_secs_f64();
        let remote_s = self.conversion.remote_at(since_s)?;
        // As a difference, because it is small and keeps the nanoseconds.
        let offset_s = since_s - remote_s;
        let remote = remote_zero + (host - host_zero) - TimeDelta::from_secs_f64(offset_s);
        Some((remote, self.uncertainty_at(remote_s, offset_s)?))
    }

    /// Whether, since the last call, no line fitted any more and the bounds were discarded: the clock stepped, or its
    /// rate error is larger than [`MAX_SKEW`](super::MAX_SKEW).
    pub fn take_contradiction(&mut self) -> bool {
        std::mem::take(&mut self.is_contradicted)
    }

    pub fn round_trip(&self) -> Option<TimeDelta> {
        self.round_trip
    }

    /// The uncertainty of the latest stamp after conversion.
    pub fn uncertainty(&self) -> Option<TimeDelta> {
        let offset_s = self.conversion.offset_at(self.latest_s)?;
        self.uncertainty_at(self.latest_s, offset_s)
    }

    /// The same clock with another type: an observer that turns out to be the robot.
    pub fn cast_clock<D: Clock>(self) -> ClockAligner<D> {
        ClockAligner {
            unwrapper: self.unwrapper,
            bounds: self.bounds,
            origin: self.origin.map(|(remote, host)| (Timestamp::from_nanos(remote.as_nanos()), host)),
            linear_offset: self.linear_offset,
            conversion: self.conversion,
            latest_s: self.latest_s,
            answers: self.answers,
            round_trip: self.round_trip,
            step_micros: self.step_micros,
            is_contradicted: self.is_contradicted,
        }
    }

    fn unwrap_stamp(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> UnwrapOutcome<C> {
        let unwrapped = self.unwrapper.unwrap(endpoint, stamp, arrival);
        if matches!(unwrapped, UnwrapOutcome::Restarted(_)) {
            self.reset();
        }
        if let UnwrapOutcome::Continued(remote) | UnwrapOutcome::Restarted(remote) = unwrapped {
            let shown_micros = remote.as_micros().unsigned_abs();
            // Nearly always it is known already, and to find that out is one division.
            if self.step_micros == 0 || !shown_micros.is_multiple_of(self.step_micros) {
                self.step_micros = greatest_common_divisor(self.step_micros, shown_micros);
            }
        }
        unwrapped
    }

    /// A stamp is an upper bound: it was made before its arrival.
    fn bound_above(&mut self, remote: Timestamp<C>, arrival: Timestamp<HostClock>) -> ClockPoint {
        let meeting = self.clock_point(remote, arrival);
        self.latest_s = self.latest_s.max(meeting.remote_s);
        self.bounds.add_arrival(meeting.remote_s, meeting.host_s);
        self.bounds.discard_before(self.latest_s);
        if !self.bounds.is_two_way() {
            self.answers = 0;
        }
        meeting
    }

    fn add_answer(&mut self, remote: Timestamp<C>, sent: Timestamp<HostClock>, received: Timestamp<HostClock>) {
        let ClockPoint { remote_s, host_s } = self.clock_point(remote, sent);
        self.bounds.add_departure(host_s - self.step_s(), remote_s);
        self.answers = self.answers.saturating_add(1);
        self.round_trip = Some(received - sent);
    }

    /// Fits the line again and turns the conversion towards it. False if no line fits: the clock stepped.
    fn fit(&mut self, now: ClockPoint) -> bool {
        let is_two_way = self.answers >= MIN_ANSWERS;
        let line = if is_two_way {
            self.bounds.two_way_offset(self.latest_s)
        } else if now.host_s >= ONE_WAY_AFTER.as_secs_f64() {
            self.bounds.one_way_offset(self.latest_s, ONE_WAY_DELAY_S)
        } else {
            None
        };
        if let Some(line) = &line {
            // Nothing that has happened may be converted anew: neither a stamp that has arrived nor an instant before now.
            let present_s = self.conversion.remote_at(now.host_s);
            let from_s = present_s.map_or(self.latest_s, |present_s| present_s.max(self.latest_s));
            self.conversion.steer(line, from_s);
            self.linear_offset = Some(*line);
        }
        line.is_some() || !is_two_way
    }

    /// The clock stepped forward: discards everything but the last message.
    fn restart(&mut self, remote: Timestamp<C>, arrival: Timestamp<HostClock>) {
        self.reset();
        self.is_contradicted = true;
        self.bound_above(remote, arrival);
    }

    /// The bounds hold around the line; the conversion may still be turning towards it.
    fn uncertainty_at(&self, remote_s: f64, offset_s: f64) -> Option<TimeDelta> {
        let line = self.linear_offset?;
        let to_go_s = (offset_s - line.offset_at(remote_s)).abs();
        Some(TimeDelta::from_secs_f64(line.uncertainty_at(remote_s) + to_go_s))
    }

    fn alignment(&self, remote: Timestamp<C>, round_trip: TimeDelta) -> Option<Alignment<C>> {
        let (host, uncertainty) = self.host_at(remote)?;
        let line = self.linear_offset?;
        Some(Alignment {
            remote,
            host,
            offset: TimeDelta::from_nanos(remote.as_nanos().saturating_sub(host.as_nanos())),
            skew_ppm: (1.0 / (1.0 + line.slope) - 1.0) * 1e6,
            skew_uncertainty_ppm: line.slope_uncertainty * 1e6,
            uncertainty,
            round_trip,
        })
    }

    fn clock_point(&mut self, remote: Timestamp<C>, host: Timestamp<HostClock>) -> ClockPoint {
        let (remote_zero, host_zero) = *self.origin.get_or_insert((remote, host));
        ClockPoint { remote_s: (remote - remote_zero).as_secs_f64(), host_s: (host - host_zero).as_secs_f64() }
    }

    /// A counter's value may be as old as its step, by which the lower bound is relaxed.
    fn step_s(&self) -> f64 {
        (self.step_micros as f64 * 1e-6).clamp(1e-6, MAX_STEP_S)
    }

    fn reset(&mut self) {
        *self =
            Self { unwrapper: std::mem::take(&mut self.unwrapper), step_micros: self.step_micros, ..Self::default() };
    }
}

fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::BrickClock;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    #[test]
    fn a_millisecond_counter_contradicts_no_bound_on_a_fast_link() {
        let mut rng = Pcg64::seed_from_u64(5);
        let mut aligner = ClockAligner::<BrickClock>::default();
        for k in 0..600 {
            let sent_s = f64::from(k) * 0.1 + 0.001 * rng.random::<f64>();
            let shown_ms = ((1_234.5 + (sent_s + 20e-6) * 1.0001) * 1e3).floor();
            let outcome = aligner.observe_exchange(
                Endpoint::default(),
                Timestamp::from_secs_f64(sent_s),
                Timestamp::from_secs_f64(sent_s + 40e-6),
                shown_ms as i64 * 1_000_000,
            );
            assert!(k < 3 || outcome.alignment.is_some(), "exchange {k}");
        }
        assert_eq!(aligner.step_micros, 1_000);
    }

    #[test]
    fn without_answers_the_one_way_line_takes_over() {
        let mut aligner = ClockAligner::<BrickClock>::default();
        for k in 0..100_i64 {
            aligner.observe_arrival(
                Endpoint::default(),
                WireStamp::Millis32((5_000 + k * 50) as u32),
                Timestamp::from_millis(k * 50 + 10 + (k * 7) % 13),
            );
        }
        let (host, uncertainty) = aligner.host_at(Timestamp::from_millis(9_000)).unwrap();
        assert!((host.as_secs_f64() - 4.0).abs() < 2e-3, "{host:?}");
        let bound_ms = uncertainty.as_millis_f64();
        assert!((10.0..15.0).contains(&bound_ms), "{bound_ms}");
    }
}
