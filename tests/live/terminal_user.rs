//! A person at a terminal: sees the screen of a program, and presses keys.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::num::NonZeroU16;
use std::os::fd::{AsFd, OwnedFd};
use std::process::{Child, Command, ExitStatus};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{Termios, tcgetattr};
use nix::unistd::Pid;

/// So long the program has for what is waited for, in seconds of its own session; far more than it needs.
const TIMEOUT_S: f64 = 120.0;
/// So long it has to end once it was told to, in looks of a tenth of a second.
const MAX_POLLS: u32 = 600;

/// A terminal with a program on it.
pub(crate) struct TerminalUser {
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
    pub(crate) fn start(command: &mut Command, (columns, lines): (u16, u16)) -> Self {
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
    pub(crate) fn press(&mut self, keys: &[u8]) {
        self.wire.write_all(keys).expect("the terminal takes keys");
    }

    /// Makes the window larger or smaller.
    pub(crate) fn resize(&mut self, (columns, lines): (u16, u16)) {
        let size = rustix::termios::Winsize { ws_row: lines, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        rustix::termios::tcsetwinsize(&self.wire, size).expect("it has a size");
        let (rows, width) = of_screen((columns, lines));
        self.screen.screen_mut().set_size(rows, width);
    }

    /// The screen as text.
    pub(crate) fn text(&self) -> String {
        self.screen.screen().contents()
    }

    /// Whether any cell of the screen has a colour.
    pub(crate) fn has_colours(&self) -> bool {
        let screen = self.screen.screen();
        let (lines, columns) = screen.size();
        let (lines, columns) = (lines.get(), columns.get());
        let cells = (0..lines).flat_map(|line| (0..columns).map(move |column| (line, column)));
        let mut cells = cells.filter_map(|(line, column)| screen.cell(line, column));
        cells.any(|cell| [cell.fgcolor(), cell.bgcolor()].iter().any(|colour| *colour != vt100::Color::Default))
    }

    /// Looks at the screen until it is as described.
    pub(crate) fn wait_until(&mut self, what: &str, is_so: impl Fn(&str) -> bool) -> String {
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
    pub(crate) fn terminate(&self) {
        let pid = Pid::from_raw(i32::try_from(self.child.id()).expect("a process id"));
        kill(pid, Signal::SIGTERM).expect("it can be signalled");
    }

    /// Reads on until the program has ended, and looks whether the terminal is as it was. Gives what the program left on it.
    pub(crate) fn wait_for_exit(mut self) -> (ExitStatus, String) {
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
pub(crate) fn number_before(text: &str, end: &str) -> Option<f64> {
    let head = &text[..text.find(end)?];
    head.rsplit([' ', '\n']).next()?.parse().ok()
}
