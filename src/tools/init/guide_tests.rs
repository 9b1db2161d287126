//! The guide in virtual time, with a simulated robot of each protocol that a person moves.

use posebridge_protocol::detect::{Protocol, recognise};
use posebridge_protocol::text_columns::{ColumnTable, guess_columns};
use posebridge_sim::scenario::Personality;
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, PeerId, TimeDelta, Timestamp};

use super::args::GuideFlags;
use super::findings::Findings;
use super::live::GuidedRobot;
use super::robot_source::{RobotSource, brick_of};
use super::session::GuideSession;
use super::*;
use crate::config::{LineSection, RobotWiring, load_text};

/// The flags of a command line.
fn flags(arguments: &[&str]) -> GuideFlags {
    use clap::{Args, Command, FromArgMatches};
    let all = [&["init", "--guide"], arguments].concat();
    let matches = InitArgs::augment_args(Command::new("init")).try_get_matches_from(all).unwrap();
    InitArgs::from_arg_matches(&matches).unwrap().guide
}

fn scenario(seed: u64, personality: Personality, settings: &str) -> Scenario {
    let text = format!(
        "seed = {seed}\n{settings}\n[path.by-hand]\n[drive]\nrest_s = 5\npause_s = 3\n[camera]\nis_present = false\n"
    );
    Scenario::from_toml(&text).unwrap().with_personality(personality)
}

/// A robot with its bytes so far.
struct World {
    simulation: Simulation,
    now: Timestamp<HostClock>,
    bytes: Vec<u8>,
}

impl World {
    fn new(scenario: Scenario) -> Self {
        Self { simulation: Simulation::new(scenario), now: Timestamp::ZERO, bytes: Vec::new() }
    }

    /// A millisecond, with what the robot sends in it.
    fn step(&mut self) -> Vec<Vec<u8>> {
        self.simulation.step();
        self.now = Timestamp::ZERO + self.simulation.elapsed();
        std::iter::from_fn(|| self.simulation.poll()).collect()
    }

    fn listen(&mut self, for_s: f64) {
        let end = self.now + TimeDelta::from_secs_f64(for_s);
        while self.now < end {
            let heard = self.step();
            self.bytes.extend(heard.concat());
        }
    }

    /// Runs a session until the guide has all motions, or the hand is done.
    fn guide(&mut self, source: &RobotSource, flags: &GuideFlags) -> GuideSession {
        let link = LinkId(0);
        let mut session =
            GuideSession::new(source.station_config().unwrap(), flags.settings(source), self.now).unwrap();
        session.handle(self.now, &Input::Link { link, state: LinkState::Up });
        while session.guide.step().is_some() && !self.simulation.is_finished() {
            for (_, _, bytes) in std::mem::take(&mut session.outgoing) {
                self.simulation.receive(&bytes);
            }
            for bytes in self.step() {
                session.handle(self.now, &Input::Bytes { link, peer: PeerId::default(), bytes });
            }
            if session.deadline().is_some_and(|due| due <= self.now) {
                session.handle(self.now, &Input::Tick);
            }
        }
        session
    }
}

fn link() -> TemplateLink {
    TemplateLink { url: "serial:brick.tty".to_owned(), ..TemplateLink::default() }
}

/// The configuration that the guide writes for a robot, and the robot.
fn guided(scenario: Scenario, flags: &GuideFlags) -> (Config, Vec<String>, Simulation) {
    let mut world = World::new(scenario);
    world.listen(1.5);
    // A LEGO brick is silent until it is asked.
    let protocol = match world.simulation.scenario().brick.personality {
        Personality::Nxt => Protocol::Nxt,
        Personality::Ev3 => Protocol::Ev3,
        Personality::Mavlink | Personality::NxtPush | Personality::Line => recognise(&world.bytes).protocol,
    };
    let mut source = RobotSource::new(link(), protocol.name().to_owned(), brick_of(protocol).unwrap(), None).unwrap();
    if let Some(table) = ColumnTable::read(&world.bytes).filter(|_| source.reads_text()) {
        let mapping = guess_columns(&table, Some(TimeDelta::from_millis(1_500)));
        source.set_columns(mapping.guesses.iter().map(|guess| guess.column.to_string()).collect());
    }
    let session = world.guide(&source, flags);
    let robot = GuidedRobot { source, session };
    let findings = Findings::of(&robot).unwrap();
    let text = guided_text(&robot, &findings, "a.toml");
    let loaded = load_text("a.toml", &text, &[]).unwrap_or_else(|error| panic!("{error}:\n{text}"));
    loaded.config.validate().unwrap();
    (loaded.config, [findings.lines, findings.notes].concat(), world.simulation)
}

fn assert_geometry(config: &Config, simulation: &Simulation, seed: u64) {
    let robot = &config.robot;
    let found = [robot.left_wheel_radius_m, robot.right_wheel_radius_m, robot.track_width_m];
    for (found, truth) in found.into_iter().zip(simulation.true_geometry_m()) {
        assert!((found / truth - 1.0).abs() < 0.02, "seed {seed}: {found} for {truth}");
    }
    assert!((robot.ticks_per_turn / 360.0 - 1.0).abs() < 0.02, "{}", robot.ticks_per_turn);
    assert!(!robot.adopt_description);
}

