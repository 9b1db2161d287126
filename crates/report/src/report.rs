//! The result of a command: text for a terminal, an HTML page and JSON, rendered from the same values.
//!
//! Values are in SI units. A [`Format`] defines their text; JSON contains them unchanged, under stable keys.
//!
//! ```
//! use posebridge_report::quantity::{Format, Quantity, Unit};
//! use posebridge_report::report::Report;
//! let mut report = Report::new("demo", "Track width");
//! report.values([Quantity::new("track_m", "track width", 0.1123, Format::new(Unit::Millimetres, 1)).with_sigma(0.0004)]);
//! assert_eq!(report.text(), "Track width\n\ntrack width  112.3 ± 0.4 mm\n");
//! assert_eq!(report.json()["track_m"]["value"], 0.1123);
//! ```

use serde_json::{Map, Value, json};

use super::chart::{Plot, render_plot};
use super::colour::Colour;
use super::metrics::VerdictTone;
use super::page::{ReportBlock, ReportPage};
use super::quantity::{Format, Quantity, Unit};
use super::tables::{NO_VALUE, TextTable, wrapped};

enum Cell {
    Text(String),
    Count(Option<usize>),
    Number(Option<f64>),
    Uncertain {
        value: Option<f64>,
        sigma: Option<f64>,
    },
    /// Only in JSON.
    Data(Value),
}

struct Column {
    key: &'static str,
    /// A column without a heading is only in JSON.
    heading: Option<String>,
    format: Format,
    cells: Vec<Cell>,
}

impl Column {
    fn text(&self, row: usize) -> String {
        match &self.cells[row] {
            Cell::Text(text) => text.clone(),
            Cell::Count(count) => count.map_or_else(|| NO_VALUE.to_owned(), |count| count.to_string()),
            Cell::Number(value) => self.format.number(*value),
            Cell::Uncertain { value, sigma } => self.format.uncertain_number(*value, *sigma),
            Cell::Data(value) => value.to_string(),
        }
    }

    fn json(&self, row: usize) -> Value {
        match &self.cells[row] {
            Cell::Text(text) => json!(text),
            Cell::Count(count) => json!(count),
            Cell::Number(value) => json!(value),
            Cell::Uncertain { value, sigma } => json!({ "value": value, "sigma": sigma }),
            Cell::Data(value) => value.clone(),
        }
    }
}

/// A table: rows, and columns that read a value from a row. A column's key is that of the row's JSON object; an empty key omits the
/// column there.
pub struct Table<'a, R> {
    rows: &'a [R],
    columns: Columns,
    labels: usize,
}

impl<'a, R> Table<'a, R> {
    pub const fn of(rows: &'a [R]) -> Self {
        Self { rows, columns: Columns { columns: Vec::new(), rows: rows.len() }, labels: 1 }
    }

    /// Number of leading columns that identify a row (default 1): a text table too wide for a terminal continues below and repeats
    /// them.
    pub fn labels(self, labels: usize) -> Self {
        Self { labels, ..self }
    }

    pub fn text(self, key: &'static str, heading: impl Into<String>, value: impl Fn(&R) -> String) -> Self {
        self.column(key, Some(heading.into()), Format::new(Unit::None, 0), &|row| Cell::Text(value(row)))
    }

    pub fn count(self, key: &'static str, heading: impl Into<String>, value: impl Fn(&R) -> usize) -> Self {
        self.optional_count(key, heading, |row| Some(value(row)))
    }

    /// Integers; `None` is a dash in text and `null` in JSON.
    pub fn optional_count(
        self,
        key: &'static str,
        heading: impl Into<String>,
        value: impl Fn(&R) -> Option<usize>,
    ) -> Self {
        self.column(key, Some(heading.into()), Format::new(Unit::None, 0), &|row| Cell::Count(value(row)))
    }

    /// Numbers in SI units; `None` is a dash in text and `null` in JSON.
    pub fn number(
        self,
        key: &'static str,
        heading: impl Into<String>,
        format: Format,
        value: impl Fn(&R) -> Option<f64>,
    ) -> Self {
        self.column(key, Some(heading.into()), format, &|row| Cell::Number(value(row)))
    }

