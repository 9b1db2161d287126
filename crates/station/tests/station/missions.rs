//! Plans and goals of ground stations: uploads, downloads and refusals, in virtual time.

mod any_request;
mod drive;

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, link, ticks};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{
    CommandInt, CommandLong, ItemPosition, Message, MissionItem, PlanContent, PlanMessage, Setpoint, plan,
};
use posebridge_station::{AnnouncedAs, GoalPolicy, StationConfig};
use posebridge_telemetry::{Address, Arena, GeodeticOrigin, GeodeticPoint, Meters, Point2, Radians};

const OTHER_GCS: Address = Address::new(253, 190);
/// MAV_MISSION_RESULT.
const ACCEPTED: u8 = 0;
const UNSUPPORTED_FRAME: u8 = 2;
const UNSUPPORTED: u8 = 3;
const NO_SPACE: u8 = 4;
const INVALID_PARAM5_X: u8 = 10;
const INVALID_SEQUENCE: u8 = 13;
const DENIED: u8 = 14;
const CANCELLED: u8 = 15;
/// MISSION_STATE.
const NOT_STARTED: u8 = 2;
const ACTIVE: u8 = 3;
const PAUSED: u8 = 4;
const COMPLETE: u8 = 5;
/// MAV_FRAME.
const LOCAL_NED: u8 = 1;
const GLOBAL_INT: u8 = 5;
/// A corner of the arena in Delft.
const LATITUDE_E7: i32 = 520_115_000;
const LONGITUDE_E7: i32 = 43_571_000;

fn with_ground_station(goals: GoalPolicy) -> StationConfig {
    let mut config = config();
    config.robot_system = Some(BRICK.system);
    config.robot.goals = goals;
    let mut gcs = link(GCS_LINK, vec![]);
    gcs.announced_as = AnnouncedAs::StationAndVehicle;
    config.links.push(gcs);
    config
}

fn origin() -> GeodeticOrigin {
    let [latitude, longitude] = [LATITUDE_E7, LONGITUDE_E7].map(|e7| Radians((f64::from(e7) * 1e-7).to_radians()));
    GeodeticOrigin::new(GeodeticPoint { latitude, longitude }, Meters(0.0)).expect("it is on the Earth")
}

/// An item without a position.
fn item(sequence: u16, command: u16) -> MissionItem {
    MissionItem {
        target: BRICK,
        plan: plan::MISSION,
        sequence,
        frame: LOCAL_NED,
        command,
        current: u8::from(sequence == 0),
        autocontinue: 1,
        params: [0.0, 0.0, 0.0, f32::MAX],
        position: ItemPosition::Integer { x: 0, y: 0 },
        z: -0.125,
    }
}

/// A way-point in centimetres of the arena, whose x is east.
fn way_point(sequence: u16, x_cm: i32, y_cm: i32) -> MissionItem {
    MissionItem { position: ItemPosition::Integer { x: y_cm * 100, y: x_cm * 100 }, ..item(sequence, 16) }
}

const SQUARE_CM: [(i32, i32); 4] = [(40, 0), (40, 40), (0, 40), (0, 0)];

fn square() -> Vec<MissionItem> {
    (0..).zip(SQUARE_CM).map(|(sequence, (x_cm, y_cm))| way_point(sequence, x_cm, y_cm)).collect()
}

fn plan_message(content: PlanContent) -> Message {
    Message::Plan(PlanMessage { target: BRICK, plan: plan::MISSION, content })
}

fn command(command: u16, params: &[f32]) -> Message {
    let mut seven = [0.0; 7];
    seven[..params.len()].copy_from_slice(params);
    Message::Command(CommandLong { target: BRICK, command, params: seven })
}

fn reposition(frame: u8, x: i32, y: i32) -> Message {
    let params = [-1.0, 1.0, 0.0, f32::NAN];
    Message::CommandInt(CommandInt { target: BRICK, frame, command: ids::COMMAND_REPOSITION, params, x, y, z: 0.0 })
}

/// What a ground station hears of the vehicle about plans and commands, after the first `first_output` outputs.
fn heard_since(station: &TestStation, first_output: usize) -> Vec<Message> {
    let is_about = |message: &Message| {
        matches!(
            message,
            Message::Plan(_)
                | Message::MissionItem(_)
                | Message::MissionCurrent(_)
                | Message::MissionItemReached { .. }
                | Message::CommandAck(_)
        )
    };
    station.messages_since(first_output, GCS_LINK).into_iter().filter(is_about).collect()
}

