//! Talk to the person who runs the program. A stderr that cannot be written is no reason to stop.

use std::io::Write;

/// Says a line.
pub fn say(line: &str) {
    // There is nobody left to tell.
    drop(writeln!(std::io::stderr().lock(), "{line}"));
}