    /// Numbers with standard deviations; in JSON objects of `value` and `sigma`.
    pub fn uncertain(
        self,
        key: &'static str,
        heading: impl Into<String>,
        format: Format,
        value: impl Fn(&R) -> Option<f64>,
        sigma: impl Fn(&R) -> Option<f64>,
    ) -> Self {
        let cell = |row: &R| Cell::Uncertain { value: value(row), sigma: sigma(row) };
        self.column(key, Some(heading.into()), format, &cell)
    }

    /// Only in JSON.
    pub fn data(self, key: &'static str, value: impl Fn(&R) -> Value) -> Self {
        self.column(key, None, Format::new(Unit::None, 0), &|row| Cell::Data(value(row)))
    }

    fn column(mut self, key: &'static str, heading: Option<String>, format: Format, cell: &dyn Fn(&R) -> Cell) -> Self {
        let cells = self.rows.iter().map(cell).collect();
        self.columns.columns.push(Column { key, heading, format, cells });
        self
    }

    /// The rows as an array of objects, for JSON with another structure than that of [`Report::table`].
    pub fn json(&self) -> Value {
        self.columns.json()
    }
}

/// The values of a table, without the type of its rows: a report has dozens of those.
struct Columns {
    columns: Vec<Column>,
    rows: usize,
}

impl Columns {
    fn header(&self) -> Vec<String> {
        let shown = |column: &Column| Some(column.format.append_unit(column.heading.as_deref()?));
        self.columns.iter().filter_map(shown).collect()
    }

    fn cells(&self) -> Vec<Vec<String>> {
        let shown = || self.columns.iter().filter(|column| column.heading.is_some());
        (0..self.rows).map(|row| shown().map(|column| column.text(row)).collect()).collect()
    }

    fn json(&self) -> Value {
        let keyed = || self.columns.iter().filter(|column| !column.key.is_empty());
        let object = |row| keyed().map(|column| (column.key.to_owned(), column.json(row))).collect();
        (0..self.rows).map(|row| Value::Object(object(row))).collect()
    }
}

/// A part of a page, and of the text unless it is only for the page.
#[derive(Clone, Debug)]
struct Section {
    block: ReportBlock,
    /// Number of leading columns of a table that identify a row.
    labels: usize,
    is_page_only: bool,
}

/// The result of a command, for terminal, page and JSON.
#[derive(Clone, Debug)]
pub struct Report {
    name: &'static str,
    title: String,
    sections: Vec<Section>,
    json: Map<String, Value>,
}

impl Report {
    /// `name` is the command's words joined; it also names files.
    pub fn new(name: &'static str, title: impl Into<String>) -> Self {
        Self { name, title: title.into(), sections: Vec::new(), json: Map::new() }
    }

