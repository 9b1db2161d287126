//! Stations of a fleet for tests, with real sessions.
#![allow(
    dead_code,
    clippy::expect_used,
    reason = "each test program uses its part; helpers stop where the set-up is broken"
)]

use std::net::TcpListener;
use std::sync::{Arc, Mutex};

use posebridge_fleet::{FleetName, FleetTable, Input, StationId, StationName};
use posebridge_link::HostTimer;
use posebridge_zenoh::{Connection, FleetEvent, FleetSession};

pub(crate) struct Member {
    pub(crate) id: StationId,
    pub(crate) session: FleetSession,
    pub(crate) table: Arc<Mutex<FleetTable>>,
}

/// A port that was free a moment ago: Zenoh does not say which one it took.
pub(crate) fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    format!("tcp/{}", listener.local_addr().expect("its address"))
}

impl Member {
    pub(crate) fn start(fleet: &str, name: &str, connection: Connection) -> Self {
        let id = StationId { name: StationName::new(name).expect("a name"), instance: 1 };
        let table = Arc::new(Mutex::new(FleetTable::new(16, 16)));
        let fleet = FleetName::new(fleet).expect("a name");
        let session = FleetSession::start(connection, fleet, id.clone(), HostTimer::start(), Arc::clone(&table));
        Self { id, session: session.expect("a session"), table }
    }

    pub(crate) fn listening(fleet: &str, endpoint: &str) -> Self {
        Self::start(fleet, "a", Connection { listen: vec![endpoint.to_owned()], ..Connection::default() })
    }

    pub(crate) fn joining(fleet: &str, name: &str, endpoint: &str) -> Self {
        Self::start(fleet, name, Connection { join: vec![endpoint.to_owned()], ..Connection::default() })
    }

    /// The first input that fits; those before it are dropped.
    pub(crate) async fn wait_for<T>(&mut self, pick: impl Fn(&Input) -> Option<T>) -> T {
        loop {
            if let FleetEvent::Ownership(input) = self.session.next_event().await
                && let Some(found) = pick(&input)
            {
                return found;
            }
        }
    }

    pub(crate) async fn wait_for_input(&mut self, expected: Input) {
        self.wait_for(|input| (*input == expected).then_some(())).await;
    }
}
