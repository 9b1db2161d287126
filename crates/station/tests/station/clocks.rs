//! Clocks that run wrong, wrap and begin again: observations keep their place in time.

use crate::support::simulation::StationSimulation;
use crate::support::{
    AlignedObservation, BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, link, messages, ticks, time_answer,
    vision_fix,
};
use posebridge_protocol::message::{Inertial, Message, VisionFix, WireStamp};
use posebridge_sim::Scenario;
use posebridge_telemetry::{
    Address, BrickClock, Event, FusionOutcome, HostClock, LinkId, ObservationKind, PeerId, Radians, RadiansPerSecond,
    SensorId, TimeDelta, Timestamp,
};

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
fn alignment_errors(setup: &StationSimulation) -> Vec<(TimeDelta, TimeDelta)> {
    let settings = setup.simulation.scenario().brick;
    let rate = 1.0 + settings.clock_skew_ppm * 1e-6;
    let start = Timestamp::<BrickClock>::from_micros(settings.clock_start_micros as i64);
    let mut errors = vec![];
    for AlignedObservation { observation, .. } in setup.station.aligned() {
        let ObservationKind::Fix(measured) = observation.measurement else {
            continue;
        };
        let sent = setup.simulation.camera_fixes().iter();
        let taken = sent
            .filter(|fix| f64::from(fix.position.x.0 as f32) == measured.position.x.0)
            .find(|fix| f64::from(fix.position.y.0 as f32) == measured.position.y.0);
        let exposed = taken.expect("the camera sent it").exposed;
        if exposed >= TimeDelta::from_millis(5_000) {
            let expected = start + TimeDelta::from_secs_f64(exposed.as_secs_f64() * rate);
            errors.push((observation.stamp - expected, observation.stamp_sigma));
        }
    }
    errors
}

fn worst_ms(errors: &[(TimeDelta, TimeDelta)]) -> f64 {
    let sizes = errors.iter().map(|(error, _)| error.as_millis_f64().abs());
    sizes.fold(0.0, f64::max)
}

#[test]
fn fixes_stay_aligned_and_the_estimate_follows_with_a_clock_that_is_2000_ppm_off_and_wraps() {
    for skew_ppm in [2_000.0, -2_000.0] {
        let mut setup = StationSimulation::new(scenario(skew_ppm), &config());
        setup.run_for(25);
        let errors = alignment_errors(&setup);
        assert!(errors.len() > 150, "{} fixes", errors.len());
        let worst_ms = worst_ms(&errors);
        println!("{skew_ppm} ppm: worst {worst_ms:.2} ms");
        // The brick's own ticks are a millisecond; without the skew the last fixes would be 50 ms off.
        assert!(worst_ms < 4.0, "{skew_ppm} ppm: {worst_ms} ms");
        for (error, sigma) in errors {
            let bound_ms = 3.0 * sigma.as_millis_f64() + 0.5;
            assert!(error.as_millis_f64().abs() < bound_ms, "{error:?} {sigma:?}");
        }
        assert_eq!(setup.station.restarts(), []);
        check_estimate(&setup, 40);
        let verdicts = setup.station.verdicts("fix");
        let accepted = verdicts.iter().filter(|verdict| **verdict == FusionOutcome::Accepted);
        assert!(accepted.count() as f64 > 0.95 * verdicts.len() as f64);
    }
}

/// The estimate has followed the robot to its last `count` poses, without a jump.
fn check_estimate(setup: &StationSimulation, count: usize) {
    for truth in setup.simulation.truth().iter().rev().take(count) {
        let estimate = setup.station.engine.first_robot().estimate_at(truth.brick_time);
        let estimate = estimate.expect("within the history");
        let error_m = (estimate.pose.x.0 - truth.pose.x.0).hypot(estimate.pose.y.0 - truth.pose.y.0);
        assert!(error_m < 0.03, "{error_m} at {:?}", truth.sim_time);
        assert_eq!(estimate.reset_counter, 0);
    }
}

#[test]
fn fixes_are_aligned_at_once_when_a_link_comes_back_after_the_wrap() {
    let mut setup = StationSimulation::new(scenario(-2_000.0), &config());
    setup.run_for(6);
    let before = alignment_errors(&setup).len();
    setup.cut_for(4);
    setup.run_for(2);
    let errors = alignment_errors(&setup);
    assert!(errors.len() > before + 15, "{}", errors.len());
    let worst_ms = worst_ms(&errors[before..]);
    println!("after the cut: worst {worst_ms:.2} ms");
    assert!(worst_ms < 4.0, "{worst_ms} ms");
    check_estimate(&setup, 10);
}

