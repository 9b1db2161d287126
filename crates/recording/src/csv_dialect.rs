//! The dialect of a CSV file: what separates its columns, and its decimal mark.
//!
//! Both are found by the header and the rows, or stated by whoever knows the file. What can be read in two ways is refused: no number is
//! read wrongly.
//!
//! # Model
//! ```text
//! delimiter     the one that splits the header; of several the one that gives each row the fields of the header.
//!               Without a header: the one that every row has
//! decimal mark  a point; beside semicolons and tabs a comma, where numbers have commas and none has a point.
//!               `1,234` alone may be 1.234 or 1234
//! ```

use std::fmt;

use serde::Deserialize;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Delimiter {
    /// `,`, with double quotes around fields that contain one.
    #[default]
    Comma,
    /// `;`, likewise.
    Semicolon,
    /// One tab, likewise.
    Tab,
    /// Any run of spaces and tabs; never detected.
    Whitespace,
}

impl Delimiter {
    const DETECTED: [Self; 3] = [Self::Comma, Self::Semicolon, Self::Tab];

    /// `None` for a run of blanks.
    pub const fn letter(self) -> Option<char> {
        match self {
            Self::Comma => Some(','),
            Self::Semicolon => Some(';'),
            Self::Tab => Some('\t'),
            Self::Whitespace => None,
        }
    }

    /// The trimmed fields of a line, without the quotes around them.
    pub fn split(self, line: &str) -> Vec<&str> {
        self.letter().map_or_else(|| line.split_whitespace().collect(), |letter| split_quoted(line, letter))
    }
}