/// The goals that were sent to the robot; `None` is a stop.
fn setpoints_since(station: &TestStation, first_output: usize) -> Vec<Option<Point2<Arena>>> {
    let sent = station.messages_since(first_output, LINK).into_iter();
    let targets = sent.filter_map(|message| match message {
        Message::PositionTarget(request) => {
            assert_eq!(request.target, BRICK);
            Some(match request.setpoint {
                Setpoint::Position { x, y } => Some(Point2::new(x, y)),
                Setpoint::BodyVelocity { forward, turn } => {
                    assert_eq!((forward.0, turn.0), (0.0, 0.0));
                    None
                }
                Setpoint::Unsupported => panic!("no robot follows it"),
            })
        }
        _ => None,
    });
    targets.collect()
}

/// A robot that stands, and two ground stations.
struct Transfer {
    station: TestStation,
    robot: RemotePeer,
    gcs: RemotePeer,
    other: RemotePeer,
    now_ms: i64,
}

impl Transfer {
    fn new(config: &StationConfig) -> Self {
        let mut transfer = Self {
            station: TestStation::new(config),
            robot: RemotePeer::new(BRICK, LINK, 0),
            gcs: RemotePeer::new(GCS, GCS_LINK, 0),
            other: RemotePeer::new(OTHER_GCS, GCS_LINK, 1),
            now_ms: 0,
        };
        transfer.pass(2_000);
        transfer
    }

    /// Time passes; the robot is heard.
    fn pass(&mut self, millis: i64) -> Vec<Message> {
        let first_output = self.station.outputs.len();
        let end_ms = self.now_ms + millis;
        while self.now_ms < end_ms {
            self.now_ms += 50;
            self.station.pass_until(at(self.now_ms));
            if self.now_ms % 1_000 == 0 {
                self.robot.send(&mut self.station, at(self.now_ms), &HEARTBEAT);
            }
            self.robot.send(&mut self.station, at(self.now_ms), &ticks(self.now_ms as u32, 0, 0));
        }
        heard_since(&self.station, first_output)
    }

    fn say(&mut self, message: &Message) -> Vec<Message> {
        let first_output = self.station.outputs.len();
        let forwarded = self.gcs.send(&mut self.station, at(self.now_ms), message);
        assert_eq!(forwarded, [], "the robot gets no request that the station answers");
        heard_since(&self.station, first_output)
    }

    /// The answer to a message, without MISSION_CURRENT.
    fn answer(&mut self, message: &Message) -> Option<PlanContent> {
        let mut answers = self.say(message);
        answers.retain(|answer| !matches!(answer, Message::MissionCurrent(_)));
        match answers[..] {
            [] => None,
            [Message::Plan(answer)] => {
                assert_eq!((answer.target, answer.plan), (GCS, plan::MISSION));
                Some(answer.content)
            }
            ref other => panic!("{other:?}"),
        }
    }

    fn upload(&mut self, items: &[MissionItem]) -> u8 {
        let mut answer = self.answer(&plan_message(PlanContent::Count { items: items.len() as u16 }));
        loop {
            match answer {
                Some(PlanContent::RequestInt { sequence }) => {
                    answer = self.answer(&Message::MissionItem(items[usize::from(sequence)]));
                }
                Some(PlanContent::Ack { result }) => return result,
                other => panic!("{other:?}"),
            }
        }
    }

    fn count(&mut self) -> u16 {
        match self.answer(&plan_message(PlanContent::RequestList)) {
            Some(PlanContent::Count { items }) => items,
            other => panic!("{other:?}"),
        }
    }

    fn last_text(&self) -> &str {
        self.station.texts().last().copied().unwrap_or_default()
    }

    fn result(&mut self, message: &Message) -> u8 {
        let acks = self.say(message);
        match acks[..] {
            [Message::CommandAck(ack), ..] => ack.result,
            ref other => panic!("{other:?}"),
        }
    }
}

fn states(heard: &[Message]) -> Vec<(u16, u16, u8)> {
    let mut states: Vec<_> = heard
        .iter()
        .filter_map(|message| match message {
            Message::MissionCurrent(current) => Some((current.sequence, current.items, current.state)),
            _ => None,
        })
        .collect();
    states.dedup();
    states
}

