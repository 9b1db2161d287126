//! Drives of the laboratory's robots, and the faults of a robot that is wired, counted or configured wrongly.

use std::f64::consts::TAU;

use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_estimator::wiring::{WiringFault, WiringFinding, WiringMonitor};
use posebridge_estimator::{FilterConfig, Params};
use posebridge_sim::montecarlo::{Camera, CameraSees, Course, Drive, Scenario};
use posebridge_telemetry::{
    DriveGeometry, Fix, Heading, Meters, Observation, ObservationKind, Point2, Radians, RadiansPerSecond,
    quantities::wrap_rad,
};

/// What a filter of this drive is configured with.
pub(crate) fn filter_config(drive: &Drive) -> FilterConfig {
    let prior = &drive.prior;
    FilterConfig {
        geometry: prior.geometry,
        noise: prior.noise,
        start: None,
        params: Params::default(),
        calibration: prior.calibration,
        arena_map: prior.arena_map.clone(),
        slow_sensor: SlowSensor::UNKNOWN,
    }
}

pub(crate) fn scenario(name: &str) -> Scenario {
    Scenario::bundled(name).unwrap()
}

/// The configuration of a robot with a fault of its geometry.
pub(crate) fn broken_geometry(fault: WiringFault, good: DriveGeometry) -> DriveGeometry {
    let travel = 1.0 / fault.travel_factor();
    DriveGeometry {
        left_wheel_radius: good.left_wheel_radius * travel,
        right_wheel_radius: good.right_wheel_radius * travel,
        track_width: good.track_width / fault.track_factor(),
        tick: good.tick,
    }
}

/// What a robot with this fault observes instead.
pub(crate) fn broken(fault: WiringFault, observed: ObservationKind) -> ObservationKind {
    let wheels = |change: fn(f64, f64) -> [f64; 2]| match observed {
        ObservationKind::WheelAngles { left, right } => {
            let [left, right] = change(left.0, right.0);
            ObservationKind::WheelAngles { left: Radians(left), right: Radians(right) }
        }
        _ => observed,
    };
    let gyro = |factor: f64| match observed {
        ObservationKind::TurnRate(rate) => ObservationKind::TurnRate(RadiansPerSecond(factor * rate.0)),
        _ => observed,
    };
    let camera = |unit: f64, sign: f64| match observed {
        ObservationKind::Fix(fix) => ObservationKind::Fix(Fix {
            position: Point2::new(Meters(unit * fix.position.x.0), Meters(unit * sign * fix.position.y.0)),
            heading: fix.heading.map(|heading| Heading::from_rad(sign * heading.rad())),
            ..fix
        }),
        _ => observed,
    };
    match fault {
        WiringFault::GyroInDegrees => gyro(360.0 / TAU),
        WiringFault::GyroInRadians => gyro(TAU / 360.0),
        WiringFault::GyroReversed => gyro(-1.0),
        WiringFault::WheelsSwapped => wheels(|left, right| [right, left]),
        WiringFault::LeftWheelReversed => wheels(|left, right| [-left, right]),
        WiringFault::RightWheelReversed => wheels(|left, right| [left, -right]),
        WiringFault::BothWheelsReversed => wheels(|left, right| [-left, -right]),
        WiringFault::CameraInMillimeters => camera(1e3, 1.0),
        WiringFault::CameraYDown => camera(1.0, -1.0),
        WiringFault::WheelsReportHalf
        | WiringFault::WheelsReportDouble
        | WiringFault::TrackTooWide
        | WiringFault::TrackTooNarrow
        | WiringFault::RadiiInMillimeters
        | WiringFault::TrackInMillimeters
        | WiringFault::RadiiAndTrackInMillimeters => observed,
    }
}

/// A finding, and how far the robot had driven and turned by then.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FoundAt {
    pub(crate) finding: WiringFinding,
    pub(crate) path_m: f64,
    pub(crate) turns: f64,
}

/// Everything that the detector finds on a drive, with a fault or without one.
pub(crate) fn detect(
    drive: &Drive,
    fault: Option<WiringFault>,
    mut keep: impl FnMut(&Observation) -> Option<Observation>,
) -> Vec<FoundAt> {
    let mut config = filter_config(drive);
    if let Some(fault) = fault {
        config.geometry = broken_geometry(fault, config.geometry);
    }
    let mut monitor = WiringMonitor::new(&config);
    let mut found = Vec::new();
    let (mut path_m, mut turned_rad, mut step) = (0.0, 0.0, 0);
    for arrival in &drive.arrivals {
        while step < arrival.step {
            let (before, after) = (&drive.truth[step], &drive.truth[step + 1]);
            path_m += (after.x.0 - before.x.0).hypot(after.y.0 - before.y.0);
            turned_rad += wrap_rad(after.heading.rad() - before.heading.rad()).abs();
            step += 1;
        }
        let Some(observation) = keep(&arrival.observation) else {
            continue;
        };
        let measurement = fault.map_or(observation.measurement, |fault| broken(fault, observation.measurement));
        if let Some(finding) = monitor.observe(&Observation { measurement, ..observation }) {
            found.push(FoundAt { finding, path_m, turns: turned_rad / TAU });
        }
    }
    found
}

/// A square of 40 cm, four laps, with one late fix per second if there is a camera.
pub(crate) fn short_square(camera: Option<CameraSees>) -> Scenario {
    let mut scenario = scenario("gyro-scale-1hz");
    if let Course::Laps(laps) = &mut scenario.path {
        laps.side_m = 0.4;
        laps.laps = 4;
    }
    scenario.camera = scenario.camera.zip(camera).map(|(camera, sees)| Camera { sees, ..camera });
    scenario
}
