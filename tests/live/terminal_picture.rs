//! The picture of the terminal view in docs/dashboard.md: a lap of the simulated brick in virtual time, drawn as `--tui` draws it.
//! `POSEBRIDGE_WRITE_PICTURES=1 cargo test --test live terminal_picture` draws it anew.

use std::collections::BTreeMap;
use std::fmt::Write as _;

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
use ratatui::buffer::{Buffer, Cell};
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier};

/// Larger than the usual 80 by 24, so that every panel fits.
const SIZE: Rect = Rect::new(0, 0, 112, 36);

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
    let picture = svg(&buffer);
    let path = root().join("docs/images/terminal.svg");
    if std::env::var_os("POSEBRIDGE_WRITE_PICTURES").is_some() {
        std::fs::write(&path, &picture).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap();
    let head = |picture: &str| picture.lines().next().map(str::to_owned);
    assert_eq!(head(&kept), head(&picture), "draw it anew: POSEBRIDGE_WRITE_PICTURES=1");
    for (name, picture) in [("drawn", &picture), ("kept", &kept)] {
        // One robot needs no list of robots, a simulated one no set-up, no filters are compared, and there is no fleet.
        let absent = ["Robots", "Set-up", "Filters compared", "Fleet"];
        for panel in PANELS.iter().filter(|panel| !absent.contains(&panel.title)) {
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

/// A cell, in pixels.
const WIDTH: u16 = 9;
const HEIGHT: u16 = 18;
/// From the top of a cell to the line on which its letters stand.
const BASELINE: u16 = 14;
/// Around all.
const MARGIN: u16 = 9;
const BACKGROUND: &str = "#15191e";
const FOREGROUND: &str = "#e4e7eb";

/// A terminal's cells as a picture: letters as text, braille dots and frames as lines, so that it looks the same with any font.
fn svg(buffer: &Buffer) -> String {
    let (columns, rows) = (buffer.area.width, buffer.area.height);
    let (width, height) = (columns * WIDTH + 2 * MARGIN, rows * HEIGHT + 2 * MARGIN);
    let mut letters = String::new();
    let mut dots: BTreeMap<&str, String> = BTreeMap::new();
    let mut frames = String::new();
    for row in 0..rows {
        let cells: Vec<&Cell> = (0..columns).filter_map(|column| buffer.cell((column, row))).collect();
        letters += &row_of_letters(&cells, row);
        for (column, cell) in (0..columns).zip(&cells) {
            let (x, y) = (MARGIN + column * WIDTH, MARGIN + row * HEIGHT);
            let symbol = cell.symbol().chars().next().unwrap_or(' ');
            match kind_of(symbol) {
                CellKind::Braille(bits) => braille(bits, (x, y), dots.entry(colour(cell)).or_default()),
                CellKind::Frame(arms) => frame(arms, (x, y), &mut frames),
                CellKind::Letter => {}
            }
        }
    }
    let mut all = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\">\n\
         <rect width=\"{width}\" height=\"{height}\" rx=\"6\" fill=\"{BACKGROUND}\"/>\n\
         <path d=\"{frames}\" stroke=\"{}\" fill=\"none\"/>\n",
        hexadecimal(Color::DarkGray)
    );
    for (colour, path) in &dots {
        // Writing to a String cannot fail.
        let _ = writeln!(all, "<path d=\"{path}\" stroke=\"{colour}\" stroke-width=\"2.4\" stroke-linecap=\"round\"/>");
    }
    let font = "ui-monospace, 'DejaVu Sans Mono', Menlo, Consolas, monospace";
    let _ =
        write!(all, "<g font-family=\"{font}\" font-size=\"14.5\" xml:space=\"preserve\">\n{letters}</g>\n</svg>\n");
    all
}

enum CellKind {
    Braille(u32),
    /// Lines from the middle of the cell: left, right, up, down.
    Frame([bool; 4]),
    Letter,
}

fn kind_of(symbol: char) -> CellKind {
    match symbol {
        '\u{2800}'..='\u{28ff}' => CellKind::Braille(u32::from(symbol) - 0x2800),
        '─' => CellKind::Frame([true, true, false, false]),
        '│' => CellKind::Frame([false, false, true, true]),
        '┌' => CellKind::Frame([false, true, false, true]),
        '┐' => CellKind::Frame([true, false, false, true]),
        '└' => CellKind::Frame([false, true, true, false]),
        '┘' => CellKind::Frame([true, false, true, false]),
        _ => CellKind::Letter,
    }
}

/// Unicode's braille patterns: the bits of dots 1 to 8 stand for these columns and rows.
fn braille(bits: u32, (x, y): (u16, u16), path: &mut String) {
    let places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)];
    for (bit, (column, row)) in places.into_iter().enumerate() {
        if bits & (1 << bit) != 0 {
            let (x, y) = (
                f64::from(x) + f64::from(WIDTH) * (0.25 + 0.5 * f64::from(column)),
                f64::from(y) + f64::from(HEIGHT) * (0.125 + 0.25 * f64::from(row)),
            );
            let _ = write!(path, "M{x} {y}h0");
        }
    }
}

