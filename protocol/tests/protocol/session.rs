//! The conversation in virtual time: heartbeats, time, intervals, commands, parameters, and clocks that wrap or differ.

use posebridge_protocol::message::{
    CommandAck, CommandInt, CommandLong, CommandResult, Heartbeat, Message, SetMessageInterval, TextPart, TimeSync,
};
use posebridge_protocol::session::{RequestedMessages, Session, SessionConfig, SessionOutput};
use posebridge_telemetry::{Address, BrickClock, HostClock, TimeDelta, Timestamp};

use crate::support::{CAMERA, GCS, ROBOT, ROVER, STATION, at};

const SET_MESSAGE_INTERVAL: u16 = 511;

const ONBOARD: Heartbeat = Heartbeat { vehicle_type: 18, autopilot: 8, base_mode: 0, system_status: 4 };

type Output = SessionOutput<HostClock>;

fn quiet() -> SessionConfig {
    SessionConfig {
        own: STATION,
        heartbeat: ONBOARD,
        heartbeat_period: TimeDelta::from_millis(1_000),
        timesync_period: None,
        peer_timeout: TimeDelta::from_millis(3_000),
        requested_messages: RequestedMessages::default(),
        offered_messages: vec![],
    }
}

/// A station and its clock, stepped from deadline to deadline.
struct Station {
    session: Session<HostClock>,
    now: Timestamp<HostClock>,
}

impl Station {
    fn new(config: SessionConfig) -> Self {
        Self { session: Session::new(config, at(0)), now: at(0) }
    }

    /// Lets time pass, waking at every deadline; returns what came out, with its time in milliseconds.
    fn run_until(&mut self, end: Timestamp<HostClock>) -> Vec<(i64, Output)> {
        let mut outputs = Vec::new();
        while let Some(deadline) = self.session.deadline()
            && deadline <= end
        {
            self.now = deadline.max(self.now);
            self.session.tick(self.now);
            while let Some(output) = self.session.poll() {
                outputs.push((self.now.as_micros() / 1_000, output));
            }
        }
        self.now = end;
        outputs
    }

    /// Hears a message at the present time; returns what came out.
    fn receive(&mut self, from: Address, message: &Message) -> Vec<Output> {
        self.session.handle(self.now, from, message);
        std::iter::from_fn(|| self.session.poll()).collect()
    }
}

fn sent(outputs: &[(i64, Output)]) -> Vec<(i64, Message)> {
    outputs
        .iter()
        .filter_map(|(millis, output)| match output {
            SessionOutput::Send(message) => Some((*millis, message.clone())),
            _ => None,
        })
        .collect()
}

fn times_of(outputs: &[(i64, Output)], matches: impl Fn(&Message) -> bool) -> Vec<i64> {
    sent(outputs).iter().filter(|(_, message)| matches(message)).map(|(millis, _)| *millis).collect()
}

fn is_time_request(message: &Message) -> bool {
    matches!(message, Message::TimeSync(TimeSync { answer_nanos: 0, .. }))
}

fn request(nanos: i64, target: Option<Address>) -> Message {
    Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: nanos, target })
}

fn answer(peer_nanos: i64, echoed: Timestamp<HostClock>, target: Option<Address>) -> Message {
    Message::TimeSync(TimeSync { answer_nanos: peer_nanos, request_nanos: echoed.as_nanos(), target })
}

#[test]
fn heartbeats_come_once_per_period_and_missed_ones_are_not_made_up_for() {
    let mut station = Station::new(quiet());
    let outputs = station.run_until(at(3_500));
    let expected = [0, 1_000, 2_000, 3_000].map(|millis| (millis, Message::Heartbeat(ONBOARD)));
    assert_eq!(sent(&outputs), expected);
    let session = &mut station.session;
    session.tick(at(10_300));
    assert_eq!(std::iter::from_fn(|| session.poll()).count(), 1);
    assert_eq!(session.deadline(), Some(at(11_300)));
    session.tick(at(11_700));
    assert_eq!(session.deadline(), Some(at(12_300)), "a late one leaves the rhythm as it is");
}

