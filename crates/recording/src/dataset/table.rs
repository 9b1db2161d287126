//! Splits text into rows of fields: lines, headers, comments, filters, and columns bound to their index.
//!
//! Each line is parsed separately, so that an unbalanced quote invalidates one row and not the rest of the file.

use std::io::Read;

use flate2::read::MultiGzDecoder;
use posebridge_telemetry::Heading;

use super::column::{Angle, Column, ColumnRef, Dimension, HeadingColumns};
use super::run::{BadRowReason, LoadError, RowError};
use super::schema::{Delimiter, FileEntry, RowOrder, TimeColumn, TimeUnit};

/// Limit of the unpacked size of a gzip file: no recording of a small robot is so large.
const MAX_TEXT_BYTES: u64 = 1 << 30;
/// RFC 1952, section 2.3.1.
const GZIP_MAGIC: [u8; 2] = [0x1F, 0x8B];
/// U+FEFF in UTF-8; some programs write it before the first line.
const BYTE_ORDER_MARK: [u8; 3] = [0xEF, 0xBB, 0xBF];

/// Unpacks a gzip file, detected by its first bytes, and decodes it. Bytes that are not UTF-8 become U+FFFD and invalidate only their
/// field.
pub(super) fn decode_text(path: &str, bytes: Vec<u8>) -> Result<String, LoadError> {
    let bytes = if bytes.starts_with(&GZIP_MAGIC) { gunzip(path, &bytes)? } else { bytes };
    let body = bytes.strip_prefix(&BYTE_ORDER_MARK).unwrap_or(&bytes);
    Ok(String::from_utf8_lossy(body).into_owned())
}

fn gunzip(path: &str, bytes: &[u8]) -> Result<Vec<u8>, LoadError> {
    let mut unpacked = Vec::new();
    let mut reader = MultiGzDecoder::new(bytes).take(MAX_TEXT_BYTES + 1);
    reader.read_to_end(&mut unpacked).map_err(|source| LoadError::Gzip { path: path.to_owned(), source })?;
    if unpacked.len() as u64 > MAX_TEXT_BYTES {
        return Err(LoadError::TooLarge { path: path.to_owned() });
    }
    Ok(unpacked)
}

#[derive(Debug)]
pub(super) struct DatasetTable {
    /// As written in the descriptor.
    pub(super) path: String,
    text: String,
    format: TableFormat,
    names: Vec<String>,
    time: Option<BoundTimeColumn>,
    arrival_nanos: Option<BoundTimeColumn>,
    offset_nanos: i64,
    /// Larger steps between timestamps are suspect.
    pub(super) max_gap_nanos: Option<i64>,
}

