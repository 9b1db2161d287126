//! Link health.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, HostClock, LinkHealth, LinkId, LinkState, Span, Stamp};

use super::{Pace, Setting, Told, View};
use crate::model::{Frame, LinkRow, Number};

/// So many links are shown; a configuration has a handful.
const MOST_LINKS: usize = 256;

/// All links.
pub(super) struct Links {
    setting: Setting,
    known: BTreeMap<LinkId, Link>,
    has_news: bool,
}

/// What is known of one link.
#[derive(Clone, Copy)]
struct Link {
    state: LinkState,
    health: LinkHealth,
    heard: Option<Stamp<HostClock>>,
    bytes_in_per_s: f64,
    frames_in_per_s: f64,
}

impl Link {
    fn take(&mut self, now: Stamp<HostClock>, health: LinkHealth) {
        if let Some(heard) = self.heard {
            let passed_s = (now - heard).as_secs_f64();
            let rate = |after: u64, before: u64| after.saturating_sub(before) as f64 / passed_s;
            self.bytes_in_per_s = rate(health.bytes_in, self.health.bytes_in);
            self.frames_in_per_s = rate(health.frames_in, self.health.frames_in);
        }
        self.heard = Some(now);
        self.health = health;
    }

    fn row(&self, id: LinkId, name: String) -> LinkRow {
        let health = &self.health;
        let millis = |span: Option<Span>| Number::from(span.map_or(f64::NAN, Span::as_millis_f64));
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
            checksum_errors: health.checksum_errors,
            garbage_bytes: health.garbage_bytes,
            stalls: health.stalls,
            queued_frames: health.port.queued_frames,
            drops_out: health.drops_out,
            round_trip_ms: millis(health.round_trip),
            clock_uncertainty_ms: millis(health.clock_uncertainty),
        }
    }
}

impl Links {
    pub(super) fn new(setting: &Setting) -> Self {
        Self { setting: setting.clone(), known: BTreeMap::new(), has_news: false }
    }

    fn link(&mut self, id: LinkId) -> Option<&mut Link> {
        if !self.known.contains_key(&id) && self.known.len() >= MOST_LINKS {
            return None;
        }
        Some(self.known.entry(id).or_insert(Link {
            state: LinkState::Down,
            health: LinkHealth::default(),
            heard: None,
            bytes_in_per_s: 0.0,
            frames_in_per_s: 0.0,
        }))
    }
}

impl View for Links {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        match told {
            Told::Event(Event::Link { link, state }) => {
                if let Some(link) = self.link(*link) {
                    link.state = *state;
                    self.has_news = true;
                }
            }
            Told::Event(Event::Health { link, health, .. }) => {
                if let Some(link) = self.link(*link) {
                    link.take(now, *health);
                }
            }
            Told::Event(_) | Told::Truth(_) | Told::Standing(_) => {}
        }
    }

    fn add_news(&mut self, frame: &mut Frame, pace: Pace) {
        if std::mem::take(&mut self.has_news) || pace == Pace::Second {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        let rows = self.known.iter();
        let rows = rows.map(|(id, link)| link.row(*id, self.setting.link_name(*id)));
        history.links = Some(rows.collect());
    }
}