    /// The command's words joined, such as `lab-wall`.
    pub const fn name(&self) -> &'static str {
        self.name
    }

    /// The result in a sentence, before all else.
    pub fn answer(&mut self, text: impl Into<String>) {
        let block = ReportBlock::Text(text.into());
        self.sections.insert(0, Section { block, labels: 0, is_page_only: false });
    }

    pub fn heading(&mut self, text: impl Into<String>) {
        self.add(ReportBlock::Heading(text.into()));
    }

    pub fn paragraph(&mut self, text: impl Into<String>) {
        self.add(ReportBlock::Text(text.into()));
    }

    /// One line each.
    pub fn list(&mut self, lines: impl IntoIterator<Item = String>) {
        let lines: Vec<String> = lines.into_iter().collect();
        if !lines.is_empty() {
            self.add(ReportBlock::List(lines));
        }
    }

    /// One line each.
    pub fn values(&mut self, values: impl IntoIterator<Item = Quantity>) {
        let mut rows = Vec::new();
        for value in values {
            if !value.key.is_empty() {
                self.json.insert(value.key.to_owned(), value.json());
            }
            rows.extend(value.text().map(|text| vec![value.label, text]));
        }
        if !rows.is_empty() {
            self.add(ReportBlock::Table { header: Vec::new(), rows });
        }
    }

    /// With a non-empty key JSON gets an array of the rows.
    pub fn table<R>(&mut self, key: &'static str, table: &Table<'_, R>) {
        let (columns, labels) = (&table.columns, table.labels);
        let block = ReportBlock::Table { header: columns.header(), rows: columns.cells() };
        self.sections.push(Section { block, labels, is_page_only: false });
        if !key.is_empty() {
            self.json.insert(key.to_owned(), columns.json());
        }
    }

    /// A reservation about the result.
    pub fn warning(&mut self, text: impl Into<String>) {
        self.verdict(VerdictTone::Bad, "Warning:", text);
    }

    /// A rating in a word, with its reason.
    pub fn verdict(&mut self, tone: VerdictTone, word: impl Into<String>, text: impl Into<String>) {
        self.add(ReportBlock::Verdict { tone, word: word.into(), text: text.into() });
    }

    /// Keeps line breaks and spaces.
    pub fn code(&mut self, text: impl Into<String>) {
        self.add(ReportBlock::PreformattedText(text.into()));
    }

    /// Only in the page.
    pub fn chart(&mut self, plot: &Plot, caption: impl Into<String>) {
        self.figure(render_plot(plot), caption);
    }

    /// A whole SVG document, only in the page.
    pub fn figure(&mut self, svg: String, caption: impl Into<String>) {
        self.page_only(ReportBlock::Figure { svg, caption: caption.into() });
    }

    /// A paragraph about purpose and method, only in the page: the user of a terminal knows them.
    pub fn background(&mut self, text: impl Into<String>) {
        self.page_only(ReportBlock::Text(text.into()));
    }

    /// The command line that reproduces the page, only in the page.
    pub fn command(&mut self, text: impl Into<String>) {
        self.page_only(ReportBlock::PreformattedText(text.into()));
    }

    /// A block that is too long for a terminal.
    pub fn page_only(&mut self, block: ReportBlock) {
        self.sections.push(Section { block, labels: 0, is_page_only: true });
    }

    fn add(&mut self, block: ReportBlock) {
        self.sections.push(Section { block, labels: 0, is_page_only: false });
    }

    /// Only in JSON.
    pub fn data(&mut self, key: &str, value: Value) {
        self.json.insert(key.to_owned(), value);
    }

    /// Plain text: the title, then the sections, with a line feed at the end.
    pub fn text(&self) -> String {
        self.text_in(Colour::Plain)
    }

    /// Text for a terminal.
    pub fn text_in(&self, colour: Colour) -> String {
        let mut text = self.title.clone() + "\n";
        let mut above: Option<&ReportBlock> = None;
        for section in &self.sections {
            let part = section.text(colour);
            if part.is_empty() {
                continue;
            }
            let belongs_above = matches!(
                (above, &section.block),
                (Some(ReportBlock::Heading(_)), _) | (Some(ReportBlock::Verdict { .. }), ReportBlock::Verdict { .. })
            );
            if !belongs_above {
                text.push('\n');
            }
            text += &part;
            above = Some(&section.block);
        }
        text
    }

    pub fn page(&self) -> ReportPage {
        ReportPage {
            title: self.title.clone(),
            blocks: self.sections.iter().map(|section| section.block.clone()).collect(),
        }
    }

    pub fn json(&self) -> Value {
        Value::Object(self.json.clone())
    }
}

impl Section {
    fn text(&self, colour: Colour) -> String {
        if self.is_page_only {
            return String::new();
        }
        match &self.block {
            ReportBlock::Heading(text) | ReportBlock::Subheading(text) => format!("{text}\n"),
            ReportBlock::Text(text) => wrapped("", text),
            ReportBlock::PreformattedText(text) => text.trim_end_matches('\n').to_owned() + "\n",
            ReportBlock::List(lines) => lines.iter().map(|line| wrapped("", line)).collect(),
            ReportBlock::Verdict { tone, word, text } => {
                let plain = wrapped("", &format!("{word} {text}"));
                plain.replacen(word, &colour.paint(*tone, word), 1)
            }
            ReportBlock::Table { header, rows } if header.is_empty() => values_text(rows),
            ReportBlock::Table { header, rows } | ReportBlock::CodeTable { header, rows } => {
                let mut table = TextTable::new(header.iter().cloned()).labels(self.labels);
                for row in rows {
                    table.push(row.iter().cloned());
                }
                table.render()
            }
            ReportBlock::Figure { .. } | ReportBlock::FigureGrid(_) => String::new(),
        }
    }
}

