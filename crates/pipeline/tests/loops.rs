//! What comes back round a loop of links, late: it is passed on, obeyed and used once.
#![expect(
    clippy::expect_used,
    reason = "helpers of tests stop at the first surprise"
)]
#![expect(
    dead_code,
    reason = "the helpers are shared with tests that need others of them"
)]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/network.rs"]
mod network;
#[path = "support/station.rs"]
mod station;

use brick::{BRICK, ticks};
use network::{OnTheirWay, Speaker, passed_on};
use posebridge_telemetry::{Event, LinkId, Span};
use station::{LINK, Station, at, config, link};

/// Two links to another station.
const NEAR: LinkId = LinkId(4);
const FAR: LinkId = LinkId(5);

fn station_in_a_loop() -> Station {
    let mut config = config();
    config.links.push(link(NEAR, vec![]));
    config.links.push(link(FAR, vec![]));
    Station::new(&config)
}

#[test]
fn a_frame_that_waited_in_a_full_queue_on_its_way_round_goes_no_further() {
    // 64 KiB of forwarded frames may wait for a line of 57600 baud.
    let longest_wait = Span::from_secs_f64(65_536.0 / 5_760.0);
    for wait in [Span::from_millis(1_500), longest_wait] {
        let mut station = station_in_a_loop();
        let mut brick = Speaker::new(BRICK, LINK, 0);
        let far = Speaker::new(BRICK, FAR, 0);
        let mut on_their_way = OnTheirWay::default();
        for k in 0..800_u32 {
            let now = at(i64::from(k) * 50);
            let (frame, passed) = brick.say(&mut station, now, &ticks(5_000 + k * 50, 0, 0));
            assert_eq!(passed.len(), 2, "out by both links");
            on_their_way.send(now + wait, (), frame);
            while let Some(((), back)) = on_their_way.take_due(now) {
                let seen = station.outputs.len();
                far.give(&mut station, now, &back);
                assert_eq!(passed_on(&station, seen, &back), [], "after {wait:?}");
            }
        }
        let is_observation = |event: &&Event| matches!(event, Event::Observed { .. });
        assert_eq!(station.events().filter(is_observation).count(), 800);
    }
}
