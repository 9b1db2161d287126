//! Several robots in one station, from the command line to the tables: on one UDP port and on terminals of their own.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::collections::BTreeSet;
use std::path::Path;

use posebridge::config::{Config, LinkSection, load_text};
use posebridge::station::event_collector::EventCollector;
use posebridge::station::learned_calibration::LearnedCalibration;
use posebridge::station::per_robot::{PerRobot, RobotEntry};
use posebridge::station::run_report::{SimulationTruth, errors};
use posebridge_sim::{Scenario, Simulation, Steering};
use posebridge_station::Station;
use posebridge_telemetry::{Event, Input, LinkId, LinkState, Output, PeerId, Recipients, TimeDelta, Timestamp};
use support::{RunningProgram, assert_replays, json, read_text, run, write_text};

/// A brick and where the station hears it.
struct ConnectedBrick {
    simulation: Simulation,
    link: LinkId,
    peer: PeerId,
}

impl ConnectedBrick {
    fn new(scenario: Scenario, link: u16, peer: u32) -> Self {
        Self { simulation: Simulation::new(scenario), link: LinkId(link), peer: PeerId(peer) }
    }

    fn receives(&self, link: LinkId, to: Recipients) -> bool {
        self.link == link
            && match to {
                Recipients::All => true,
                Recipients::AllExcept(peer) => peer != self.peer,
                Recipients::Peer(peer) => peer == self.peer,
            }
    }
}

/// What bricks and a station leave behind.
struct BricksRun {
    bricks: Vec<ConnectedBrick>,
    inputs: Vec<(TimeDelta, Input)>,
    events: Vec<Event>,
}

/// A station whose first link is a UDP port and whose others are terminals.
fn station(links: u16) -> Station {
    let port = LinkSection { listen: true, ..LinkSection::new("udp://127.0.0.1:14550") };
    let terminals = (1..links).map(|link| LinkSection::new(&format!("serial:brick-{link}.tty")));
    let config = Config { links: std::iter::once(port).chain(terminals).collect(), ..Config::default() };
    Station::new(config.station_config().unwrap(), Timestamp::ZERO).unwrap()
}

/// Lets bricks drive for so long with a station of this many links; every input and event is kept.
fn drive(links: u16, bricks: Vec<ConnectedBrick>, duration: TimeDelta) -> BricksRun {
    drive_with(&mut station(links), links, bricks, duration)
}

/// The same with any station.
fn drive_with(station: &mut Station, links: u16, mut bricks: Vec<ConnectedBrick>, duration: TimeDelta) -> BricksRun {
    let mut run = BricksRun { bricks: Vec::new(), inputs: Vec::new(), events: Vec::new() };
    let mut pending: Vec<Input> =
        (0..links).map(|link| Input::Link { link: LinkId(link), state: LinkState::Up }).collect();
    let mut elapsed = TimeDelta::ZERO;
    while elapsed < duration {
        let now = Timestamp::ZERO + elapsed;
        if station.deadline().is_some_and(|deadline| deadline <= now) {
            pending.push(Input::Tick);
        }
        for input in pending.drain(..) {
            station.handle(now, &input);
            run.inputs.push((elapsed, input));
            while let Some(output) = station.poll() {
                match output {
                    Output::Event(event) => run.events.push(event),
                    Output::Transmit { link, to, bytes, .. } => {
                        let listeners = bricks.iter_mut().filter(|brick| brick.receives(link, to));
                        listeners.for_each(|brick| brick.simulation.receive(&bytes));
                    }
                    Output::Request(_) => {}
                }
            }
        }
        for brick in &mut bricks {
            brick.simulation.step();
            while let Some(bytes) = brick.simulation.poll() {
                pending.push(Input::Bytes { link: brick.link, peer: brick.peer, bytes });
            }
        }
        elapsed = bricks.first().map_or(duration, |brick| brick.simulation.elapsed());
    }
    run.bricks = bricks;
    run
}

