//! The picture of the terminal view in docs/dashboard.md: a lap of the simulated brick in virtual time, drawn as `--tui` draws it.
//! `POSEBRIDGE_WRITE_PICTURES=1 cargo test --test live terminal_picture` draws it anew.

use crate::support::root;
use crate::support::virtual_drive::record_drive_and_truth;
use posebridge::config::load_scenario;
use posebridge::station::page_history;
use posebridge::station::tui::model::Model;
use posebridge::station::tui::panels::PANELS;
use posebridge::station::tui::render::render;
use posebridge::station::tui::theme::Theme;
use posebridge_dashboard::model::{LogLine, RecordingNow, SimulatorFacts};
use posebridge_sim::Simulation;
use posebridge_telemetry::TimeDelta;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

/// Larger than the usual 80 by 24, so that every panel fits.
const SIZE: Rect = Rect::new(0, 0, 112, 34);

fn model() -> Model {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.mcap");
    let scenario = load_scenario("square").unwrap();
    record_drive_and_truth(&path, scenario.clone(), TimeDelta::from_millis(100));
    let history = page_history::build_history(&path).unwrap();
    let driven = Simulation::new(scenario.with_laps(1));
    let mut model = Model::new(Some(SimulatorFacts {
        scenario: "square".to_owned(),
        path: driven.path().iter().map(|at| [at.x.0, at.y.0]).collect(),
        ..SimulatorFacts::default()
    }));
    model.on_frame(&history);
    // Which a recording does not hold of itself.
    model.recording =
        Some(RecordingNow { name: "recording.mcap".to_owned(), bytes: std::fs::metadata(&path).unwrap().len() });
    model.log.push_front(LogLine { t_s: 0.0, severity: 5, text: "the page listens at 127.0.0.1:4680".to_owned() });
    model
}

#[test]
fn the_picture_shows_a_lap_with_every_panel() {
    let mut buffer = Buffer::empty(SIZE);
    render(&model(), Theme::Coloured, SIZE, &mut buffer);
    let picture = crate::terminal_svg::svg(&buffer);
    let path = root().join("docs/images/terminal.svg");
    if std::env::var_os("POSEBRIDGE_WRITE_PICTURES").is_some() {
        std::fs::write(&path, &picture).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap();
    let head = |picture: &str| picture.lines().next().map(str::to_owned);
    assert_eq!(head(&kept), head(&picture), "draw it anew: POSEBRIDGE_WRITE_PICTURES=1");
    for (name, picture) in [("drawn", &picture), ("kept", &kept)] {
        // One robot needs no list of robots.
        for panel in PANELS.iter().filter(|panel| panel.title != "Robots") {
            for word in panel.title.split(' ') {
                assert!(picture.contains(&format!(">{word}<")), "{word} in the one {name}");
            }
        }
        // Where no fix lies over them.
        assert!(picture.matches("h0").count() > 100, "the map in the one {name}");
        for word in ["wheels", "camera", "kidnap", "gyro_bias_rad_per_s"] {
            assert!(picture.contains(&format!(">{word}<")), "{word} in the one {name}");
        }
    }
}
