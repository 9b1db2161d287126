use std::io::Read as _;

use nix::pty::openpty;
use nix::sys::termios::tcgetattr;
use posebridge_dashboard::model::{
    CalibrationRow, ClockRow, ErrorsRow, EstimatePoint, FixPoint, FleetEstimateRow, FleetOwnerRow, FleetRobotRow,
    FleetState, FleetStationRow, Frame, FusionPoint, LinkRow, LogLine, QuantityPoint, RecordingNow, RobotFrame,
    TruthPoint,
};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};

use super::keys::{KEYS, KeyPress};
use super::render::render;
use super::*;

/// A robot that drives a quarter of a circle around the origin, a metre away; its odometry drifts outwards.
fn drive(count: u32) -> impl Iterator<Item = (f64, f64, f64)> {
    (0..count).map(move |step| {
        let angle_rad = f64::from(step) / f64::from(count) * std::f64::consts::FRAC_PI_2;
        (f64::from(step) * 0.05, angle_rad.cos(), angle_rad.sin())
    })
}

fn estimates() -> Vec<EstimatePoint> {
    let points = drive(200).map(|(t_s, x_m, y_m)| EstimatePoint {
        t_s,
        robot_s: t_s,
        x_m: x_m.into(),
        y_m: y_m.into(),
        heading_rad: 3.1.into(),
        major_m: 0.0123.into(),
        minor_m: 0.01.into(),
        axis_rad: 0.3.into(),
        heading_sigma_rad: 0.01.into(),
        forward_m_per_s: 0.2.into(),
        turn_rad_per_s: 0.16.into(),
        reset_counter: 1,
        is_dead_reckoning: false,
        fix_age_s: 0.08.into(),
        is_relative: false,
        is_heading_known: true,
    });
    points.collect()
}

fn truth() -> Vec<TruthPoint> {
    let points = drive(200).map(|(t_s, x_m, y_m)| TruthPoint {
        robot: None,
        t_s,
        robot_s: t_s,
        x_m: x_m.into(),
        y_m: y_m.into(),
        heading_rad: 3.1.into(),
        odometry: Some([(x_m * (1.0 + 0.03 * t_s)).into(), (y_m * 1.1).into(), 3.0.into()]),
    });
    points.collect()
}

fn records() -> Vec<FusionPoint> {
    let record = |step: u32, sensor: &'static str, verdict: &'static str, nis: f64| FusionPoint {
        t_s: f64::from(step) * 0.05,
        sensor: sensor.into(),
        kind: sensor.into(),
        verdict: verdict.into(),
        nis: nis.into(),
        dof: u8::from(nis.is_finite()),
        ..FusionPoint::default()
    };
    let steps = (0..200).flat_map(|step| {
        [
            record(step, "wheels", "accepted", 0.2),
            record(step, "gyro", "accepted", f64::NAN),
            record(step, "camera", if step % 9 == 8 { "gated" } else { "accepted" }, 1.02),
        ]
    });
    steps.collect()
}

fn fixes() -> Vec<FixPoint> {
    let verdicts = ["accepted", "gated", "too old", "accepted", "reset to"];
    let points = drive(5).zip(verdicts).map(|((_, x_m, y_m), verdict)| FixPoint {
        t_s: 9.0,
        x_m: (x_m * 0.9).into(),
        y_m: (y_m * 0.9).into(),
        verdict: verdict.into(),
        lag_s: 0.1.into(),
        ..FixPoint::default()
    });
    points.collect()
}

fn links() -> Vec<LinkRow> {
    let link = LinkRow {
        id: 0,
        name: "sim://square".to_owned(),
        state: "up".to_owned(),
        bytes_in_per_s: 4_321.0.into(),
        frames_in_per_s: 87.0.into(),
        lost: 3,
        round_trip_ms: 1.25.into(),
        ..LinkRow::default()
    };
    let other =
        LinkRow { id: 1, name: "udp://127.0.0.1:14550".to_owned(), state: "down".to_owned(), ..LinkRow::default() };
    vec![link, other]
}

