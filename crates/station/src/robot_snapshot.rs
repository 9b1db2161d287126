//! The state of a robot as bytes: all that its next estimates depend on, for another station that continues them.
//!
//! ```text
//! version (u16), program version, name of the filter, fingerprint of the configuration      RobotFingerprint
//! filter, clock, monitors, cameras, thermometers                                            SavedRobot
//! ```
//! In the format of `estimator::saved`. Not part of it is what belongs to endpoints: ids, links, routes, intervals, requests, and the robot's
//! place among others; nor what a robot is sent of its own accord (missions), nor the filters that are compared with its own.
//!
//! The bytes come from another machine and may be anything. All of them are read, checked and built into new values before any of these
//! takes the place of an old one.

use posebridge_estimator::fingerprint::hash;
use posebridge_estimator::saved::{self, Numbers};
use posebridge_estimator::wiring::{SavedMonitor, WiringFinding, WiringMonitor};
use posebridge_estimator::{ConfigFingerprint, FilterConfig, RestoreError};
use posebridge_telemetry::{ChannelName, DriveGeometry, RobotSnapshot, TimeDelta};
use serde::{Deserialize, Serialize};

use crate::battery_monitor::BatteryMonitor;
use crate::camera_table::CameraTable;
use crate::clock_alignment::{ClockAlignment, SavedClocks};
use crate::config::{DescriptionPolicy, RobotConfig};
use crate::estimate_publisher::SavedPublisher;
use crate::estimator::{Estimator, SavedEstimator};
use crate::fusion_alarms::FusionAlarms;
use crate::host_times::ShiftHostTimes;
use crate::motion_source_selection::MotionSourceSelector;
use crate::robot::{Robot, is_valid_geometry};
use crate::sensor_health::SensorHealth;

/// Raised with every change of the layout.
const VERSION: u16 = 1;
const PROGRAM: &str = env!("CARGO_PKG_VERSION");
/// Longer bytes are not read: those of the largest filter with every state between its observations.
pub(crate) const MAX_BYTES: usize = 8 << 20;
/// No monitor finds so much.
const MAX_FINDINGS: usize = 64;

/// What must agree for a state to mean the same here.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct RobotFingerprint {
    version: u16,
    program: String,
    filter: String,
    config: ConfigFingerprint,
    /// Of wiring, meaning of wheel speeds and place of the tag.
    extractor: u64,
    /// Of the arena's place on the Earth.
    origin: u64,
    description: u64,
    thermometers: u64,
}

impl RobotFingerprint {
    fn new(robot: &Robot, config: &RobotConfig) -> Self {
        // Parameters may have been set since; a geometry that the robot has described is part of the state.
        let geometry = config.filter_config.geometry;
        let filter_config = FilterConfig { geometry, ..robot.estimator.config.clone() };
        let extractor = &robot.extractor;
        Self {
            version: VERSION,
            program: PROGRAM.to_owned(),
            filter: robot.estimator.entry.name.to_owned(),
            config: ConfigFingerprint::new(&filter_config),
            extractor: hash(&(extractor.wiring, extractor.rpm, extractor.tag_in_body)),
            origin: hash(&extractor.origin),
            description: hash(&config.description),
            thermometers: hash(&config.thermometers),
        }
    }

    /// Fails with what differs.
    fn check(&self, own: &Self) -> Result<(), String> {
        if (self.version, &self.program) != (own.version, &own.program) {
            let [theirs, ours] =
                [self, own].map(|of| format!("{} (layout {})", printable_name(&of.program), of.version));
            return Err(format!("it is of posebridge {theirs}, and this is {ours}"));
        }
        if self.filter != own.filter {
            let theirs = printable_name(&self.filter);
            return Err(format!("it is of the filter {theirs}, and the robot has {} here", own.filter));
        }
        let others = [
            (self.extractor, own.extractor, "wiring or tag"),
            (self.origin, own.origin, "geodetic origin"),
            (self.description, own.description, "use of its description"),
            (self.thermometers, own.thermometers, "thermometers"),
        ];
        let others = others.into_iter().filter(|(theirs, ours, _)| theirs != ours).map(|(_, _, name)| name);
        let differences: Vec<_> = own.config.differences(&self.config).chain(others).collect();
        match differences.as_slice() {
            [] => Ok(()),
            [one] => Err(format!("the robot is configured otherwise there: its {one}")),
            [some @ .., last] => {
                Err(format!("the robot is configured otherwise there: its {} and {last}", some.join(", ")))
            }
        }
    }
}

/// The beginning of a name from elsewhere.
fn printable_name(name: &str) -> String {
    name.chars().take(32).map(|c| if c.is_ascii_graphic() { c } else { '?' }).collect()
}

/// A channel and the state of its filter.
pub(crate) type SavedThermometer = (ChannelName, Vec<u8>);

#[derive(Serialize, Deserialize)]
struct SavedRobot {
    /// The one that the robot has described.
    geometry: Option<DriveGeometry>,
    estimator: SavedEstimator,
    clocks: SavedClocks,
    motion_sources: MotionSourceSelector,
    sensor_health: SensorHealth,
    battery: BatteryMonitor,
    cameras: CameraTable,
    publisher: SavedPublisher,
    alarms: FusionAlarms,
    wiring_monitor: SavedMonitor,
    wiring_findings: Vec<WiringFinding>,
    thermometers: Vec<SavedThermometer>,
}

