//! Texts of strangers that would steer a terminal, or read as another text than they are.

use posebridge_telemetry::is_printable;

use crate::robot::{Robot, folder_file};
use crate::support::{posebridge, read_text};

/// Clears the screen, sets the window's title, returns to the start of the line, and turns the direction of what follows.
const HOSTILE: &str = "\u{1b}[2J\u{1b}]0;mine\u{7}\r\u{9b}H\u{202e}ready";

#[test]
fn no_text_of_a_robot_or_a_file_steers_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let [stdout, stderr] = ["tables.txt", "messages.txt"].map(|name| folder_file(folder.path(), name));
    let mut robot = Robot::new();
    let mut station =
        robot.start_station(folder.path(), &["--no-dashboard", "--events", "events.jsonl"], stderr, stdout);
    robot.drive(1);
    robot.say(HOSTILE);
    robot.drive(1);
    station.interrupt();
    assert!(station.0.wait().unwrap().success());
    let mut shown: Vec<String> =
        ["tables.txt", "messages.txt", "events.jsonl"].map(|name| read_text(folder.path(), name)).into();
    assert!(shown[1].contains("mine???H?ready"), "{}", shown[1]);
    assert!(shown[2].contains("mine???H?ready"), "{}", shown[2]);
    // A file whose name and columns are as bad.
    let hostile = format!("{HOSTILE}.csv");
    std::fs::write(folder.path().join(&hostile), format!("t,{HOSTILE}\n1,2\n")).unwrap();
    let mut inspect = posebridge(folder.path());
    let inspected = inspect.args(["inspect", &hostile]).output().unwrap();
    shown.push(String::from_utf8(inspected.stdout).unwrap() + &String::from_utf8(inspected.stderr).unwrap());
    assert!(shown[3].contains("ready"), "{}", shown[3]);
    for text in &shown {
        let odd: Vec<_> = text.chars().filter(|letter| !is_printable(*letter) && !"\n\t".contains(*letter)).collect();
        assert!(odd.is_empty(), "{odd:?} in {text}");
    }
}
