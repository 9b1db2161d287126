//! Convex hulls of the pipeline's clock stage: of arrivals alone, and of both directions as the station uses them.

use posebridge_station::clock::Endpoint;
use posebridge_station::clock::align::ClockAligner;
use posebridge_station::clock::bounds::{ClockBounds, LinearOffset};
use posebridge_telemetry::{BrickClock, Timestamp};

use super::{ClockExchange, ClockMethod};

/// A stamp that is older than the last one by more than this is that of a restarted clock, s.
const RESTART_S: f64 = 1.0;

/// The highest line below all arrivals of the window, late by the link's smallest delay.
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
