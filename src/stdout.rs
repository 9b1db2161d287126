//! Results on standard output. Somebody who has read enough and closed the pipe is no error.

use std::io::{ErrorKind, Write};

/// Writes a text.
///
/// # Errors
/// It cannot be written, for another reason than a closed pipe.
pub fn print(text: &str) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}