/// Splits at delimiters outside double quotes; trims spaces and quotes.
fn split_quoted(line: &str, delimiter: char) -> Vec<&str> {
    let mut in_quotes = false;
    line.split(|letter| {
        in_quotes ^= letter == '"';
        letter == delimiter && !in_quotes
    })
    .map(|field| {
        let field = field.trim();
        let inner = field.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
        inner.unwrap_or(field)
    })
    .collect()
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DecimalMark {
    #[default]
    Point,
    Comma,
}

impl DecimalMark {
    /// A finite number with this mark and without separators of thousands.
    pub fn number(self, text: &str) -> Option<f64> {
        let value = match self {
            Self::Point => text.parse(),
            Self::Comma if text.contains('.') => return None,
            Self::Comma => text.replacen(',', ".", 1).parse(),
        };
        value.ok().filter(|value: &f64| value.is_finite())
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CsvDialect {
    pub delimiter: Delimiter,
    pub decimal: DecimalMark,
}

impl fmt::Display for CsvDialect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let delimiter = match self.delimiter {
            Delimiter::Comma => "commas",
            Delimiter::Semicolon => "semicolons",
            Delimiter::Tab => "tabs",
            Delimiter::Whitespace => "blanks",
        };
        let decimal = match self.decimal {
            DecimalMark::Point => "points",
            DecimalMark::Comma => "commas",
        };
        write!(f, "columns between {delimiter}, decimal {decimal}")
    }
}

/// The file can be read in two ways.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}")]
pub struct AmbiguousDialect {
    /// From 1.
    pub line: usize,
    pub what: String,
}

/// What is known of a dialect beforehand.
#[derive(Clone, Copy, Debug, Default)]
pub struct StatedDialect {
    pub delimiter: Option<Delimiter>,
    pub decimal: Option<DecimalMark>,
}

/// Rows that are looked at together; after them only a missing decimal mark is looked for.
const SAMPLE_ROWS: usize = 256;

/// Finds the dialect of a file by its rows, which are passed one by one.
#[derive(Debug)]
pub struct DialectSearch {
    stated: StatedDialect,
    /// Line and text of the names of the columns.
    header: Option<(usize, String)>,
    sample: Vec<(usize, String)>,
    delimiter: Option<Delimiter>,
    marks: MarksFound,
}

/// Lines of the first number with each mark.
#[derive(Clone, Copy, Debug, Default)]
struct MarksFound {
    point: Option<usize>,
    comma: Option<usize>,
    /// `1,234`.
    unclear: Option<usize>,
}

impl DialectSearch {
    pub fn new(stated: StatedDialect, header: Option<(usize, &str)>) -> Self {
        let header = header.map(|(line, text)| (line, text.to_owned()));
        Self { stated, header, sample: Vec::new(), delimiter: None, marks: MarksFound::default() }
    }

    /// Looks at a row; false if no further one is needed.
    pub fn push(&mut self, line: usize, text: &str) -> Result<bool, AmbiguousDialect> {
        if let Some(delimiter) = self.delimiter {
            self.marks.add(line, text, delimiter);
        } else {
            self.sample.push((line, text.to_owned()));
            if self.sample.len() < SAMPLE_ROWS {
                return Ok(true);
            }
            self.read_sample()?;
        }
        let is_found = self.marks.point.or(self.marks.comma).is_some();
        Ok(self.delimiter != Some(Delimiter::Comma) && self.stated.decimal.is_none() && !is_found)
    }

    pub fn finish(mut self) -> Result<CsvDialect, AmbiguousDialect> {
        if self.delimiter.is_none() {
            self.read_sample()?;
        }
        let delimiter = self.delimiter.unwrap_or_default();
        let decimal = match (self.stated.decimal, delimiter) {
            (Some(DecimalMark::Comma), Delimiter::Comma) => {
                let line = self.header.map_or(1, |(line, _)| line);
                return Err(ambiguous(line, "commas cannot be both the delimiter and the decimal mark"));
            }
            (Some(decimal), _) => decimal,
            (None, Delimiter::Comma) => DecimalMark::Point,
            (None, Delimiter::Semicolon | Delimiter::Tab | Delimiter::Whitespace) => self.marks.decimal()?,
        };
        Ok(CsvDialect { delimiter, decimal })
    }

    fn read_sample(&mut self) -> Result<(), AmbiguousDialect> {
        let delimiter = self.find_delimiter()?;
        self.delimiter = Some(delimiter);
        let sample = std::mem::take(&mut self.sample);
        for (line, text) in &sample {
            self.marks.add(*line, text, delimiter);
        }
        if delimiter == Delimiter::Comma { self.check_width(&sample) } else { Ok(()) }
    }

    fn find_delimiter(&self) -> Result<Delimiter, AmbiguousDialect> {
        if let Some(stated) = self.stated.delimiter {
            return Ok(stated);
        }
        let header = self.header.as_ref().map(|(_, text)| text.as_str());
        // A few rows may be damaged.
        let most = |is_it: &dyn Fn(&str) -> bool| {
            2 * self.sample.iter().filter(|(_, row)| is_it(row)).count() > self.sample.len()
        };
        let is_split = |delimiter: &Delimiter| match header {
            Some(header) => delimiter.split(header).len() > 1,
            None => most(&|row| delimiter.split(row).len() > 1),
        };
        let splitting: Vec<Delimiter> = Delimiter::DETECTED.into_iter().filter(is_split).collect();
        if let [] | [_] = splitting.as_slice() {
            return Ok(splitting.first().copied().unwrap_or_default());
        }
        let mut fitting = splitting.into_iter().filter(|delimiter| {
            let columns = header.map(|header| delimiter.split(header).len());
            most(&|row| is_clean(row, *delimiter) && columns.is_none_or(|count| delimiter.split(row).len() == count))
        });
        match (fitting.next(), fitting.next()) {
            (Some(only), None) => Ok(only),
            _ => Err(ambiguous(
                self.header.as_ref().or(self.sample.first()).map_or(1, |(line, _)| *line),
                "commas, semicolons or tabs: each could separate the columns; write only one of them outside quotes",
            )),
        }
    }

    /// Refuses rows with more fields than the header has, if that is no damage to a few: decimal commas have shifted their numbers.
    fn check_width(&self, sample: &[(usize, String)]) -> Result<(), AmbiguousDialect> {
        let Some((_, header)) = &self.header else {
            return Ok(());
        };
        let width = |text: &str| {
            let fields = Delimiter::Comma.split(text);
            fields.len() - fields.iter().rev().take_while(|field| field.is_empty()).count()
        };
        let names = width(header);
        let mut wide = sample.iter().filter(|(_, row)| width(row) > names);
        let Some((line, row)) = wide.next() else {
            return Ok(());
        };
        if 2 * (1 + wide.count()) < sample.len() && self.marks.point.is_some() {
            return Ok(());
        }
        let what = format!(
            "{} fields for {names} columns: commas are the delimiter and, it seems, the decimal mark, too; separate the columns by \
             semicolons, or write decimal points",
            width(row)
        );
        Err(AmbiguousDialect { line: *line, what })
    }
}

impl MarksFound {
    fn add(&mut self, line: usize, text: &str, delimiter: Delimiter) {
        for field in delimiter.split(text) {
            let found = match mark_of(field) {
                Some(FoundMark::Point) => &mut self.point,
                Some(FoundMark::Comma) => &mut self.comma,
                Some(FoundMark::Unclear) => &mut self.unclear,
                None => continue,
            };
            found.get_or_insert(line);
        }
    }

    fn decimal(self) -> Result<DecimalMark, AmbiguousDialect> {
        match (self.point, self.comma, self.unclear) {
            (Some(point), Some(comma), _) => Err(ambiguous(
                point.max(comma),
                "numbers with decimal points and numbers with decimal commas in one file: write one of them, without separators of \
                 thousands",
            )),
            (_, None, Some(line)) => Err(ambiguous(
                line,
                "a number like 1,234 may be 1.234 or 1234: write decimal points (of a descriptor's file say `decimal = \"comma\"`), and \
                 no separators of thousands",
            )),
            (None, Some(_), _) => Ok(DecimalMark::Comma),
            (_, None, None) => Ok(DecimalMark::Point),
        }
    }
}

#[derive(Clone, Copy)]
enum FoundMark {
    Point,
    Comma,
    Unclear,
}

/// The only mark in a number; `None` without one, and for what is no number.
fn mark_of(field: &str) -> Option<FoundMark> {
    let number = field.strip_prefix(['-', '+']).unwrap_or(field);
    let at = number.find(['.', ','])?;
    let (whole, fraction) = (&number[..at], &number[at + 1..]);
    let digits = fraction.bytes().take_while(u8::is_ascii_digit).count();
    if !whole.bytes().all(|byte| byte.is_ascii_digit()) || digits == 0 {
        return None;
    }
    let exponent = &fraction[digits..];
    if !exponent.is_empty() && format!("1{exponent}").parse::<f64>().is_err() {
        // Separators of thousands look like this, too: `1,234,567` and `1.234,5`.
        let is_grouped = exponent.bytes().all(|byte| byte.is_ascii_digit() || matches!(byte, b'.' | b','));
        return (is_grouped && number.contains(',')).then_some(FoundMark::Unclear);
    }
    let is_group = exponent.is_empty() && digits == 3 && (1..=3).contains(&whole.len()) && !whole.starts_with('0');
    Some(match number.as_bytes()[at] {
        b'.' => FoundMark::Point,
        _ if is_group => FoundMark::Unclear,
        _ => FoundMark::Comma,
    })
}

/// Whether no field of the row contains another delimiter, except as the decimal mark of a number.
fn is_clean(row: &str, delimiter: Delimiter) -> bool {
    let has_other = |field: &str| field.contains([',', ';', '\t']) && mark_of(field).is_none();
    !delimiter.split(row).into_iter().any(has_other)
}

fn ambiguous(line: usize, what: &str) -> AmbiguousDialect {
    AmbiguousDialect { line, what: what.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(header: Option<&str>, rows: &[&str]) -> Result<String, (usize, String)> {
        let mut search = DialectSearch::new(StatedDialect::default(), header.map(|text| (1, text)));
        let mut dialect = || {
            for (line, row) in (2..).zip(rows) {
                if !search.push(line, row)? {
                    break;
                }
            }
            std::mem::replace(&mut search, DialectSearch::new(StatedDialect::default(), None)).finish()
        };
        dialect().map(|dialect| dialect.to_string()).map_err(|error| (error.line, error.what))
    }

    #[test]
    fn quotes_protect_delimiters_within_one_line() {
        assert_eq!(split_quoted("1, \"a,b\" ,,2", ','), ["1", "a,b", "", "2"]);
        assert_eq!(split_quoted("\"open,1", ','), ["\"open,1"]);
        assert_eq!(split_quoted("", ';'), [""]);
    }

    #[test]
    fn the_dialect_is_found_by_header_and_rows() {
        let ints = vec!["0;0;0"; 2 * SAMPLE_ROWS];
        for (header, rows, expected) in [
            (Some("t,x"), &["0,1.5"][..], "columns between commas, decimal points"),
            (Some("t;x"), &["0;1.5"], "columns between semicolons, decimal points"),
            (Some("t;x"), &["0;1", "1;1,5"], "columns between semicolons, decimal commas"),
            (Some("t;x"), &["0;1,234", "1;0,125"], "columns between semicolons, decimal commas"),
            (Some("t;x"), &["0;-1,5e-3"], "columns between semicolons, decimal commas"),
            (Some("t\tx, m"), &["0,5\t1"], "columns between tabs, decimal commas"),
            (Some("t;pos (x,y)"), &["0;1", "1;2"], "columns between semicolons, decimal points"),
            (None, &["0,5;1", "1;2"], "columns between semicolons, decimal commas"),
            (None, &["0,1.5", "1,2"], "columns between commas, decimal points"),
            (Some("t"), &["0.5"], "columns between commas, decimal points"),
            (Some("a;b;c"), &[&ints[..], &["0;0;0,5"]].concat(), "columns between semicolons, decimal commas"),
        ] {
            assert_eq!(found(header, rows).as_deref(), Ok(expected), "{header:?} {rows:?}");
        }
    }

    #[test]
    fn what_can_be_read_in_two_ways_is_refused_with_its_line() {
        for (header, rows, line, words) in [
            (Some("t,x"), &["0,1,5", "1,2,5"][..], 2, "3 fields for 2 columns: commas are the delimiter and"),
            (Some("t,x"), &["0,1", "1,2,5", "2,3"], 3, "3 fields for 2 columns"),
            (Some("t,x,"), &["0,1,5"], 2, "3 fields for 2 columns"),
            (Some("t,x"), &["0,1.5", "1,2,5", "2,3,5"], 3, "3 fields for 2 columns"),
            (Some("t;x"), &["0;1", "1;1,234"], 3, "may be 1.234 or 1234"),
            (Some("t;x"), &["0;1,234,567"], 2, "may be 1.234 or 1234"),
            (Some("t;x"), &["0;1.234,5"], 2, "may be 1.234 or 1234"),
            (Some("t;x"), &["0;1.5", "1;1,5"], 3, "one of them"),
            (Some("t;x,y"), &["0;1", "1,2"], 1, "each could separate the columns"),
            (None, &["0;a,b"], 2, "each could separate the columns"),
        ] {
            let (at, what) = found(header, rows).unwrap_err();
            assert!(at == line && what.contains(words), "{header:?} {rows:?}: {at} {what}");
        }
    }

    #[test]
    fn a_number_has_the_mark_of_its_file_and_no_other() {
        assert_eq!(DecimalMark::Comma.number("-1,25"), Some(-1.25));
        assert_eq!(DecimalMark::Point.number("-1.25"), Some(-1.25));
        for (mark, text) in [(DecimalMark::Comma, "1.25"), (DecimalMark::Comma, "1,2,5"), (DecimalMark::Point, "1,25")]
        {
            assert_eq!(mark.number(text), None, "{text}");
        }
    }
}
