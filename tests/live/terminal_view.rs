//! `--tui`: the terminal view of the real program on a pseudo-terminal, with a person who sees and presses keys.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::net::UdpSocket;
use std::num::NonZeroU16;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::process::{Child, Command, ExitStatus};

use crate::support::posebridge;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{Termios, tcgetattr};
use nix::unistd::Pid;
use serde_json::Value;

/// So long the program has for what is waited for, in seconds of its own session; far more than it needs.
const TIMEOUT_S: f64 = 120.0;
/// So long it has to end once it was told to, in looks of a tenth of a second.
const MAX_POLLS: u32 = 600;

/// A terminal with a program on it.
struct TerminalUser {
    wire: File,
    /// Kept to look at its modes.
    terminal: OwnedFd,
    child: Child,
    screen: vt100::Parser,
    /// Everything that the program has written.
    written: Vec<u8>,
    initial_settings: Termios,
}

impl TerminalUser {
    /// Starts a program on a terminal of so many columns and lines.
    fn start(command: &mut Command, (columns, lines): (u16, u16)) -> Self {
        let size = Winsize { ws_row: lines, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        let pty = openpty(Some(&size), None).expect("a pseudo-terminal");
        let (rows, width) = of_screen((columns, lines));
        let initial_settings = tcgetattr(&pty.slave).expect("it has modes");
        let end = || pty.slave.try_clone().expect("it can be shared");
        let child = command.stdin(end()).stdout(end()).stderr(end()).spawn().expect("the program starts");
        Self {
            wire: File::from(pty.master),
            terminal: pty.slave,
            child,
            screen: vt100::Parser::new(rows, width, 0),
            written: Vec::new(),
            initial_settings,
        }
    }

    /// Presses keys.
    fn press(&mut self, keys: &[u8]) {
        self.wire.write_all(keys).expect("the terminal takes keys");
    }

    /// Makes the window larger or smaller.
    fn resize(&mut self, (columns, lines): (u16, u16)) {
        let size = rustix::termios::Winsize { ws_row: lines, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        rustix::termios::tcsetwinsize(&self.wire, size).expect("it has a size");
        let (rows, width) = of_screen((columns, lines));
        self.screen.screen_mut().set_size(rows, width);
    }

    /// The screen as text.
    fn text(&self) -> String {
        self.screen.screen().contents()
    }

    /// Whether any cell of the screen has a colour.
    fn has_colours(&self) -> bool {
        let screen = self.screen.screen();
        let (lines, columns) = screen.size();
        let (lines, columns) = (lines.get(), columns.get());
        let cells = (0..lines).flat_map(|line| (0..columns).map(move |column| (line, column)));
        let mut cells = cells.filter_map(|(line, column)| screen.cell(line, column));
        cells.any(|cell| [cell.fgcolor(), cell.bgcolor()].iter().any(|colour| *colour != vt100::Color::Default))
    }

    /// Looks at the screen until it is as described.
    fn wait_until(&mut self, what: &str, is_so: impl Fn(&str) -> bool) -> String {
        loop {
            let text = self.text();
            if is_so(&text) {
                return text;
            }
            let now_s = number_before(&text, " s  ").unwrap_or(0.0);
            assert!(now_s < TIMEOUT_S, "never seen: {what}; there stands\n{text}");
            let ended = self.child.try_wait().expect("it can be asked");
            assert!(ended.is_none(), "it ended ({ended:?}) before {what}:\n{text}");
            self.read_output();
        }
    }

    /// Takes what the program has written, if it has within a tenth of a second.
    fn read_output(&mut self) -> bool {
        let mut asked = [PollFd::new(self.wire.as_fd(), PollFlags::POLLIN)];
        if poll(&mut asked, PollTimeout::from(100_u16)).expect("it can be waited for") == 0 {
            return false;
        }
        let mut bytes = [0; 4_096];
        let read = self.wire.read(&mut bytes).expect("the terminal is open");
        self.screen.process(&bytes[..read]);
        self.written.extend_from_slice(&bytes[..read]);
        true
    }

    /// Asks the program to end, as `kill` does.
    fn terminate(&self) {
        let pid = Pid::from_raw(i32::try_from(self.child.id()).expect("a process id"));
        kill(pid, Signal::SIGTERM).expect("it can be signalled");
    }

    /// Reads on until the program has ended, and looks whether the terminal is as it was. Gives what the program left on it.
    fn wait_for_exit(mut self) -> (ExitStatus, String) {
        let mut looks = 0;
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("it can be asked") {
                break status;
            }
            looks += u32::from(!self.read_output());
            assert!(looks < MAX_POLLS, "it does not end; there stands\n{}", self.text());
        };
        while self.read_output() {}
        let after = tcgetattr(&self.terminal).expect("it has modes");
        assert_eq!(after, self.initial_settings, "the modes are as they were");
        let screen = self.screen.screen();
        assert!(!screen.alternate_screen(), "the other screen is back");
        assert!(!screen.hide_cursor(), "the cursor is seen");
        (status, self.remaining_output())
    }

    /// What was written after the other screen was left.
    fn remaining_output(&self) -> String {
        let all = String::from_utf8_lossy(&self.written);
        let left = all.rsplit("\u{1b}[?1049l").next().unwrap_or_default();
        left.replace('\r', "")
    }
}

/// As the screen's reader wants them.
fn of_screen((columns, lines): (u16, u16)) -> (NonZeroU16, NonZeroU16) {
    let number = |number: u16| NonZeroU16::new(number).expect("a size of more than nothing");
    (number(lines), number(columns))
}

impl Drop for TerminalUser {
    fn drop(&mut self) {
        // Already gone is as good.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// The number that ends where this text begins for the first time.
fn number_before(text: &str, end: &str) -> Option<f64> {
    let head = &text[..text.find(end)?];
    head.rsplit([' ', '\n']).next()?.parse().ok()
}

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
        ["the brick's odometry", "picture    run/track.svg", "recording  run/recording.mcap", "learned    radius_scale"]
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
