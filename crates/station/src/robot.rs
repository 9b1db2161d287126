//! One robot: its clock, its estimator, and its publisher.

use posebridge_estimator::wiring::{WiringFinding, WiringMonitor};
use posebridge_estimator::{EstimatedQuantity, FILTERS, FilterCommand, FilterEntry, find_filter};
use posebridge_protocol::message::RobotDescription;
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{
    Address, BrickClock, Calibration, DriveGeometry, Estimate, FilterComparison, Fix, FusionOutcome, GeodeticOrigin,
    HostClock, Observation, Radians, RobotId, SensorId, SensorSwitch, StartPose, Timestamp, Wiring,
};

use crate::battery_monitor::BatteryMonitor;
use crate::camera_table::{CameraIdentity, CameraTable, FixAdmission, Newcomers};
use crate::clock_alignment::ClockAlignment;
use crate::compared_estimators::{ComparedEstimators, EstimatorInput};
use crate::config::{BuildError, DescriptionPolicy, LinkConfig, RobotConfig};
use crate::estimate_publisher::{EstimatePublisher, EstimateSource};
use crate::estimator::{Estimator, FusionReport};
use crate::fusion_alarms::FusionAlarms;
use crate::motion_source_selection::MotionSourceSelector;
use crate::observation_extractor::ObservationExtractor;
use crate::ownership_status::OwnershipStatus;
use crate::sender_identity::PEER_TIMEOUT;
use crate::sensor_health::SensorHealth;

/// The filters of a robot, found in the table of filters.
pub(crate) struct RobotFilters {
    own: &'static FilterEntry,
    /// Those that run beside it.
    compared: Vec<&'static FilterEntry>,
}

impl RobotFilters {
    pub(crate) fn find(config: &RobotConfig) -> Result<Self, BuildError> {
        let find = |name: &String| {
            find_filter(name).ok_or_else(|| BuildError::UnknownFilter {
                name: name.clone(),
                known: FILTERS.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
            })
        };
        let compared = config.compared_filters.iter().map(find).collect::<Result<_, _>>()?;
        Ok(Self { own: find(&config.filter)?, compared })
    }

    /// The configured filters to compare, or else every filter of a pose.
    fn to_compare(config: &RobotConfig) -> Vec<&'static FilterEntry> {
        let is_chosen = |entry: &&FilterEntry| {
            let is_of_pose = entry.quantity == EstimatedQuantity::Pose;
            let is_named = config.compared_filters.iter().any(|name| name == entry.name);
            is_of_pose && entry.name != config.filter && (config.compared_filters.is_empty() || is_named)
        };
        FILTERS.iter().filter(is_chosen).collect()
    }
}

/// The state of one robot.
pub struct Robot {
    pub(crate) id: RobotId,
    /// Its block in [`StationConfig::robots`](crate::StationConfig::robots).
    pub(crate) block: Option<usize>,
    name: Option<String>,
    /// Its number in fixes.
    pub(crate) tag: Option<u32>,
    /// The address in the robot's own frames: that of its id, unless another robot of the link has the same.
    pub(crate) wire_address: Address,
    /// The address that ground stations see as the vehicle.
    pub(crate) vehicle_address: Address,
    pub(crate) extractor: ObservationExtractor,
    pub(crate) motion_sources: MotionSourceSelector,
    pub(crate) sensor_health: SensorHealth,
    /// It has sent messages of our own dialect.
    pub(crate) is_of_own_dialect: bool,
    /// It drives to goals.
    pub(crate) accepts_goals: bool,
    pub(crate) battery: BatteryMonitor,
    pub(crate) clocks: ClockAlignment,
    pub(crate) estimator: Estimator,
    pub(crate) compared: ComparedEstimators,
    pub(crate) publisher: EstimatePublisher,
    pub(crate) alarms: FusionAlarms,
    pub(crate) wiring_monitor: WiringMonitor,
    pub(crate) wiring_findings: Vec<WiringFinding>,
    /// The endpoint and the instant of its last message.
    pub(crate) last_seen: Option<(Endpoint, Timestamp<HostClock>)>,
    pub(crate) cameras: CameraTable,
    description: DescriptionPolicy,
    pub(crate) is_described: bool,
    pub(crate) ownership: OwnershipStatus,
}

