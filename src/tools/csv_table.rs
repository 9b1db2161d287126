//! Small CSV tables with column names in the first line.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use csv::{ReaderBuilder, StringRecord, Terminator, Trim};
use posebridge_recording::csv_dialect::{CsvDialect, DialectSearch, StatedDialect};

use crate::console::print_line;
use crate::text_file::read_text;

pub struct CsvTable {
    name: String,
    dialect: CsvDialect,
    columns: StringRecord,
    rows: Vec<(usize, StringRecord)>,
}

pub struct CsvRow<'a> {
    table: &'a CsvTable,
    line: usize,
    cells: &'a StringRecord,
}

impl CsvTable {
    /// Reads a file; lines that begin with `#` and empty ones are ignored. The dialect is found by the lines, and said if it is not the
    /// usual one. Rejects a row with more cells than columns: a decimal comma would shift the rest.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = read_text(path).with_context(|| format!("reading `{name}`"))?;
        let table = Self::parse(name, text.trim_start_matches('\u{feff}'))?;
        if table.dialect != CsvDialect::default() {
            print_line(&format!("`{}`: {}", table.name, table.dialect));
        }
        Ok(table)
    }

    fn parse(name: String, text: &str) -> Result<Self> {
        // The lines are chosen here: the crate counts them wrongly after CRLF, blank lines and comments.
        let is_row = |(_, line): &(usize, &str)| !line.trim().is_empty() && !line.starts_with('#');
        let lines: Vec<(usize, &str)> = (1..).zip(text.lines()).filter(is_row).collect();
        let dialect = dialect_of(&name, &lines)?;
        let (numbers, lines): (Vec<usize>, Vec<&str>) = lines.into_iter().unzip();
        let text = lines.join("\n");
        let reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(dialect.delimiter.letter().unwrap_or(',') as u8)
            .trim(Trim::All)
            .terminator(Terminator::Any(b'\n'))
            .from_reader(text.as_bytes());
        let mut records = numbers.into_iter().zip(reader.into_records()).map(|(line, cells)| {
            let cells = cells.with_context(|| format!("`{name}` line {line}"))?;
            ensure!(
                !cells.as_slice().contains('\n'),
                "`{name}` line {line}: a quote is not closed; end the cell with \""
            );
            Ok((line, cells))
        });
        let Some(header) = records.next() else { bail!("`{name}` is empty: its first line has to name the columns") };
        let (_, columns) = header?;
        let rows = records.collect::<Result<Vec<_>>>()?;
        for (line, cells) in &rows {
            // A spreadsheet may end its lines with commas.
            ensure!(
                cells.iter().skip(columns.len()).all(str::is_empty),
                "`{name}` line {line} has {} cells under {} columns; write decimal points, not commas: -12.5",
                cells.len(),
                columns.len()
            );
        }
        Ok(Self { name, dialect, columns, rows })
    }

    pub fn has(&self, column: &str) -> bool {
        self.columns.iter().any(|name| name == column)
    }

    /// As in the first line.
    pub fn columns(&self) -> &StringRecord {
        &self.columns
    }

    pub fn rows(&self) -> impl Iterator<Item = CsvRow<'_>> {
        self.rows.iter().map(|(line, cells)| CsvRow { table: self, line: *line, cells })
    }
}

fn dialect_of(name: &str, lines: &[(usize, &str)]) -> Result<CsvDialect> {
    // A quote that is not closed is told by the reader.
    let is_closed = |line: &str| line.matches('"').count().is_multiple_of(2);
    let Some((header, rows)) = lines.split_first().filter(|(header, _)| is_closed(header.1)) else {
        return Ok(CsvDialect::default());
    };
    let mut search = DialectSearch::new(StatedDialect::default(), Some(*header));
    let find = || {
        for (line, text) in rows.iter().filter(|(_, text)| is_closed(text)) {
            if !search.push(*line, text)? {
                break;
            }
        }
        search.finish()
    };
    find().map_err(|error| anyhow!("`{name}` line {}: {error}", error.line))
}

