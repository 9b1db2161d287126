//! Reads the rows of a file one by one: lines, headers, comments, filters, and columns bound to their index.
//!
//! Each line is parsed separately, so that an unbalanced quote invalidates one row and not the rest of the file.

use std::borrow::Cow;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};

use flate2::bufread::MultiGzDecoder;
use posebridge_telemetry::Heading;

use super::column::{Angle, Column, ColumnRef, Dimension, HeadingColumns};
use super::decimal_time::decimal_nanos;
use super::run::{BadRowReason, LoadError, MAX_HELD_BYTES, RowError};
use super::schema::{FileEntry, RowOrder, TimeColumn, TimeUnit};
use crate::csv_dialect::{CsvDialect, DecimalMark, Delimiter, DialectSearch, StatedDialect};
use crate::ros2::bag::{BagError, BagTopic, DAMAGED};

/// Limit of the unpacked size of a gzip file: no recording of a small robot is so large.
const MAX_TEXT_BYTES: u64 = 1 << 30;
/// No row of a table is longer.
const MAX_LINE_BYTES: usize = 1 << 20;
const READ_BYTES: usize = 1 << 16;
/// RFC 1952, section 2.3.1.
const GZIP_MAGIC: [u8; 2] = [0x1F, 0x8B];
/// U+FEFF in UTF-8; some programs write it before the first line.
const BYTE_ORDER_MARK: [u8; 3] = [0xEF, 0xBB, 0xBF];

/// The lines of a file, of which one is in memory. A gzip file, detected by its first bytes, is unpacked. Bytes that are not UTF-8 become
/// U+FFFD and invalidate only their field.
pub(super) struct TextLines {
    path: String,
    reader: Box<dyn BufRead>,
    is_packed: bool,
    line: Vec<u8>,
    number: usize,
    bytes: u64,
}

impl TextLines {
    pub(super) fn open(path: &str, file: Box<dyn Read>) -> Result<Self, LoadError> {
        let mut plain = BufReader::with_capacity(READ_BYTES, file);
        let beginning = plain.fill_buf().map_err(|source| open_error(path.to_owned(), source))?;
        let is_packed = beginning.starts_with(&GZIP_MAGIC);
        let reader: Box<dyn BufRead> = if is_packed {
            Box::new(BufReader::with_capacity(READ_BYTES, MultiGzDecoder::new(plain)))
        } else {
            Box::new(plain)
        };
        Ok(Self { path: path.to_owned(), reader, is_packed, line: Vec::new(), number: 0, bytes: 0 })
    }

    /// The next line and its number, from 1; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<(usize, Cow<'_, str>)>, LoadError> {
        self.line.clear();
        let read = (&mut self.reader).take(MAX_LINE_BYTES as u64 + 1).read_until(b'\n', &mut self.line);
        let path = || self.path.clone();
        let read = read.map_err(|source| {
            let path = path();
            if self.is_packed { LoadError::Gzip { path, source } } else { open_error(path, source) }
        })?;
        if read == 0 {
            return Ok(None);
        }
        self.number += 1;
        self.bytes += read as u64;
        if read > MAX_LINE_BYTES {
            return Err(LoadError::LongLine { path: path(), line: self.number });
        }
        if self.is_packed && self.bytes > MAX_TEXT_BYTES {
            return Err(LoadError::TooLarge { path: path() });
        }
        let mut line = self.line.as_slice();
        if self.number == 1 {
            line = line.strip_prefix(&BYTE_ORDER_MARK).unwrap_or(line);
        }
        let line = line.strip_suffix(b"\n").map_or(line, |line| line.strip_suffix(b"\r").unwrap_or(line));
        Ok(Some((self.number, String::from_utf8_lossy(line))))
    }
}

/// A missing topic, or a folder without a bag, is an error of the bag and not of its path.
pub(super) fn open_error(path: String, source: io::Error) -> LoadError {
    if source.kind() == ErrorKind::InvalidData {
        LoadError::Bag { path, source: BagError::Read(source) }
    } else {
        LoadError::Open { path, source }
    }
}

