//! Clocks that run wrong, wrap and begin again: observations keep their place in time.
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
use posebridge_protocol::message::{Inertial, Message, TimeSync, WireStamp};
use posebridge_sim::Scenario;
use posebridge_telemetry::{
    BrickClock, Event, HostClock, Observed, Radians, RadiansPerSecond, Span, Stamp, Verdict,
};
use station::{STATION, Station, at, config};
use world::World;

/// A robot whose clock runs wrong by so much and whose 32-bit register wraps eight seconds after the beginning.
fn scenario(skew_ppm: f64) -> Scenario {
    let mut scenario = Scenario::default().with_seed(11);
    scenario.brick.clock_skew_ppm = skew_ppm;
    scenario.brick.clock_start_micros = (1 << 32) - 8_000_000;
    scenario.camera.dropout = 0.0;
    scenario
}

/// How far the stamp of each fix, on the brick's clock, is from the instant at which the camera exposed it, with the station's own
/// idea of that error (one standard deviation), from five seconds after the beginning.
fn alignment_errors(world: &World) -> Vec<(Span, Span)> {
    let settings = world.simulation.scenario().brick;
    let rate = 1.0 + settings.clock_skew_ppm * 1e-6;
    let start = Stamp::<BrickClock>::from_micros(settings.clock_start_micros as i64);
    let mut errors = vec![];
    for event in world.station.events() {
        let Event::Observed { observation, .. } = event else {
            continue;
        };
        let Observed::Fix(seen) = observation.observed else {
            continue;
        };
        let sent = world.simulation.camera_fixes().iter();
        let taken = sent
            .filter(|fix| f64::from(fix.position.x.0 as f32) == seen.position.x.0)
            .find(|fix| f64::from(fix.position.y.0 as f32) == seen.position.y.0);
        let exposed = taken.expect("the camera sent it").exposed;
        if exposed >= Span::from_millis(5_000) {
            let expected = start + Span::from_secs_f64(exposed.as_secs_f64() * rate);
            errors.push((observation.stamp - expected, observation.stamp_sigma));
        }
    }
    errors
}

fn worst_ms(errors: &[(Span, Span)]) -> f64 {
    let sizes = errors.iter().map(|(error, _)| error.as_millis_f64().abs());
    sizes.fold(0.0, f64::max)
}

#[test]
fn fixes_stay_aligned_with_a_clock_that_is_2000_ppm_off_and_wraps() {
    for skew_ppm in [2_000.0, -2_000.0] {
        let mut world = World::new(scenario(skew_ppm), &config());
        world.run_for(25);
        let errors = alignment_errors(&world);
        assert!(errors.len() > 150, "{} fixes", errors.len());
        let worst_ms = worst_ms(&errors);
        println!("{skew_ppm} ppm: worst {worst_ms:.2} ms");
        // The brick's own ticks are a millisecond; without the skew the last fixes would be 50 ms off.
        assert!(worst_ms < 4.0, "{skew_ppm} ppm: {worst_ms} ms");
        for (error, sigma) in errors {
            let bound_ms = 3.0 * sigma.as_millis_f64() + 0.5;
            assert!(
                error.as_millis_f64().abs() < bound_ms,
                "{error:?} {sigma:?}"
            );
        }
        let is_restart = |event: &&Event| matches!(event, Event::BrickRestarted { .. });
        assert_eq!(world.station.events().filter(is_restart).count(), 0);
    }
}

#[test]
fn fixes_are_aligned_at_once_when_a_link_comes_back_after_the_wrap() {
    let mut world = World::new(scenario(-2_000.0), &config());
    world.run_for(6);
    let before = alignment_errors(&world).len();
    world.cut_for(4);
    world.run_for(2);
    let errors = alignment_errors(&world);
    assert!(errors.len() > before + 15, "{}", errors.len());
    let worst_ms = worst_ms(&errors[before..]);
    println!("after the cut: worst {worst_ms:.2} ms");
    assert!(worst_ms < 4.0, "{worst_ms} ms");
}

#[test]
fn across_the_wrap_the_estimate_follows_the_robot() {
    let mut world = World::new(scenario(2_000.0), &config());
    world.run_for(25);
    for truth in world.simulation.truth().iter().rev().take(40) {
        let estimate = world.station.pipeline.estimate_at(truth.brick);
        let estimate = estimate.expect("within the history");
        let error_m =
            (estimate.pose.x.0 - truth.pose.x.0).hypot(estimate.pose.y.0 - truth.pose.y.0);
        assert!(error_m < 0.03, "{error_m} at {:?}", truth.world);
    }
    let verdicts: Vec<Verdict> = world
        .station
        .events()
        .filter_map(|event| match event {
            Event::Fused { record, .. } if record.kind == "fix" => Some(record.verdict),
            _ => None,
        })
        .collect();
    let accepted = verdicts
        .iter()
        .filter(|verdict| **verdict == Verdict::Accepted);
    assert!(accepted.count() as f64 > 0.95 * verdicts.len() as f64);
}