#[test]
fn a_brick_that_restarts_keeps_its_pose_and_gets_its_requests_again() {
    let mut setup = StationSimulation::new(scenario(100.0), &config());
    setup.run_for(10);
    let before = setup.station.engine.first_robot().latest_time();
    setup.simulation.restart_brick();
    let restarted_at = setup.now();
    setup.run_for(8);
    assert_eq!(setup.station.restarts().len(), 1);
    assert!(setup.station.engine.first_robot().latest_time() < before, "a new clock");

    check_estimate(&setup, 1);
    assert!(!setup.station.last_estimate().is_dead_reckoning, "fixes are used again");

    let requests = setup.station.sent().filter(|sent| {
        let is_request = |message: &Message| matches!(message, Message::SetMessageInterval(_));
        sent.now > restarted_at && messages(sent.bytes).iter().any(is_request)
    });
    assert_eq!(requests.count(), 2, "once for each message that is wanted");
}

/// Answers every time request that the station has sent since `first`, as `source` with a clock that is so many milliseconds
/// ahead of the host's.
fn answer(station: &mut TestStation, first: usize, now: Timestamp<HostClock>, (source, ahead_ms): (Address, i64)) {
    for request in station.time_requests(first) {
        let answer = time_answer(now.as_nanos() + ahead_ms * 1_000_000 - 5_000_000, request.nanos);
        station.bytes(now, &frame(source, &answer));
    }
}

const CAMERA: Address = Address::new(200, 1);

/// A fix of a camera whose clock is so many milliseconds ahead.
fn fix(exposed: Timestamp<HostClock>, ahead_ms: i64) -> Vec<u8> {
    let fix = VisionFix { heading: None, ..vision_fix(exposed.as_micros() / 1_000 + ahead_ms, 0.0) };
    frame(CAMERA, &Message::VisionPosition(fix))
}

/// Half a second in which brick and camera answer, without telemetry.
fn station_without_telemetry() -> TestStation {
    let mut station = TestStation::new(&config());
    station.bytes(at(10), &frame(BRICK, &HEARTBEAT));
    for k in 0..6_i64 {
        let now = at(100 + k * 100);
        let sent = station.outputs.len();
        station.pass_until(now);
        for (source, ahead_ms) in [(BRICK, 100_000), (CAMERA, 500_000)] {
            answer(&mut station, sent, now + TimeDelta::from_millis(10), (source, ahead_ms));
        }
    }
    station
}

#[test]
fn what_a_brick_answered_before_its_first_telemetry_is_known_when_it_becomes_the_robot() {
    let mut station = station_without_telemetry();
    station.bytes(at(650), &frame(BRICK, &ticks(100_640, 0, 0)));
    station.bytes(at(660), &fix(at(640), 500_000));
    let mut aligned = station.aligned();
    aligned.retain(|aligned| aligned.observation.sensor == SensorId::CAMERA);
    let [fix] = aligned[..] else {
        panic!("the fix is placed at once: {aligned:?}");
    };
    let error_ms = (fix.observation.stamp - Timestamp::from_millis(100_640)).as_millis_f64();
    assert!(error_ms.abs() < 10.0, "{error_ms}");
    assert!(!station.events().any(|event| matches!(event, Event::ReceiveError { .. } | Event::BrickRestarted { .. })));
}

#[test]
fn a_restarted_camera_gets_time_requests_at_once() {
    let mut station = station_without_telemetry();
    station.bytes(at(650), &frame(BRICK, &ticks(100_640, 0, 0)));
    station.pass_until(at(5_000));
    // It shows its uptime from the start, 495 s less than before.
    station.bytes(at(5_010), &fix(at(5_000), -4_000));
    let first_output = station.outputs.len();
    station.pass_until(at(6_000));
    let quick = station.time_requests(first_output).len();
    assert!(quick >= 9, "{quick} requests in a second");
    assert_eq!(station.unaligned(CAMERA), [at(5_010)]);
    assert_eq!(station.restarts(), []);
}

#[test]
fn answered_requests_align_the_clocks_and_an_impossibly_early_answer_does_not_restart_them() {
    let mut station = TestStation::new(&config());
    station.bytes(at(10), &frame(BRICK, &HEARTBEAT));
    for k in 0..20_i64 {
        let now = at(100 + k * 100);
        let sent = station.outputs.len();
        station.pass_until(now);
        let millis = 100_000 + now.as_micros() as u32 / 1_000;
        station.bytes(now, &frame(BRICK, &ticks(millis, 0, 0)));
        answer(&mut station, sent, now + TimeDelta::from_millis(10), (BRICK, 100_000));
    }
    let (offset, uncertainty) = *station.clock_offsets().last().expect("the clocks are aligned");
    let error = offset - TimeDelta::from_millis(100_000);
    assert!(error.as_nanos().abs() <= uncertainty.as_nanos(), "{error:?} {uncertainty:?}");

    let sent = station.outputs.len();
    station.pass_until(at(4_000));
    let request = station.time_requests(sent)[0];
    station.bytes(at(4_005), &frame(BRICK, &time_answer(-5, request.nanos)));
    assert_eq!(station.restarts(), []);
}