#[test]
fn peers_are_seen_lost_and_seen_again() {
    let mut station = Station::new(quiet());
    let peer_seen = Output::PeerSeen { peer: ROBOT, heartbeat: ROVER };
    assert_eq!(station.receive(ROBOT, &Message::Heartbeat(ROVER)), std::slice::from_ref(&peer_seen));
    station.run_until(at(2_000));
    // Anything keeps it alive.
    let text = Message::StatusText { severity: 6, text: String::new(), part: TextPart::default() };
    assert!(station.receive(ROBOT, &text).is_empty());
    let outputs = station.run_until(at(6_000));
    let lost: Vec<_> = outputs.iter().filter(|(_, output)| matches!(output, SessionOutput::PeerLost { .. })).collect();
    let expected = Output::PeerLost { peer: ROBOT, silence: TimeDelta::from_millis(3_000) };
    assert_eq!(lost, [&(5_000, expected)]);
    assert_eq!(station.receive(ROBOT, &Message::Heartbeat(ROVER)), [peer_seen]);
    assert!(station.receive(ROBOT, &Message::Heartbeat(ROVER)).is_empty());
}

#[test]
fn a_clock_that_is_set_back_delays_no_peer_s_loss() {
    let mut station = Station::new(quiet());
    station.run_until(at(3_600_000));
    station.receive(ROBOT, &Message::Heartbeat(ROVER));
    station.now = at(5);
    station.session.tick(station.now);
    let outputs = station.run_until(at(10_000));
    let lost = outputs.iter().find(|(_, output)| matches!(output, SessionOutput::PeerLost { .. }));
    assert_eq!(lost.map(|(millis, _)| *millis), Some(3_005));
}

#[test]
fn our_own_echo_is_ignored() {
    let mut station = Station::new(quiet());
    assert!(station.receive(STATION, &Message::Heartbeat(ONBOARD)).is_empty());
    assert!(station.receive(STATION, &request(5, None)).is_empty());
}

#[test]
fn time_requests_for_us_or_everybody_are_answered() {
    let mut station = Station::new(quiet());
    station.run_until(at(250));
    let answered = |request_nanos| {
        Output::Send(Message::TimeSync(TimeSync { answer_nanos: 250_000_000, request_nanos, target: Some(ROBOT) }))
    };
    for target in [None, Some(STATION), Some(Address::new(1, 0))] {
        assert_eq!(station.receive(ROBOT, &request(77, target)), [answered(77)]);
    }
    for target in [CAMERA, Address::new(2, 197)] {
        assert!(station.receive(ROBOT, &request(77, Some(target))).is_empty());
    }
}

#[test]
fn an_answer_is_never_a_request() {
    let mut session = Session::<BrickClock>::new(quiet(), Timestamp::ZERO);
    session.handle(Timestamp::ZERO, CAMERA, &request(1, None));
    let output = session.poll();
    let Some(SessionOutput::Send(Message::TimeSync(sync))) = output else {
        panic!("{output:?}");
    };
    assert_ne!(sync.answer_nanos, 0);
}

#[test]
fn ten_quick_time_requests_then_the_period_and_again_for_a_new_peer() {
    let mut station = Station::new(SessionConfig { timesync_period: Some(TimeDelta::from_millis(1_000)), ..quiet() });
    let times = times_of(&station.run_until(at(5_050)), is_time_request);
    let expected: Vec<i64> = (0..10).map(|index| index * 100).chain((1..=5).map(|second| second * 1_000)).collect();
    assert_eq!(times, expected);
    station.receive(ROBOT, &Message::Heartbeat(ROVER));
    let times = times_of(&station.run_until(at(7_500)), is_time_request);
    let expected: Vec<i64> = (0..10).map(|index| 5_150 + index * 100).chain([6_150, 7_150]).collect();
    assert_eq!(times, expected);
}

#[test]
fn only_true_fresh_and_first_answers_count() {
    let mut station = Station::new(SessionConfig { timesync_period: Some(TimeDelta::from_millis(1_000)), ..quiet() });
    station.run_until(at(104));
    let exchanged = |peer| Output::TimeExchanged { peer, sent: at(100), received: at(104), peer_nanos: 9_000 };
    let good = answer(9_000, at(100), Some(STATION));
    assert_eq!(station.receive(ROBOT, &good), [exchanged(ROBOT)]);
    assert!(station.receive(ROBOT, &good).is_empty(), "a duplicate");
    let broadcast = answer(9_000, at(100), None);
    assert_eq!(station.receive(CAMERA, &broadcast), [exchanged(CAMERA)]);
    let invented = answer(9_000, at(101), Some(STATION));
    assert!(station.receive(ROBOT, &invented).is_empty(), "never asked");
    let foreign = answer(9_000, at(0), Some(CAMERA));
    assert!(station.receive(ROBOT, &foreign).is_empty(), "for somebody else");
    station.run_until(at(5_101));
    let stale = answer(9_000, at(100), Some(STATION));
    assert!(station.receive(Address::new(7, 7), &stale).is_empty(), "stale");
}