#[test]
fn a_brick_that_restarts_keeps_its_pose_and_is_asked_again() {
    let mut world = World::new(scenario(100.0), &config());
    world.run_for(10);
    let before = world.station.pipeline.latest();
    world.simulation.restart_brick();
    let restarted_at = world.now();
    world.run_for(8);
    let is_restart = |event: &&Event| matches!(event, Event::BrickRestarted { .. });
    assert_eq!(world.station.events().filter(is_restart).count(), 1);
    assert!(world.station.pipeline.latest() < before, "a new clock");

    let truth = world.simulation.truth().last().expect("it is logged");
    let estimate = world.station.pipeline.estimate_at(truth.brick);
    let estimate = estimate.expect("it was observed");
    let error_m = (estimate.pose.x.0 - truth.pose.x.0).hypot(estimate.pose.y.0 - truth.pose.y.0);
    assert!(error_m < 0.03, "{error_m}");
    assert_eq!(estimate.reset_counter, 0, "no jump");
    assert!(!estimate.is_dead_reckoning, "fixes are used again");

    let asked = world.station.sent().filter(|(now, bytes)| {
        let is_request = |message: &Message| matches!(message, Message::SetMessageInterval(_));
        *now > restarted_at && messages(bytes).iter().any(is_request)
    });
    assert_eq!(asked.count(), 2, "once for each message that is wanted");
}

/// Answers every time request that the station has sent since `first`, with a clock that is 100 s ahead of the host's.
fn answer(station: &mut Station, first: usize, now: Stamp<HostClock>) {
    let requests: Vec<i64> = station.outputs[first..]
        .iter()
        .filter_map(|(_, output)| match output {
            posebridge_telemetry::Output::Transmit { bytes, .. } => Some(messages(bytes)),
            posebridge_telemetry::Output::Event(_) => None,
        })
        .flatten()
        .filter_map(|message| match message {
            Message::TimeSync(sync) if sync.answer_nanos == 0 => Some(sync.request_nanos),
            _ => None,
        })
        .collect();
    for request_nanos in requests {
        let answer = Message::TimeSync(TimeSync {
            answer_nanos: now.as_nanos() + 100_000_000_000 - 5_000_000,
            request_nanos,
            target: Some(STATION),
        });
        station.bytes(now, &frame(BRICK, &answer));
    }
}

#[test]
fn answered_requests_align_the_clocks_and_an_answer_from_before_all_time_does_not_restart_them() {
    let mut station = Station::new(&config());
    station.bytes(at(10), &frame(BRICK, &HEARTBEAT));
    for k in 0..20_i64 {
        let now = at(100 + k * 100);
        let sent = station.outputs.len();
        station.pass_until(now);
        let millis = 100_000 + now.as_micros() as u32 / 1_000;
        station.bytes(now, &frame(BRICK, &ticks(millis, 0, 0)));
        answer(&mut station, sent, now + Span::from_millis(10));
    }
    let aligned = station.events().filter_map(|event| match event {
        Event::BrickClockAligned {
            offset,
            uncertainty,
            ..
        } => Some((*offset, *uncertainty)),
        _ => None,
    });
    let (offset, uncertainty) = aligned.last().expect("the clocks are aligned");
    let error = offset - Span::from_millis(100_000);
    assert!(
        error.as_nanos().abs() <= uncertainty.as_nanos(),
        "{error:?} {uncertainty:?}"
    );

    let sent = station.outputs.len();
    station.pass_until(at(4_000));
    let request = station.outputs[sent..]
        .iter()
        .find_map(|(now, output)| {
            let posebridge_telemetry::Output::Transmit { bytes, .. } = output else {
                return None;
            };
            let is_request = |message: &Message| matches!(message, Message::TimeSync(_));
            messages(bytes).iter().any(is_request).then_some(*now)
        })
        .expect("it asks all the time");
    let nonsense = Message::TimeSync(TimeSync {
        answer_nanos: -5,
        request_nanos: request.as_nanos(),
        target: Some(STATION),
    });
    station.bytes(at(4_005), &frame(BRICK, &nonsense));
    assert!(
        !station
            .events()
            .any(|event| matches!(event, Event::BrickRestarted { .. }))
    );
}

/// What the gyro said: the rate in the frame, and its integral.
fn inertial(millis: u32, rate_rad_per_s: f64, turn_rad: f64) -> Vec<u8> {
    let message = Message::Inertial(Inertial {
        stamp: WireStamp::Micros32(millis * 1_000),
        turn_rate: Some(RadiansPerSecond(rate_rad_per_s)),
        turn: Some(Radians(turn_rad)),
        wheel_accelerations: None,
    });
    frame(BRICK, &message)
}

#[test]
fn a_lost_frame_of_the_gyro_costs_nothing_and_an_overtaken_one_spoils_nothing() {
    let mut station = Station::new(&config());
    // Rate 1 rad/s throughout but for the lost frame at 1100, in which the robot turned by 0.3 rad.
    for (arrival_ms, bytes) in [
        (1_000, inertial(1_000, 1.0, 5.0)),
        (1_050, inertial(1_050, 1.0, 5.05)),
        (1_160, inertial(1_150, 1.0, 5.4)),
        (1_170, inertial(1_100, 6.0, 5.35)),
        (1_200, inertial(1_200, 1.0, 5.5)),
    ] {
        station.bytes(at(arrival_ms), &bytes);
    }
    let rates: Vec<f64> = station
        .events()
        .filter_map(|event| match event {
            Event::Observed { observation, .. } => match observation.observed {
                Observed::TurnRate(rate) => Some((rate.0 * 1e3).round() / 1e3),
                _ => None,
            },
            _ => None,
        })
        .collect();
    assert_eq!(rates, [1.0, 1.0, 3.5, 6.0, 2.0]);
}