impl Robot {
    /// A robot without messages yet; `links` are those of the station.
    pub(crate) fn new(
        filters: &RobotFilters,
        config: &RobotConfig,
        links: &[LinkConfig],
        origin: Option<GeodeticOrigin>,
    ) -> Self {
        Self {
            id: RobotId::default(),
            block: None,
            name: config.name.clone(),
            tag: config.tag,
            wire_address: Address::default(),
            vehicle_address: Address::default(),
            extractor: ObservationExtractor::new(config, origin),
            motion_sources: MotionSourceSelector::default(),
            sensor_health: SensorHealth::default(),
            is_of_own_dialect: false,
            accepts_goals: false,
            battery: BatteryMonitor::default(),
            clocks: ClockAlignment::default(),
            estimator: Estimator::new(filters.own, &config.filter_config),
            compared: ComparedEstimators::new(&filters.compared, &config.filter_config),
            publisher: EstimatePublisher::new(links),
            alarms: FusionAlarms::default(),
            wiring_monitor: WiringMonitor::new(&config.filter_config),
            wiring_findings: Vec::new(),
            last_seen: None,
            cameras: CameraTable::default(),
            description: config.description,
            is_described: false,
            ownership: OwnershipStatus::default(),
        }
    }

    /// The default before any robot was detected.
    pub const fn id(&self) -> RobotId {
        self.id
    }

    /// The index of its block in [`StationConfig::robots`](crate::StationConfig::robots); `None` without a matching
    /// block. The blocks match the address of the robot's own frames, which need not be that of [`Self::id`].
    pub const fn block(&self) -> Option<usize> {
        self.block
    }

    /// `None` if no block of the configuration gives it a name.
    pub fn name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// The address that ground stations see as the vehicle.
    pub const fn vehicle_address(&self) -> Address {
        self.vehicle_address
    }

    pub fn estimate_at(&self, time: Timestamp<BrickClock>) -> Option<Estimate> {
        self.estimator.estimate_at(time)
    }

