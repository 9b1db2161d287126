//! The engine as its callers rely on it: deterministic, never late, never spinning, never panicking.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/station.rs"]
mod station;
#[path = "support/world.rs"]
mod world;

use brick::{BRICK, HEARTBEAT, frame, messages, ticks};
use posebridge_pipeline::{BuildError, OutputInstant, OutputKind, Pipeline, PipelineConfig};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{Message, PlanarPose, SetMessageInterval, VisionFix, WireStamp};
use posebridge_sim::Scenario;
use posebridge_telemetry::{
    Command, Defect, Event, Heading, HostClock, Input, LinkId, LinkState, Meters, Observation,
    Observed, Output, Point2, Pose, Radians, SensorId, Span, Stamp, Verdict,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use station::{LINK, STATION, Station, at, config, link, stream};
use world::World;

/// Twenty seconds of a simulated robot on a square, with the camera.
fn driven(config: &PipelineConfig) -> World {
    let mut world = World::new(Scenario::default().with_seed(4), config);
    world.run_for(20);
    world
}

/// Gives the same inputs to a fresh pipeline.
fn replayed(inputs: &[(Stamp<HostClock>, Input)]) -> Station {
    let mut config = config();
    config.links[0].outputs = all_outputs();
    let mut station = Station {
        pipeline: Pipeline::new(config, Stamp::ZERO).expect("the configuration is good"),
        inputs: vec![],
        outputs: vec![],
    };
    for (now, input) in inputs {
        station.give(*now, input.clone());
    }
    station
}

fn all_outputs() -> Vec<posebridge_pipeline::OutputStream> {
    posebridge_pipeline::OUTPUTS
        .iter()
        .map(|(_, kind)| stream(*kind, 0))
        .collect()
}

/// The inputs of a drive: bytes, link states, ticks.
fn inputs() -> Vec<(Stamp<HostClock>, Input)> {
    driven(&config()).station.inputs
}

/// What was observed and fused, in digits that tell any two numbers apart.
fn observed_and_fused(station: &Station) -> Vec<String> {
    station
        .events()
        .filter(|event| matches!(event, Event::Observed { .. } | Event::Fused { .. }))
        .map(|event| format!("{event:?}"))
        .collect()
}

#[test]
fn the_same_inputs_give_the_same_outputs_bit_for_bit() {
    let inputs = inputs();
    let (one, two) = (replayed(&inputs), replayed(&inputs));
    assert!(one.outputs.len() > 2_000, "{}", one.outputs.len());
    assert!(format!("{:?}", one.outputs) == format!("{:?}", two.outputs));
}

#[test]
fn how_the_bytes_are_cut_changes_neither_what_is_observed_nor_what_is_fused() {
    let inputs = inputs();
    let expected = observed_and_fused(&replayed(&inputs));
    assert!(expected.len() > 1_500, "{}", expected.len());
    for size in [1, 3, 20, 41] {
        let cut: Vec<_> = inputs
            .iter()
            .flat_map(|(now, input)| cut(*now, input, size))
            .collect();
        assert!(cut.len() > inputs.len());
        assert!(
            observed_and_fused(&replayed(&cut)) == expected,
            "in pieces of {size}"
        );
    }
}

fn cut(now: Stamp<HostClock>, input: &Input, size: usize) -> Vec<(Stamp<HostClock>, Input)> {
    let Input::Bytes { link, peer, bytes } = input else {
        return vec![(now, input.clone())];
    };
    let pieces = bytes.chunks(size).map(|piece| {
        let bytes = piece.to_vec();
        (
            now,
            Input::Bytes {
                link: *link,
                peer: *peer,
                bytes,
            },
        )
    });
    pieces.collect()
}

#[test]
fn ticks_at_the_deadlines_and_nowhere_else_miss_nothing_and_do_not_spin() {
    let mut station = Station::new(&config());
    station.bytes(at(100), &frame(BRICK, &HEARTBEAT));
    let mut count = 0;
    while let Some(due) = station.pipeline.deadline().filter(|due| *due <= at(20_000)) {
        station.give(due, Input::Tick);
        let next = station
            .pipeline
            .deadline()
            .expect("there is always a heartbeat");
        assert!(next > due, "after {due:?} comes {next:?}");
        count += 1;
    }
    let sent: Vec<(Stamp<HostClock>, Message)> = station
        .sent()
        .flat_map(|(now, bytes)| {
            messages(bytes)
                .into_iter()
                .map(move |message| (now, message))
        })
        .collect();
    let times = |wanted: fn(&Message) -> bool| -> Vec<Stamp<HostClock>> {
        let wanted = sent.iter().filter(|(_, message)| wanted(message));
        wanted.map(|(now, _)| *now).collect()
    };
    let heartbeats = times(|message| matches!(message, Message::Heartbeat(_)));
    let expected: Vec<_> = (0..=20).map(|k| at(k * 1_000)).collect();
    assert_eq!(heartbeats, expected, "each second, to the nanosecond");
    let requests = times(|message| matches!(message, Message::TimeSync(_)));
    assert!((45..75).contains(&requests.len()), "{}", requests.len());
    // Heartbeats and health share their instants; time requests, interval requests and the loss are the rest.
    assert!(count < 20 + requests.len() + 15, "{count}");
    let lost_at = station.outputs.iter().find_map(|(now, output)| {
        matches!(output, Output::Event(Event::RobotLost { .. })).then_some(*now)
    });
    assert_eq!(lost_at, Some(at(5_100)), "five seconds after it was heard");
    let healths = station
        .events()
        .filter(|event| matches!(event, Event::Health { .. }));
    assert_eq!(healths.count(), 20);
}

#[test]
fn a_frame_that_is_never_finished_is_given_up_at_the_deadline() {
    let mut station = Station::new(&config());
    let torn = frame(BRICK, &ticks(5_000, 0, 0));
    station.bytes(at(320), &torn[..torn.len() - 1]);
    station.pass_until(at(369));
    assert!(!stalled(&station));
    station.pass_until(at(370));
    assert!(stalled(&station));
}

fn stalled(station: &Station) -> bool {
    station.events().any(|event| {
        matches!(
            event,
            Event::Defect {
                defect: Defect::Stall { .. },
                ..
            }
        )
    })
}

#[test]
fn what_comes_to_light_behind_a_torn_frame_is_acted_upon_at_once() {
    let mut station = Station::new(&config());
    station.pass_until(at(250));
    // A whole heartbeat hidden behind the header of a long frame that never ends.
    let torn = [0xFD, 200, 0, 0, 0, 1, 1, 0x4B, 0x01, 0x00];
    station.bytes(at(310), &[&torn[..], &frame(BRICK, &HEARTBEAT)].concat());
    station.pass_until(at(360));
    assert!(
        station
            .events()
            .any(|event| matches!(event, Event::RobotSeen { .. }))
    );
    assert!(station.pipeline.deadline().is_some_and(|due| due > at(360)));
    let asked = station.sent().any(|(now, bytes)| {
        let is_request = |message: &Message| matches!(message, Message::SetMessageInterval(_));
        now == at(360) && messages(bytes).iter().any(is_request)
    });
    assert!(asked, "the robot is asked for its messages");
}

#[test]
fn a_link_that_is_down_gets_nothing_and_begins_anew_when_it_is_up() {
    let mut station = Station::new(&config());
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    let torn = frame(BRICK, &ticks(5_050, 9, 9));
    station.bytes(at(150), &torn[..10]);
    station.link(at(160), LINK, LinkState::Down);
    let before = station.sent().count();
    station.pass_until(at(4_500));
    station.bytes(at(4_600), &frame(BRICK, &ticks(9_500, 4, 4)));
    assert_eq!(station.sent().count(), before, "nothing leaves");
    assert!(!stalled(&station), "half a frame dies with its link");
    station.link(at(4_700), LINK, LinkState::Up);
    station.pass_until(at(6_000));
    assert!(station.sent().count() > before);
    let health = station.events().filter_map(|event| match event {
        Event::Health { health, .. } => Some(*health),
        _ => None,
    });
    let last = health.last().expect("once per second");
    assert_eq!((last.reconnects, last.frames_in), (1, 2));
    let states: Vec<_> = station
        .events()
        .filter_map(|event| match event {
            Event::Link { state, .. } => Some(*state),
            _ => None,
        })
        .collect();
    assert_eq!(states, [LinkState::Up, LinkState::Down, LinkState::Up]);
}

#[test]
fn a_robot_drives_on_through_a_link_that_is_cut() {
    let mut world = World::new(Scenario::default().with_seed(5), &config());
    world.run_for(8);
    world.cut_for(3);
    world.run_for(6);
    let truth = world.simulation.truth().last().expect("it is logged");
    let estimate = world
        .station
        .pipeline
        .estimate_at(truth.brick)
        .expect("it was observed");
    let error_m = (estimate.pose.x.0 - truth.pose.x.0).hypot(estimate.pose.y.0 - truth.pose.y.0);
    assert!(error_m < 0.05, "{error_m}");
    assert_eq!(estimate.reset_counter, 0);
}

/// The messages that a station sent, in order.
fn said(station: &Station) -> Vec<Message> {
    station
        .sent()
        .flat_map(|(_, bytes)| messages(bytes))
        .collect()
}

#[test]
fn a_peer_may_ask_for_a_message_at_an_interval_and_stop_it_again() {
    let mut config = config();
    config.links[0].outputs = vec![];
    let mut station = Station::new(&config);
    let ask = |interval| {
        Message::SetMessageInterval(SetMessageInterval {
            target: STATION,
            message_id: ids::ODOMETRY,
            interval,
        })
    };
    let drive = |station: &mut Station, from_ms: u32| {
        for step in 0..20 {
            let millis = from_ms + step * 50;
            station.bytes(at(i64::from(millis)), &frame(BRICK, &ticks(millis, 0, 0)));
        }
        let odometry = said(station)
            .iter()
            .filter(|message| matches!(message, Message::Odometry(_)))
            .count();
        station.outputs.clear();
        odometry
    };
    assert_eq!(drive(&mut station, 0), 0, "nothing is configured");
    station.bytes(at(1_000), &frame(BRICK, &ask(Some(Span::from_millis(100)))));
    assert_eq!(drive(&mut station, 1_000), 10);
    station.bytes(at(2_000), &frame(BRICK, &ask(None)));
    assert_eq!(drive(&mut station, 2_000), 0);
}

#[test]
fn an_old_fix_that_the_robot_passes_on_is_late_and_no_restart() {
    let mut station = Station::new(&config());
    for step in 0..60 {
        let millis = 1_000 + step * 50;
        station.bytes(at(i64::from(millis)), &frame(BRICK, &ticks(millis, 0, 0)));
    }
    let seen = Message::VisionPosition(VisionFix {
        stamp: WireStamp::Micros64(1_500_000),
        x: Meters(0.0),
        y: Meters(0.0),
        heading: Some(Heading::from_rad(0.0)),
        covariance: None,
        reset_counter: 0,
    });
    station.bytes(at(4_000), &frame(BRICK, &seen));
    assert!(
        !station
            .events()
            .any(|event| matches!(event, Event::BrickRestarted { .. }))
    );
    let fix = station.events().find_map(|event| match event {
        Event::Fused { record, .. } if record.kind == "fix" => Some(record.clone()),
        _ => None,
    });
    let fix = fix.expect("it was held against the estimate of its own time");
    assert_eq!(fix.stamp, Stamp::from_millis(1_500));
    assert_eq!(fix.verdict, Verdict::Accepted);
}

#[test]
fn the_status_message_tells_how_near_the_gate_the_last_fix_was() {
    let mut config = config();
    config.links[0].outputs = vec![stream(OutputKind::EstimatorStatus, 0)];
    let world = driven(&config);
    let ratios: Vec<f64> = said(&world.station)
        .iter()
        .filter_map(|message| match message {
            Message::EstimatorStatus(status) => Some(status.position_ratio),
            _ => None,
        })
        .collect();
    // NIS of three components over 16.27: about 0.18 in the mean, and never above 1 for fixes that are used.
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    assert!((0.08..0.3).contains(&mean), "{mean}");
}

#[test]
fn outputs_keep_their_intervals_and_zero_sends_every_estimate() {
    let mut config = config();
    config.links[0].outputs = vec![
        stream(OutputKind::PlanarPose, 0),
        stream(OutputKind::Odometry, 100),
        stream(OutputKind::Attitude, 1_000),
    ];
    let world = driven(&config);
    let sent: Vec<_> = world
        .station
        .sent()
        .flat_map(|(now, bytes)| {
            messages(bytes)
                .into_iter()
                .map(move |message| (now, message))
        })
        .collect();
    let estimates = world
        .station
        .events()
        .filter(|event| matches!(event, Event::Estimated { .. }));
    let of = |wanted: fn(&Message) -> bool| -> Vec<Stamp<HostClock>> {
        let wanted = sent.iter().filter(|(_, message)| wanted(message));
        wanted.map(|(now, _)| *now).collect()
    };
    let poses = of(|message| matches!(message, Message::PlanarPose(_)));
    assert_eq!(poses.len(), estimates.count());
    for (instants, interval_ms, at_least) in [
        (
            of(|message| matches!(message, Message::Odometry(_))),
            100,
            120,
        ),
        (
            of(|message| matches!(message, Message::Attitude { .. })),
            1_000,
            18,
        ),
    ] {
        let shortest = instants.windows(2).map(|pair| pair[1] - pair[0]).min();
        assert!(
            shortest >= Some(Span::from_millis(interval_ms)),
            "{shortest:?}"
        );
        assert!(instants.len() >= at_least, "{}", instants.len());
    }
}

#[test]
fn an_estimate_for_its_arrival_lies_ahead_and_says_that_it_is_predicted() {
    let mut config = config();
    config.links[0].outputs[0].instant = OutputInstant::Arrival;
    let ahead = planar_poses(&driven(&config));
    let (predicted, observed): (Vec<&(PlanarPose, u32)>, Vec<_>) =
        ahead.iter().partition(|(pose, _)| pose.flags.predicted);
    assert!(
        predicted.len() > 400 && observed.len() < 40,
        "{}",
        observed.len()
    );
    // Link and brick take 10 to 20 ms each way; 50 ms of telemetry period and as much again bound the rest.
    for (pose, latest_micros) in predicted {
        let lead_micros = micros(pose).wrapping_sub(*latest_micros) as i32;
        assert!((1..150_000).contains(&lead_micros), "{lead_micros}");
    }
    let present = planar_poses(&driven(&station::config()));
    for (pose, latest_micros) in &present {
        assert!(!pose.flags.predicted);
        assert_eq!(micros(pose), *latest_micros);
    }
}

/// Every pose that was sent, with the wrapped microseconds of the estimate from which it was made.
fn planar_poses(world: &World) -> Vec<(PlanarPose, u32)> {
    let mut latest = 0;
    let mut poses = vec![];
    for (_, output) in &world.station.outputs {
        match output {
            Output::Event(Event::Estimated { estimate, .. }) => {
                latest = estimate.stamp.as_micros() as u32;
            }
            Output::Transmit { bytes, .. } => {
                poses.extend(
                    messages(bytes)
                        .into_iter()
                        .filter_map(|message| match message {
                            Message::PlanarPose(pose) => Some((pose, latest)),
                            _ => None,
                        }),
                );
            }
            Output::Event(_) => {}
        }
    }
    poses
}

fn micros(pose: &PlanarPose) -> u32 {
    let WireStamp::Micros32(micros) = pose.stamp else {
        panic!("the stamp has 32 bits on the wire");
    };
    micros
}

#[test]
fn a_configuration_that_cannot_be_is_refused_with_its_reason() {
    let mut unknown = config();
    unknown.filter = "magic".to_owned();
    let error = Pipeline::new(unknown, Stamp::ZERO)
        .err()
        .expect("no such filter");
    let told = error.to_string();
    assert!(
        told.starts_with("unknown filter `magic`; there are: odometry, pose, "),
        "{told}"
    );
    let mut doubled = config();
    doubled.links.push(link(LINK, vec![]));
    let error = Pipeline::new(doubled, Stamp::ZERO)
        .err()
        .expect("one id twice");
    assert_eq!(error, BuildError::DuplicateLink { id: LINK });
}

#[test]
fn a_pose_that_is_commanded_is_believed_and_one_that_cannot_be_is_refused_in_words() {
    let mut station = Station::new(&config());
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    let set = |x_m| {
        Input::Command(Command::SetPose {
            pose: Pose::new(Meters(x_m), Meters(2.0), Heading::from_rad(0.1)),
            position_sigma_m: 0.01,
            heading_sigma_rad: 0.1,
        })
    };
    station.give(at(200), set(1.5));
    station.give(at(300), set(f64::NAN));
    let last = station.events().filter_map(|event| match event {
        Event::Estimated { estimate, .. } => Some(*estimate),
        _ => None,
    });
    let last = last.last().expect("it was told");
    assert_eq!((last.pose.x.0, last.reset_counter), (1.5, 1));
    let texts: Vec<_> = station
        .events()
        .filter_map(|event| match event {
            Event::Text { source, text, .. } => Some((*source, text.as_str())),
            _ => None,
        })
        .collect();
    assert_eq!(
        texts,
        [(
            STATION,
            "the pose was not set: a number is not finite or a sigma is negative"
        )]
    );
}

/// Any input, with the time since the one before in milliseconds.
fn any_input() -> impl Strategy<Value = (i64, Input)> {
    let link = prop_oneof![4 => Just(LINK), 1 => Just(LinkId(9))];
    let tempting = prop_oneof![3 => any::<u8>(), 1 => Just(0xFD_u8), 2 => 0_u8..10];
    let frames = (any::<u32>(), any::<i32>(), any::<u8>()).prop_map(|(millis, count, who)| {
        let source = posebridge_telemetry::Address::new(1, who % 3);
        let count = i64::from(count);
        frame(source, &ticks(millis / 1_000, count, -count))
    });
    let bytes = prop_oneof![
        2 => prop::collection::vec(tempting, 0..300),
        2 => frames,
        1 => Just(frame(BRICK, &HEARTBEAT)),
    ];
    let peer = (0_u32..3).prop_map(posebridge_telemetry::PeerId);
    let bytes = (link.clone(), peer, bytes).prop_map(|(link, peer, bytes)| Input::Bytes {
        link,
        peer,
        bytes,
    });
    let state = prop_oneof![Just(LinkState::Up), Just(LinkState::Down)];
    let state = (link, state).prop_map(|(link, state)| Input::Link { link, state });
    let number = prop_oneof![4 => -100.0..100.0, 1 => any::<f64>()];
    let numbers = (
        number.clone(),
        number.clone(),
        number,
        any::<i64>(),
        0_u8..4,
    );
    let values = numbers.prop_map(|(a, b, c, nanos, kind)| input_of((a, b, c), nanos, kind));
    let wait_ms =
        prop_oneof![6 => 0_i64..120, 1 => 0_i64..100_000, 1 => any::<u32>().prop_map(i64::from)];
    let input = prop_oneof![6 => bytes, 1 => state, 3 => values, 1 => Just(Input::Tick)];
    (wait_ms, input)
}

fn input_of((a, b, c): (f64, f64, f64), nanos: i64, kind: u8) -> Input {
    let observed = match kind {
        0 => {
            return Input::Command(Command::SetPose {
                pose: Pose::new(Meters(a), Meters(b), Heading::from_rad(c)),
                position_sigma_m: a,
                heading_sigma_rad: b,
            });
        }
        1 => Observed::TurnRate(posebridge_telemetry::RadiansPerSecond(a)),
        2 => Observed::WheelAngles {
            left: Radians(a),
            right: Radians(b),
        },
        _ => Observed::Fix(posebridge_telemetry::Fix {
            position: Point2::new(Meters(a), Meters(b)),
            heading: Some(Heading::from_rad(c)),
            covariance: None,
            tag_in_body: Point2::new(Meters(c), Meters(a)),
            reset_counter: 0,
        }),
    };
    Input::Observation(Observation {
        sensor: SensorId(kind),
        // Mostly within some seconds, now and then anywhere.
        stamp: Stamp::from_nanos(if nanos % 7 == 0 {
            nanos
        } else {
            nanos % 5_000_000_000
        }),
        stamp_sigma: Span::from_nanos(nanos % 50_000_000),
        observed,
    })
}

fn cases() -> ProptestConfig {
    ProptestConfig {
        cases: 300,
        rng_seed: RngSeed::Fixed(20_260_103),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn whatever_comes_the_engine_neither_panics_nor_spins(
        inputs in prop::collection::vec(any_input(), 1..60),
        begin in prop_oneof![3 => Just(0_i64), 1 => any::<i64>(), 1 => Just(i64::MAX - 5)],
    ) {
        let mut config = config();
        config.links[0].outputs = all_outputs();
        let mut station = Station::new(&config);
        let mut now = Stamp::from_nanos(begin.max(0));
        for (wait_ms, input) in inputs {
            now = now + Span::from_millis(wait_ms);
            station.give(now, input);
            let due = station.pipeline.deadline().expect("there is always a heartbeat");
            // At the end of all time there is no later instant.
            prop_assert!(due > now || due == Stamp::from_nanos(i64::MAX), "{due:?} at {now:?}");
        }
    }
}