fn calibration() -> Vec<CalibrationRow> {
    let row = |name: &'static str, value: f64, sigma: f64| CalibrationRow {
        t_s: 9.9,
        name: name.into(),
        value,
        sigma,
        unit: "".into(),
    };
    vec![row("radius_scale", 0.0056, 0.0025), row("gyro_bias_rad_per_s", -0.013, 0.0009), row("fix_delay_s", 0.0, 0.0)]
}

fn log() -> Vec<LogLine> {
    let line = |t_s: f64, severity: u8, text: &str| LogLine { t_s, severity, text: text.to_owned() };
    vec![
        line(0.2, 5, "heard 0/1/1"),
        line(4.0, 4, "1/1: \u{1b}[2Jfix gated\u{7}"),
        line(9.5, 5, "link sim://square is up"),
    ]
}

/// A message with a bit of everything.
fn frame() -> Frame {
    Frame {
        now_s: 9.96,
        robots: vec![
            RobotFrame {
                id: "0/1/1".to_owned(),
                estimates: estimates(),
                fixes: fixes(),
                fusion: records(),
                calibration: Some(calibration()),
                ..RobotFrame::default()
            },
            // Received, but not estimated.
            RobotFrame { id: "0/1/100".to_owned(), ..RobotFrame::default() },
        ],
        truth: truth(),
        errors: Some(ErrorsRow { odometry_m: 0.4217.into(), estimate_m: 0.0061.into() }),
        links: Some(links()),
        clock: Some(ClockRow {
            offset_s: -3.25,
            skew_ppm: 41.0.into(),
            uncertainty_ms: 0.31.into(),
            method: "two-way".to_owned(),
        }),
        log: log(),
        recording: Some(Some(RecordingNow { name: "recording.mcap".to_owned(), bytes: 1_234_567 })),
        ..Frame::default()
    }
}

fn model() -> Model {
    let mut model = Model::new(Some(SimulatorFacts {
        scenario: "quarter".to_owned(),
        path: drive(50).map(|(_, x, y)| [x, y]).collect(),
        ..SimulatorFacts::default()
    }));
    model.on_frame(&frame());
    model
}

fn drawn(model: &Model, look: Theme, (width, height): (u16, u16)) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| render(model, look, frame.area(), frame.buffer_mut())).unwrap();
    terminal.backend().buffer().clone()
}

fn text_of(buffer: &Buffer) -> String {
    let width = usize::from(buffer.area.width);
    let rows = buffer.content.chunks(width);
    let rows = rows.map(|row| row.iter().map(Cell::symbol).collect::<String>());
    let rows: Vec<String> = rows.map(|row| row.trim_end().to_owned()).collect();
    rows.join("\n")
}

fn pictured(model: &Model, size: (u16, u16)) -> String {
    text_of(&drawn(model, Theme::Coloured, size))
}

#[test]
fn everything_together_in_the_usual_sizes() {
    insta::assert_snapshot!("all_80x24", pictured(&model(), (80, 24)));
    insta::assert_snapshot!("all_120x40", pictured(&model(), (120, 40)));
    insta::assert_snapshot!("all_20x5", pictured(&model(), (20, 5)));
    insta::assert_snapshot!("nothing_yet_80x24", pictured(&Model::default(), (80, 24)));
}

#[test]
fn each_panel_alone() {
    let mut model = model();
    for panel in PANELS {
        choose(&mut model, UiAction::NextPanel);
        let name = panel.title.to_lowercase().replace(' ', "_");
        let text = pictured(&model, (60, 14));
        assert!(text.contains(&format!(" {} ", panel.title)), "{text}");
        insta::assert_snapshot!(format!("panel_{name}"), text);
    }
    choose(&mut model, UiAction::NextPanel);
    assert_eq!(model.selection.panel, None);
    choose(&mut model, UiAction::PreviousPanel);
    assert_eq!(model.selection.panel, Some(PANELS.len() - 1));
    choose(&mut model, UiAction::Back);
    assert_eq!(model.selection.panel, None);
}