fn values_text(rows: &[Vec<String>]) -> String {
    let pairs = || rows.iter().filter_map(|row| row.split_first());
    let width = pairs().map(|(label, _)| label.chars().count()).max().unwrap_or(0);
    let lines = pairs().map(|(label, value)| format!("{label:<width$}  {}\n", value.concat()));
    lines.collect::<Vec<_>>().concat()
}

#[cfg(test)]
mod tests {
    use super::super::tables::LINE_WIDTH;
    use super::*;

    const MM: Format = Format::new(Unit::Millimetres, 1);

    fn report() -> Report {
        let mut report = Report::new("demo", "Squares & ends");
        report.values([
            Quantity::new("bend_rad", "bend per side", -0.1, Format::new(Unit::Degrees, 2).signed()),
            Quantity::optional("scatter_m", "scatter", None, MM),
            Quantity::new("track", "track x", 1.02, Format::new(Unit::None, 3)).with_sigma(0.004),
        ]);
        let rows = [("cw", Some(0.0123), 3), ("ccw", None, 10)];
        let table = Table::of(&rows)
            .text("way", "direction", |(way, ..)| (*way).to_owned())
            .number("ahead_m", "ahead", MM.signed(), |(_, ahead_m, _)| *ahead_m)
            .count("", "runs", |(.., runs)| *runs)
            .data("runs_squared", |(.., runs)| json!(runs * runs));
        report.heading("Ends");
        report.table("ends", &table);
        report.warning("a < b");
        report.verdict(VerdictTone::Good, "Fine:", "c");
        report.background("why");
        report.data("source", json!("drive"));
        report
    }

    #[test]
    fn text_page_and_json_hold_the_same_values() {
        let report = report();
        let text = "Squares & ends\n\nbend per side  -5.73 deg\ntrack x        1.020 ± 0.004\n\nEnds\n\
                    direction  ahead mm  runs\ncw            +12.3     3\nccw               -    10\n\nWarning: a < b\nFine: c\n";
        assert_eq!(report.text(), text);
        let json = json!({
            "bend_rad": -0.1, "scatter_m": null, "track": { "value": 1.02, "sigma": 0.004 },
            "source": "drive", "ends": [
                { "way": "cw", "ahead_m": 0.0123, "runs_squared": 9 },
                { "way": "ccw", "ahead_m": null, "runs_squared": 100 },
            ],
        });
        assert_eq!(report.json(), json);
        let html = report.page().html();
        let expected = [
            "<h1>Squares &amp; ends</h1>",
            "<td>-5.73 deg</td>",
            "<th>ahead mm</th>",
            "<td>+12.3</td>",
            "a &lt; b",
            "<p>why</p>",
        ];
        for part in expected {
            assert!(html.contains(part), "{part} in {html}");
        }
    }

    #[test]
    fn a_table_that_is_too_wide_goes_on_below_its_labels() {
        let share = Format::new(Unit::Percent, 1);
        let heading = "x".repeat(LINE_WIDTH - 14);
        let table = Table::of(&[0.25])
            .text("", "a", |_| "row".to_owned())
            .count("", "b", |_| 7)
            .number("", &heading, share, |value| Some(*value))
            .uncertain("c", "c", Format::three_digits(Unit::Millimetres), |value| Some(*value), |_| Some(0.000_123))
            .labels(2);
        let mut report = Report::new("wide", "Wide");
        report.table("rows", &table);
        let text = report.text();
        assert!(text.ends_with(" 25.0\n\na    b         c mm\nrow  7  250 ± 0.123\n"), "{text}");
        assert_eq!(report.json(), json!({ "rows": [{ "c": { "value": 0.25, "sigma": 0.000_123 } }] }));
    }

    #[test]
    fn a_paragraph_breaks_between_words_before_the_line_is_full() {
        let (line, long) = ("x".repeat(LINE_WIDTH - 2), "w".repeat(LINE_WIDTH + 5));
        assert_eq!(wrapped("", &format!("{line} a b\n{long} y")), format!("{line} a\nb\n{long}\ny\n"));
        assert_eq!(wrapped("", ""), "\n");
    }
}