impl ShiftHostTimes for SavedRobot {
    fn shift_host_times(&mut self, by: TimeDelta) {
        let Self {
            geometry: _,
            estimator: _,
            clocks,
            motion_sources,
            sensor_health,
            battery,
            cameras,
            publisher,
            alarms: _,
            wiring_monitor: _,
            wiring_findings: _,
            thermometers: _,
        } = self;
        clocks.shift_host_times(by);
        motion_sources.shift_host_times(by);
        sensor_health.shift_host_times(by);
        battery.shift_host_times(by);
        cameras.shift_host_times(by);
        publisher.shift_host_times(by);
    }
}

/// Everything of a snapshot that is checked and can take its place in a robot.
pub(crate) struct RestoredRobot {
    geometry: Option<DriveGeometry>,
    estimator: Estimator,
    clocks: ClockAlignment,
    wiring_monitor: WiringMonitor,
    saved: SavedRobot,
}

impl RestoredRobot {
    pub(crate) fn thermometers(&self) -> &[SavedThermometer] {
        &self.saved.thermometers
    }
}

impl Robot {
    /// The state as bytes; `config` is the robot's configuration, `thermometers` are the states of its thermometers.
    pub(crate) fn save(&self, config: &RobotConfig, thermometers: Vec<SavedThermometer>) -> Vec<u8> {
        let saved = SavedRobot {
            geometry: self.is_described.then_some(self.estimator.config.geometry),
            estimator: self.estimator.save(),
            clocks: self.clocks.save(),
            motion_sources: self.motion_sources.clone(),
            sensor_health: self.sensor_health.clone(),
            battery: self.battery,
            cameras: self.cameras.clone(),
            publisher: self.publisher.save(),
            alarms: self.alarms.clone(),
            wiring_monitor: self.wiring_monitor.save(),
            wiring_findings: self.wiring_findings.clone(),
            thermometers,
        };
        saved::to_bytes(&(RobotFingerprint::new(self, config), saved))
    }

    /// Reads a snapshot for this robot. Fails with a part of a sentence that says why it cannot be used.
    pub(crate) fn read_snapshot(
        &self,
        snapshot: &RobotSnapshot,
        config: &RobotConfig,
    ) -> Result<RestoredRobot, String> {
        if snapshot.bytes.len() > MAX_BYTES {
            return Err(format!("it has more than {MAX_BYTES} bytes"));
        }
        // The fingerprint alone first: what follows has another layout where it differs.
        let (theirs, state): (RobotFingerprint, _) =
            saved::split_first(&snapshot.bytes).map_err(|error| error.to_string())?;
        theirs.check(&RobotFingerprint::new(self, config))?;
        let mut saved: SavedRobot = saved::from_bytes(state).map_err(|error| error.to_string())?;
        saved.shift_host_times(-snapshot.clock_offset);
        self.rebuild(saved, config).map_err(|error| error.to_string())
    }

    fn rebuild(&self, saved: SavedRobot, config: &RobotConfig) -> Result<RestoredRobot, RestoreError> {
        saved.cameras.check()?;
        (saved.wiring_findings.len() <= MAX_FINDINGS)
            .then_some(())
            .ok_or(RestoreError::Implausible("it has too many findings about its wiring"))?;
        saved
            .estimator
            .fix_ratio
            .are_finite()
            .then_some(())
            .ok_or(RestoreError::Implausible("the ratio of its last fix is not finite"))?;
        let geometry = saved.geometry.filter(|_| config.description == DescriptionPolicy::Adopt);
        (geometry.is_none_or(|geometry| is_valid_geometry(&geometry)))
            .then_some(())
            .ok_or(RestoreError::Implausible("its described geometry cannot be"))?;
        let own = &self.estimator.config;
        let filter_config = FilterConfig { geometry: geometry.unwrap_or(config.filter_config.geometry), ..own.clone() };
        let estimator = Estimator::restored(self.estimator.entry, &filter_config, &saved.estimator)?;
        let wiring_monitor = WiringMonitor::new(&filter_config).with_saved(&saved.wiring_monitor)?;
        let clocks = ClockAlignment::restored(saved.clocks.clone())?;
        Ok(RestoredRobot { geometry, estimator, clocks, wiring_monitor, saved })
    }

    /// Continues from a snapshot that was read for it.
    pub(crate) fn set_restored(&mut self, restored: RestoredRobot) {
        let RestoredRobot { geometry, estimator, clocks, wiring_monitor, saved } = restored;
        self.extractor.geometry = estimator.config.geometry;
        self.is_described = geometry.is_some();
        self.estimator = estimator;
        self.clocks = clocks;
        self.motion_sources = saved.motion_sources;
        self.sensor_health = saved.sensor_health;
        self.battery = saved.battery;
        self.cameras = saved.cameras;
        self.publisher.restore(&saved.publisher);
        self.alarms = saved.alarms;
        self.wiring_monitor = wiring_monitor;
        self.wiring_findings = saved.wiring_findings;
    }
}
