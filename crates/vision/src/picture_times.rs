//! When the pictures of a folder were taken: a table (CSV) beside them.

use csv::{ErrorKind, Position, ReaderBuilder, Trim};

/// A row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureTime {
    /// As it is written.
    pub file: String,
    pub time_s: f64,
}

/// Names of a column that the header may use, in any case.
const FILE_NAMES: &[&str] = &["file", "file_name", "filename", "picture", "image"];
const TIME_NAMES: &[&str] = &["time_s", "t_s", "timestamp_s", "seconds"];

/// A table that is not read. Lines count from 1.
#[derive(Debug, thiserror::Error)]
pub enum PictureTimesError {
    #[error("line {line}: the header needs the columns `file` and `time_s` (seconds), separated by commas")]
    Header { line: u64 },
    #[error("line {line}: {what}")]
    Row { line: u64, what: String },
}

/// Reads a table of file names and times in seconds, which never step back. Other columns, empty lines and lines that begin with `#` are
/// skipped.
pub fn parse_picture_times(text: &str) -> Result<Vec<PictureTime>, PictureTimesError> {
    let mut reader = ReaderBuilder::new().trim(Trim::All).comment(Some(b'#')).from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| row_error(text, &error))?;
    let column = |names: &[&str]| header.iter().position(|name| names.contains(&name.to_ascii_lowercase().as_str()));
    let (Some(file_column), Some(time_column)) = (column(FILE_NAMES), column(TIME_NAMES)) else {
        return Err(PictureTimesError::Header { line: line_of(text, header.position()) });
    };
    let mut times: Vec<PictureTime> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| row_error(text, &error))?;
        let error = |what: String| PictureTimesError::Row { line: line_of(text, record.position()), what };
        let (file, time) = (&record[file_column], &record[time_column]);
        if file.is_empty() {
            return Err(error("the name of the file is empty".to_owned()));
        }
        let time_s = time.parse().ok().filter(|time: &f64| time.is_finite());
        let time_s = time_s.ok_or_else(|| error(format!("`{time}` is no time in seconds")))?;
        if let Some(last) = times.last().filter(|last| last.time_s > time_s) {
            return Err(error(format!("{time_s} s is before the time of `{}`, {} s", last.file, last.time_s)));
        }
        times.push(PictureTime { file: file.to_owned(), time_s });
    }
    Ok(times)
}

fn row_error(text: &str, error: &csv::Error) -> PictureTimesError {
    let what = if let ErrorKind::UnequalLengths { expected_len, len, .. } = error.kind() {
        format!("it has {len} cells, the header has {expected_len}")
    } else {
        error.to_string()
    };
    PictureTimesError::Row { line: line_of(text, error.position()), what }
}

/// The position of a row is where the one before ended.
fn line_of(text: &str, position: Option<&Position>) -> u64 {
    let (line, start) = position.map_or((1, 0), |position| (position.line(), position.byte() as usize));
    let rest = text.get(start..).unwrap_or_default();
    line + rest.lines().take_while(|line| line.is_empty() || line.starts_with('#')).count() as u64
}
