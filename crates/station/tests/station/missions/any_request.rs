//! Whatever ground stations say about plans, in whatever order.

use super::{
    LOCAL_NED, Transfer, command, item, origin, plan_message, reposition, setpoints_since, with_ground_station,
};
use crate::support::at;
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{ItemPosition, ManualControl, Message, MissionItem, PlanContent};
use posebridge_station::{GoalPolicy, StationConfig};
use posebridge_telemetry::{Point2, SystemId};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// A message of a ground station about plans, with numbers that are nearly right.
fn any_request() -> impl Strategy<Value = Message> {
    let small = 0_u16..6;
    let number = prop_oneof![3 => (0_u8..6).prop_map(f32::from), 1 => any::<f32>()];
    let params = [number.clone(), number.clone(), number.clone(), number];
    let content = prop_oneof![
        3 => small.clone().prop_map(|items| PlanContent::Count { items }),
        1 => any::<u16>().prop_map(|items| PlanContent::Count { items }),
        1 => Just(PlanContent::RequestList),
        1 => Just(PlanContent::ClearAll),
        1 => small.clone().prop_map(|sequence| PlanContent::RequestInt { sequence }),
        1 => small.clone().prop_map(|sequence| PlanContent::Request { sequence }),
        1 => small.clone().prop_map(|sequence| PlanContent::SetCurrent { sequence }),
        1 => (0_u8..20).prop_map(|result| PlanContent::Ack { result }),
    ];
    let scaled = prop_oneof![4 => -10_000_i32..10_000, 1 => any::<i32>()];
    let position = prop_oneof![
        3 => (scaled.clone(), scaled.clone()).prop_map(|(x, y)| ItemPosition::Integer { x, y }),
        1 => any::<[f32; 2]>().prop_map(|[x, y]| ItemPosition::Float { x, y }),
    ];
    let what = prop_oneof![4 => Just(16_u16), 1 => Just(20), 1 => Just(93), 1 => any::<u16>()];
    let any_item = (small, what, prop_oneof![4 => Just(LOCAL_NED), 1 => 0_u8..12], position, params.clone(), 0_u8..2);
    let any_item = any_item.prop_map(|(sequence, command, frame, position, params, autocontinue)| {
        Message::MissionItem(MissionItem { frame, position, params, autocontinue, ..item(sequence, command) })
    });
    let drive = prop_oneof![
        Just(ids::COMMAND_MISSION_START),
        Just(ids::COMMAND_PAUSE_CONTINUE),
        Just(ids::COMMAND_SET_MISSION_CURRENT),
        Just(ids::COMMAND_SET_MODE),
        Just(ids::COMMAND_RETURN_TO_LAUNCH),
        Just(ids::COMMAND_REPOSITION),
    ];
    let long = (drive, params).prop_map(|(number, params)| command(number, &params));
    let exact = (0_u8..12, scaled.clone(), scaled).prop_map(|(frame, x, y)| reposition(frame, x, y));
    let by_hand = Just(Message::ManualControl(ManualControl { system: SystemId(1), forward: None, turn: None }));
    prop_oneof![4 => content.prop_map(plan_message), 6 => any_item, 3 => long, 1 => exact, 1 => by_hand]
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200,
        rng_seed: RngSeed::Fixed(20_261_130),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn for_any_requests_the_station_neither_panics_nor_spins_and_sends_robots_to_places_alone(
        said in prop::collection::vec((any_request(), any::<bool>(), prop_oneof![4 => 0_i64..200, 1 => 0_i64..9_000]), 1..80),
    ) {
        let config = StationConfig { origin: Some(origin()), ..with_ground_station(GoalPolicy::Accept) };
        let mut transfer = Transfer::new(&config);
        let first_output = transfer.station.outputs.len();
        for (message, is_other, wait_ms) in said {
            let now = at(transfer.now_ms);
            let speaker = if is_other { &mut transfer.other } else { &mut transfer.gcs };
            speaker.send(&mut transfer.station, now, &message);
            let due = transfer.station.engine.deadline().expect("there is always a heartbeat");
            prop_assert!(due > now, "{due:?} at {now:?} after {message:?}");
            transfer.pass(wait_ms);
        }
        for place in setpoints_since(&transfer.station, first_output).into_iter().flatten() {
            prop_assert!(place.distance(Point2::ORIGIN).0 <= 15_000.0, "{place:?}");
        }
    }
}