/// The gyro's reading: the rate in the frame, and its integral.
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
    let mut station = TestStation::new(&config());
    // Rate 1 rad/s throughout but for the lost frame at 1100, in which the robot turned by 0.3 rad.
    for (arrival_ms, bytes) in [
        (1_000, inertial(1_000, 1.0, 5.0)),
        (1_050, inertial(1_050, 1.0, 5.05)),
        (1_160, inertial(1_150, 1.0, 5.4)),
        (1_170, inertial(1_100, 6.0, 5.35)),
        (1_200, inertial(1_200, 1.0, 5.5)),
        // A gap says nothing; then across the wrap of 32 bits of microradians.
        (3_000, inertial(3_000, 9.0, 2_147.473_648)),
        (3_100, inertial(3_100, 9.0, -2_147.473_648)),
    ] {
        station.bytes(at(arrival_ms), &bytes);
    }
    let rates = station.aligned().into_iter().filter_map(|aligned| match aligned.observation.measurement {
        ObservationKind::TurnRate(rate) => Some((rate.0 * 1e3).round() / 1e3),
        _ => None,
    });
    assert_eq!(rates.collect::<Vec<_>>(), [1.0, 1.0, 3.5, 6.0, 2.0, 9.0, 0.2]);
}

/// A link beside the robot's, whose inputs may be handled out of their order in time.
const BESIDE: LinkId = LinkId(4);

/// A minute of a brick whose clock is so many per cent faster than the host's and that answers each request at once: how
/// often its clock could not be aligned.
fn clock_warnings_at_rate_error(percent: i64) -> usize {
    let mut station = TestStation::new(&config());
    station.bytes(at(1), &frame(BRICK, &HEARTBEAT));
    let mut first_output = 0;
    for k in 0..1_200_i64 {
        let now = at(20 + k * 50);
        station.pass_until(now);
        let brick_ms = (k * 50) * (100 + percent) / 100 + 5_000;
        let requests = station.time_requests(first_output);
        first_output = station.outputs.len();
        station.bytes(now, &frame(BRICK, &ticks(brick_ms as u32, 0, 0)));
        for request in requests {
            station.bytes(now, &frame(BRICK, &time_answer(brick_ms * 1_000_000, request.nanos)));
        }
    }
    station.unaligned(BRICK).len()
}

#[test]
fn a_clock_that_cannot_be_aligned_is_reported() {
    assert_eq!(clock_warnings_at_rate_error(0), 0);
    assert_eq!(clock_warnings_at_rate_error(1), 0);
    assert!(clock_warnings_at_rate_error(3) > 3);
}

/// Twenty seconds of a brick that answers on one link while the inputs of another one are stamped later and handled first.
/// How many exchanges of time came of it, and how many robots were lost.
fn exchanges_beside_a_link_ahead(ahead_ms: i64) -> (usize, usize) {
    let mut config = config();
    config.links.push(link(BESIDE, vec![]));
    let mut station = TestStation::new(&config);
    station.bytes(at(1), &frame(BRICK, &HEARTBEAT));
    let (mut first_output, mut pending) = (0, Vec::new());
    for k in 0..2_000_i64 {
        let now = at(20 + k * 10);
        if k % 5 == 0 {
            station.bytes(now, &frame(BRICK, &ticks(5_000 + k as u32 * 10, 0, 0)));
        }
        if k % 100 == 0 {
            station.bytes(now, &frame(BRICK, &HEARTBEAT));
        }
        pending.extend(station.time_requests(first_output).into_iter().filter(|request| request.link == LINK));
        // No reply comes before its request, and each direction takes a while.
        for request in pending.extract_if(.., |request| Timestamp::from_nanos(request.nanos + 5_000_000) <= now) {
            station.bytes(now, &frame(BRICK, &time_answer(request.nanos + 4_982_000_000, request.nanos)));
        }
        first_output = station.outputs.len();
        let ahead = now + TimeDelta::from_millis(ahead_ms);
        station.bytes_from(ahead, BESIDE, PeerId::default(), &frame(Address::new(7, 7), &HEARTBEAT));
    }
    let exchanges = station.count(|event| matches!(event, Event::BrickClockAligned { .. }));
    (exchanges, station.count(|event| matches!(event, Event::RobotLost { .. })))
}

#[test]
fn arrivals_of_several_links_that_are_handled_out_of_order_lose_no_exchange_and_no_peer() {
    let (in_order, _) = exchanges_beside_a_link_ahead(0);
    assert!(in_order > 40, "{in_order}");
    // Ten milliseconds from one input of the first link to the next: from 10 on its inputs are behind.
    for ahead_ms in [9, 12, 25, 80] {
        let (exchanges, lost) = exchanges_beside_a_link_ahead(ahead_ms);
        assert!(in_order.abs_diff(exchanges) <= 2, "{ahead_ms} ms: {exchanges} of {in_order}");
        assert_eq!(lost, 0, "{ahead_ms} ms");
    }
}

#[test]
fn an_observation_keeps_the_instant_at_which_its_bytes_came() {
    let mut config = config();
    config.links.push(link(BESIDE, vec![]));
    let mut station = TestStation::new(&config);
    station.bytes_from(at(140), BESIDE, PeerId::default(), &frame(Address::new(7, 7), &HEARTBEAT));
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    let [observed] = station.aligned()[..] else { panic!("one observation") };
    assert_eq!(observed.arrival, at(100));
}
