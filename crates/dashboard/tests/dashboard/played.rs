//! A dashboard whose station loop and clock are the test.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use posebridge_dashboard::model::{Frame, RobotFrame};
use posebridge_dashboard::{
    BoundListener, Dashboard, DashboardInputs, EventBatch, EventFeed, FrameTaps, ListenAddress, StationInfo,
    TokenPolicy,
};
use posebridge_telemetry::{Address, Event, Input, TimeDelta, Timestamp};
use tokio::sync::mpsc;

/// A clock that goes on when somebody looks at it, or stands.
#[derive(Clone, Default)]
pub(crate) struct ManualClock {
    millis: Arc<AtomicI64>,
    step_ms: i64,
}

impl ManualClock {
    /// One that goes on by 20 ms whenever somebody looks.
    pub(crate) fn running() -> Self {
        Self { step_ms: 20, ..Self::default() }
    }

    /// Goes on.
    pub(crate) fn advance(&self, millis: i64) -> i64 {
        self.millis.fetch_add(millis, Ordering::Relaxed)
    }
}

/// A dashboard whose shard is the test.
pub(crate) struct TestStation {
    pub(crate) dashboard: Dashboard,
    pub(crate) feed: EventFeed,
    pub(crate) commands: mpsc::Receiver<Input>,
    pub(crate) clock: ManualClock,
    folder: tempfile::TempDir,
}

/// What a dashboard needs of the program around it; its replays say how many bytes the file has.
pub(crate) fn sources(folder: &Path, clock: &ManualClock) -> DashboardInputs {
    let clock = clock.clone();
    DashboardInputs {
        clock: Box::new(move || Timestamp::from_millis(clock.advance(clock.step_ms))),
        truth: None,
        recordings: folder.join("run"),
        replay: Box::new(|path| {
            let bytes = std::fs::read(path).map_err(|error| error.to_string())?;
            if bytes.starts_with(b"bad") {
                return Err("it is no recording".to_owned());
            }
            let id = format!("{} bytes", bytes.len());
            Ok(Frame { robots: vec![RobotFrame { id, ..RobotFrame::default() }], ..Frame::default() })
        }),
        ui_dir: None,
        taps: FrameTaps::default(),
        cameras: Vec::new(),
        fleet: None,
    }
}

impl TestStation {
    pub(crate) fn start(token: TokenPolicy) -> Self {
        let facts = StationInfo { token, ..StationInfo::default() };
        Self::with(facts, ManualClock::running())
    }

    pub(crate) fn with(facts: StationInfo, clock: ManualClock) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("run")).unwrap();
        std::fs::write(folder.path().join("secret.mcap"), "secret").unwrap();
        let sources = sources(folder.path(), &clock);
        let bound = BoundListener::new(ListenAddress::Exact("127.0.0.1:0".parse().unwrap())).unwrap();
        let (dashboard, feed, commands) = Dashboard::start(Some(bound), facts, sources).unwrap();
        Self { dashboard, feed, commands, clock, folder }
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.dashboard.address().unwrap()
    }

    pub(crate) fn publish(&self, events: Vec<Event>) {
        self.feed.publish(EventBatch {
            now: Timestamp::from_millis(self.clock.advance(0)),
            latency: TimeDelta::from_micros(15),
            events: events.into(),
            status: None,
        });
    }

    pub(crate) fn record(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.folder.path().join("run").join(name), bytes).unwrap();
    }
}

/// A line that somebody says.
pub(crate) fn text_event(text: &str) -> Event {
    Event::Text { source: Address::new(1, 1), severity: 6, text: text.to_owned() }
}
