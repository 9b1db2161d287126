//! Link health, and the alignment of the robot's clock.

use posebridge_telemetry::{Event, HostClock, LinkHealth, LinkId, LinkState, TimeDelta, Timestamp};

use super::retained_series::BoundedMap;
use super::view::{View, ViewConfig, ViewInput};
use crate::model::{ClockRow, Frame, LinkRow, Number};

/// A configuration has a handful.
const MAX_LINKS: usize = 256;
/// The brick answers time requests.
const TWO_WAY: &str = "two-way";
/// One-way messages only.
const ONE_WAY: &str = "one-way";

pub(super) struct Links {
    config: ViewConfig,
    by_id: BoundedMap<LinkId, LinkActivity>,
    has_changed: bool,
}

#[derive(Clone, Copy)]
struct LinkActivity {
    state: LinkState,
    health: LinkHealth,
    last_seen: Option<Timestamp<HostClock>>,
    bytes_in_per_s: f64,
    frames_in_per_s: f64,
}

impl LinkActivity {
    fn update(&mut self, now: Timestamp<HostClock>, health: LinkHealth) {
        if let Some(last) = self.last_seen {
            let passed_s = (now - last).as_secs_f64();
            let rate = |after: u64, before: u64| after.saturating_sub(before) as f64 / passed_s;
            self.bytes_in_per_s = rate(health.bytes_in, self.health.bytes_in);
            self.frames_in_per_s = rate(health.frames_in, self.health.frames_in);
        }
        self.last_seen = Some(now);
        self.health = health;
    }

    fn row(&self, id: LinkId, name: String) -> LinkRow {
        let health = &self.health;
        let millis = |duration: Option<TimeDelta>| Number::from(duration.map_or(f64::NAN, TimeDelta::as_millis_f64));
        LinkRow {
            id: id.0,
            name,
            state: match self.state {
                LinkState::Up => "up".to_owned(),
                LinkState::Down => "down".to_owned(),
            },
            bytes_in_per_s: self.bytes_in_per_s.into(),
            frames_in_per_s: self.frames_in_per_s.into(),
            lost: health.frames_lost,
            kernel_drops: health.port.kernel_drops,
            flood_drops: health.port.flood_drops,
            excess_requests: health.excess_requests,
            checksum_errors: health.checksum_errors,
            garbage_bytes: health.garbage_bytes,
            stalls: health.timeouts,
            queued_frames: health.port.queued_frames,
            drops_out: health.drops_out,
            round_trip_ms: millis(health.round_trip),
            clock_uncertainty_ms: millis(health.clock_uncertainty),
        }
    }
}

impl Links {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        Self { config: setting.clone(), by_id: BoundedMap::new(MAX_LINKS), has_changed: false }
    }

    fn link(&mut self, id: LinkId) -> Option<&mut LinkActivity> {
        self.by_id.get_or_insert(id, || LinkActivity {
            state: LinkState::Down,
            health: LinkHealth::default(),
            last_seen: None,
            bytes_in_per_s: 0.0,
            frames_in_per_s: 0.0,
        })
    }
}

impl View for Links {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(Event::Link { link, state }) => {
                if let Some(link) = self.link(*link) {
                    link.state = *state;
                    self.has_changed = true;
                }
            }
            ViewInput::Event(Event::Health { link, health, .. }) => {
                if let Some(link) = self.link(*link) {
                    link.update(now, *health);
                }
            }
            ViewInput::Event(_) | ViewInput::Truth(_) | ViewInput::Status(_) => {}
        }
    }

    fn take_change(&mut self) -> bool {
        std::mem::take(&mut self.has_changed)
    }

    fn add_history(&self, history: &mut Frame) {
        let rows = self.by_id.entries.iter().map(|(id, link)| link.row(*id, self.config.link_name(*id)));
        history.links = Some(rows.collect());
    }
}

#[derive(Default)]
pub(super) struct Clock {
    row: Option<ClockRow>,
}

impl View for Clock {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        let ViewInput::Event(Event::BrickClockAligned { offset, skew_ppm, uncertainty, round_trip, .. }) = input else {
            return;
        };
        // Between two replies the alignment is also refined by one-way messages.
        let has_answered = round_trip.is_some() || self.row.as_ref().is_some_and(|row| row.method == TWO_WAY);
        let method = if has_answered { TWO_WAY } else { ONE_WAY };
        self.row = Some(ClockRow {
            offset_s: offset.as_secs_f64(),
            skew_ppm: (*skew_ppm).into(),
            uncertainty_ms: uncertainty.as_millis_f64().into(),
            method: method.to_owned(),
        });
    }

    fn add_history(&self, history: &mut Frame) {
        history.clock.clone_from(&self.row);
    }
}