/// Where the text of a table comes from.
#[derive(Clone, Debug)]
pub(super) struct TableSource {
    pub(super) file: String,
    /// Of a bag.
    pub(super) topic: Option<BagTopic>,
}

impl TableSource {
    pub(super) fn name(&self) -> String {
        match &self.topic {
            Some(topic) => format!("{}:{}", self.file, topic.name),
            None => self.file.clone(),
        }
    }
}

#[derive(Debug)]
pub(super) struct DatasetTable {
    /// As written in the descriptor, with the topic of a bag.
    pub(super) path: String,
    pub(super) source: TableSource,
    format: TableFormat,
    /// As found, where it is not what the descriptor says or leaves out.
    pub(super) detected: Option<CsvDialect>,
    names: Vec<String>,
    time: Option<BoundTimeColumn>,
    arrival_nanos: Option<BoundTimeColumn>,
    offset_nanos: i64,
    /// Larger steps between timestamps are suspect.
    pub(super) max_gap_nanos: Option<i64>,
}

#[derive(Debug)]
struct TableFormat {
    dialect: CsvDialect,
    header_lines: usize,
    comment: Option<String>,
    filter: Option<(usize, String)>,
    order: RowOrder,
    /// The time is a column by name, and one line is one row of fields for each name.
    has_names: bool,
}

#[derive(Debug)]
struct BoundTimeColumn {
    index: usize,
    unit: TimeUnit,
    plus: Option<(usize, TimeUnit)>,
}

#[derive(Debug)]
pub(super) struct TableRow<'a> {
    /// From 1.
    pub(super) line: usize,
    fields: Vec<&'a str>,
    decimal: DecimalMark,
    /// Of the header; empty without one, or if the descriptor numbers the columns.
    names: &'a [String],
    /// Of a bag.
    is_message: bool,
}

impl TableRow<'_> {
    fn field(&self, index: usize) -> Result<&str, RowError> {
        let count = self.fields.len();
        self.fields.get(index).copied().ok_or_else(|| {
            let detail = format!("{} is wanted, the row has {count}", self.column_name(index));
            RowError::new(BadRowReason::MissingColumn, detail)
        })
    }

    fn number(&self, index: usize) -> Result<f64, RowError> {
        let text = self.field(index)?;
        self.decimal.number(text).ok_or_else(|| self.not_numeric(index, text))
    }

    /// A column as in the header, or its number from 0.
    fn column_name(&self, index: usize) -> String {
        self.names.get(index).map_or_else(|| format!("column {index}"), |name| format!("column `{name}`"))
    }

    fn not_numeric(&self, index: usize, text: &str) -> RowError {
        let shown: String = text.chars().take(MAX_QUOTED_CHARS).collect();
        let with_point = text.replacen(',', ".", 1);
        let hint = match self.decimal {
            DecimalMark::Point if text.contains(',') && with_point.parse::<f64>().is_ok() => {
                format!(": a decimal comma; write {with_point}")
            }
            DecimalMark::Comma if text.contains('.') => ": the file has decimal commas".to_owned(),
            DecimalMark::Point | DecimalMark::Comma => String::new(),
        };
        RowError::new(BadRowReason::NotNumeric, format!("{}: `{shown}`{hint}", self.column_name(index)))
    }

    /// Rejects a row with more fields than the header has, and one that stands for a damaged message.
    pub(super) fn check_width(&self) -> Result<(), RowError> {
        if self.is_message
            && let Some(first) = self.fields.first().and_then(|field| field.strip_prefix(DAMAGED))
        {
            let rest = self.fields.get(1..).unwrap_or_default();
            let detail = [&[first], rest].concat().join(", ");
            return Err(RowError::new(BadRowReason::Damaged, detail));
        }
        let (names, fields) = (self.names.len(), self.fields.len());
        let is_wider = names > 0 && self.fields.iter().skip(names).any(|field| !field.is_empty());
        if !is_wider {
            return Ok(());
        }
        let detail = format!(
            "{fields} for {names}: decimal commas? Separate columns by semicolons, or write numbers with a point"
        );
        Err(RowError::new(BadRowReason::ExtraColumn, detail))
    }
}

