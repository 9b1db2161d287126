//! What a station told of its links and its robot.

use posebridge_telemetry::{Event, LinkHealth, LinkId, SourceHealth};

use crate::station::Station;

/// The health of a link that was told last, with that of its sources.
pub(crate) fn health(station: &Station, id: LinkId) -> (LinkHealth, Vec<SourceHealth>) {
    let health = station.events().filter_map(|event| match event {
        Event::Health { link, health, sources, .. } if *link == id => Some((*health, sources.clone())),
        _ => None,
    });
    health.last().expect("a second has passed")
}

/// How many observations were made.
pub(crate) fn observed(station: &Station) -> usize {
    let is_observation = |event: &&Event| matches!(event, Event::Observed { .. });
    station.events().filter(is_observation).count()
}
