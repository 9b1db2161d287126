use super::*;

use insta::assert_json_snapshot;
use posebridge_telemetry::{
    Address, Arena, Estimate, Event, Fix, FusionOutcome, FusionRecord, Heading, HostClock, LinkHealth, LinkId,
    LinkState, Meters, MetersPerSecond, Observation, ObservationKind, Point2, Pose, RadiansPerSecond, RobotId,
    SensorId, TimeDelta, Timestamp, Validity,
};

use crate::feed::{RobotStatus, SimulatedTruth, StationStatus};
use crate::model::{CalibrationRow, Frame, ParameterValue, RobotFrame, SimulatorNow};

pub(super) fn at(millis: i64) -> Timestamp<HostClock> {
    Timestamp::from_millis(millis)
}

pub(super) fn robot() -> RobotId {
    RobotId { link: LinkId(0), address: Address::new(1, 1) }
}

pub(super) fn view(name: &str) -> Box<dyn View> {
    view_with_retention(
        name,
        RetentionPolicy::SlidingWindow { duration: TimeDelta::from_millis(60_000), max_points: 1_200 },
    )
}

fn view_with_retention(name: &str, keep: RetentionPolicy) -> Box<dyn View> {
    let setting = ViewConfig { links: vec!["sim://square".to_owned()], retention: keep, dead_reckoning: None };
    let entry = VIEWS.iter().find(|entry| entry.name == name).unwrap();
    (entry.build)(&setting)
}

pub(super) fn updates(view: &mut dyn View, pace: FrameContent) -> Frame {
    let mut frame = Frame::default();
    view.add_updates(&mut frame, pace);
    frame
}

pub(super) fn history(view: &dyn View) -> Frame {
    let mut frame = Frame::default();
    view.add_history(&mut frame);
    frame
}