fn with_requested_intervals() -> SessionConfig {
    SessionConfig {
        requested_messages: RequestedMessages {
            of_robots: vec![(42_100, TimeDelta::from_millis(20)), (42_101, TimeDelta::from_millis(50))],
            ..RequestedMessages::default()
        },
        ..quiet()
    }
}

fn requested_ids(outputs: &[(i64, Output)]) -> Vec<(i64, u32)> {
    sent(outputs)
        .iter()
        .filter_map(|(millis, message)| match message {
            Message::SetMessageInterval(request) => {
                assert_eq!(request.target, ROBOT);
                Some((*millis, request.message_id))
            }
            _ => None,
        })
        .collect()
}

fn ack(result: u8) -> Message {
    Message::CommandAck(CommandAck { command: SET_MESSAGE_INTERVAL, result, target: Some(STATION) })
}

#[test]
fn intervals_are_requested_one_by_one_as_they_are_acknowledged() {
    let mut station = Station::new(with_requested_intervals());
    station.receive(ROBOT, &Message::Heartbeat(ROVER));
    assert_eq!(requested_ids(&station.run_until(at(1_500))), [(0, 42_100), (1_000, 42_100)]);
    station.receive(ROBOT, &ack(1));
    assert_eq!(requested_ids(&station.run_until(at(2_200))), [(2_000, 42_100)], "for the time being rejected");
    station.receive(ROBOT, &ack(0));
    assert_eq!(requested_ids(&station.run_until(at(2_300))), [(2_200, 42_101)]);
    station.receive(ROBOT, &ack(0));
    station.receive(ROBOT, &Message::Heartbeat(ROVER));
    assert!(requested_ids(&station.run_until(at(5_000))).is_empty());
}

#[test]
fn a_robot_that_never_acknowledges_is_requested_five_times() {
    let mut station =
        Station::new(SessionConfig { peer_timeout: TimeDelta::from_millis(60_000), ..with_requested_intervals() });
    station.receive(ROBOT, &Message::Heartbeat(ROVER));
    let requested = requested_ids(&station.run_until(at(30_000)));
    let first = (0..5).map(|attempt| (attempt * 1_000, 42_100));
    let second = (5..10).map(|attempt| (attempt * 1_000, 42_101));
    assert_eq!(requested, first.chain(second).collect::<Vec<_>>());
}

#[test]
fn no_requests_are_sent_to_cameras_and_ground_stations() {
    let mut station = Station::new(with_requested_intervals());
    station.receive(CAMERA, &Message::Heartbeat(ONBOARD));
    let ground = Heartbeat { vehicle_type: 6, ..ROVER };
    station.receive(GCS, &Message::Heartbeat(ground));
    assert!(requested_ids(&station.run_until(at(2_500))).is_empty());
}

#[test]
fn requests_are_repeated_after_a_robots_restart() {
    let mut station = Station::new(SessionConfig {
        requested_messages: RequestedMessages {
            of_robots: vec![(42_100, TimeDelta::from_millis(20))],
            ..RequestedMessages::default()
        },
        ..quiet()
    });
    station.receive(ROBOT, &Message::Heartbeat(ROVER));
    station.run_until(at(100));
    station.receive(ROBOT, &ack(0));
    assert!(requested_ids(&station.run_until(at(500))).is_empty());
    station.session.peer_restarted(at(500), ROBOT);
    assert_eq!(requested_ids(&station.run_until(at(600))), [(500, 42_100)]);
}

