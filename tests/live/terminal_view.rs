//! `--tui`: the terminal view of the real program on a pseudo-terminal, with a person who sees and presses keys.

use std::net::UdpSocket;
use std::path::Path;

use crate::support::posebridge;
use crate::terminal_user::{TerminalUser, number_before};
use serde_json::Value;

/// The station with a simulated brick and the view, in its own folder.
fn watched(folder: &Path, more: &[&str], size: (u16, u16)) -> TerminalUser {
    let mut command = posebridge(folder);
    command
        .args(["run", "--tui", "--no-dashboard", "--out", "run", "--seed", "3"])
        .args(more)
        .env("TERM", "xterm-256color")
        .env_remove("NO_COLOR");
    TerminalUser::start(&mut command, size)
}

fn estimate_off_m(text: &str) -> Option<f64> {
    let (_, behind) = text.split_once("estimate ")?;
    number_before(behind, " m off").or_else(|| behind.split(' ').next()?.parse().ok())
}

fn resets(text: &str) -> Option<u32> {
    let (_, behind) = text.split_once("resets ")?;
    let digits: String = behind.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok()
}

#[test]
fn a_kidnap_is_seen_with_its_reset_and_the_error_falls_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut person = watched(folder.path(), &[], (110, 36));
    let is_steady = |text: &str| estimate_off_m(text).is_some_and(|off_m| off_m < 0.03);
    let text = person.wait_until("a good estimate that is recorded", |text| {
        is_steady(text)
            && text.contains("last fix")
            && text.contains("camera")
            && text.contains("recording recording.mcap")
    });
    for title in ["Arena", "Pose", "Sources and NIS", "Links and clock", "Biases and calibration", "Events"] {
        assert!(text.contains(title), "{title} in\n{text}");
    }
    let before = resets(&text).unwrap();
    person.press(b"?");
    person.wait_until("the help", |text| text.contains("end the run, as Ctrl-C does"));
    person.press(b"?k");
    person.wait_until("what was done", |text| text.contains("the robot is kidnapped"));
    person.wait_until("that it is elsewhere", |text| estimate_off_m(text).is_some_and(|off_m| off_m > 0.2));
    person.wait_until("the reset", |text| resets(text).is_some_and(|resets| resets > before));
    person.wait_until("a good estimate again", is_steady);
    // The panels one by one, and back.
    person.press(b"\t");
    person.wait_until("the map alone", |text| !text.contains("Links and clock") && text.contains("Arena"));
    person.press(b"\x1b");
    person.wait_until("all of them", |text| text.contains("Links and clock"));
    person.press(b"c");
    person.wait_until("a covered camera", |text| text.contains("the camera is covered"));
    person.wait_until("dead reckoning", |text| text.contains("dead reckoning"));
    person.press(b"cs");
    person.wait_until("fixes again", |text| text.contains("last fix 0."));
    person.press(b"p");
    person.wait_until("the pulled cable", |text| text.contains("DOWN"));
    person.wait_until("the cable again", |text| text.contains("0 UP"));
    person.press(b"q");
    assert_tables(person);
}

/// The run ends well, and what it prints without the view stands there.
fn assert_tables(person: TerminalUser) {
    let (status, left) = person.wait_for_exit();
    assert_eq!(status.code(), Some(0), "{left}");
    for words in
        ["brick's own odometry", "picture    run/track.svg", "recording  run/recording.mcap", "learned  radius_scale"]
    {
        assert!(left.contains(words), "{words} in\n{left}");
    }
    // What was said while the view had the screen: the log has the lost link.
    assert!(left.contains("link down"), "{left}");
}

#[test]
fn ctrl_c_ends_it_after_the_window_got_smaller_and_larger() {
    let folder = tempfile::tempdir().unwrap();
    let mut person = watched(folder.path(), &[], (80, 24));
    person.wait_until("the view", |text| text.contains("Arena") && text.contains("Events"));
    person.resize((20, 5));
    let text = person.wait_until("one panel", |text| {
        !text.contains("Arena") && text.contains("q quit") && text.contains("odometry")
    });
    assert_eq!(text.lines().count(), 5, "{text}");
    person.resize((120, 40));
    person.wait_until("all of them", |text| text.contains("Biases and calibration"));
    person.press(b"\x03");
    assert_eq!(person.wait_for_exit().0.code(), Some(0));
}

#[test]
fn an_error_is_read_on_the_terminal_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    // The event file cannot be made, which is found when the view has the screen already.
    let person = watched(folder.path(), &["--events", "there/is/no/such.txt"], (80, 24));
    let (status, left) = person.wait_for_exit();
    assert_eq!(status.code(), Some(2), "{left}");
    assert!(left.contains("posebridge: creating the event file `there/is/no/such.txt`"), "{left}");
}

#[test]
fn a_terminal_that_hangs_does_not_slow_the_filter() {
    let folder = tempfile::tempdir().unwrap();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = format!("--plotjuggler={}", socket.local_addr().unwrap());
    let mut person = watched(folder.path(), &[&address], (160, 50));
    person.wait_until("a good estimate", |text| estimate_off_m(text).is_some());
    // From here on nobody reads the terminal. Estimates go on all the same, none of them missing.
    let mut bytes = vec![0; 65_536];
    let mut stamps_s: Vec<f64> = Vec::new();
    while stamps_s.len() < 2 || stamps_s[stamps_s.len() - 1] - stamps_s[0] < 6.0 {
        let read = socket.recv(&mut bytes).unwrap();
        let message: Value = serde_json::from_slice(&bytes[..read]).unwrap();
        if message.pointer("/robot_0_1_1/estimate").is_some() {
            stamps_s.push(message["timestamp"].as_f64().unwrap());
        }
    }
    // 20 observations of the brick a second, with 10 fixes beside them; a machine with other work delays some.
    assert!(stamps_s.len() > 6 * 20, "{} estimates in 6 s", stamps_s.len());
    person.terminate();
    let (status, left) = person.wait_for_exit();
    assert_eq!(status.code(), Some(0), "{left}");
    assert!(left.contains("recording  run/recording.mcap"), "{left}");
}

#[test]
fn without_colours_none_is_sent() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = posebridge(folder.path());
    command.args(["--tui", "--no-dashboard", "--no-record", "--out", "run"]).env("NO_COLOR", "1");
    let mut person = TerminalUser::start(&mut command, (100, 30));
    person.wait_until("the view", |text| text.contains("last fix") && text.contains("camera"));
    assert!(!person.has_colours());
    assert!(person.text().contains("not recording"));
    person.press(b"q");
    assert_eq!(person.wait_for_exit().0.code(), Some(0));
}
