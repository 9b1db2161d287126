//! The simulated brick in virtual time, with a station whose configuration is wrong in one thing: the station says it once, and a
//! replay says the same.

use posebridge::config::load_text;
use posebridge::station::wiring_fix::{WiringReport, wiring_text};
use posebridge::virtual_station::{RunEvent, RunScript, run_with};
use posebridge_sim::Scenario;
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, Input, Output, TimeDelta, Timestamp};

/// One lap of a square of a metre takes half a minute.
const AT_MOST: TimeDelta = TimeDelta::from_millis(60_000);

/// What a station says of the wiring: in a run and in a replay of its inputs, and the lines that undo it.
struct Said {
    live: Vec<String>,
    replayed: Vec<String>,
    lines: String,
}

fn drive(settings: &str) -> Said {
    let config = load_text("test", settings, &[]).unwrap().config;
    let (mut inputs, mut live): (Vec<(Timestamp<HostClock>, Input)>, Vec<Event>) = (Vec::new(), Vec::new());
    let script = RunScript {
        commands: &[],
        until: AT_MOST,
        linger: TimeDelta::ZERO,
        observer: &mut |now, event| match event {
            RunEvent::Input(input) => inputs.push((now, input.clone())),
            RunEvent::Event(event) => live.push(event.clone()),
        },
    };
    run_with(Scenario::bundled("square").unwrap(), config.station_config().unwrap(), script).unwrap();
    let mut station = Station::new(config.station_config().unwrap(), Timestamp::ZERO).unwrap();
    let mut replayed = Vec::new();
    for (now, input) in &inputs {
        station.handle(*now, input);
        while let Some(output) = station.poll() {
            if let Output::Event(event) = output {
                replayed.push(event);
            }
        }
    }
    let texts = |events: &[Event]| -> Vec<String> {
        let text = |event: &Event| match event {
            Event::Text { text, .. } if text.contains("the wheels") => Some(text.clone()),
            _ => None,
        };
        events.iter().filter_map(text).collect()
    };
    Said {
        live: texts(&live),
        replayed: texts(&replayed),
        lines: wiring_text(&WiringReport::of_session(station.robots(), &config)),
    }
}

#[test]
fn what_is_configured_wrongly_is_said_once_live_and_in_a_replay_with_the_line_that_undoes_it() {
    let described = "[robot]\nadopt_description = false\n";
    for (settings, words, line) in [
        ("[robot.wiring]\nswap_wheels = true\n", "are swapped", "swap_wheels = false"),
        ("[robot.wiring]\nreverse_left = true\n", "the left wheel counts backwards", "reverse_left = false"),
        ("[robot.wiring]\nreverse_right = true\n", "the right wheel counts backwards", "reverse_right = false"),
        ("[robot.wiring]\nreverse_left = true\nreverse_right = true\n", "both wheels count", "reverse_left = false"),
        ("[robot.wiring]\nreverse_gyro = true\n", "axis is reversed", "reverse_gyro = false"),
        ("[robot.wiring]\ngyro_unit = \"deg/s\"\n", "reports radians per second", "gyro_unit = \"rad/s\""),
        ("[robot.wiring]\ncamera_y_down = true\n", "points down", "camera_y_down = false"),
        (&format!("{described}ticks_per_turn = 720.0\n"), "twice as many", "ticks_per_turn = 360.0"),
        (&format!("{described}ticks_per_turn = 180.0\n"), "half as many", "ticks_per_turn = 360.0"),
        (&format!("{described}track_width_m = 0.224\n"), "is twice the real one", "track_width_m = 0.112"),
    ] {
        let said = drive(settings);
        let [text] = said.live.as_slice() else { panic!("{settings}: {:?}", said.live) };
        assert!(text.contains(words), "{settings}: {text}");
        assert_eq!(said.replayed, said.live);
        assert!(said.lines.contains(&format!("\n{line}\n")), "{settings}: {}", said.lines);
    }
}

#[test]
fn nothing_is_said_of_a_robot_that_is_configured_rightly() {
    let said = drive("");
    assert_eq!(said.live, Vec::<String>::new());
    assert_eq!(said.lines, "# wiring: nothing wrong was found\n");
}
