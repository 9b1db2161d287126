//! Texts of people, read whole: configurations, scenarios and tables of measurements. A file without end does not fill the memory.

use std::fs::File;
use std::io::{Error, ErrorKind, Read as _, Result};
use std::path::Path;

/// Larger than any table that a person measures, or a day of a simulation's truth.
const MAX_BYTES: u64 = 256 << 20;

pub(crate) fn read_text(path: impl AsRef<Path>) -> Result<String> {
    let mut text = String::new();
    File::open(path)?.take(MAX_BYTES + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MAX_BYTES {
        return Err(Error::new(ErrorKind::FileTooLarge, format!("it holds more than {} MiB", MAX_BYTES >> 20)));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_end_is_refused() {
        assert_eq!(read_text("/dev/zero").unwrap_err().kind(), ErrorKind::FileTooLarge);
    }
}