#[test]
fn several_robots_have_a_list_and_the_others_stand_on_the_map() {
    let mut model = model();
    let at = |x_m: f64, y_m: f64, t_s: f64| EstimatePoint {
        t_s,
        x_m: x_m.into(),
        y_m: y_m.into(),
        heading_rad: 0.0.into(),
        major_m: 0.012.into(),
        fix_age_s: 0.4.into(),
        ..EstimatePoint::default()
    };
    let robot = |id: &str, name: Option<&str>, estimate| RobotFrame {
        id: id.to_owned(),
        name: name.map(str::to_owned),
        estimates: vec![estimate],
        ..RobotFrame::default()
    };
    model.on_frame(&Frame {
        now_s: 10.0,
        robots: vec![robot("0/2/1", Some("ada\u{1b}[2J"), at(1.5, 0.2, 9.9)), robot("0/3/1", None, at(0.4, 1.2, 4.0))],
        ..Frame::default()
    });
    choose(&mut model, UiAction::NextRobot);
    insta::assert_snapshot!("several_robots_120x40", pictured(&model, (120, 40)));
}

#[test]
fn no_size_is_too_small_or_too_large() {
    let mut model = model();
    for panel in std::iter::once(None).chain((0..PANELS.len()).map(Some)) {
        model.selection.panel = panel;
        model.selection.has_help = panel.is_none_or(|panel| panel % 2 == 0);
        for width in [1, 2, 3, 7, 20, 63, 64, 80, 300] {
            for height in [1, 2, 3, 4, 5, 15, 16, 24, 100] {
                let buffer = drawn(&model, Theme::Coloured, (width, height));
                assert_eq!(buffer.area.area(), u32::from(width) * u32::from(height));
            }
        }
    }
}

