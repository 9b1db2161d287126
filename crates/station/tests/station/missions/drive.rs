//! The drive of a simulated brick along a plan and to a goal, by the estimates of the station.

use super::{
    ACTIVE, COMPLETE, GLOBAL_INT, LATITUDE_E7, LONGITUDE_E7, OTHER_GCS, PAUSED, command, heard_since, item, origin,
    plan_message, reposition, setpoints_since, square, states, way_point, with_ground_station,
};
use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::simulation::StationSimulation;
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{ManualControl, Message, MissionItem, PlanContent};
use posebridge_sim::Scenario;
use posebridge_station::{GoalPolicy, StationConfig};
use posebridge_telemetry::{GeodeticPoint, Radians, SystemId};

/// A simulated brick that rests until it is sent somewhere, beside a station that shows it to a ground station.
struct Drive {
    setup: StationSimulation,
    gcs: RemotePeer,
    config: StationConfig,
}

impl Drive {
    fn new(config: StationConfig) -> Self {
        let mut scenario = Scenario::default().with_seed(5);
        scenario.drive.rest_s = 1e5;
        let mut drive =
            Self { setup: StationSimulation::new(scenario, &config), gcs: RemotePeer::new(GCS, GCS_LINK, 0), config };
        drive.setup.run_for(4);
        drive
    }

    fn say(&mut self, message: &Message) -> Vec<Message> {
        let first_output = self.setup.station.outputs.len();
        let now = self.setup.now();
        self.gcs.send(&mut self.setup.station, now, message);
        heard_since(&self.setup.station, first_output)
    }

    fn upload(&mut self, items: &[MissionItem]) {
        self.say(&plan_message(PlanContent::Count { items: items.len() as u16 }));
        for item in items {
            self.say(&Message::MissionItem(*item));
        }
    }

    fn accepted(&mut self, message: &Message) {
        let heard = self.say(message);
        assert!(matches!(heard[..], [Message::CommandAck(ack), ..] if ack.result == 0), "{heard:?}");
    }

    /// Drives until the mission is complete; what the ground station hears meanwhile.
    fn finish(&mut self, most_s: i64) -> Vec<Message> {
        let first_output = self.setup.station.outputs.len();
        for _ in 0..most_s {
            self.setup.run_for(1);
            let heard = heard_since(&self.setup.station, first_output);
            if states(&heard).last().is_some_and(|(_, _, state)| *state == COMPLETE) {
                return heard;
            }
        }
        panic!("the mission is not complete after {most_s} s: {:?}", heard_since(&self.setup.station, first_output));
    }

    fn distance_m(&self, x_m: f64, y_m: f64) -> f64 {
        let truth = self.setup.simulation.truth().last().expect("it moves").pose;
        (truth.x.0 - x_m).hypot(truth.y.0 - y_m)
    }

    /// The same inputs give the same outputs.
    fn assert_replays(&self) {
        let again = self.setup.station.replayed(&self.config);
        assert!(again.outputs == self.setup.station.outputs);
    }
}

fn reached(heard: &[Message]) -> Vec<u16> {
    let reached = heard.iter().filter_map(|message| match message {
        Message::MissionItemReached { sequence } => Some(*sequence),
        _ => None,
    });
    reached.collect()
}

#[test]
fn a_square_of_four_way_points_is_driven_in_order() {
    let mut drive = Drive::new(with_ground_station(GoalPolicy::Accept));
    let mut items = square();
    items[1].params = [1.5, 0.1, 0.0, 0.0];
    items.push(MissionItem { params: [1.0, -1.0, -1.0, -1.0], ..item(4, ids::COMMAND_DELAY) });
    drive.upload(&items);
    drive.accepted(&command(ids::COMMAND_MISSION_START, &[]));
    let heard = drive.finish(60);
    assert_eq!(reached(&heard), [0, 1, 2, 3, 4]);
    let expected = [(0, 5, ACTIVE), (1, 5, ACTIVE), (2, 5, ACTIVE), (3, 5, ACTIVE), (4, 5, ACTIVE), (4, 5, COMPLETE)];
    assert_eq!(states(&heard)[usize::from(states(&heard)[0].2 != ACTIVE)..], expected);
    assert!(drive.distance_m(0.0, 0.0) < 0.1, "{:?}", drive.setup.simulation.truth().last().expect("it moves").pose);
    drive.assert_replays();
}