/// Longest excerpt of a bad field in a message.
const MAX_QUOTED_CHARS: usize = 40;

#[derive(Clone, Debug)]
pub(super) struct BoundColumn<D> {
    index: usize,
    column: Column<D>,
}

impl<D> BoundColumn<D> {
    /// SI units.
    pub(super) fn read(&self, row: &TableRow<'_>) -> Result<f64, RowError> {
        Ok(self.column.to_si(row.number(self.index)?))
    }

    pub(super) fn read_id(&self, row: &TableRow<'_>) -> Result<u32, RowError> {
        let value = self.read(row)?;
        let id = value as u32;
        if f64::from(id) == value { Ok(id) } else { Err(row.not_numeric(self.index, row.field(self.index)?)) }
    }
}

#[derive(Clone, Debug)]
pub(super) enum BoundHeadingColumns {
    Angle(BoundColumn<Angle>),
    Quaternion { qz: usize, qw: usize },
}

impl BoundHeadingColumns {
    pub(super) fn read(&self, row: &TableRow<'_>) -> Result<Heading, RowError> {
        match self {
            Self::Angle(column) => column.read(row).map(Heading::from_rad),
            Self::Quaternion { qz, qw } => {
                let (qz, qw) = (row.number(*qz)?, row.number(*qw)?);
                if qz == 0.0 && qw == 0.0 {
                    return Err(RowError::new(BadRowReason::OutOfRange, "a quaternion of zeros"));
                }
                Ok(Heading::from_rad(2.0 * qz.atan2(qw)))
            }
        }
    }
}

