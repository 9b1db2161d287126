//! Small tables that a person typed: a line of column names, then numbers, with commas between.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

/// A file of rows.
pub(crate) struct CsvTable {
    name: String,
    columns: Vec<String>,
    rows: Vec<(usize, Vec<String>)>,
}

/// One row, which knows its line.
pub(crate) struct CsvRow<'a> {
    table: &'a CsvTable,
    line: usize,
    cells: &'a [String],
}

impl CsvTable {
    /// Reads a file; lines that begin with `#` and empty ones are left out.
    ///
    /// # Errors
    /// It cannot be read, names no columns, or a row has more cells than there are columns: a decimal comma would shift what follows.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).with_context(|| format!("reading `{name}`"))?;
        let text = text.trim_start_matches('\u{feff}');
        let cells = |line: &str| -> Vec<String> { line.split(',').map(|cell| cell.trim().to_owned()).collect() };
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
        let Some((_, header)) = lines.next() else {
            bail!("`{name}` is empty: its first line has to name the columns")
        };
        let columns = cells(header);
        let rows: Vec<(usize, Vec<String>)> = lines.map(|(index, line)| (index + 1, cells(line))).collect();
        for (line, cells) in &rows {
            // A spreadsheet may end its lines with commas.
            let beyond = cells.iter().skip(columns.len());
            ensure!(
                beyond.into_iter().all(String::is_empty),
                "`{name}` line {line} has {} cells under {} columns; write decimal points, not commas: -12.5",
                cells.len(),
                columns.len()
            );
        }
        Ok(Self { name, columns, rows })
    }

    /// Whether there is such a column.
    pub(crate) fn has(&self, column: &str) -> bool {
        self.columns.iter().any(|name| name == column)
    }

    /// The names of the columns, as the first line has them.
    pub(crate) fn columns(&self) -> &[String] {
        &self.columns
    }

    /// The rows in their order.
    pub(crate) fn rows(&self) -> impl Iterator<Item = CsvRow<'_>> {
        self.rows.iter().map(|(line, cells)| CsvRow { table: self, line: *line, cells })
    }
}

impl CsvRow<'_> {
    /// The text in a column.
    pub(crate) fn text(&self, column: &str) -> Result<&str> {
        let CsvTable { name, columns, .. } = self.table;
        let Some(place) = columns.iter().position(|known| known == column) else {
            bail!("`{name}` has no column `{column}`; it has: {}. Name it in the first line", columns.join(", "))
        };
        match self.cells.get(place) {
            Some(text) if !text.is_empty() => Ok(text),
            _ => bail!("`{name}` line {}: column `{column}` is empty", self.line),
        }
    }

    /// The number in a column.
    pub(crate) fn number(&self, column: &str) -> Result<f64> {
        let text = self.text(column)?;
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => bail!("`{}` line {}: `{text}` in column `{column}` is no number", self.table.name, self.line),
        }
    }

    /// Where the row stands, for a complaint.
    pub(crate) fn location(&self) -> String {
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
        let listing = listing("\u{feff}way, x_mm\n# measured twice\n\ncw , 12.5\n").unwrap();
        let rows: Vec<CsvRow<'_>> = listing.rows().collect();
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].text("way").unwrap(), rows[0].number("x_mm").unwrap()), ("cw", 12.5));
        assert!(listing.has("way") && !listing.has("y_mm"));
    }

    #[test]
    fn a_decimal_comma_is_refused_and_the_empty_cells_of_a_spreadsheet_are_not() {
        let error = listing("way,x_mm,y_mm\ncw,1,2\ncw,-12,5,-20,1\n").err();
        let error = error.unwrap().to_string();
        assert!(
            error.ends_with("t.csv` line 3 has 5 cells under 3 columns; write decimal points, not commas: -12.5"),
            "{error}"
        );
        let listing = listing("way,x_mm\ncw,-12.5,,\n").unwrap();
        let row = listing.rows().next().unwrap();
        assert_eq!(row.number("x_mm").unwrap(), -12.5);
    }

    #[test]
    fn what_is_missing_is_named_with_its_line() {
        let listing = listing("way,x_mm\ncw\ncw,far\n").unwrap();
        let error = |index: usize, column: &str| {
            let row = listing.rows().nth(index).unwrap();
            row.number(column).unwrap_err().to_string()
        };
        assert!(error(0, "x_mm").ends_with("t.csv` line 2: column `x_mm` is empty"));
        assert!(error(1, "x_mm").ends_with("t.csv` line 3: `far` in column `x_mm` is no number"));
        assert!(error(1, "y_mm").contains("has no column `y_mm`; it has: way, x_mm"));
    }
}