#[test]
fn a_drive_pauses_and_goes_on_and_a_person_has_priority() {
    let mut drive = Drive::new(with_ground_station(GoalPolicy::Accept));
    let mut items = square();
    items[0] = way_point(0, 100, 0);
    drive.upload(&items);
    // As MAVSDK starts and pauses.
    drive.accepted(&command(ids::COMMAND_SET_MODE, &[1.0, 4.0, 4.0]));
    drive.setup.run_for(1);
    drive.accepted(&command(ids::COMMAND_SET_MODE, &[1.0, 4.0, 3.0]));
    drive.setup.run_for(2);
    let stopped = drive.setup.simulation.truth().last().expect("it moves").pose;
    drive.setup.run_for(3);
    assert!(drive.distance_m(stopped.x.0, stopped.y.0) < 1e-3 && drive.distance_m(0.0, 0.0) > 0.02);
    drive.accepted(&command(ids::COMMAND_PAUSE_CONTINUE, &[1.0]));
    drive.setup.run_for(1);
    let first_output = drive.setup.station.outputs.len();
    let by_hand = ManualControl { system: SystemId(1), forward: Some(0.0), turn: Some(0.5) };
    drive.say(&Message::ManualControl(by_hand));
    drive.setup.run_for(5);
    assert_eq!(states(&heard_since(&drive.setup.station, first_output)), [(0, 4, PAUSED)]);
    assert_eq!(setpoints_since(&drive.setup.station, first_output), [], "the station does not steer against a person");
    assert!(drive.setup.station.texts().contains(&"mission paused at item 0: steered by hand"));
    drive.accepted(&command(ids::COMMAND_SET_MISSION_CURRENT, &[3.0]));
    drive.accepted(&command(ids::COMMAND_MISSION_START, &[]));
    let heard = drive.finish(30);
    assert_eq!(reached(&heard), [3]);
    drive.assert_replays();
}

#[test]
fn a_goal_on_the_earth_is_driven_to_at_the_seventh_digit_of_its_degrees() {
    let mut drive = Drive::new(StationConfig { origin: Some(origin()), ..with_ground_station(GoalPolicy::Accept) });
    let goal = origin().to_arena(GeodeticPoint {
        latitude: Radians((f64::from(LATITUDE_E7 + 37) * 1e-7).to_radians()),
        longitude: Radians((f64::from(LONGITUDE_E7 + 61) * 1e-7).to_radians()),
    });
    let first_output = drive.setup.station.outputs.len();
    drive.accepted(&reposition(GLOBAL_INT, LATITUDE_E7 + 37, LONGITUDE_E7 + 61));
    drive.setup.run_for(15);
    assert!(
        drive.distance_m(goal.x.0, goal.y.0) < 0.1,
        "{:?}",
        drive.setup.simulation.truth().last().expect("it moves").pose
    );
    for sent in setpoints_since(&drive.setup.station, first_output) {
        assert!(sent.expect("a goal").distance(goal).0 < 1e-6, "a float of degrees would be half a metre off");
    }
    assert!(drive.setup.station.texts().contains(&"goal reached"));
    assert_eq!(states(&heard_since(&drive.setup.station, first_output)), [], "there is no mission");
}

#[test]
fn a_drive_waits_while_the_robot_is_silent_and_says_so_once() {
    let mut drive = Drive::new(with_ground_station(GoalPolicy::Accept));
    drive.upload(&square());
    drive.accepted(&command(ids::COMMAND_MISSION_START, &[]));
    drive.setup.run_for(1);
    drive.setup.cut_for(8);
    let waits = "the drive to the goal waits: the robot is silent";
    assert_eq!(drive.setup.station.texts().iter().filter(|text| **text == waits).count(), 1);
    let heard = drive.finish(60);
    assert_eq!(reached(&heard), [0, 1, 2, 3]);
    drive.assert_replays();
}

#[test]
fn a_flood_of_plan_messages_is_charged_and_delays_no_goal() {
    let mut drive = Drive::new(with_ground_station(GoalPolicy::Accept));
    drive.upload(&square());
    drive.accepted(&command(ids::COMMAND_MISSION_START, &[]));
    let mut flooder = RemotePeer::new(OTHER_GCS, GCS_LINK, 9);
    let first_output = drive.setup.station.outputs.len();
    for _ in 0..2_000 {
        let now = drive.setup.now();
        for request in [PlanContent::RequestList, PlanContent::Request { sequence: 0 }] {
            flooder.send(&mut drive.setup.station, now, &plan_message(request));
        }
    }
    let answers = heard_since(&drive.setup.station, first_output);
    assert!((300..=500).contains(&answers.len()), "{} answers", answers.len());
    assert_eq!(reached(&drive.finish(60)), [0, 1, 2, 3]);
}
