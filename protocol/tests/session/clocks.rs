//! What depends on the clock itself: one that wraps, two that differ, and instants at which nothing is due.

use posebridge_protocol::message::Message;
use posebridge_protocol::session::{Session, SessionConfig, SessionOutput};
use posebridge_telemetry::{BrickClock, HostClock, TimeDelta, Timestamp};

use crate::{CAMERA, Output, ROBOT, ROVER, STATION, at, quiet};

#[test]
fn a_clock_that_wraps_does_not_stop_the_heartbeats() {
    let wrap = 1_i64 << 32;
    let micros = |total: i64| Timestamp::<BrickClock>::from_micros(total % wrap);
    let start = wrap - 1_500_000;
    let mut session = Session::new(SessionConfig { own: ROBOT, ..quiet() }, micros(start));
    let mut beats = 0;
    for step in 0..400 {
        session.tick(micros(start + step * 10_000));
        while let Some(output) = session.poll() {
            beats += usize::from(matches!(output, SessionOutput::Send(Message::Heartbeat(_))));
        }
    }
    // Four seconds: the beats of 0, 1, 2 and 3 s, up to one step late at the wrap.
    assert_eq!(beats, 4);
}

#[test]
fn two_sessions_measure_each_other() {
    // A brick whose clock is 2 s behind, on a link that takes 5 ms each way.
    let offset = TimeDelta::from_millis(-2_000);
    let mut station = Session::<HostClock>::new(
        SessionConfig { timesync_period: Some(TimeDelta::from_millis(1_000)), ..quiet() },
        at(3_000),
    );
    let brick_time = |host: Timestamp<HostClock>| Timestamp::<BrickClock>::from_nanos((host + offset).as_nanos());
    let mut brick =
        Session::<BrickClock>::new(SessionConfig { own: ROBOT, heartbeat: ROVER, ..quiet() }, brick_time(at(3_000)));
    station.tick(at(3_000));
    while let Some(output) = station.poll() {
        if let SessionOutput::Send(message) = output {
            brick.handle(brick_time(at(3_005)), STATION, &message);
        }
    }
    let mut exchanges = Vec::new();
    while let Some(output) = brick.poll() {
        if let SessionOutput::Send(message) = output {
            station.handle(at(3_010), ROBOT, &message);
        }
    }
    while let Some(output) = station.poll() {
        exchanges.push(output);
    }
    let expected =
        Output::TimeExchanged { peer: ROBOT, sent: at(3_000), received: at(3_010), peer_nanos: 1_005_000_000 };
    assert_eq!(exchanges, [expected]);
}

#[test]
fn where_nothing_is_due_a_tick_does_nothing_and_where_something_is_it_is_known() {
    let config = SessionConfig {
        timesync_period: Some(TimeDelta::from_millis(700)),
        requested_messages: vec![(30, TimeDelta::from_millis(50)), (31, TimeDelta::from_millis(50))],
        ..quiet()
    };
    // One that is asked before each tick, and one that is ticked whatever it is asked.
    let mut asked = Session::<HostClock>::new(config.clone(), at(0));
    asked.offer_parameters([("A".to_owned(), 1.0), ("B".to_owned(), 2.0)].into_iter());
    let mut ticked = Session::<HostClock>::new(config, at(0));
    ticked.offer_parameters([("A".to_owned(), 1.0), ("B".to_owned(), 2.0)].into_iter());
    let (mut due, mut idle) = (0, 0);
    for step in 0..4_000_i64 {
        let now = at(step * 7 + step % 3);
        let heard = match step % 400 {
            0..200 if step % 10 == 0 => Some((ROBOT, Message::Heartbeat(ROVER))),
            250 => Some((CAMERA, Message::ParamRequestList { target: STATION })),
            _ => None,
        };
        if let Some((from, message)) = heard {
            asked.handle(now, from, &message);
            ticked.handle(now, from, &message);
        }
        if step == 1_000 {
            asked.peer_restarted(now, ROBOT);
            ticked.peer_restarted(now, ROBOT);
        }
        assert_eq!(asked.deadline(), ticked.deadline(), "step {step}");
        let is_due = asked.deadline().is_some_and(|deadline| deadline <= now);
        assert_eq!(asked.is_due(now), is_due, "step {step}");
        if is_due {
            asked.tick(now);
            due += 1;
        } else {
            idle += 1;
        }
        ticked.tick(now);
        let said = std::iter::from_fn(|| asked.poll());
        let expected = std::iter::from_fn(|| ticked.poll());
        assert!(said.eq(expected), "step {step}");
    }
    assert!(due > 50 && idle > 1_000, "{due} {idle}");
}