/// The root mean square error of each robot's estimates in metres, in the order of the bricks.
fn rms_m(run: &BricksRun) -> Vec<f64> {
    let mut robots = PerRobot::new(EventCollector::default);
    for event in &run.events {
        robots.push(event, EventCollector::on_event);
    }
    let rms_of = |brick: &ConnectedBrick| {
        let truth = SimulationTruth::from_simulation(&brick.simulation);
        let rms = |robot: &RobotEntry<EventCollector>| errors(&robot.value, &truth).0.position_rms_m;
        // Robots with the same ids are told apart by where they are: the others are at least a path away.
        let on_link = robots.entries().iter().filter(|robot| robot.robot.is_some_and(|id| id.link == brick.link));
        on_link.filter_map(rms).min_by(f64::total_cmp).unwrap()
    };
    run.bricks.iter().map(rms_of).collect()
}

const CONFIG: &str = r#"
[[robot]]
name = "brick"

[[robot]]
match = { system = 2 }
name = "ada"
"#;

/// What `replay --json` says of each robot: its name and its root mean square error in metres.
fn replayed(folder: &Path, recording: &str) -> Vec<(String, f64)> {
    let report = json(folder, &["replay", recording]);
    let robots = report["estimators"].as_array().unwrap().iter().map(|one| {
        let name = one["robot"].as_str().expect("each row names its robot").to_owned();
        (name, one["position_rms_m"].as_f64().expect("each robot has a truth"))
    });
    robots.collect()
}

#[test]
fn simulated_robots_on_one_port_have_their_own_names_truths_and_figures() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "robots.toml", CONFIG);
    let args = ["run", "--robots", "4", "--duration", "5", "--config", "robots.toml", "--no-dashboard"];
    let out = ["--link", "sim://square", "--out", "run", "--events", "live"];
    let table = run(folder, &[&args[..], &out].concat());
    let all = BTreeSet::from(["0/1/1", "ada", "0/3/1", "0/4/1"]);
    for robot in &all {
        assert!(table.lines().any(|line| line.starts_with(robot)), "{robot}: {table}");
    }
    let robots = replayed(folder, "run/recording.mcap");
    let names: BTreeSet<&str> = robots.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, all);
    // Another robot's truth is a metre and a half away.
    assert!(robots.iter().all(|(_, rms_m)| *rms_m < 0.02), "{robots:?}");
    assert_replays(folder, "run/recording.mcap", "live");
    let report = json(folder, &["report", "run/recording.mcap", "--only", "ada"]);
    assert_eq!(report["runs"].as_array().unwrap().len(), 1);
    assert_eq!(report["runs"][0]["name"], "ada");
    run(folder, &["export", "run/recording.mcap", "--format", "csv,tum", "--out", "out"]);
    let estimates = read_text(folder, "out/estimates.csv");
    let of_robots: BTreeSet<&str> = estimates.lines().skip(1).filter_map(|line| line.rsplit(',').next()).collect();
    assert_eq!(of_robots, all);
    for name in ["estimate-ada.tum", "truth-ada.tum", "estimate-0-1-1.tum"] {
        assert!(folder.join("out").join(name).is_file(), "{name}");
    }
}

#[test]
fn robots_on_terminals_of_their_own_are_robots_of_their_own_links() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let sim = ["sim", "--robots", "2", "--listen", "pty:brick-{}.tty"];
    let mut bricks = RunningProgram::posebridge(folder, &sim);
    bricks.wait_for("brick 2 up");
    let links = ["--link", "serial:brick-1.tty", "--link", "serial:brick-2.tty"];
    let args = ["run", "--duration", "4", "--no-dashboard", "--out", "run"];
    let table = run(folder, &[&args[..], &links].concat());
    for robot in ["0/1/1", "1/2/1"] {
        assert!(table.lines().any(|line| line.starts_with(robot)), "{robot}: {table}");
    }
}

