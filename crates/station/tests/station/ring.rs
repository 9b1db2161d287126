//! Two stations that are joined by two links: frames do not circle.

use std::collections::BTreeMap;

use crate::support::network::{BytesInTransit, RemotePeer};
use crate::support::{TestStation, at, config, link, stream, ticks};
use posebridge_protocol::dialect::ids;
use posebridge_station::OutputKind;
use posebridge_telemetry::{Address, LinkId, PeerId};

/// One of two stations in a ring, and a link of it.
type RingPort = (usize, LinkId);

/// Two stations joined by two links of unequal delay; the first has a brick, the second a listener.
struct StationRing {
    stations: [TestStation; 2],
    in_transit: BytesInTransit<RingPort>,
    first_output: [usize; 2],
    /// How often each frame crossed between the stations, and how often it reached the listener.
    crossings: BTreeMap<Vec<u8>, u32>,
    received: BTreeMap<Vec<u8>, u32>,
    frames: u64,
}

const NEAR: LinkId = LinkId(1);
const FAR: LinkId = LinkId(2);

impl StationRing {
    fn new() -> Self {
        let station = |system| {
            let mut config = config();
            config.own_address = Address::new(system, 197);
            config.links[0].id = LinkId(0);
            let pose = || vec![stream(OutputKind::PlanarPose, 100)];
            config.links.push(link(NEAR, pose()));
            config.links.push(link(FAR, pose()));
            TestStation::new(&config)
        };
        Self {
            stations: [station(1), station(2)],
            in_transit: BytesInTransit::default(),
            first_output: [0, 0],
            crossings: BTreeMap::new(),
            received: BTreeMap::new(),
            frames: 0,
        }
    }

    /// One millisecond.
    fn step(&mut self, now: i64) {
        while let Some(((index, link), bytes)) = self.in_transit.take_due(at(now)) {
            self.stations[index].bytes_from(at(now), link, PeerId::default(), &bytes);
        }
        for index in 0..2 {
            self.stations[index].pass_until(at(now));
            let station = &self.stations[index];
            for sent in station.sent_since(self.first_output[index]) {
                let delay = match sent.link {
                    NEAR => 3,
                    FAR => 40,
                    _ => {
                        *self.received.entry(sent.bytes.to_vec()).or_default() += 1;
                        continue;
                    }
                };
                if sent.to.includes(PeerId::default()) {
                    self.frames += 1;
                    *self.crossings.entry(sent.bytes.to_vec()).or_default() += 1;
                    self.in_transit.send(at(now + delay), (1 - index, sent.link), sent.bytes.to_vec());
                }
            }
            self.first_output[index] = station.outputs.len();
        }
    }
}

#[test]
fn two_stations_joined_by_two_links_do_not_let_frames_circle() {
    let mut ring = StationRing::new();
    let mut brick = RemotePeer::new(Address::new(3, 1), LinkId(0), 0);
    let mut sent = Vec::new();
    let mut per_minute = Vec::new();
    for minute in 0..3_i64 {
        let before = ring.frames;
        for k in 0..60_000 {
            let now = minute * 60_000 + k;
            if now % 50 == 0 {
                let stamp = u32::try_from(now).expect("three minutes");
                let frame = brick.frame(&ticks(5_000 + stamp, 0, 0));
                brick.send_bytes(&mut ring.stations[0], at(now), &frame);
                sent.push(frame);
            }
            ring.step(now);
        }
        per_minute.push(ring.frames - before);
    }
    for frame in &sent[..sent.len() - 2] {
        assert_eq!(ring.received.get(frame), Some(&1), "reaches the listener once");
        // Out by both links, and back by the slower one from the station that had it by the quicker one.
        assert_eq!(ring.crossings.get(frame), Some(&3));
    }
    println!("frames between the stations per minute: {per_minute:?}");
    // Whatever it is, it crosses no more often. Messages without stamp may repeat byte for byte when the counter has wrapped.
    let unstamped = [ids::HEARTBEAT, ids::COMMAND_LONG, ids::COMMAND_ACK];
    for (frame, count) in &ring.crossings {
        let id = u32::from_le_bytes([frame[7], frame[8], frame[9], 0]);
        assert!(*count <= 3 || unstamped.contains(&id), "message {id}: {count}");
    }
    assert!(per_minute[2].abs_diff(per_minute[1]) < 20, "{per_minute:?}");
}