#[test]
fn a_filter_of_one_quantity_has_its_estimate_and_its_steps_in_the_panel_of_the_pose() {
    let mut model = Model::new(None);
    let point = |t_s, verdict: &'static str, predicted| QuantityPoint {
        t_s,
        verdict: verdict.into(),
        unit: "m".into(),
        estimate: 1.5.into(),
        bound_95: 0.04.into(),
        rate_per_s: (-0.25).into(),
        steps: 4,
        predicted,
        ..QuantityPoint::default()
    };
    let thermometer = QuantityPoint { name: "temp1".to_owned(), estimate: 48.7.into(), ..point(2.0, "accepted", 0) };
    model.on_frame(&Frame {
        now_s: 2.0,
        robots: vec![RobotFrame {
            id: "0/1/1".to_owned(),
            quantities: vec![point(1.9, "gated", 0), point(2.0, "", 1), thermometer],
            ..RobotFrame::default()
        }],
        ..Frame::default()
    });
    let text = pictured(&model, (120, 40));
    for expected in ["1.500 ± 0.040 m (95 %)  -0.250 m/s", "last reading gated, 25 % of 4 steps by prediction"] {
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn numbers_that_are_none_are_drawn_as_dashes() {
    let mut model = Model::new(None);
    model.on_frame(&Frame {
        robots: vec![RobotFrame {
            id: "0/1/1".to_owned(),
            estimates: vec![EstimatePoint { x_m: f64::NAN.into(), y_m: 1e30.into(), ..EstimatePoint::default() }],
            fixes: vec![FixPoint::default()],
            ..RobotFrame::default()
        }],
        truth: vec![TruthPoint::default()],
        errors: Some(ErrorsRow::default()),
        ..Frame::default()
    });
    let text = pictured(&model, (80, 24));
    assert!(text.contains("odometry – m off, estimate – m off"), "{text}");
}

#[test]
fn without_colours_the_same_cells_are_drawn() {
    let model = model();
    let coloured = drawn(&model, Theme::Coloured, (120, 40));
    let plain = drawn(&model, Theme::Plain, (120, 40));
    assert_eq!(text_of(&coloured), text_of(&plain));
    assert!(coloured.content.iter().any(|cell| cell.fg == Color::LightBlue));
    let has_colour = |cell: &&Cell| cell.fg != Color::Reset || cell.bg != Color::Reset;
    assert_eq!(plain.content.iter().find(has_colour), None);
    assert!(plain.content.iter().any(|cell| cell.modifier == Modifier::BOLD));
}

#[test]
fn help_explains_every_key_and_those_of_the_brick_are_offered_where_there_is_one() {
    let mut model = model();
    choose(&mut model, UiAction::Help);
    let text = pictured(&model, (120, 24));
    for key in KEYS {
        assert!(text.contains(key.help), "{}: {text}", key.name);
    }
    choose(&mut model, UiAction::Back);
    assert!(!model.selection.has_help);
    assert!(pictured(&model, (80, 24)).contains("k kidnap"));
    model.simulator = None;
    assert!(!pictured(&model, (80, 24)).contains("kidnap"));
}

#[test]
fn arrows_choose_among_the_robots_that_have_an_estimate() {
    let mut model = model();
    let mut second = frame();
    second.robots.truncate(1);
    "0/2/1".clone_into(&mut second.robots[0].id);
    model.on_frame(&second);
    assert_eq!(model.robots.len(), 3);
    assert_eq!(model.visible_robots().len(), 2);
    assert_eq!(model.selected_robot().unwrap().id, "0/1/1");
    choose(&mut model, UiAction::NextRobot);
    assert_eq!(model.selected_robot().unwrap().id, "0/2/1");
    assert!(pictured(&model, (120, 24)).contains("robot 0/2/1 of 2"));
    choose(&mut model, UiAction::NextRobot);
    assert_eq!(model.selected_robot().unwrap().id, "0/1/1");
    choose(&mut model, UiAction::PreviousRobot);
    assert_eq!(model.selected_robot().unwrap().id, "0/2/1");
}

#[test]
fn what_comes_is_bounded() {
    let mut model = Model::default();
    for index in 0..200 {
        let mut one = frame();
        one.robots[0].id = format!("0/{index}/1");
        one.robots[0].fusion[0].sensor = format!("sensor {index}").into();
        model.on_frame(&one);
        model.push_message("one\ntwo");
    }
    assert_eq!(model.robots.len(), 64);
    assert_eq!(model.log.len(), 300);
    let mut many = frame();
    many.robots.truncate(1);
    let record = many.robots[0].fusion[0].clone();
    many.robots[0].fusion =
        (0..100).map(|index| FusionPoint { sensor: format!("sensor {index}").into(), ..record.clone() }).collect();
    let mut model = Model::default();
    model.on_frame(&many);
    assert_eq!(model.robots[0].sources.len(), 32);
}

#[test]
fn a_terminal_is_given_back_when_something_panics() {
    let pty = openpty(None, None).unwrap();
    let before = tcgetattr(&pty.slave).unwrap();
    let name = nix::unistd::ttyname(&pty.slave).unwrap();
    let tty = Tty::open_at(&name).unwrap();
    assert!(tty.drain().unwrap());
    assert_ne!(tcgetattr(&pty.slave).unwrap(), before);
    restore_on_panic(&tty, || {});
    let thread = std::thread::spawn(|| panic!("on purpose: this message belongs to a test"));
    assert!(thread.join().is_err());
    assert_eq!(tcgetattr(&pty.slave).unwrap(), before);
    let mut shown = vec![0; 1_000];
    let read = std::fs::File::from(pty.master).read(&mut shown).unwrap();
    let shown = String::from_utf8_lossy(&shown[..read]).into_owned();
    assert!(shown.starts_with("\u{1b}[?1049h"), "{shown:?}");
    assert!(shown.ends_with("\u{1b}[?1049l"), "{shown:?}");
}

#[test]
fn what_is_typed_is_heard_and_a_terminal_that_hangs_up_is_an_error() {
    let pty = openpty(None, None).unwrap();
    let name = nix::unistd::ttyname(&pty.slave).unwrap();
    let tty = Tty::open_at(&name).unwrap();
    assert_eq!(tty.read(0).unwrap(), b"");
    nix::unistd::write(&pty.master, b"k\x1b[A").unwrap();
    let input = tty.read(1_000).unwrap();
    assert_eq!(keys::parse_key_presses(&input), [KeyPress::Letter('k'), KeyPress::Up]);
    let area = tty.area().unwrap();
    assert_eq!((area.width, area.height), (80, 24));
    drop(pty.master);
    assert!(tty.read(1_000).is_err());
    assert!(tty.drain().is_err());
    tty.restore();
}

#[test]
fn a_terminal_that_hangs_is_not_waited_for_and_gets_no_more_than_a_picture() {
    let pty = openpty(None, None).unwrap();
    let name = nix::unistd::ttyname(&pty.slave).unwrap();
    let tty = Tty::open_at(&name).unwrap();
    let mut screen = Screen::new(Arc::clone(&tty), Theme::Coloured).unwrap();
    let mut model = model();
    // There is no reader: the system's buffer fills, and from then on nothing is added.
    let mut most = 0;
    for picture in 0..2_000_u32 {
        model.now_s = f64::from(picture);
        model.selection.panel = Some(picture as usize % PANELS.len());
        screen.show(&model).unwrap();
        most = most.max(tty.waiting());
    }
    assert!(!tty.drain().unwrap());
    // A picture of 80 by 24 cells, each with a colour of its own.
    assert!((1..80 * 24 * 20).contains(&most), "{most} bytes wait");
    let before = tty.waiting();
    screen.show(&model).unwrap();
    assert_eq!(tty.waiting(), before);
}

#[test]
fn a_station_of_a_fleet_lists_its_robots_with_owner_age_and_losses() {
    let owner =
        |name: &str, is_this: bool| FleetOwnerRow { name: name.to_owned(), is_this, ..FleetOwnerRow::default() };
    let estimate = |age_s: f64, is_position_valid: bool| FleetEstimateRow {
        x_m: 1.5.into(),
        y_m: (-0.25).into(),
        heading_rad: 1.0.into(),
        is_position_valid,
        is_heading_valid: true,
        age_s,
        ..FleetEstimateRow::default()
    };
    let robot = |name: &str, owner, estimate| FleetRobotRow {
        name: name.to_owned(),
        owner,
        estimate,
        lost: 3,
        stale: 1,
        ..FleetRobotRow::default()
    };
    let station = |name: &str, is_this: bool, clock_uncertainty_s| FleetStationRow {
        name: name.to_owned(),
        is_this,
        clock_uncertainty_s,
        ..FleetStationRow::default()
    };
    let mut model = model();
    assert!(model.is_fleet_due());
    model.set_fleet(FleetState {
        name: "class".to_owned(),
        stations: vec![
            station("left", true, Some(0.0)),
            station("right", false, Some(0.0012)),
            station("new", false, None),
        ],
        robots: vec![
            robot("ada", Some(owner("left", true)), Some(estimate(0.042, true))),
            robot("bob\u{1b}[2J", Some(owner("right", false)), Some(estimate(7.2, true))),
            robot("eve", None, Some(estimate(0.5, false))),
            robot("new", Some(owner("right", false)), None),
        ],
    });
    assert!(!model.is_fleet_due());
    insta::assert_snapshot!("fleet_120x40", pictured(&model, (120, 40)));
    let size_of_each = [(1, 1), (7, 3), (20, 5), (64, 16)];
    model.selection.panel = PANELS.iter().position(|panel| panel.title == "Fleet");
    for size in size_of_each {
        drawn(&model, Theme::Coloured, size);
    }
    model.on_frame(&Frame { now_s: 10.97, ..Frame::default() });
    assert!(model.is_fleet_due(), "a second later");
}
