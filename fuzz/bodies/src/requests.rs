//! Whatever a ground station asks of a station and its robot, in any order and with any fields: every input ends, and what is sent are whole
//! frames of a bounded number.

use std::sync::LazyLock;

use posebridge::config::load_text;
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::dialect::definitions::{MessageDefinition, definitions};
use posebridge_protocol::dialect::fields::{FullPayload, Value, frame};
use posebridge_protocol::framing::{VerifiedFrame, WireVersion, verify};
use posebridge_protocol::message::{Heartbeat, Message, WheelTicks, WireStamp};
use posebridge_station::{Station, StationConfig};
use posebridge_telemetry::{
    Address, EncoderTicks, HostClock, Input, LinkId, LinkState, Output, PeerId, TimeDelta, Timestamp,
};

use crate::operands::Operands;

/// A robot that drives to goals, a ground station, and a place on the Earth.
const CONFIG: &str = r#"
[station.origin]
latitude = 52.0
longitude = 4.3
[robot]
accepts_goals = true
[[link]]
url = "udp://127.0.0.1:1"
[[link]]
url = "udp://127.0.0.1:2"
ground_station = true
"#;
const ROBOT_LINK: LinkId = LinkId(0);
const GROUND_LINK: LinkId = LinkId(1);
const ROBOT: Address = Address::new(1, 1);
const GROUND: Address = Address::new(255, 190);
/// What ground stations ask, command and upload; any other message can come as well.
const REQUESTS: [&str; 24] = [
    "PARAM_REQUEST_READ",
    "PARAM_REQUEST_LIST",
    "PARAM_SET",
    "MISSION_REQUEST_LIST",
    "MISSION_REQUEST_INT",
    "MISSION_REQUEST",
    "MISSION_COUNT",
    "MISSION_ITEM_INT",
    "MISSION_ITEM",
    "MISSION_CLEAR_ALL",
    "MISSION_SET_CURRENT",
    "MISSION_ACK",
    "COMMAND_INT",
    "COMMAND_LONG",
    "MANUAL_CONTROL",
    "SET_POSITION_TARGET_LOCAL_NED",
    "FILE_TRANSFER_PROTOCOL",
    "LOG_REQUEST_LIST",
    "LOG_REQUEST_DATA",
    "SET_GPS_GLOBAL_ORIGIN",
    "TIMESYNC",
    "PING",
    "REQUEST_DATA_STREAM",
    "SET_MODE",
];
/// Outputs of one input beyond which something feeds itself.
const MAX_OUTPUTS: usize = 2_000;
const MAX_INPUTS: usize = 100;
const WAIT_UNIT_MS: i64 = 5;
static STATION_CONFIG: LazyLock<StationConfig> = LazyLock::new(config);

/// Input: operations of a wait, a message and its fields.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    let mut station = Recipient::new(&STATION_CONFIG);
    let mut conversation = Conversation::default();
    for _ in 0..MAX_INPUTS {
        if operands.is_empty() {
            return;
        }
        let input = conversation.next(&mut operands);
        station.handle(&input, TimeDelta::from_millis(WAIT_UNIT_MS * i64::from(operands.byte())));
    }
}

fn config() -> StationConfig {
    let loaded = load_text("requests.toml", CONFIG, &[]);
    match loaded.map(|loaded| loaded.config.station_config()) {
        Ok(Ok(config)) => config,
        Ok(Err(error)) => panic!("{error:#}"),
        Err(error) => panic!("{error}"),
    }
}

/// A station and its time.
struct Recipient {
    station: Station,
    now: Timestamp<HostClock>,
}

impl Recipient {
    fn new(config: &StationConfig) -> Self {
        let now = Timestamp::from_millis(1_000);
        let mut station = match Station::new(config.clone(), now) {
            Ok(station) => station,
            Err(error) => panic!("{error}"),
        };
        for link in [ROBOT_LINK, GROUND_LINK] {
            station.handle(now, &Input::Link { link, state: LinkState::Up });
        }
        Self { station, now }
    }

    /// An input, and the time behind it.
    fn handle(&mut self, input: &Input, wait: TimeDelta) {
        self.station.handle(self.now, input);
        self.check_outputs();
        let end = self.now + wait;
        while let Some(due) = self.station.deadline().filter(|due| *due <= end) {
            assert!(due > self.now, "it is due at {due:?}, now {:?}", self.now);
            self.now = due;
            self.station.handle(due, &Input::Tick);
            self.check_outputs();
        }
        self.now = end;
    }

    fn check_outputs(&mut self) {
        let mut outputs = 0;
        while let Some(output) = self.station.poll() {
            outputs += 1;
            assert!(outputs < MAX_OUTPUTS);
            if let Output::Transmit { bytes, .. } = output {
                assert!(matches!(verify(&bytes), VerifiedFrame::Frame(_)), "{bytes:02x?}");
            }
        }
    }
}

/// Those who speak: the robot and the ground station.
struct Conversation {
    robot: Encoder,
    ticks: u16,
    sequence: u8,
}

impl Default for Conversation {
    fn default() -> Self {
        Self { robot: Encoder::new(WireVersion::V2), ticks: 0, sequence: 0 }
    }
}

impl Conversation {
    fn next(&mut self, operands: &mut Operands<'_>) -> Input {
        let which = operands.byte();
        let (link, bytes) = match which {
            0..=15 => (ROBOT_LINK, self.robot_message(operands.byte())),
            16..=239 => {
                let name = REQUESTS[usize::from(which) % REQUESTS.len()];
                let Some(definition) = definitions().iter().find(|definition| definition.name == name) else {
                    panic!("no dialect has {name}");
                };
                (GROUND_LINK, self.request(definition, operands))
            }
            240..=255 => {
                let all = definitions();
                (GROUND_LINK, self.request(&all[usize::from(operands.number()) % all.len()], operands))
            }
        };
        Input::Bytes { link, peer: PeerId::default(), bytes }
    }

    fn robot_message(&mut self, step: u8) -> Vec<u8> {
        let message = if step == 0 {
            Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 })
        } else {
            self.ticks = self.ticks.wrapping_add(u16::from(step));
            let ticks = EncoderTicks(i64::from(self.ticks));
            let stamp = WireStamp::Micros32(u32::from(self.ticks) * 10_000);
            Message::WheelTicks(WheelTicks { stamp, left: ticks, right: ticks })
        };
        let mut bytes = Vec::new();
        self.robot.encode(ROBOT, &message, &mut bytes);
        bytes
    }

    /// A message with its fields from the operands; three of four times it is for the vehicle.
    fn request(&mut self, definition: &MessageDefinition, operands: &mut Operands<'_>) -> Vec<u8> {
        let options = operands.byte();
        let mut payload = FullPayload::new(operands.take_up_to(usize::from(options >> 2)));
        if options & 3 != 0 {
            for (name, part) in [("target_system", ROBOT.system.0), ("target_component", ROBOT.component.0)] {
                if let Some(field) = definition.fields.iter().find(|field| field.name == name) {
                    payload.set(field, 0, Value::Unsigned(part.into()));
                }
            }
        }
        self.sequence = self.sequence.wrapping_add(1);
        frame(definition, WireVersion::V2, GROUND, self.sequence, &payload).unwrap_or_default()
    }
}