#[test]
fn a_brick_accepts_its_own_intervals_of_offered_messages() {
    let offered_messages = vec![42_101];
    let mut brick = Station::new(SessionConfig { own: ROBOT, heartbeat: ROVER, offered_messages, ..quiet() });
    let interval = Some(TimeDelta::from_millis(50));
    let request = |target, message_id| Message::SetMessageInterval(SetMessageInterval { target, message_id, interval });
    let acknowledged = |result| {
        let target = Some(STATION);
        Output::Send(Message::CommandAck(CommandAck { command: SET_MESSAGE_INTERVAL, result, target }))
    };
    let accepted = [acknowledged(0), Output::IntervalRequested { by: STATION, message_id: 42_101, interval }];
    for target in [ROBOT, Address::new(1, 0)] {
        assert_eq!(brick.receive(STATION, &request(target, 42_101)), accepted);
    }
    for other in [Address::new(0, 0), CAMERA, Address::new(2, 1)] {
        assert!(brick.receive(STATION, &request(other, 42_101)).is_empty(), "{other}");
    }
    assert_eq!(brick.receive(STATION, &request(ROBOT, 42_100)), [acknowledged(3)], "not offered");
}

#[test]
fn other_commands_reach_us_only_when_meant_for_us_alone() {
    let mut station = Station::new(quiet());
    let command = |target| Message::Command(CommandLong { target, command: 65_000, params: [0.0; 7] });
    let commanded = Output::CommandReceived {
        by: GCS,
        command: CommandLong { target: STATION, command: 65_000, params: [0.0; 7] },
        exact: None,
    };
    assert_eq!(station.receive(GCS, &command(STATION)), [commanded]);
    station.session.acknowledge_command(GCS, 65_000, CommandResult::Unsupported);
    let unsupported = Output::Send(Message::CommandAck(CommandAck { command: 65_000, result: 3, target: Some(GCS) }));
    assert_eq!(station.session.poll(), Some(unsupported));
    assert!(station.receive(GCS, &command(Address::new(1, 0))).is_empty());
    assert!(station.receive(GCS, &command(ROBOT)).is_empty());
}

#[test]
fn a_command_with_integer_coordinates_is_the_same_command() {
    let mut station = Station::new(SessionConfig { offered_messages: vec![331], ..quiet() });
    let command = |command, frame, params| {
        Message::CommandInt(CommandInt { target: STATION, frame, command, params, x: 15_000, y: -20_000, z: 0.5 })
    };
    let params = [1.0, 2.0, 3.0, 4.0];
    let commanded = |frame, p5, p6| Output::CommandReceived {
        by: GCS,
        command: CommandLong { target: STATION, command: 65_000, params: [1.0, 2.0, 3.0, 4.0, p5, p6, 0.5] },
        exact: Some(CommandInt { target: STATION, frame, command: 65_000, params, x: 15_000, y: -20_000, z: 0.5 }),
    };
    // Local coordinates are 1e-4 m, global ones 1e-7 degrees; a mission's are what they are.
    for (frame, p5, p6) in [(1, 1.5, -2.0), (20, 1.5, -2.0), (6, 0.0015, -0.002), (2, 15_000.0, -20_000.0)] {
        let outputs = station.receive(GCS, &command(65_000, frame, params));
        assert_eq!(outputs, [commanded(frame, p5, p6)], "frame {frame}");
    }
    let outputs = station.receive(GCS, &command(SET_MESSAGE_INTERVAL, 2, [331.0, 2e5, 0.0, 0.0]));
    let requested = Output::IntervalRequested { by: GCS, message_id: 331, interval: Some(TimeDelta::from_millis(200)) };
    assert_eq!(outputs[1..], [requested]);
}

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
fn is_due_is_true_exactly_when_a_tick_does_something() {
    let config = SessionConfig {
        timesync_period: Some(TimeDelta::from_millis(700)),
        requested_messages: RequestedMessages {
            of_robots: vec![(30, TimeDelta::from_millis(50)), (31, TimeDelta::from_millis(50))],
            ..RequestedMessages::default()
        },
        ..quiet()
    };
    // One is ticked only when it is due, the other at every step.
    let [mut checked, mut ticked] = [config.clone(), config].map(|config| {
        let mut session = Session::<HostClock>::new(config, at(0));
        session.offer_parameters([("A".to_owned(), 1.0), ("B".to_owned(), 2.0)].into_iter());
        session
    });
    let (mut due, mut idle) = (0, 0);
    for step in 0..4_000_i64 {
        let now = at(step * 7 + step % 3);
        let received = match step % 400 {
            0..200 if step % 10 == 0 => Some((ROBOT, Message::Heartbeat(ROVER))),
            250 => Some((CAMERA, Message::ParamRequestList { target: STATION })),
            _ => None,
        };
        if let Some((from, message)) = received {
            checked.handle(now, from, &message);
            ticked.handle(now, from, &message);
        }
        if step == 1_000 {
            checked.peer_restarted(now, ROBOT);
            ticked.peer_restarted(now, ROBOT);
        }
        assert_eq!(checked.deadline(), ticked.deadline(), "step {step}");
        let is_due = checked.deadline().is_some_and(|deadline| deadline <= now);
        assert_eq!(checked.is_due(now), is_due, "step {step}");
        if is_due {
            checked.tick(now);
            due += 1;
        } else {
            idle += 1;
        }
        ticked.tick(now);
        let outputs = std::iter::from_fn(|| checked.poll());
        let expected = std::iter::from_fn(|| ticked.poll());
        assert!(outputs.eq(expected), "step {step}");
    }
    assert!(due > 50 && idle > 1_000, "{due} {idle}");
}

