//! What a run has made, as CSV: a wide file per stream, for spreadsheets, pandas and PlotJuggler.
//!
//! Takes the events of a pipeline with the instants at which they happened; gives lines to whatever the caller opens for each stream.
//! Nothing is rounded: every number reads back as the same. A value that is not there is an empty field.
//!
//! # Model
//! ```text
//! estimates.csv      what the filter believed, with its covariance            t_s: the brick's clock
//! fusion.csv         what became of each observation: innovation, S, NIS
//! <kind>.csv         the observations of a kind: wheel_angles, fix, ..
//! clock.csv          alignments of the brick's clock
//! temperature.csv    thermometers
//! links.csv          health of the links, once per second                      host_s: since the session began
//! sources.csv        what each sender sent
//! events.csv         everything else, in words
//! ```
//! Names of columns end in their unit, SI throughout. Spaces: positions and headings in the arena, counter-clockwise positive.
//!
//! # Sources
//! RFC 4180 for the quoting of texts.

mod columns;
mod events;
mod observations;

use std::collections::BTreeMap;
use std::io::Write;

use posebridge_telemetry::{Event, HostClock, Stamp};

/// Opens a stream by its name, without extension.
type Open<'o, W> = dyn FnMut(&str) -> std::io::Result<W> + 'o;

/// Writes events to the streams that they belong to; a stream of which nothing came is never opened.
pub struct Streams<'o, W: Write> {
    open: Box<Open<'o, W>>,
    opened: BTreeMap<String, (W, u64)>,
}

/// A line for one stream.
struct Row {
    stream: &'static str,
    header: &'static str,
    fields: Vec<Field>,
}

/// What stands between two commas.
enum Field {
    Number(f64),
    Count(u64),
    Flag(bool),
    Text(String),
    Nothing,
}

impl<'o, W: Write> Streams<'o, W> {
    /// No stream yet.
    pub fn new(open: impl FnMut(&str) -> std::io::Result<W> + 'o) -> Self {
        Self { open: Box::new(open), opened: BTreeMap::new() }
    }

    /// Writes an event that happened at `now`.
    ///
    /// # Errors
    /// A stream cannot be opened or written.
    pub fn take(&mut self, now: Stamp<HostClock>, event: &Event) -> std::io::Result<()> {
        for row in events::rows(now, event) {
            self.write(&row)?;
        }
        Ok(())
    }

    /// Ends all streams and says how many lines each has besides its header, by name.
    ///
    /// # Errors
    /// One cannot be written.
    pub fn finish(self) -> std::io::Result<Vec<(String, u64)>> {
        let mut lines = Vec::new();
        for (name, (mut out, count)) in self.opened {
            out.flush()?;
            lines.push((name, count));
        }
        Ok(lines)
    }

    fn write(&mut self, row: &Row) -> std::io::Result<()> {
        if !self.opened.contains_key(row.stream) {
            let mut out = (self.open)(row.stream)?;
            writeln!(out, "{}", row.header)?;
            self.opened.insert(row.stream.to_owned(), (out, 0));
        }
        let Some((out, count)) = self.opened.get_mut(row.stream) else {
            return Ok(());
        };
        *count += 1;
        for (index, field) in row.fields.iter().enumerate() {
            if index > 0 {
                out.write_all(b",")?;
            }
            field.write(out)?;
        }
        out.write_all(b"\n")
    }
}

impl Field {
    fn write(&self, out: &mut impl Write) -> std::io::Result<()> {
        match self {
            // What is no number is nothing to a spreadsheet.
            Self::Number(number) if number.is_finite() => write!(out, "{number}"),
            Self::Number(_) | Self::Nothing => Ok(()),
            Self::Count(count) => write!(out, "{count}"),
            Self::Flag(flag) => write!(out, "{}", u8::from(*flag)),
            Self::Text(text) => write_text(text, out),
        }
    }
}

/// Quoted where it has to be.
fn write_text(text: &str, out: &mut impl Write) -> std::io::Result<()> {
    if text.contains([',', '"', '\n', '\r']) {
        write!(out, "\"{}\"", text.replace('"', "\"\""))
    } else {
        out.write_all(text.as_bytes())
    }
}

impl From<f64> for Field {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<u64> for Field {
    fn from(count: u64) -> Self {
        Self::Count(count)
    }
}

impl From<bool> for Field {
    fn from(flag: bool) -> Self {
        Self::Flag(flag)
    }
}

impl From<&str> for Field {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Field {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl<T: Into<Self>> From<Option<T>> for Field {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Nothing, Into::into)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_digits_and_texts_are_quoted_where_they_must_be() {
        let written = |field: Field| {
            let mut out = Vec::new();
            field.write(&mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        assert_eq!(written(Field::Number(0.1 + 0.2)), "0.30000000000000004");
        assert_eq!(written(Field::Number(f64::NAN)), "");
        assert_eq!(written(true.into()), "1");
        assert_eq!(written(Option::<f64>::None.into()), "");
        assert_eq!(written("a \"b\", c".into()), "\"a \"\"b\"\", c\"");
    }
}