    /// The latest instant of any observation.
    pub fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.estimator.latest_time()
    }

    /// The learned constants, relative to [`Self::geometry`].
    pub fn calibration(&self) -> Option<Calibration> {
        self.estimator.calibration()
    }

    /// The filter's nominal geometry: the configured one, or the one that the robot has described.
    pub const fn geometry(&self) -> DriveGeometry {
        self.estimator.config.geometry
    }

    /// How its sensors are configured to be connected.
    pub const fn wiring(&self) -> Wiring {
        self.extractor.wiring
    }

    /// What is connected, counted or configured wrongly, in the order in which it was found.
    pub fn wiring_findings(&self) -> &[WiringFinding] {
        &self.wiring_findings
    }

    /// The names of the filters that run beside its own.
    pub fn compared_filters(&self) -> impl Iterator<Item = &'static str> {
        self.compared.filters()
    }

    pub fn switched_off(&self) -> impl Iterator<Item = SensorId> {
        self.estimator.switched_off.iter().copied()
    }

    /// Whether ground stations see it under another system than that of its own frames.
    pub(crate) fn is_renamed(&self) -> bool {
        self.vehicle_address.system != self.wire_address.system
    }

    pub(crate) fn is_alive(&self, now: Timestamp<HostClock>) -> bool {
        self.last_seen.is_some_and(|(_, last)| now - last < PEER_TIMEOUT)
    }

    /// Decides about the fix of a camera with its own clock.
    pub(crate) fn admit_fix(
        &mut self,
        now: Timestamp<HostClock>,
        camera: CameraIdentity,
        fix: &Fix,
        stamp: Timestamp<BrickClock>,
        newcomers: Newcomers,
    ) -> FixAdmission {
        let estimator = &self.estimator;
        self.cameras.admit(now, camera, fix, newcomers, || {
            estimator.estimate_at(stamp).filter(|estimate| estimate.validity.position)
        })
    }

    pub(crate) fn estimate_source(&self, now: Timestamp<HostClock>) -> EstimateSource<'_> {
        let (clocks, estimator) = (&self.clocks, &self.estimator);
        EstimateSource { now, clocks, estimator, epoch: self.ownership.epoch(), origin: self.extractor.origin }
    }

    pub(crate) fn publishing(&mut self, now: Timestamp<HostClock>) -> (&mut EstimatePublisher, EstimateSource<'_>) {
        let Self { publisher, clocks, estimator, ownership, extractor, .. } = self;
        (publisher, EstimateSource { now, clocks, estimator, epoch: ownership.epoch(), origin: extractor.origin })
    }

    /// Whether the robot's description replaces the configured geometry, which happens once.
    pub(crate) fn needs_description(&self) -> bool {
        self.description == DescriptionPolicy::Adopt && !self.is_described
    }

    pub(crate) fn set_described_geometry(&mut self, geometry: DriveGeometry) {
        self.is_described = true;
        if geometry != self.estimator.config.geometry {
            self.extractor.geometry = geometry;
            self.estimator.set_geometry(geometry);
            self.wiring_monitor.set_geometry(geometry);
            // They were about the geometry before.
            self.wiring_findings.clear();
            self.compared.push(EstimatorInput::SetGeometry(geometry));
        }
    }

    /// Starts the compared filters at the robot's present pose, or stops them.
    pub(crate) fn compare_filters(&mut self, to: FilterComparison, config: &RobotConfig) {
        self.compared = match to {
            FilterComparison::Off => ComparedEstimators::default(),
            FilterComparison::On => {
                let mut filter_config = self.estimator.config.clone();
                let start = self.estimator.latest_estimate().and_then(|estimate| estimate.start_pose());
                filter_config.start = start.or(filter_config.start);
                ComparedEstimators::new(&RobotFilters::to_compare(config), &filter_config)
            }
        };
        self.compared.push(EstimatorInput::Command(Box::new(FilterCommand::SetOnlineCalibration(
            self.estimator.online_calibration,
        ))));
        for sensor in &self.estimator.switched_off {
            self.compared.push(EstimatorInput::SwitchSensor(*sensor, SensorSwitch::Off));
        }
    }

    /// Uses an observation, late or not, unless its sensor is disabled.
    pub(crate) fn observe(&mut self, observation: &Observation) -> FusionReport {
        self.compared.push(EstimatorInput::Observation(*observation));
        self.estimator.observe(observation)
    }

    /// Compares an observation with those of the other sensors; a text when that shows something that is connected, counted or
    /// configured wrongly.
    pub(crate) fn check_wiring(&mut self, observation: &Observation) -> Option<String> {
        if self.estimator.switched_off.contains(&observation.sensor) {
            return None;
        }
        let finding = self.wiring_monitor.observe(observation)?;
        let text = format!("{finding} (--fix-wiring prints the lines that undo it)");
        self.wiring_findings.push(finding);
        Some(text)
    }

    /// [`FusionOutcome::Malformed`] and no change if a number is not finite or a sigma is negative.
    pub(crate) fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        self.compared.push(EstimatorInput::SetPose(*start));
        self.estimator.set_pose(start)
    }

    /// False if the robot's own filter does not support the command.
    pub(crate) fn apply(&mut self, command: &FilterCommand) -> bool {
        self.compared.push(EstimatorInput::Command(Box::new(*command)));
        self.estimator.apply(command)
    }

    pub(crate) fn switch_sensor(&mut self, sensor: SensorId, to: SensorSwitch) {
        self.compared.push(EstimatorInput::SwitchSensor(sensor, to));
        self.estimator.switch_sensor(sensor, to);
    }

    /// After a reset of the brick's clock.
    pub(crate) fn restart_clock(&mut self) {
        self.compared.push(EstimatorInput::RestartClock);
        self.estimator.restart_clock();
        self.motion_sources = MotionSourceSelector::default();
        self.wiring_monitor.restart_clock();
    }
}

/// The geometry in a robot's description, if all its lengths are valid.
pub(crate) fn described_geometry(description: &RobotDescription) -> Option<DriveGeometry> {
    let geometry = DriveGeometry {
        left_wheel_radius: description.left_wheel_radius,
        right_wheel_radius: description.right_wheel_radius,
        track_width: description.track_width,
        tick: Radians(std::f64::consts::TAU / description.ticks_per_turn),
    };
    is_valid_geometry(&geometry).then_some(geometry)
}

/// Whether all lengths are finite and more than zero.
pub(crate) fn is_valid_geometry(geometry: &DriveGeometry) -> bool {
    let DriveGeometry { left_wheel_radius, right_wheel_radius, track_width, tick } = *geometry;
    let lengths = [left_wheel_radius.0, right_wheel_radius.0, track_width.0, tick.0];
    lengths.iter().all(|length| length.is_finite() && *length > 0.0)
}