impl CsvRow<'_> {
    pub fn text(&self, column: &str) -> Result<&str> {
        let CsvTable { name, columns, .. } = self.table;
        let Some(index) = columns.iter().position(|known| known == column) else {
            let known: Vec<&str> = columns.iter().collect();
            bail!("`{name}` has no column `{column}`; it has: {}. Name it in the first line", known.join(", "))
        };
        match self.cells.get(index) {
            Some(text) if !text.is_empty() => Ok(text),
            _ => bail!("`{name}` line {}: column `{column}` is empty", self.line),
        }
    }

    pub fn number(&self, column: &str) -> Result<f64> {
        let text = self.text(column)?;
        match self.table.dialect.decimal.number(text) {
            Some(number) => Ok(number),
            None => bail!("`{}` line {}: `{text}` in column `{column}` is no number", self.table.name, self.line),
        }
    }

    /// File and line, for error messages.
    pub fn location(&self) -> String {
        format!("`{}` line {}", self.table.name, self.line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listing(text: &str) -> Result<CsvTable> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        CsvTable::read(&path)
    }

    #[test]
    fn rows_are_read_by_the_names_of_their_columns() {
        let listing = listing("\u{feff}way, x_mm\n# measured twice\n\n\"cw, \"\"slow\"\"\" , -12.5,,\n").unwrap();
        let rows: Vec<CsvRow<'_>> = listing.rows().collect();
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].text("way").unwrap(), rows[0].number("x_mm").unwrap()), ("cw, \"slow\"", -12.5));
        assert!(listing.has("way") && !listing.has("y_mm"));
    }

    #[test]
    fn semicolons_and_decimal_commas_are_read_right() {
        let listing = listing("way;x_mm\ncw;-12,5\n\"c;w\";3\n").unwrap();
        let rows: Vec<_> =
            listing.rows().map(|row| (row.text("way").unwrap().to_owned(), row.number("x_mm").unwrap())).collect();
        assert_eq!(rows, [("cw".to_owned(), -12.5), ("c;w".to_owned(), 3.0)]);
    }

    #[test]
    fn an_error_names_the_line_and_the_column() {
        let counted = "\r\nway,x_mm\r\n \r\n# twice\r\n\r\ncw,far\r\n";
        let (no_number, no_value) = ("`far` in column `x_mm` is no number", "column `x_mm` is empty");
        for (text, column, line, expected) in [
            (counted, "x_mm", 6, no_number),
            ("way,x_mm\ncw,far\n", "x_mm", 2, no_number),
            ("way,x_mm\ncw\n", "x_mm", 2, no_value),
            ("way,x_mm\ncw,1\n", "y_mm", 0, "has no column `y_mm`; it has: way, x_mm"),
            ("\"way,x_mm\ncw,1\n", "x_mm", 1, "a quote is not closed"),
            ("way,x_mm\n\ncw,1\n\"cw,2\ncw,3\n", "x_mm", 4, "a quote is not closed"),
            (
                "way,x_mm,y_mm\ncw,1,2\ncw,-12,5,-20,1\n",
                "x_mm",
                3,
                "5 fields for 3 columns: commas are the delimiter and",
            ),
            (
                "way,x_mm,y_mm\ncw,1.5,2\ncw,1,2\ncw,-12,5,-20,1\n",
                "x_mm",
                4,
                "has 5 cells under 3 columns; write decimal points, not commas: -12.5",
            ),
            ("way;x_mm\ncw;1,234\n", "x_mm", 2, "may be 1.234 or 1234"),
        ] {
            let number = listing(text).and_then(|listing| listing.rows().next().unwrap().number(column));
            let error = number.unwrap_err().to_string();
            assert!(line == 0 || error.contains(&format!("t.csv` line {line}")), "{error}");
            assert!(error.contains(expected), "{error}");
        }
    }
}