#[derive(Debug)]
struct TableFormat {
    delimiter: Delimiter,
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
    /// Of the header; empty without one, or if the descriptor numbers the columns.
    names: &'a [String],
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
        text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| self.not_numeric(index, text))
    }

    /// A column as in the header, or its number from 0.
    fn column_name(&self, index: usize) -> String {
        self.names.get(index).map_or_else(|| format!("column {index}"), |name| format!("column `{name}`"))
    }

    fn not_numeric(&self, index: usize, text: &str) -> RowError {
        let shown: String = text.chars().take(MAX_QUOTED_CHARS).collect();
        let with_point = text.replacen(',', ".", 1);
        let hint = if text.contains(',') && with_point.parse::<f64>().is_ok() {
            format!(": a decimal comma; write {with_point}")
        } else {
            String::new()
        };
        RowError::new(BadRowReason::NotNumeric, format!("{}: `{shown}`{hint}", self.column_name(index)))
    }

    /// Rejects a row with more fields than the header has.
    pub(super) fn check_width(&self) -> Result<(), RowError> {
        let (names, fields) = (self.names.len(), self.fields.len());
        let is_wider = names > 0 && self.fields.iter().skip(names).any(|field| !field.is_empty());
        if !is_wider {
            return Ok(());
        }
        let detail = format!(
            "{fields} for {names}: decimal commas? Separate columns by semicolons (`delimiter = \"semicolon\"`) and write numbers with a \
             point"
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
    /// Skips the header lines and binds the columns that the file entry itself names.
    pub(super) fn new(path: String, text: String, entry: &FileEntry) -> Result<Self, LoadError> {
        if entry.header_lines > 0 && text.trim().is_empty() {
            return Err(LoadError::Empty { path, line: entry.header_lines });
        }
        let mut table = Self {
            names: header_names(&text, entry),
            path,
            text,
            format: TableFormat {
                delimiter: entry.delimiter,
                header_lines: entry.header_lines,
                comment: entry.comment.clone(),
                filter: None,
                order: entry.order,
                has_names: entry.delimiter != Delimiter::Whitespace
                    && entry.time.as_ref().is_some_and(|time| matches!(time.column, ColumnRef::Name(_))),
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
                    hint: self.delimiter_hint(),
                })
            }
        }
    }

    /// What a header that is one column looks like with another delimiter.
    fn delimiter_hint(&self) -> &'static str {
        match self.names.as_slice() {
            [] => "; `header_lines` is 0, so columns have numbers and no names",
            [only] if only.contains(';') => "; `delimiter = \"semicolon\"` would split it",
            [only] if only.contains('\t') => "; `delimiter = \"tab\"` would split it",
            [only] if only.contains(',') => "; `delimiter = \"comma\"` would split it",
            _ => "",
        }
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

    /// The rows after the header, without blank lines, comments and filtered rows.
    pub(super) fn rows(&self) -> impl Iterator<Item = TableRow<'_>> {
        let numbered = self.text.lines().enumerate();
        numbered.skip(self.format.header_lines).filter_map(|(index, line)| self.row(index + 1, line))
    }

    /// Sorted as the descriptor requests; rows without a timestamp come first.
    pub(super) fn ordered_rows(&self) -> Vec<TableRow<'_>> {
        let mut rows: Vec<_> = self.rows().collect();
        if self.format.order == RowOrder::Time {
            rows.sort_by_cached_key(|row| self.time_nanos(row).ok());
        }
        rows
    }

    fn row<'a>(&'a self, line: usize, text: &'a str) -> Option<TableRow<'a>> {
        let visible = text.trim();
        let comment = self.format.comment.as_deref();
        if visible.is_empty() || comment.is_some_and(|prefix| visible.starts_with(prefix)) {
            return None;
        }
        let fields = split(text, self.format.delimiter);
        if let Some((index, expected)) = &self.format.filter
            && fields.get(*index) != Some(&expected.as_str())
        {
            return None;
        }
        let names = if self.format.has_names { self.names.as_slice() } else { &[] };
        Some(TableRow { line, fields, names })
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
            decimal_nanos(text, unit.exponent()).ok_or_else(|| row.not_numeric(index, text))
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

fn header_names(text: &str, entry: &FileEntry) -> Vec<String> {
    let Some(last) = entry.header_lines.checked_sub(1) else {
        return Vec::new();
    };
    let line = text.lines().nth(last).unwrap_or_default().trim();
    let names = split(line, entry.delimiter);
    names.into_iter().map(str::to_owned).collect()
}

fn split(line: &str, delimiter: Delimiter) -> Vec<&str> {
    match delimiter {
        Delimiter::Comma => split_quoted(line, ','),
        Delimiter::Semicolon => split_quoted(line, ';'),
        Delimiter::Tab => split_quoted(line, '\t'),
        Delimiter::Whitespace => line.split_whitespace().collect(),
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

/// More than any clock prints; further digits of a fraction are dropped.
const MAX_DIGITS: u32 = 30;
/// Beyond any time in use; keeps the arithmetic inside 128 bits.
const MAX_EXPONENT: i32 = 40;

/// Nanoseconds of a decimal number in units of ten to the `unit_exponent` seconds, rounded to the nearest (half away from zero); `None`
/// if it is not a decimal number or overflows.
///
/// Exact: a Unix time with nanoseconds has 19 digits and does not fit an `f64`, which is off by up to 0.1 microseconds and can make two
/// timestamps equal.
fn decimal_nanos(text: &str, unit_exponent: i32) -> Option<i64> {
    let (negative, digits) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let (number, exponent) = match digits.split_once(['e', 'E']) {
        Some((number, exponent)) => (number, exponent.parse::<i32>().ok()?),
        None => (digits, 0),
    };
    if !(-MAX_EXPONENT..=MAX_EXPONENT).contains(&exponent) {
        return None;
    }
    let (mantissa, fraction_digits) = mantissa(number)?;
    let magnitude = scale(mantissa, exponent + unit_exponent + 9 - fraction_digits)?;
    i64::try_from(if negative { -magnitude } else { magnitude }).ok()
}

/// The digits as one integer, and the number of decimals.
fn mantissa(number: &str) -> Option<(i128, i32)> {
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    let (mut mantissa, mut digits, mut fraction_digits) = (0_i128, 0_u32, 0_i32);
    for (position, byte) in whole.bytes().chain(fraction.bytes()).enumerate() {
        if !byte.is_ascii_digit() {
            return None;
        }
        let is_fraction = position >= whole.len();
        if digits >= MAX_DIGITS {
            if is_fraction {
                continue;
            }
            return None;
        }
        mantissa = mantissa * 10 + i128::from(byte - b'0');
        digits += u32::from(mantissa != 0);
        fraction_digits += i32::from(is_fraction);
    }
    Some((mantissa, fraction_digits))
}

/// `value` times ten to the `power`, rounded half up.
fn scale(value: i128, power: i32) -> Option<i128> {
    let factor = 10_i128.checked_pow(power.unsigned_abs());
    if power >= 0 {
        return match value {
            0 => Some(0),
            _ => value.checked_mul(factor?),
        };
    }
    // A divisor beyond 128 bits leaves nothing of a number of at most 30 digits.
    Some(factor.map_or(0, |divisor| (value + divisor / 2) / divisor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_protect_delimiters_within_one_line() {
        assert_eq!(split_quoted("1, \"a,b\" ,,2", ','), ["1", "a,b", "", "2"]);
        assert_eq!(split_quoted("\"open,1", ','), ["\"open,1"]);
        assert_eq!(split_quoted("", ';'), [""]);
    }

    #[test]
    fn a_byte_order_mark_and_gzip_are_taken_off() {
        let text = decode_text("a.csv", b"\xEF\xBB\xBF1,2".to_vec()).unwrap();
        assert_eq!(text, "1,2");
        // `printf 1,2 | gzip -n`
        let packed = [
            0x1F, 0x8B, 0x08, 0, 0, 0, 0, 0, 0, 0x03, 0x33, 0xD4, 0x31, 0x02, 0x00, 0x9B, 0x6C, 0x0E, 0x2B, 0x03, 0, 0,
            0,
        ];
        assert_eq!(decode_text("a.csv.gz", packed.to_vec()).unwrap(), "1,2");
        let cut = packed[..14].to_vec();
        assert!(matches!(decode_text("a.csv.gz", cut), Err(LoadError::Gzip { .. })));
    }

    #[test]
    fn stamps_keep_every_nanosecond() {
        assert_eq!(decimal_nanos("1493325165.641284114", 0), Some(1_493_325_165_641_284_114));
        assert_eq!(decimal_nanos("0.0500000000000114", 0), Some(50_000_000));
        assert_eq!(decimal_nanos("378", -3), Some(378_000_000));
        assert_eq!(decimal_nanos("-1.5", -3), Some(-1_500_000));
        assert_eq!(decimal_nanos("12043.0", -3), Some(12_043_000_000));
        assert_eq!(decimal_nanos("1.5e3", -6), Some(1_500_000));
        assert_eq!(decimal_nanos("+.25", 0), Some(250_000_000));
        assert_eq!(decimal_nanos("0.6", -9), Some(1));
        assert_eq!(decimal_nanos("-0.5", -9), Some(-1));
        assert_eq!(decimal_nanos("0.00000000000000000000000000000000000000001", 0), Some(0));
    }

    #[test]
    fn what_is_not_a_decimal_number_is_refused() {
        for text in [
            "",
            "-",
            ".",
            "e5",
            "1e",
            "1e99",
            "nan",
            "inf",
            "1.2.3",
            "0x10",
            "1 2",
            "٣",
            "9223372037",
            "99999999999999999999999999999999999999999999",
        ] {
            assert_eq!(decimal_nanos(text, 0), None, "{text:?}");
        }
    }
}