impl DatasetTable {
    /// Reads the header and as many rows as tell the dialect, and binds the columns that the file entry itself names.
    pub(super) fn new(source: TableSource, mut lines: TextLines, entry: &FileEntry) -> Result<Self, LoadError> {
        let path = lines.path.clone();
        let mut header = String::new();
        let mut is_empty = true;
        for _ in 0..entry.header_lines {
            let line = lines.next()?.map(|(_, line)| line.into_owned()).unwrap_or_default();
            is_empty &= line.trim().is_empty();
            line.trim().clone_into(&mut header);
        }
        let has_names = entry.delimiter != Some(Delimiter::Whitespace)
            && entry.time.as_ref().is_some_and(|time| matches!(time.column, ColumnRef::Name(_)));
        let named = (has_names && entry.header_lines > 0).then_some((entry.header_lines, header.as_str()));
        let stated = StatedDialect { delimiter: entry.delimiter, decimal: entry.decimal };
        let mut search = DialectSearch::new(stated, named);
        let refused = |source| LoadError::Dialect { path: path.clone(), source };
        while let Some((line, text)) = lines.next()? {
            if is_visible(&text, entry.comment.as_deref()) {
                is_empty = false;
                if !search.push(line, &text).map_err(refused)? {
                    break;
                }
            }
        }
        if entry.header_lines > 0 && is_empty {
            return Err(LoadError::Empty { path, line: entry.header_lines });
        }
        let dialect = search.finish().map_err(refused)?;
        let expected =
            CsvDialect { delimiter: entry.delimiter.unwrap_or_default(), decimal: entry.decimal.unwrap_or_default() };
        let mut names: Vec<String> = match entry.header_lines {
            0 => Vec::new(),
            _ => dialect.delimiter.split(&header).into_iter().map(str::to_owned).collect(),
        };
        // A spreadsheet may end its lines with delimiters: no column is below them.
        names.truncate(names.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1));
        let mut table = Self {
            names,
            path,
            source,
            detected: (dialect != expected).then_some(dialect),
            format: TableFormat {
                dialect,
                header_lines: entry.header_lines,
                comment: entry.comment.clone(),
                filter: None,
                order: entry.order,
                has_names,
            },
            time: None,
            arrival_nanos: None,
            offset_nanos: seconds_to_nanos(entry.offset_s.unwrap_or_default().0),
            max_gap_nanos: entry.max_gap_s.map(|gap| seconds_to_nanos(gap.0)),
        };
        table.time = table.bind_time(entry.time.as_ref())?;
        table.arrival_nanos = table.bind_time(entry.arrival.as_ref())?;
        if let Some(filter) = &entry.filter {
            let index = table.index_of(&filter.column)?;
            table.format.filter = Some((index, filter.equals.clone()));
        }
        Ok(table)
    }

    fn bind_time(&self, column: Option<&TimeColumn>) -> Result<Option<BoundTimeColumn>, LoadError> {
        let Some(time) = column else {
            return Ok(None);
        };
        let plus = match &time.plus {
            None => None,
            Some(part) => Some((self.index_of(&part.column)?, part.unit)),
        };
        Ok(Some(BoundTimeColumn { index: self.index_of(&time.column)?, unit: time.unit, plus }))
    }

    fn index_of(&self, column: &ColumnRef) -> Result<usize, LoadError> {
        match column {
            ColumnRef::Index(index) => Ok(*index),
            ColumnRef::Name(name) => {
                let found = self.names.iter().position(|known| known == name);
                found.ok_or_else(|| LoadError::NoColumn {
                    path: self.path.clone(),
                    line: self.format.header_lines,
                    column: name.clone(),
                    known: self.names.join(", "),
                    hint: self.names_hint(),
                })
            }
        }
    }

    /// Why the header has no names, or not the expected ones.
    fn names_hint(&self) -> &'static str {
        if self.format.header_lines == 0 { "; `header_lines` is 0, so columns have numbers and no names" } else { "" }
    }

    pub(super) fn bind<D: Dimension>(&self, column: &Column<D>) -> Result<BoundColumn<D>, LoadError> {
        Ok(BoundColumn { index: self.index_of(&column.source)?, column: column.clone() })
    }

    /// The column may be absent from the descriptor.
    pub(super) fn bind_optional<D: Dimension>(
        &self,
        column: Option<&Column<D>>,
    ) -> Result<Option<BoundColumn<D>>, LoadError> {
        column.map(|column| self.bind(column)).transpose()
    }

    pub(super) fn bind_heading(&self, columns: &HeadingColumns) -> Result<BoundHeadingColumns, LoadError> {
        Ok(match columns {
            HeadingColumns::Angle(column) => BoundHeadingColumns::Angle(self.bind(column)?),
            HeadingColumns::Quaternion { qz, qw } => {
                BoundHeadingColumns::Quaternion { qz: self.index_of(qz)?, qw: self.index_of(qw)? }
            }
        })
    }

    /// Passes the rows after the header, without blank lines, comments and filtered rows, in the order that the descriptor requests.
    pub(super) fn for_each_row(
        &self,
        mut lines: TextLines,
        mut take: impl FnMut(&TableRow<'_>) -> Result<(), LoadError>,
    ) -> Result<(), LoadError> {
        let mut held = HeldRows::default();
        while let Some((line, text)) = lines.next()? {
            let Some(row) = self.row(line, &text) else {
                continue;
            };
            match self.format.order {
                RowOrder::File => take(&row)?,
                RowOrder::Time => held.push(&self.path, line, &text, self.time_nanos(&row).ok())?,
            }
        }
        held.rows.sort_by_key(|row| row.nanos);
        held.rows
            .iter()
            .filter_map(|row| self.row(row.line, &held.text[row.start..row.end]))
            .try_for_each(|row| take(&row))
    }

    fn row<'a>(&'a self, line: usize, text: &'a str) -> Option<TableRow<'a>> {
        if line <= self.format.header_lines || !is_visible(text, self.format.comment.as_deref()) {
            return None;
        }
        let CsvDialect { delimiter, decimal } = self.format.dialect;
        let fields = delimiter.split(text);
        let is_message = self.source.topic.is_some();
        let is_damaged = is_message && text.starts_with(DAMAGED);
        if let Some((index, expected)) = &self.format.filter
            && fields.get(*index) != Some(&expected.as_str())
            && !is_damaged
        {
            return None;
        }
        let names = if self.format.has_names { self.names.as_slice() } else { &[] };
        Some(TableRow { line, fields, decimal, names, is_message })
    }

    /// Time base of the data.
    pub(super) fn time_nanos(&self, row: &TableRow<'_>) -> Result<i64, RowError> {
        match &self.time {
            Some(time) => self.read_time(time, row),
            None => Err(RowError::new(BadRowReason::MissingColumn, "the file has no time column")),
        }
    }

    /// `None` without an arrival column.
    pub(super) fn arrival(&self, row: &TableRow<'_>) -> Result<Option<i64>, RowError> {
        let arrival = self.arrival_nanos.as_ref();
        arrival.map(|time| self.read_time(time, row)).transpose()
    }

    fn read_time(&self, time: &BoundTimeColumn, row: &TableRow<'_>) -> Result<i64, RowError> {
        let part = |index: usize, unit: TimeUnit| {
            let text = row.field(index)?;
            let with_point = match row.decimal {
                DecimalMark::Point => Some(Cow::Borrowed(text)),
                DecimalMark::Comma => (!text.contains('.')).then(|| text.replacen(',', ".", 1).into()),
            };
            let nanos = with_point.and_then(|number| decimal_nanos(&number, unit.exponent()));
            nanos.ok_or_else(|| row.not_numeric(index, text))
        };
        let mut nanos = part(time.index, time.unit)?;
        if let Some((index, unit)) = time.plus {
            nanos = nanos.saturating_add(part(index, unit)?);
        }
        Ok(nanos.saturating_add(self.offset_nanos))
    }
}