#[test]
fn a_robot_that_is_given_a_free_system_id_keeps_the_block_of_its_own_ids() {
    let text = format!("{CONFIG}\n[[robot]]\nmatch = {{ system = 1 }}\nname = \"bob\"");
    let config = Config {
        links: vec![LinkSection { listen: true, ..LinkSection::new("udp://127.0.0.1:14550") }],
        ..load_text("robots.toml", &text, &[]).unwrap().config
    };
    let mut station = Station::new(config.station_config().unwrap(), Timestamp::ZERO).unwrap();
    let mut scenarios = Scenario::default().without_end().side_by_side(2).unwrap();
    scenarios[1].brick.system = 1;
    let bricks = (0..).zip(scenarios).map(|(peer, scenario)| ConnectedBrick::new(scenario, 0, peer)).collect();
    drive_with(&mut station, 1, bricks, TimeDelta::from_millis(5_000));
    let ids: Vec<String> = station.robots().iter().map(|robot| robot.id().address.to_string()).collect();
    assert_eq!(ids, ["1/1", "2/1"], "the second is given system 2, which the block of ada matches");
    let learned = LearnedCalibration::of_session(&station, "run", &config).unwrap();
    let names: Vec<_> = learned.iter().map(|learned| (learned.robot.name.as_str(), learned.run.as_str())).collect();
    assert_eq!(names, [("bob", "run bob"), ("bob", "run bob 0/2/1")]);
}

/// Robots on one UDP port, on terminals of their own, and two more on the port with ids that others there have.
const ON_PORT: u8 = 30;
const ON_TERMINALS: u8 = 8;
const NAMESAKES: u8 = 2;

#[test]
fn each_of_many_robots_is_estimated_as_well_as_alone_and_a_replay_is_the_run() {
    let duration = TimeDelta::from_millis(60_000);
    let count = ON_PORT + ON_TERMINALS + NAMESAKES;
    // By its own odometry a robot drives the same path whatever the station tells it, so that both have one truth.
    let scenario = Scenario::default().without_end().with_steering(Steering::Odometry);
    let mut scenarios = scenario.side_by_side(count).unwrap();
    for (index, scenario) in scenarios.iter_mut().skip(usize::from(ON_PORT + ON_TERMINALS)).enumerate() {
        scenario.brick.system = 1 + index as u8;
    }
    let links = u16::from(1 + ON_TERMINALS);
    let place = |index: usize| match index.checked_sub(usize::from(ON_PORT)) {
        Some(terminal) if terminal < usize::from(ON_TERMINALS) => (1 + terminal as u16, 0),
        _ => (0, index as u32),
    };
    let bricks = scenarios.iter().enumerate().map(|(index, scenario)| {
        let (link, peer) = place(index);
        ConnectedBrick::new(scenario.clone(), link, peer)
    });
    let together = drive(links, bricks.collect(), duration);
    let together_m = rms_m(&together);
    for (index, scenario) in scenarios.into_iter().enumerate() {
        let (link, peer) = place(index);
        let alone = drive(links, vec![ConnectedBrick::new(scenario, link, peer)], duration);
        let ratio = together_m[index] / rms_m(&alone)[0];
        println!("robot {index}: {:.3} mm, {ratio:.4} of what it is alone", 1e3 * together_m[index]);
        assert!((ratio - 1.0).abs() < 0.05, "robot {index}: {ratio}");
    }
    let mut replay = station(links);
    let mut replayed: Vec<Event> = Vec::new();
    for (elapsed, input) in &together.inputs {
        replay.handle(Timestamp::ZERO + *elapsed, input);
        while let Some(output) = replay.poll() {
            if let Output::Event(event) = output {
                replayed.push(event);
            }
        }
    }
    assert_eq!(replay.robots().len(), usize::from(count));
    assert!(replayed == together.events, "the replay is the run");
}