#[test]
fn a_plan_comes_back_as_it_was_uploaded_in_either_form_of_its_items() {
    let mut transfer = Transfer::new(&with_ground_station(GoalPolicy::Accept));
    let mut items = square();
    items.push(item(4, ids::COMMAND_DELAY));
    items.push(MissionItem { autocontinue: 0, ..item(5, ids::COMMAND_RETURN_TO_LAUNCH) });
    items[1].position = ItemPosition::Float { x: 0.5, y: -0.25 };
    assert_eq!(transfer.upload(&items), ACCEPTED);
    assert_eq!(transfer.count(), 6);
    for sent in &items {
        let back = |position| Message::MissionItem(MissionItem { target: GCS, position, ..*sent });
        let sequence = sent.sequence;
        let integer = transfer.say(&plan_message(PlanContent::RequestInt { sequence }));
        assert_eq!(integer, [back(sent.position.to_integer(LOCAL_NED))]);
        let float = transfer.say(&plan_message(PlanContent::Request { sequence }));
        assert_eq!(float, [back(sent.position.to_float(LOCAL_NED))]);
    }
    let missing = plan_message(PlanContent::RequestInt { sequence: 6 });
    assert_eq!(transfer.answer(&missing), Some(PlanContent::Ack { result: INVALID_SEQUENCE }));
    assert_eq!(states(&transfer.pass(3_000)), [(0, 6, NOT_STARTED)], "once a second");
    assert_eq!(transfer.answer(&plan_message(PlanContent::ClearAll)), Some(PlanContent::Ack { result: ACCEPTED }));
    assert_eq!(transfer.count(), 0);
    assert_eq!(transfer.pass(3_000), [], "there is nothing to report");
}

#[test]
fn a_lost_item_is_asked_for_again_and_a_silent_sender_is_given_up() {
    let mut transfer = Transfer::new(&with_ground_station(GoalPolicy::Accept));
    let items = square();
    let request = |sequence| plan_message_to_gcs(PlanContent::RequestInt { sequence });
    let begin = plan_message(PlanContent::Count { items: 4 });
    assert_eq!(transfer.answer(&begin), Some(PlanContent::RequestInt { sequence: 0 }));
    assert_eq!(transfer.pass(1_400), []);
    assert_eq!(transfer.pass(200), [request(0)], "after 1.5 s");
    let first = Message::MissionItem(items[0]);
    assert_eq!(transfer.answer(&first), Some(PlanContent::RequestInt { sequence: 1 }));
    assert_eq!(transfer.answer(&first), None, "the answer to the repeated request comes late");
    let early = Message::MissionItem(items[3]);
    assert_eq!(transfer.answer(&early), Some(PlanContent::RequestInt { sequence: 1 }), "one was left out");
    // Five repetitions, then the end.
    let mut expected = vec![request(1); 5];
    expected.push(plan_message_to_gcs(PlanContent::Ack { result: CANCELLED }));
    assert_eq!(transfer.pass(10_000), expected);
    assert_eq!(transfer.count(), 0);
    let late = Message::MissionItem(items[1]);
    assert_eq!(transfer.answer(&late), Some(PlanContent::Ack { result: INVALID_SEQUENCE }));
    // The last acknowledgement may be lost, too.
    assert_eq!(transfer.upload(&items), ACCEPTED);
    assert_eq!(transfer.answer(&early), Some(PlanContent::Ack { result: ACCEPTED }));
}

fn plan_message_to_gcs(content: PlanContent) -> Message {
    Message::Plan(PlanMessage { target: GCS, plan: plan::MISSION, content })
}

#[test]
fn one_ground_station_uploads_at_a_time_and_both_see_the_plan() {
    let mut transfer = Transfer::new(&with_ground_station(GoalPolicy::Accept));
    transfer.answer(&plan_message(PlanContent::Count { items: 4 }));
    let denied = Message::Plan(PlanMessage {
        target: OTHER_GCS,
        plan: plan::MISSION,
        content: PlanContent::Ack { result: DENIED },
    });
    for content in [PlanContent::Count { items: 2 }, PlanContent::ClearAll] {
        let first_output = transfer.station.outputs.len();
        transfer.other.send(&mut transfer.station, at(transfer.now_ms), &plan_message(content));
        assert_eq!(heard_since(&transfer.station, first_output), std::slice::from_ref(&denied));
    }
    // It begins anew.
    assert_eq!(transfer.upload(&square()), ACCEPTED);
    let first_output = transfer.station.outputs.len();
    transfer.other.send(&mut transfer.station, at(transfer.now_ms), &plan_message(PlanContent::RequestList));
    let count = PlanContent::Count { items: 4 };
    let expected = Message::Plan(PlanMessage { target: OTHER_GCS, plan: plan::MISSION, content: count });
    assert_eq!(heard_since(&transfer.station, first_output), [expected]);
}

