//! How many states per second, side by side: IO maps against single commands, at 30 ms for each transaction.

use posebridge_protocol::bricks::nxt::{MaxOutstanding, NxtSensor, NxtSettings};
use posebridge_protocol::message::Message;

use super::bench::Bench;
use super::brick::{IoMapLimit, SimulatedNxt};
use super::session::{SECOND, assert_true, moving_brick};
use crate::support::RecordedEvent;

/// After connect and set-up.
const FROM: i64 = SECOND;
const SECONDS: i64 = 20;

/// States, wheels with the gyro of the same round, in a second.
fn states_per_second(maps: IoMapLimit, outstanding: MaxOutstanding) -> f64 {
    let settings = NxtSettings {
        sensors: [NxtSensor::HtGyro, NxtSensor::None, NxtSensor::None, NxtSensor::None],
        gyro_rest_counts: Some(600.0),
        outstanding,
        ..NxtSettings::default()
    };
    let mut brick = moving_brick();
    brick.ports[0].raw = 610;
    brick.io_map_limit = maps;
    let bench = Bench::run(settings, brick, FROM + SECONDS * SECOND);
    assert_true(&bench);
    let count = |is: fn(&Message) -> bool| {
        let is_counted = |(at, item): &&(i64, RecordedEvent)| {
            *at >= FROM && matches!(item, RecordedEvent::Message(message) if is(message))
        };
        bench.events.iter().filter(is_counted).count()
    };
    let wheels = count(|message| matches!(message, Message::WheelTicks(_)));
    let rates = count(|message| matches!(message, Message::Inertial(_)));
    wheels.min(rates) as f64 / SECONDS as f64
}

/// What two IO maps hold, three motors and four ports, read by the seven single commands that it takes; and the clock, which no single
/// command tells, left out.
fn seven_commands_per_second() -> f64 {
    let mut brick = SimulatedNxt::new();
    let (mut now, mut states) = (0, 0);
    while now < SECONDS * SECOND {
        for (opcode, port) in [(6, 0), (6, 1), (6, 2), (7, 0), (7, 1), (7, 2), (7, 3)] {
            brick.push_bytes(now, &[0x03, 0x00, 0x00, opcode, port]);
            now = brick.next_reply().expect("a reply is on its way");
            let reply = brick.queue_reply(now).expect("it has arrived");
            assert_eq!(reply[2..6], [0x02, opcode, 0x00, port]);
        }
        states += 1;
    }
    f64::from(states) / SECONDS as f64
}

#[test]
fn io_maps_give_at_least_fourteen_states_a_second_and_three_times_single_commands() {
    let complete = states_per_second(IoMapLimit::UpTo(119), MaxOutstanding::One);
    let two = states_per_second(IoMapLimit::UpTo(119), MaxOutstanding::Two);
    let short = states_per_second(IoMapLimit::UpTo(55), MaxOutstanding::One);
    let single = states_per_second(IoMapLimit::Unknown, MaxOutstanding::One);
    let seven = seven_commands_per_second();
    println!("states per second at 30 ms for each transaction");
    println!("  IO maps, 119 bytes     3 motors + 4 ports  {complete:5.2}");
    println!("  the same, two at once                      {two:5.2}");
    println!("  IO maps, 55 bytes      2 motors + 1 port   {short:5.2}");
    println!("  single commands        2 motors + 1 port   {single:5.2}");
    println!("  single commands        3 motors + 4 ports  {seven:5.2}");
    println!("  IO maps over single commands, same content {:5.2}", complete / seven);
    assert!(complete >= 14.0, "{complete}");
    assert!(complete >= 3.0 * seven, "{complete} {seven}");
    assert!(short > single && complete >= short, "{complete} {short} {single}");
}