#[test]
fn the_geometry_of_a_robot_of_each_protocol_is_right_within_two_per_cent() {
    for personality in [Personality::Mavlink, Personality::Nxt, Personality::Ev3, Personality::Line] {
        for seed in 1..=6 {
            let (config, lines, simulation) = guided(scenario(seed, personality, ""), &flags(&[]));
            assert_geometry(&config, &simulation, seed);
            assert_eq!(config.robot.wiring, RobotWiring::default(), "{personality:?}: {lines:?}");
            let brick = match personality {
                Personality::Mavlink => None,
                Personality::Nxt | Personality::NxtPush => Some("nxt"),
                Personality::Ev3 => Some("ev3"),
                Personality::Line => Some("columns"),
            };
            assert_eq!(config.links[0].brick.as_deref(), brick);
            assert_eq!(config.links[0].url, "serial:brick.tty");
        }
    }
}

#[test]
fn what_a_board_prints_otherwise_is_found_and_corrected() {
    let cases: [(&str, &[&str], RobotWiring); 3] = [
        (
            "[text_board]\nline = \"enc: {-right_ticks} / {left_ticks} gyro {-gyro_deg_per_s} at {time_s}\"",
            &["left_ticks", "right_ticks", "gyro_deg_per_s", "time_s"],
            RobotWiring { swap_wheels: true, reverse_right: true, reverse_gyro: true, ..RobotWiring::default() },
        ),
        (
            "[text_board]\nheader = \"ms;r;l;gz\"\nline = \"{time_ms};{right_ticks};{left_ticks};{gyro_rad_per_s}\"",
            &["time_ms", "right_ticks", "left_ticks", "gyro_rad_per_s"],
            RobotWiring::default(),
        ),
        (
            "[text_board]\nline = \"{time_us} {-left_ticks} {-right_ticks}\"",
            &["time_us", "left_ticks", "right_ticks"],
            RobotWiring { reverse_left: true, reverse_right: true, ..RobotWiring::default() },
        ),
    ];
    for (settings, columns, wiring) in cases {
        let (config, lines, simulation) = guided(scenario(3, Personality::Line, settings), &flags(&[]));
        assert_geometry(&config, &simulation, 3);
        assert_eq!(config.robot.wiring, wiring, "{lines:?}");
        assert_eq!(config.robot.line.unwrap().columns, columns);
    }
}

#[test]
fn a_robot_that_reports_metres_knows_its_wheels_and_not_its_track() {
    let (config, lines, simulation) =
        guided(scenario(2, Personality::Mavlink, "[brick]\nwire = \"standard\""), &flags(&[]));
    assert!(lines[0].contains("a metre is"), "{lines:?}");
    let [left_m, right_m, track_m] = simulation.true_geometry_m();
    let scale = 0.5 * (left_m + right_m) / simulation.scenario().robot.wheel_radius_m;
    assert!((1.0 + config.robot.calibration.radius_scale.value - scale).abs() < 0.01);
    assert!((config.robot.track_width_m / track_m - 1.0).abs() < 0.02);
}

#[test]
fn motions_that_are_left_out_and_known_counts_stand_in_the_file() {
    let flags = flags(&["--skip", "wheel", "--ticks-per-turn", "360"]);
    let mut scenario = scenario(5, Personality::Mavlink, "");
    let posebridge_sim::scenario::Course::ByHand(motions) = &mut scenario.path else { panic!("by hand") };
    // Too little to be a motion.
    motions.wheel_turns = 0.001;
    let (config, lines, simulation) = guided(scenario, &flags);
    assert_geometry(&config, &simulation, 5);
    assert!(lines[0].contains("given"), "{lines:?}");
}

/// The gyro's own numbers have a scale that the turn shows.
#[test]
fn a_gyro_of_unknown_scale_is_given_the_usual_one_that_is_near() {
    use posebridge_estimator::hand_motions::{DriveFigures, HandFigures};
    use posebridge_telemetry::UncertainValue;
    let figures = |ratio: f64| DriveFigures {
        gyro_step: None,
        ticks_per_turn: None,
        radii_m: None,
        reported_m: None,
        track_m: None,
        order: posebridge_telemetry::WheelOrder::AsNamed,
        polarity: [posebridge_telemetry::Polarity::Normal; 2],
        gyro_ratio: Some(UncertainValue { value: ratio, sigma: 0.01 }),
    };
    let cases = [
        ("gyro_counts", 131.0 / 131.0, "gyro_counts", Some("131.0")),
        ("gyro_counts", 16.0 / 131.0, "gyro_counts", Some("16.4")),
        ("gyro_counts", 20.0 / 131.0, "gyro_counts", Some("20.0")),
        ("gyro_counts", 1.02 / 131.0, "gyro_deg_per_s", None),
        ("gyro_deg_per_s", 1.1, "gyro_deg_per_s", None),
        ("gyro_deg_per_s", 1_f64.to_radians(), "gyro_rad_per_s", None),
        ("-gyro_rad_per_s", 57.0, "-gyro_deg_per_s", None),
    ];
    for (column, ratio, expected, scale) in cases {
        let mut source = RobotSource::new(link(), String::new(), "columns", None).unwrap();
        let columns = ["left_ticks", "right_ticks", column].map(str::to_owned);
        source.line = Some(LineSection { columns: columns.into(), ..LineSection::default() });
        let base = source.base_profile().unwrap().robot;
        let findings = Findings::new(&figures(ratio), &HandFigures::default(), &source, &base);
        let value = |key: &str| findings.values.iter().find(|value| value.key == key).map(|value| value.value.clone());
        assert!(
            value("columns").unwrap().contains(&format!("\"{expected}\"")),
            "{column} {ratio}: {:?}",
            value("columns")
        );
        assert_eq!(value("gyro_counts_per_deg_per_s").as_deref(), scale, "{column} {ratio}");
    }
}
