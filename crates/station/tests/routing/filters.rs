//! What a link's rules keep out, keep back or thin.

use std::collections::BTreeMap;

use crate::brick::{HEARTBEAT, ticks};
use crate::events::observed;
use crate::routing_setup::{GCS_LINK, RoutingSetup, command, health, three_links};
use crate::station::{LINK, at};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::routing::{AllowBlockList, ForwardPolicy, LinkRules};
use posebridge_telemetry::{Output, PeerId, Priority, Recipients, SystemId, TimeDelta};

#[test]
fn what_a_filter_keeps_out_is_neither_believed_nor_passed_on() {
    let mut config = three_links();
    config.links[0].rules.inward.messages = AllowBlockList { allow: vec![], block: vec![ids::PB_WHEEL_TICKS] };
    config.links[2].rules.outward.systems = AllowBlockList { allow: vec![SystemId(2)], block: vec![] };
    let mut setup = RoutingSetup::new(&config);
    let station = &mut setup.station;
    let (_, passed) = setup.brick.send(station, at(100), &ticks(5_000, 0, 0));
    assert_eq!((passed, observed(station)), (vec![], 0));
    let (_, passed) = setup.brick.send(station, at(110), &HEARTBEAT);
    assert_eq!(passed.len(), 1, "the camera's link only: {passed:?}");
    let (_, passed) = setup.camera.send(station, at(120), &HEARTBEAT);
    assert_eq!(passed.len(), 2);
    assert_eq!(health(station, LINK).filtered, 1);
}

#[test]
fn a_link_may_take_only_what_is_meant_for_it() {
    let mut config = three_links();
    config.links[0].rules.forward = ForwardPolicy::Targeted;
    config.links[1].rules.forward = ForwardPolicy::Disabled;
    let mut setup = RoutingSetup::new(&config);
    let station = &mut setup.station;
    let (_, passed) = setup.gcs.send(station, at(100), &HEARTBEAT);
    assert_eq!(passed, [(GCS_LINK, Recipients::AllExcept(PeerId(5)), Priority::Forwarded)]);
    assert_eq!(setup.gcs.send(station, at(110), &command()).1.len(), 1);
    assert_eq!(setup.camera.send(station, at(120), &HEARTBEAT).1, []);
}

#[test]
fn rates_thin_telemetry_and_estimates_but_never_commands() {
    let mut config = three_links();
    let thin = |rules: &mut LinkRules| {
        rules.limits.bytes_per_s = Some(200);
        let interval = TimeDelta::from_millis(200);
        rules.limits.min_intervals = BTreeMap::from([(ids::PB_WHEEL_TICKS, interval)]);
    };
    // Estimates of 64 bytes each leave to the brick, ticks of 25 bytes to the ground station.
    thin(&mut config.links[0].rules);
    thin(&mut config.links[2].rules);
    let mut setup = RoutingSetup::new(&config);
    let mut ticks_passed = 0;
    for k in 0..200_u32 {
        let station = &mut setup.station;
        let now = at(100 + i64::from(k) * 50);
        let message = ticks(5_000 + k * 50, 0, 0);
        let (_, passed) = setup.brick.send(station, now, &message);
        ticks_passed += passed.iter().filter(|(link, ..)| *link == GCS_LINK).count();
        if k % 10 == 0 {
            let (_, passed) = setup.gcs.send(station, now, &command());
            assert_eq!(passed.len(), 1, "commands pass");
        }
    }
    assert_eq!(ticks_passed, 50, "one of four, for ten seconds");
    let station = &mut setup.station;
    let estimates = station.outputs.iter().filter(|(_, output)| {
        matches!(output, Output::Transmit { link: LINK, priority: Priority::Estimate { .. }, .. })
    });
    let estimates = estimates.count();
    // 200 B/s for ten seconds, of which twenty commands of 45 bytes have taken their part; one bucket more at the start.
    assert!((15..=25).contains(&estimates), "{estimates}");
    let (brick, gcs) = (health(station, LINK), health(station, GCS_LINK));
    assert_eq!(brick.rate_limited + estimates as u64, 200);
    assert_eq!(gcs.rate_limited, 150);
}