/// A participant of three parameters that sends nothing else.
fn owner() -> Session<HostClock> {
    let mut session =
        Session::new(SessionConfig { heartbeat_period: TimeDelta::from_millis(100_000_000), ..quiet() }, at(0));
    session.offer_parameters(["GATE_PROB", "SIXTEEN_BYTES_OK", "TAU_S"].map(|name| (name.to_owned(), 1.5)).into_iter());
    session.tick(at(0));
    while session.poll().is_some() {}
    session
}

const LIST: Message = Message::ParamRequestList { target: STATION };

/// Milliseconds and index of each value that is sent until an instant.
fn values_sent_until(session: &mut Session<HostClock>, end_ms: i64) -> Vec<(i64, u16)> {
    let mut sent_values = Vec::new();
    while let Some(due) = session.deadline().filter(|due| *due <= at(end_ms)) {
        session.tick(due);
        while let Some(output) = session.poll() {
            if let SessionOutput::Send(Message::ParamValue { index, .. }) = output {
                sent_values.push((due.as_micros() / 1_000, index));
            }
        }
    }
    sent_values
}

#[test]
fn a_clock_that_is_set_back_does_not_hold_a_list_up() {
    let mut session = owner();
    session.handle(at(3_600_000), GCS, &LIST);
    assert_eq!(values_sent_until(&mut session, 3_600_010), [(3_600_000, 0)], "before");
    session.tick(at(5));
    let indices: Vec<u16> = values_sent_until(&mut session, 1_000).iter().map(|(_, index)| *index).collect();
    assert_eq!(indices, [1, 2]);
}

#[test]
fn a_changed_parameter_is_announced_only_after_a_request() {
    let mut session = owner();
    assert_eq!(session.report_parameter(2, 7.0), None);
    let set = Message::ParamSet { target: STATION, name: "Tau_s".to_owned(), value: 2.5 };
    session.handle(at(0), GCS, &set);
    assert_eq!(session.poll(), Some(SessionOutput::ParameterSetRequested { by: GCS, index: 2, value: 2.5 }));
    let announced = Message::ParamValue { name: "TAU_S".to_owned(), value: 8.0, count: 3, index: 2 };
    assert_eq!(session.report_parameter(2, 8.0), Some(announced));
    assert_eq!(session.report_parameter(3, 8.0), None);
}

#[test]
fn parameter_requests_to_others_are_not_answered() {
    let read = |target| Message::ParamRequestRead { target, name: "TAU_S".to_owned(), index: -1 };
    let set = |target| Message::ParamSet { target, name: "TAU_S".to_owned(), value: 2.5 };
    let of_all_components = Address::new(STATION.system.0, 0);
    for target in [ROBOT, Address::new(2, STATION.component.0), Address::new(2, 0)] {
        let mut session = owner();
        for message in [Message::ParamRequestList { target }, read(target), set(target)] {
            session.handle(at(0), GCS, &message);
        }
        assert_eq!(session.poll(), None, "{target}");
        assert_eq!(values_sent_until(&mut session, 1_000), [], "{target}");
    }
    let mut session = owner();
    session.handle(at(0), GCS, &read(of_all_components));
    assert!(matches!(session.poll(), Some(SessionOutput::Send(Message::ParamValue { index: 2, .. }))));
}