fn frame([left, right, up, down]: [bool; 4], (x, y): (u16, u16), path: &mut String) {
    let (middle_x, middle_y) = (x + WIDTH / 2, y + HEIGHT / 2);
    let ends =
        [(left, (x, middle_y)), (right, (x + WIDTH, middle_y)), (up, (middle_x, y)), (down, (middle_x, y + HEIGHT))];
    for (_, (end_x, end_y)) in ends.into_iter().filter(|(is_there, _)| *is_there) {
        let _ = write!(path, "M{middle_x} {middle_y}L{end_x} {end_y}");
    }
}

/// Runs of letters of one look, each stretched to the cells that it has.
fn row_of_letters(cells: &[&Cell], row: u16) -> String {
    let mut text = String::new();
    let is_letter = |cell: &Cell| {
        let symbol = cell.symbol().chars().next().unwrap_or(' ');
        symbol != ' ' && matches!(kind_of(symbol), CellKind::Letter)
    };
    let look = |cell: &Cell| (colour(cell), cell.modifier.contains(Modifier::BOLD));
    let mut at = 0;
    while at < cells.len() {
        if !is_letter(cells[at]) {
            at += 1;
            continue;
        }
        let run = cells[at..].iter().take_while(|cell| is_letter(cell) && look(cell) == look(cells[at])).count();
        let (colour, is_bold) = look(cells[at]);
        let weight = if is_bold { " font-weight=\"bold\"" } else { "" };
        let (x, y) = (usize::from(MARGIN) + at * usize::from(WIDTH), MARGIN + row * HEIGHT + BASELINE);
        let length = run * usize::from(WIDTH);
        let letters: String = cells[at..at + run].iter().map(|cell| cell.symbol()).collect();
        let letters = letters.replace('&', "&amp;").replace('<', "&lt;");
        let _ = writeln!(
            text,
            "<text x=\"{x}\" y=\"{y}\" fill=\"{colour}\"{weight} textLength=\"{length}\" lengthAdjust=\"spacingAndGlyphs\">{letters}</text>"
        );
        at += run;
    }
    text
}

fn colour(cell: &Cell) -> &'static str {
    hexadecimal(cell.fg)
}

/// The terminal's colours that the view uses, on a dark ground.
const COLOURS: [(Color, &str); 6] = [
    (Color::DarkGray, "#7f8894"),
    (Color::Red, "#e8704f"),
    (Color::LightBlue, "#62b2ff"),
    (Color::Green, "#58c884"),
    (Color::Yellow, "#e6c35c"),
    (Color::Magenta, "#d78ee4"),
];

fn hexadecimal(colour: Color) -> &'static str {
    let known = COLOURS.iter().find(|(known, _)| *known == colour);
    known.map_or(FOREGROUND, |(_, hexadecimal)| hexadecimal)
}