#[test]
fn what_cannot_be_driven_is_refused_by_name_and_the_plan_of_before_stays() {
    let mut transfer = Transfer::new(&with_ground_station(GoalPolicy::Accept));
    assert_eq!(transfer.upload(&square()), ACCEPTED);
    let global = |x, y| MissionItem { frame: 6, position: ItemPosition::Integer { x, y }, ..item(1, 16) };
    for (refused, result, text) in [
        (item(1, 22), UNSUPPORTED, "plan refused: item 1: no robot here does command 22, use 16, 20 or 93"),
        (
            global(LATITUDE_E7, LONGITUDE_E7),
            UNSUPPORTED_FRAME,
            "plan refused: item 1: set the arena's origin first (SET_GPS_GLOBAL_ORIGIN or [station.origin])",
        ),
        (way_point(1, 1_000_001, 0), 11, "plan refused: item 1, command 16: param6 10000.01, not -10000 to 10000 m"),
    ] {
        transfer.pass(1_000);
        assert_eq!(transfer.upload(&[way_point(0, 0, 0), refused]), result);
        assert_eq!(transfer.last_text(), text);
        assert_eq!(transfer.count(), 4);
    }
    let many = plan_message(PlanContent::Count { items: 1_001 });
    assert_eq!(transfer.answer(&many), Some(PlanContent::Ack { result: NO_SPACE }));
    let mut there = Transfer::new(&StationConfig { origin: Some(origin()), ..with_ground_station(GoalPolicy::Accept) });
    assert_eq!(there.upload(&[way_point(0, 0, 0), global(LATITUDE_E7, LONGITUDE_E7)]), ACCEPTED);
    assert_eq!(there.upload(&[way_point(0, 0, 0), global(LATITUDE_E7 + 1_000_000, LONGITUDE_E7)]), INVALID_PARAM5_X);
    assert_eq!(there.last_text(), "plan refused: item 1: 11 km from the arena's origin");
}

#[test]
fn a_robot_that_takes_no_goals_takes_no_plan_and_keeps_its_commands() {
    for goals in [GoalPolicy::ByLink, GoalPolicy::Refuse] {
        let mut transfer = Transfer::new(&with_ground_station(goals));
        let count = plan_message(PlanContent::Count { items: 4 });
        assert_eq!(transfer.answer(&count), Some(PlanContent::Ack { result: UNSUPPORTED }));
        let start = command(ids::COMMAND_MISSION_START, &[]);
        let forwarded = transfer.gcs.send(&mut transfer.station, at(transfer.now_ms), &start);
        assert_eq!(forwarded.len(), 1, "it may know the command itself");
    }
}

#[test]
fn commands_that_mean_nothing_are_denied_with_the_reason() {
    let mut transfer = Transfer::new(&with_ground_station(GoalPolicy::Accept));
    for (refused, result, text) in [
        (command(ids::COMMAND_MISSION_START, &[]), 2, "there is no plan to drive"),
        (command(ids::COMMAND_PAUSE_CONTINUE, &[2.0]), 2, "pause or continue: param1 2.0, not 0 or 1"),
        (command(ids::COMMAND_SET_MISSION_CURRENT, &[0.0]), 2, "no item 0: the plan has 0"),
        (
            command(ids::COMMAND_SET_MODE, &[1.0, 6.0, 0.0]),
            2,
            "no mode 1.0, 6.0, 0.0: use 1, 4 and 4 mission, 3 hold, 5 return",
        ),
        (
            command(ids::COMMAND_REPOSITION, &[-1.0, 0.0, 0.0, 0.0, 52.0, 4.0, 0.0]),
            8,
            "reposition: send COMMAND_INT, COMMAND_LONG is a metre off",
        ),
        (reposition(8, 0, 0), 9, "reposition: no position in frame 8, use 0, 1, 3, 5 or 6"),
        (
            reposition(GLOBAL_INT, 0, 0),
            2,
            "reposition: set the arena's origin first (SET_GPS_GLOBAL_ORIGIN or [station.origin])",
        ),
    ] {
        assert_eq!(transfer.result(&refused), result);
        assert_eq!(transfer.last_text(), text);
    }
}

#[test]
fn the_vehicle_announces_what_it_follows() {
    for (goals, expected) in [(GoalPolicy::Accept, 128), (GoalPolicy::Refuse, 0)] {
        let mut transfer = Transfer::new(&with_ground_station(goals));
        let ask = command(ids::COMMAND_REQUEST_MESSAGE, &[ids::AUTOPILOT_VERSION as f32]);
        let first_output = transfer.station.outputs.len();
        transfer.say(&ask);
        let answers = transfer.station.messages_since(first_output, GCS_LINK);
        let version = answers.iter().find_map(|answer| match answer {
            Message::AutopilotVersion(version) => Some(version.capabilities),
            _ => None,
        });
        assert_eq!(version.expect("it answers") & (128 | 8 | 4), expected | 8 | 4);
    }
}
