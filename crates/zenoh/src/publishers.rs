//! What a session publishes: one declared publisher for each key, because those have short names on the wire.

use std::collections::BTreeMap;

use posebridge_fleet::{FleetKey, FleetKeys};
use zenoh::Session;
use zenoh::Wait as _;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

/// Keys that are declared at most; what is published under further ones is counted as dropped.
const MAX_PUBLISHERS: usize = 65_536;

pub(crate) struct Publishers {
    session: Session,
    keys: FleetKeys,
    declared: BTreeMap<String, Publisher<'static>>,
}

impl Publishers {
    pub(crate) const fn new(session: Session, keys: FleetKeys) -> Self {
        Self { session, keys, declared: BTreeMap::new() }
    }

    /// Publishes bytes; what the network does not take is dropped. None of it is `express`: that loses most of what comes in bulk.
    pub(crate) fn publish(&mut self, key: &FleetKey, bytes: Vec<u8>) -> Result<(), zenoh::Error> {
        let text = self.keys.build(key);
        if let Some(publisher) = self.declared.get(&text) {
            return publisher.put(bytes).wait();
        }
        if self.declared.len() >= MAX_PUBLISHERS {
            return Err(format!("more than {MAX_PUBLISHERS} keys").into());
        }
        let priority = match key {
            FleetKey::Estimate { .. } => Priority::RealTime,
            FleetKey::Fix { .. } => Priority::InteractiveHigh,
            FleetKey::Raw { .. } => Priority::Data,
            FleetKey::State { .. } => Priority::DataLow,
            FleetKey::Command { .. } | FleetKey::Ownership { .. } | FleetKey::Station(_) => Priority::InteractiveLow,
        };
        let publisher = self
            .session
            .declare_publisher(text.clone())
            .priority(priority)
            .congestion_control(CongestionControl::Drop)
            .wait()?;
        let sent = publisher.put(bytes).wait();
        self.declared.insert(text, publisher);
        sent
    }
}
