//! Events of every kind, with values that all differ.

use posebridge_telemetry::{
    Address, Celsius, ChannelName, Estimate, Event, Fix, FusionOutcome, FusionRecord, Heading, LinkHealth, LinkId,
    LinkState, Meters, MetersPerSecond, Observation, ObservationKind, Point2, Pose, RadiansPerSecond, RobotId,
    ScalarEstimate, SensorId, SourceHealth, TimeDelta, Timestamp, Validity,
};

pub(crate) fn robot() -> RobotId {
    RobotId { link: LinkId(0), address: Address::new(1, 1) }
}

/// 1.5 m east, 0.25 m south, turned left by 0.6 rad; variances that all differ.
pub(crate) fn estimate(brick_millis: i64) -> Estimate {
    let mut covariance = [[0.0; 5]; 5];
    for (i, row) in covariance.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            let (low, high) = (i.min(j) as f64, i.max(j) as f64);
            *entry = if i == j { 1e-4 * (1.0 + low) } else { 1e-6 * (5.0 * low + high) };
        }
    }
    Estimate {
        stamp: Timestamp::from_millis(brick_millis),
        pose: Pose::new(Meters(1.5), Meters(-0.25), Heading::from_rad(0.6)),
        forward_speed: MetersPerSecond(0.2),
        turn_rate: RadiansPerSecond(-0.5),
        covariance,
        validity: Validity { position: true, heading: true, speeds: true },
        is_dead_reckoning: false,
        fix_age: Some(TimeDelta::from_millis(300)),
        reset_counter: 2,
        last_correction: None,
        missing: None,
    }
}

pub(crate) fn fused_event(verdict: FusionOutcome, nis: f64) -> Event {
    let record = FusionRecord {
        sensor: SensorId(200),
        kind: "fix",
        stamp: Timestamp::from_millis(5_000),
        lag: TimeDelta::from_millis(150),
        outcome: verdict,
        innovation: [0.01, -0.02, 0.0],
        innovation_covariance: [[4e-4, 1e-5, 0.0], [1e-5, 5e-4, 0.0], [0.0; 3]],
        nis,
        degrees_of_freedom: 2,
        log_likelihood: 3.5,
    };
    let robot = robot();
    Event::ObservationFused { robot, record }
}

/// The brick's clock shows 5 s at this instant of the host's, and is a thousandth fast.
pub(crate) fn aligned_event(robot: RobotId, host_millis: i64) -> Event {
    Event::BrickClockAligned {
        robot,
        offset: TimeDelta::from_millis(4_000),
        skew_ppm: 1_000.0,
        uncertainty: TimeDelta::from_micros(700),
        round_trip: Some(TimeDelta::from_millis(3)),
        brick: Timestamp::from_millis(5_000),
        host: Timestamp::from_millis(host_millis),
    }
}

fn fix_events() -> Vec<Event> {
    let fix = Fix {
        position: Point2::new(Meters(1.4), Meters(-0.2)),
        heading: Some(Heading::from_rad(0.5)),
        covariance: None,
        tag_in_body: Point2::new(Meters(0.0), Meters(0.0)),
        reset_counter: 0,
    };
    vec![
        Event::ObservationAligned {
            robot: robot(),
            source: Address::new(1, 1),
            arrival: Timestamp::from_millis(1_100),
            observation: Observation {
                sensor: SensorId(200),
                stamp: Timestamp::from_millis(5_000),
                stamp_sigma: TimeDelta::ZERO,
                measurement: ObservationKind::Fix(fix),
            },
        },
        Event::Temperature {
            brick: robot(),
            channel: ChannelName::from_bytes(b"temp1"),
            arrival: Timestamp::from_millis(1_100),
            stamp: Timestamp::from_millis(5_000),
            shown: Celsius(20.5),
            verdict: FusionOutcome::Accepted,
            settled: Some(ScalarEstimate {
                stamp: Timestamp::from_millis(5_000),
                value: 24.0,
                sigma: 0.5,
                rate_per_s: 0.0,
                unit: "°C",
            }),
        },
        Event::CameraClockAligned {
            camera: Address::new(9, 1),
            offset: TimeDelta::from_millis(-20),
            uncertainty: TimeDelta::from_millis(2),
            stamp: Timestamp::from_millis(980),
            host: Timestamp::from_millis(1_000),
        },
    ]
}

/// One of every kind.
pub(crate) fn events() -> Vec<Event> {
    let health = LinkHealth {
        bytes_in: 1_000,
        frames_lost: 3,
        round_trip: Some(TimeDelta::from_millis(3)),
        ..LinkHealth::default()
    };
    let source = SourceHealth { source: Address::new(1, 1), frames: 40, lost: 3 };
    let (link, robot) = (LinkId(0), robot());
    let mut events = vec![
        aligned_event(robot, 1_000),
        Event::RobotDetected { robot },
        Event::RobotNamed { robot, name: "ada".to_owned() },
        Event::RobotLost { robot, silence: TimeDelta::from_millis(3_000) },
        Event::BrickRestarted { robot },
        Event::Link { link, state: LinkState::Down },
        Event::Health { link, health, sources: vec![source] },
        Event::Text { source: Address::new(1, 1), severity: 3, text: "motor hot".to_owned() },
        fused_event(FusionOutcome::PoseReset, 12.0),
        Event::EstimateUpdated { robot, estimate: estimate(5_050) },
        Event::EstimateCompared { robot, filter: "ekf5", estimate: estimate(5_050) },
    ];
    let distance =
        ScalarEstimate { stamp: Timestamp::from_millis(5_050), value: 0.304, sigma: 0.02, rate_per_s: -0.5, unit: "m" };
    events.push(Event::QuantityUpdated { robot, estimate: distance });
    if let Event::ObservationFused { record, .. } = fused_event(FusionOutcome::Accepted, 1.5) {
        events.push(Event::ObservationCompared { robot, filter: "ekf5", record });
    }
    events.extend(fix_events());
    events
}