pub(super) fn seconds_to_nanos(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

fn is_visible(line: &str, comment: Option<&str>) -> bool {
    let visible = line.trim();
    !visible.is_empty() && !comment.is_some_and(|prefix| visible.starts_with(prefix))
}

/// The rows of a file that is not in the order of time. Their text takes no more memory than their numbers would.
#[derive(Default)]
struct HeldRows {
    text: String,
    rows: Vec<HeldRow>,
}

struct HeldRow {
    /// Rows without a timestamp come first.
    nanos: Option<i64>,
    line: usize,
    start: usize,
    end: usize,
}

impl HeldRows {
    fn push(&mut self, path: &str, line: usize, text: &str, nanos: Option<i64>) -> Result<(), LoadError> {
        let start = self.text.len();
        self.text.push_str(text);
        self.rows.push(HeldRow { nanos, line, start, end: self.text.len() });
        let bytes = self.text.len() + self.rows.len() * size_of::<HeldRow>();
        if bytes as u64 > MAX_HELD_BYTES {
            return Err(LoadError::TooMuch { path: path.to_owned(), line });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines_of(bytes: &[u8]) -> Result<Vec<(usize, String)>, LoadError> {
        let mut lines = TextLines::open("a.csv", Box::new(io::Cursor::new(bytes.to_vec())))?;
        let mut found = Vec::new();
        while let Some((line, text)) = lines.next()? {
            found.push((line, text.into_owned()));
        }
        Ok(found)
    }

    #[test]
    fn a_byte_order_mark_and_gzip_are_taken_off() {
        assert_eq!(
            lines_of(b"\xEF\xBB\xBF1,2\r\n\n3").unwrap(),
            [(1, "1,2".into()), (2, String::new()), (3, "3".into())]
        );
        // `printf 1,2 | gzip -n`
        let packed = [
            0x1F, 0x8B, 0x08, 0, 0, 0, 0, 0, 0, 0x03, 0x33, 0xD4, 0x31, 0x02, 0x00, 0x9B, 0x6C, 0x0E, 0x2B, 0x03, 0, 0,
            0,
        ];
        assert_eq!(lines_of(&packed).unwrap(), [(1, "1,2".into())]);
        assert!(matches!(lines_of(&packed[..14]), Err(LoadError::Gzip { .. })));
    }

    #[test]
    fn a_line_without_end_is_refused_before_it_fills_the_memory() {
        let endless = io::repeat(b'1');
        let mut lines = TextLines::open("a.csv", Box::new(endless)).unwrap();
        assert!(matches!(lines.next(), Err(LoadError::LongLine { line: 1, .. })));
        assert!(lines.line.len() <= MAX_LINE_BYTES + 1);
    }
}