/// 1.5 m east and 0.25 m south, sigmas of 3 cm and 1 cm along the axes.
pub(crate) fn estimate() -> Estimate {
    let mut covariance = [[0.0; 5]; 5];
    covariance[0][0] = 9e-4;
    covariance[1][1] = 1e-4;
    covariance[2][2] = 4e-4;
    Estimate {
        stamp: Timestamp::from_millis(5_000),
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

pub(super) fn estimated_event(estimate: &Estimate) -> Event {
    Event::EstimateUpdated { robot: robot(), estimate: *estimate }
}

fn received_event() -> Event {
    let fix = Fix {
        position: Point2::new(Meters(1.0), Meters(2.0)),
        heading: Some(Heading::from_rad(0.5)),
        covariance: None,
        tag_in_body: Point2::ORIGIN,
        reset_counter: 0,
    };
    Event::ObservationAligned {
        robot: robot(),
        source: Address::new(1, 100),
        arrival: at(1_000),
        observation: Observation {
            sensor: SensorId::CAMERA,
            stamp: Timestamp::from_millis(5_000),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Fix(fix),
        },
    }
}

pub(crate) fn fused_event(verdict: FusionOutcome, used: u8) -> Event {
    let record = FusionRecord {
        sensor: SensorId::CAMERA,
        kind: "fix",
        stamp: Timestamp::from_millis(5_000),
        lag: TimeDelta::from_millis(150),
        outcome: verdict,
        innovation: [0.01, -0.02, 0.0],
        innovation_covariance: [[4e-4, 1e-5, 0.0], [1e-5, 9e-4, 0.0], [0.0; 3]],
        nis: 1.25,
        degrees_of_freedom: used,
        log_likelihood: 3.5,
    };
    let robot = robot();
    Event::ObservationFused { robot, record }
}

#[test]
fn an_estimate_has_the_ellipse_of_95_per_cent() {
    let mut view = view("estimates");
    view.observe(at(1_000), ViewInput::Event(&estimated_event(&estimate())));
    let frame = updates(&mut *view, FrameContent::Delta);
    assert_json_snapshot!("estimate", frame.robots);
    assert!(updates(&mut *view, FrameContent::Delta).robots.is_empty());
    assert_eq!(history(&*view).robots, frame.robots);
}

#[test]
fn an_estimate_whose_place_is_unknown_is_relative_and_has_a_heading() {
    let mut view = view("estimates");
    let start = Estimate { validity: Validity::default(), ..estimate() };
    let turned = Estimate { validity: Validity { position: true, ..Validity::default() }, ..estimate() };
    for estimate in [start, turned] {
        view.observe(at(1_000), ViewInput::Event(&estimated_event(&estimate)));
    }
    let points = updates(&mut *view, FrameContent::Delta).robots[0].estimates.clone();
    let flags: Vec<_> = points.iter().map(|point| (point.is_relative, point.is_heading_known)).collect();
    assert_eq!(flags, [(true, true), (false, false)]);
}

#[test]
fn numbers_that_are_none_are_null() {
    let mut view = view("estimates");
    let mut broken = estimate();
    broken.covariance[0][0] = f64::INFINITY;
    broken.fix_age = None;
    view.observe(at(1_000), ViewInput::Event(&estimated_event(&broken)));
    let frame = updates(&mut *view, FrameContent::Delta);
    let point = &frame.robots[0].estimates[0];
    assert_eq!(point.major_m.get(), None);
    assert_eq!(point.fix_age_s.get(), None);
    assert!(point.x_m.get().is_some());
}

#[test]
fn a_fix_stands_where_it_was_seen_with_what_became_of_it() {
    let mut view = view("fixes");
    view.observe(at(1_000), ViewInput::Event(&received_event()));
    assert!(updates(&mut *view, FrameContent::Delta).is_empty(), "its record has not come");
    view.observe(at(1_000), ViewInput::Event(&fused_event(FusionOutcome::Gated, 2)));
    let frame = updates(&mut *view, FrameContent::Delta);
    assert_json_snapshot!("fix", frame.robots[0].fixes);
    // The record of a fix that was never seen has no place on the map.
    view.observe(at(1_000), ViewInput::Event(&fused_event(FusionOutcome::Gated, 2)));
    assert!(updates(&mut *view, FrameContent::Delta).is_empty());
}

#[test]
fn a_record_has_its_innovation_with_one_sigma_each() {
    let mut view = view("fusion");
    view.observe(at(1_000), ViewInput::Event(&fused_event(FusionOutcome::Accepted, 2)));
    view.observe(at(1_020), ViewInput::Event(&fused_event(FusionOutcome::TooOld, 0)));
    let frame = updates(&mut *view, FrameContent::Delta);
    assert_json_snapshot!("records", frame.robots[0].fusion);
}

#[test]
fn what_stands_is_told_when_it_changes_and_once_a_second() {
    let learned = vec![CalibrationRow {
        t_s: 1.5,
        name: "gyro_bias_rad_per_s".into(),
        value: 0.01,
        sigma: 0.002,
        unit: "rad/s".into(),
    }];
    let status = StationStatus {
        robots: vec![RobotStatus {
            robot: robot(),
            calibration: learned.clone(),
            switched_off: vec![1],
            ..RobotStatus::default()
        }],
        parameters: vec![ParameterValue { name: "gate_prob".to_owned(), value: 0.999 }],
        switched_off: vec![3],
        simulator: Some(SimulatorNow { steering: "odometry".to_owned(), link_profile: Some("usb".to_owned()) }),
        ..StationStatus::default()
    };
    let mut sent = Frame::default();
    for name in ["parameters", "switches", "simulator"] {
        let mut view = view(name);
        view.observe(at(0), ViewInput::Status(&status));
        assert!(!updates(&mut *view, FrameContent::Delta).is_empty(), "{name}");
        assert!(updates(&mut *view, FrameContent::Delta).is_empty(), "{name}");
        view.add_updates(&mut sent, FrameContent::DeltaAndSummary);
    }
    assert_eq!(sent.parameters.as_ref(), Some(&status.parameters));
    assert_eq!(sent.switched_off, Some(vec![3]));
    assert_eq!(sent.simulator, status.simulator);
    let mut calibration = view("calibration");
    calibration.observe(at(1_500), ViewInput::Status(&status));
    calibration.observe(at(1_500), ViewInput::Event(&estimated_event(&estimate())));
    let frame = updates(&mut *calibration, FrameContent::Delta);
    assert_eq!(frame.robots[0].calibration, Some(learned));
    assert!(updates(&mut *calibration, FrameContent::Delta).is_empty());
}

#[test]
fn what_is_known_of_a_robot_is_told_of_that_one_and_only_once_it_is_estimated() {
    let second = RobotId { link: LinkId(1), ..robot() };
    let row = |value| vec![CalibrationRow { name: "radius_scale".into(), value, ..CalibrationRow::default() }];
    let status = StationStatus {
        robots: vec![
            RobotStatus { robot: robot(), calibration: row(1.0), switched_off: vec![], ..RobotStatus::default() },
            RobotStatus { robot: second, calibration: row(2.0), switched_off: vec![3], ..RobotStatus::default() },
        ],
        ..StationStatus::default()
    };
    let estimated = Event::EstimateUpdated { robot: second, estimate: estimate() };
    for name in ["calibration", "switches"] {
        let mut view = view(name);
        view.observe(at(0), ViewInput::Status(&status));
        assert!(updates(&mut *view, FrameContent::Delta).robots.is_empty(), "{name}: nobody is known");
        view.observe(at(0), ViewInput::Event(&estimated));
        view.observe(at(0), ViewInput::Status(&status));
        let frame = updates(&mut *view, FrameContent::Delta);
        // The history has what was known earlier, too.
        let last = |part: &RobotFrame| {
            let row = part.calibration.as_ref().and_then(|rows| rows.last().cloned());
            (part.id.clone(), part.switched_off.clone(), row)
        };
        assert_eq!(last(&history(&*view).robots[0]), last(&frame.robots[0]));
        let [part] = &frame.robots[..] else {
            panic!("{name}: one robot has an estimate");
        };
        assert_eq!(part.id, "1/1/1");
        match &part.calibration {
            Some(rows) => assert_eq!(rows[0].value, 2.0),
            None => assert_eq!(part.switched_off, Some(vec![3])),
        }
    }
}

pub(crate) fn truth(robot: Option<RobotId>, stamp_millis: i64, x_m: f64) -> SimulatedTruth {
    SimulatedTruth {
        robot,
        now: at(stamp_millis - 4_000),
        time: Timestamp::from_millis(stamp_millis),
        pose: Pose::<Arena>::new(Meters(x_m), Meters(-0.28), Heading::from_rad(0.6)),
        odometry: Some(Pose::new(Meters(x_m + 0.3), Meters(0.12), Heading::from_rad(0.4))),
    }
}

#[test]
fn records_with_a_nis_outlive_the_thinning_of_a_long_recording() {
    let mut view = view_with_retention("fusion", RetentionPolicy::WholeSession { max_points: 3_000 });
    // Of wheels one record in four ends a window and has a NIS.
    for step in 0..40_000 {
        let record = fused_event(FusionOutcome::Accepted, u8::from(step % 4 == 3));
        view.observe(at(20 * step), ViewInput::Event(&record));
    }
    let kept = &history(&*view).robots[0].fusion;
    let with_nis = kept.iter().filter(|one| one.nis.get().is_some()).count();
    assert!((400..1_000).contains(&with_nis), "{with_nis}");
    assert!(kept.len() - with_nis >= 400);
    assert!(kept.is_sorted_by(|a, b| a.t_s <= b.t_s));
}

#[test]
fn tallies_count_what_is_thinned_as_well() {
    let mut live = view("tallies");
    let mut whole = view_with_retention("tallies", RetentionPolicy::WholeSession { max_points: 20_000 });
    for step in 0..1_000 {
        let verdict = if step % 100 == 0 { FusionOutcome::Gated } else { FusionOutcome::Accepted };
        for view in [&mut live, &mut whole] {
            view.observe(at(20 * step), ViewInput::Event(&fused_event(verdict, 2)));
        }
    }
    assert!(updates(&mut *live, FrameContent::Delta).robots.is_empty());
    let frame = updates(&mut *live, FrameContent::DeltaAndSummary);
    assert_json_snapshot!("tallies", frame.robots[0].tallies);
    assert_eq!(history(&*live).robots, frame.robots);
    let seconds = &history(&*whole).robots[0].tallies;
    assert_eq!(seconds.last(), frame.robots[0].tallies.last());
    assert_eq!(seconds.len(), 20);
    assert!(seconds.is_sorted_by(|a, b| a.t_s < b.t_s && a.seen < b.seen));
}

#[test]
fn it_is_kept_how_what_was_learned_went() {
    let status_with = |value| {
        let row = CalibrationRow { name: "radius_scale".into(), value, ..CalibrationRow::default() };
        let status =
            RobotStatus { robot: robot(), calibration: vec![row], switched_off: vec![], ..RobotStatus::default() };
        StationStatus { robots: vec![status], ..StationStatus::default() }
    };
    let mut live = view("calibration");
    let mut whole = view_with_retention("calibration", RetentionPolicy::WholeSession { max_points: 20_000 });
    for view in [&mut live, &mut whole] {
        view.observe(at(0), ViewInput::Event(&estimated_event(&estimate())));
        for second in 0..10_i32 {
            let now = at(1_000 * i64::from(second));
            view.observe(now, ViewInput::Status(&status_with(f64::from(second))));
        }
    }
    let kept = |view: &dyn View| history(view).robots[0].calibration.clone().unwrap();
    for all in [kept(&*live), kept(&*whole)] {
        assert_eq!((all.len(), all[4].t_s, all[4].value), (10, 4.0, 4.0));
    }
}

#[test]
fn of_a_long_recording_warnings_outlive_the_chatter() {
    let mut view = view_with_retention("log", RetentionPolicy::WholeSession { max_points: 1_000 });
    for step in 0..20_000_i64 {
        let event = Event::Text {
            source: Address::new(1, 1),
            severity: if step % 200 == 0 { 4 } else { 6 },
            text: step.to_string(),
        };
        view.observe(at(step), ViewInput::Event(&event));
    }
    let kept = history(&*view).log;
    assert_eq!(kept.iter().filter(|line| line.severity == 4).count(), 100);
    assert!(kept.len() < 1_000);
}

#[test]
fn rates_of_a_link_are_differences_of_its_counts() {
    let mut view = view("links");
    let up = Event::Link { link: LinkId(0), state: LinkState::Up };
    view.observe(at(0), ViewInput::Event(&up));
    for (millis, bytes_in, frames_in) in [(1_000, 500, 10), (3_000, 2_500, 50)] {
        let health = LinkHealth {
            bytes_in,
            frames_in,
            frames_lost: 3,
            round_trip: Some(TimeDelta::from_micros(4_500)),
            ..LinkHealth::default()
        };
        let event = Event::Health { link: LinkId(0), health, sources: vec![] };
        view.observe(at(millis), ViewInput::Event(&event));
    }
    let frame = updates(&mut *view, FrameContent::DeltaAndSummary);
    assert_json_snapshot!("links", frame.links);
    assert_eq!(updates(&mut *view, FrameContent::Delta).links, None);
}

#[test]
fn a_clock_that_was_answered_once_is_two_way() {
    let mut view = view("clock");
    let aligned = |round_trip| Event::BrickClockAligned {
        robot: robot(),
        offset: TimeDelta::from_millis(-1_500),
        skew_ppm: 42.0,
        uncertainty: TimeDelta::from_micros(700),
        round_trip,
        brick: Timestamp::ZERO,
        host: Timestamp::ZERO,
    };
    let mut methods = Vec::new();
    for round_trip in [None, Some(TimeDelta::from_millis(3)), None] {
        view.observe(at(0), ViewInput::Event(&aligned(round_trip)));
        methods.push(updates(&mut *view, FrameContent::DeltaAndSummary).clock.unwrap().method);
    }
    assert_eq!(methods, ["one-way", "two-way", "two-way"]);
    assert_json_snapshot!("clock", history(&*view).clock);
}

#[test]
fn the_log_tells_of_robots_links_and_texts_and_cuts_what_is_endless() {
    let mut view = view("log");
    let text = |text: String| Event::Text { source: Address::new(1, 197), severity: 6, text };
    let events = [
        Event::RobotDetected { robot: robot() },
        Event::Link { link: LinkId(0), state: LinkState::Down },
        text("gate_prob set to 0.9 (was 0.999)".to_owned()),
        estimated_event(&estimate()),
    ];
    for event in &events {
        view.observe(at(1_500), ViewInput::Event(event));
    }
    assert_json_snapshot!("log", updates(&mut *view, FrameContent::Delta).log);
    view.observe(at(2_000), ViewInput::Event(&text("ä".repeat(5_000))));
    let long = updates(&mut *view, FrameContent::Delta).log.remove(0).text;
    assert_eq!(long, format!("1/197: {}", "ä".repeat(496)));
}

#[test]
fn robots_are_named_in_the_order_in_which_they_were_heard_and_no_flood_of_them() {
    let mut view = view("robots");
    for system in 0..=255 {
        let robot = RobotId { link: LinkId(2), address: Address::new(255 - system, 1) };
        let estimate = estimate();
        view.observe(at(0), ViewInput::Event(&Event::EstimateUpdated { robot, estimate }));
    }
    let frame = updates(&mut *view, FrameContent::Delta);
    assert_eq!(frame.robots.len(), 64);
    assert_eq!(frame.robots[0].id, "2/255/1");
    assert_eq!(view.dropped(), 192);
}

#[test]
fn a_robot_has_its_name_and_when_it_was_lost_at_once_and_once_a_second() {
    let mut view = view("robots");
    let named = |name: &str| Event::RobotNamed { robot: robot(), name: name.to_owned() };
    view.observe(at(0), ViewInput::Event(&named(&"ä".repeat(100))));
    assert!(updates(&mut *view, FrameContent::DeltaAndSummary).robots.is_empty(), "it may be a camera");
    view.observe(at(0), ViewInput::Event(&estimated_event(&estimate())));
    let robot_updates = |view: &mut dyn View, pace| updates(view, pace).robots;
    assert_eq!(robot_updates(&mut *view, FrameContent::Delta)[0].name, Some("ä".repeat(60)));
    assert!(robot_updates(&mut *view, FrameContent::Delta).is_empty());
    let lost = Event::RobotLost { robot: robot(), silence: TimeDelta::from_millis(5_000) };
    view.observe(at(7_000), ViewInput::Event(&lost));
    assert_eq!(robot_updates(&mut *view, FrameContent::Delta)[0].lost_t_s, Some(7.0));
    assert_eq!(robot_updates(&mut *view, FrameContent::DeltaAndSummary)[0].lost_t_s, Some(7.0));
    view.observe(at(8_000), ViewInput::Event(&estimated_event(&estimate())));
    let [part] = &robot_updates(&mut *view, FrameContent::DeltaAndSummary)[..] else {
        panic!("one robot is known");
    };
    assert_eq!((part.lost_t_s, part.name.as_deref().map(str::len)), (None, Some(120)));
}

#[test]
fn every_view_has_a_name_of_its_own() {
    let mut names: Vec<&str> = VIEWS.iter().map(|entry| entry.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), VIEWS.len());
}
