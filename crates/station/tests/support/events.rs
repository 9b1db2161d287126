//! What a station told of its links and its robot.

use posebridge_telemetry::{Event, LinkHealth, LinkId, SourceHealth};

use crate::station::TestStation;

/// The health of a link that was told last, with that of its sources.
pub(crate) fn health(station: &TestStation, id: LinkId) -> (LinkHealth, Vec<SourceHealth>) {
    let health = station.events().filter_map(|event| match event {
        Event::Health { link, health, sources, .. } if *link == id => Some((*health, sources.clone())),
        _ => None,
    });
    health.last().expect("a second has passed")
}

/// How many observations were made.
pub(crate) fn observed(station: &TestStation) -> usize {
    let is_observation = |event: &&Event| matches!(event, Event::ObservationAligned { .. });
    station.events().filter(is_observation).count()
}
