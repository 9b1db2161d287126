//! Numbers in columns: what a board prints that does not know posebridge, and which quantity each column probably is.
//!
//! ```text
//! row      a line with as many numbers as most lines, at least two
//! name     the words before the number in every row (L 100 R 200, t=5), else that of a line without numbers (time,left,right)
//! time     named so, else the first column that grows in steps of nearly one size; its unit by the host's clock, else by the step
//! wheels   named so, else the first two columns of whole numbers that moved, else the first two of whole numbers
//! gyro     named so, else the only column that changes while the wheels rest; the scale shows in a turn on the spot
//! ```
//! A guess says what it stands on. It is shown to a person, who confirms or corrects it; the station never guesses.

use posebridge_telemetry::TimeDelta;

use crate::bricks::text_line::numbers::numbers;
use crate::bricks::text_line::{ChecksumPolicy, Column, Quantity, QuantityKind, strip_checksum};

/// Fewer rows show no pattern.
const MIN_ROWS: usize = 3;
const MIN_COLUMNS: usize = 2;
const MAX_COLUMNS: usize = 64;
/// Share of the lines with numbers that must have the same number of them.
const MIN_ROW_SHARE: f64 = 0.6;
/// Bounds memory and time: a quarter of an hour at 50 lines per second.
const MAX_ROWS: usize = 45_000;
/// As of the lines that a board prints.
const MAX_LINE_BYTES: usize = 256;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct TextColumn {
    /// Empty if it has none.
    pub name: String,
    /// One for each row.
    pub values: Vec<f64>,
    pub is_whole: bool,
}

/// The rows of a text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColumnTable {
    pub columns: Vec<TextColumn>,
    pub rows: usize,
    /// It goes on after the most rows that are read.
    pub is_cut: bool,
}

/// A line with its numbers.
struct TextRow<'a> {
    values: Vec<f64>,
    texts: Vec<&'a str>,
    labels: Vec<&'a str>,
}

impl ColumnTable {
    /// The rows of `bytes`; `None` if they are no text with numbers in columns. The first line may be the rear part of one: it is no row
    /// where there are others.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        // What has no end is no line yet.
        let end = bytes.iter().rposition(|byte| matches!(byte, b'\n' | b'\r')).unwrap_or(0);
        let lines = bytes.get(..end)?.split(|byte| matches!(byte, b'\n' | b'\r'));
        let mut lines = lines.filter(|line| !line.is_empty() && line.len() <= MAX_LINE_BYTES);
        let texts: Vec<&str> = lines
            .by_ref()
            .take(MAX_ROWS)
            .filter_map(|line| strip_checksum(line, ChecksumPolicy::Optional).ok().map(|(text, _)| text))
            .collect();
        let rows: Vec<TextRow<'_>> = texts.iter().map(|text| row_of(text)).collect();
        let width = usual_width(&rows)?;
        let is_row = |row: &&TextRow<'_>| row.values.len() == width;
        let first = rows.iter().position(|row| is_row(&row))?;
        let found: Vec<&TextRow<'_>> = rows.iter().filter(is_row).collect();
        let whole = if found.len() > MIN_ROWS && first == 0 { found.get(1..)? } else { &found[..] };
        let header = texts.iter().take(first).rev().find_map(|text| header_fields(text, width));
        let columns = (0..width).map(|index| {
            let labels = || whole.iter().filter_map(|row| row.labels.get(index));
            let label = labels().next().filter(|first| labels().all(|label| label == *first)).copied();
            let label = label.filter(|label| !label.is_empty());
            let of_header = header.as_ref().and_then(|fields| fields.get(index)).copied();
            TextColumn {
                name: label.or(of_header).unwrap_or_default().to_owned(),
                values: whole.iter().filter_map(|row| row.values.get(index)).copied().collect(),
                is_whole: whole.iter().filter_map(|row| row.texts.get(index)).all(|text| is_whole(text)),
            }
        });
        Some(Self { columns: columns.collect(), rows: whole.len(), is_cut: lines.next().is_some() })
    }
}

fn row_of(text: &str) -> TextRow<'_> {
    let mut end = 0;
    let mut row = TextRow { values: Vec::new(), texts: Vec::new(), labels: Vec::new() };
    for number in numbers(text) {
        let Some(value) = number.text.parse::<f64>().ok().filter(|value| value.is_finite()) else {
            continue;
        };
        let between = text.get(end..number.at).unwrap_or_default();
        row.labels.push(label_of(if end == 0 { between } else { without_unit(between) }));
        row.values.push(value);
        row.texts.push(number.text);
        end = number.at + number.text.len();
    }
    row
}

/// Units that may stand behind a number, before the next one's name.
const UNITS: &[&str] = &["ms", "us", "s", "mm", "cm", "m", "deg", "rad", "dps", "ticks", "V", "mV", "C"];

const fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

/// The text behind a number, without the number's unit.
fn without_unit(behind: &str) -> &str {
    let text = behind.trim_start();
    let unit = text.split(|c| !is_word(c)).next().unwrap_or_default();
    if UNITS.contains(&unit) { text.strip_prefix(unit).unwrap_or(text) } else { text }
}

/// The name before a number: what stands behind the last separator.
fn label_of(before: &str) -> &str {
    let label = before.rsplit([',', ';', '|', '\t']).next().unwrap_or(before);
    label.trim_matches(|c: char| !is_word(c))
}

fn is_whole(text: &str) -> bool {
    !text.contains(['.', 'e', 'E'])
}

/// The number of numbers that most lines have.
fn usual_width(rows: &[TextRow<'_>]) -> Option<usize> {
    let mut counts = [0_usize; MAX_COLUMNS + 1];
    for row in rows {
        if let Some(count) = counts.get_mut(row.values.len()) {
            *count += 1;
        }
    }
    let with_numbers = rows.iter().filter(|row| !row.values.is_empty()).count();
    let (width, count) = counts.into_iter().enumerate().skip(MIN_COLUMNS).max_by_key(|(_, count)| *count)?;
    (count >= MIN_ROWS && count as f64 >= MIN_ROW_SHARE * with_numbers as f64).then_some(width)
}

/// The fields of a line that names the columns.
fn header_fields(text: &str, width: usize) -> Option<Vec<&str>> {
    let text = text.trim_start_matches(['#', '%']).trim();
    for separator in [",", ";", "\t", "|"] {
        let fields: Vec<&str> = text.split(separator).map(str::trim).collect();
        if fields.len() == width {
            return Some(fields);
        }
    }
    let fields: Vec<&str> = text.split_ascii_whitespace().collect();
    (fields.len() == width).then_some(fields)
}

/// What a guess of the wheels' columns stands on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WheelEvidence {
    Names,
    /// They are the columns that counted.
    Motion,
    /// They are the only two that may count.
    Only,
    /// They are the first two of several that may count.
    Order,
    /// There are no two columns for them.
    None,
}

/// What a column probably is.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnGuess {
    pub column: Column,
    /// Why, in words for people.
    pub reason: String,
    /// The unit is a guess that nothing supports yet.
    pub is_unit_assumed: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub struct ColumnMapping {
    /// One for each column.
    pub guesses: Vec<ColumnGuess>,
    pub wheels: WheelEvidence,
}

/// Guesses what each column is. `span` is the host's time from the first row to the last, where the rows came live.
pub fn guess_columns(table: &ColumnTable, span: Option<TimeDelta>) -> ColumnMapping {
    let mut guesses: Vec<Option<ColumnGuess>> = table.columns.iter().map(|column| by_name(column, span)).collect();
    for (index, _) in table.columns.iter().enumerate() {
        // A name that comes twice names nothing.
        let kind = |index: usize, guesses: &[Option<ColumnGuess>]| {
            guesses.get(index)?.as_ref().map(|guess| guess.column.quantity.kind())
        };
        let own = kind(index, &guesses).filter(|kind| *kind != QuantityKind::Ignored);
        if own.is_some() && (0..index).any(|before| kind(before, &guesses) == own) {
            guesses[index] = Some(ignored("its name comes twice"));
        }
    }
    let has = |guesses: &[Option<ColumnGuess>], kind: QuantityKind| {
        guesses.iter().flatten().any(|guess| guess.column.quantity.kind() == kind)
    };
    if !has(&guesses, QuantityKind::Time) {
        let clock = table.columns.iter().zip(&guesses).position(|(column, guess)| guess.is_none() && is_clock(column));
        if let Some(index) = clock {
            let quantity = time_unit(&table.columns[index], span);
            guesses[index] = Some(guess(quantity, "it grows in even steps"));
        }
    }
    let wheels = guess_wheels(table, &mut guesses);
    if !has(&guesses, QuantityKind::TurnRate) {
        let is_noisy = |(column, guess): &(&TextColumn, &Option<ColumnGuess>)| guess.is_none() && is_rate(column);
        let mut noisy = table.columns.iter().zip(&guesses).enumerate().filter(|(_, pair)| is_noisy(pair));
        if let (Some((index, (column, _))), None) = (noisy.next(), noisy.next()) {
            guesses[index] = Some(ColumnGuess {
                is_unit_assumed: true,
                ..guess(assumed_gyro_unit(column), "it changes while the wheels rest")
            });
        }
    }
    let guesses = guesses.into_iter().map(|guess| guess.unwrap_or_else(|| ignored("nothing shows what it is")));
    ColumnMapping { guesses: guesses.collect(), wheels }
}

fn guess(quantity: Quantity, reason: &str) -> ColumnGuess {
    ColumnGuess { column: Column::new(quantity), reason: reason.to_owned(), is_unit_assumed: false }
}

fn ignored(reason: &str) -> ColumnGuess {
    guess(Quantity::Ignore, reason)
}

fn guess_wheels(table: &ColumnTable, guesses: &mut [Option<ColumnGuess>]) -> WheelEvidence {
    let is_named =
        |kind: QuantityKind| guesses.iter().flatten().any(|guess: &ColumnGuess| guess.column.quantity.kind() == kind);
    match (is_named(QuantityKind::Left), is_named(QuantityKind::Right)) {
        (true, true) => return WheelEvidence::Names,
        (false, false) => {}
        (true, false) | (false, true) => {
            for guess in guesses.iter_mut().filter(|guess| {
                let kind = guess.as_ref().map(|guess| guess.column.quantity.kind());
                matches!(kind, Some(QuantityKind::Left | QuantityKind::Right))
            }) {
                *guess = Some(ignored("the other wheel has no column"));
            }
            return WheelEvidence::None;
        }
    }
    let free = |predicate: fn(&TextColumn) -> bool| -> Vec<usize> {
        let columns = table.columns.iter().zip(guesses.iter()).enumerate();
        columns.filter(|(_, (column, guess))| guess.is_none() && predicate(column)).map(|(index, _)| index).collect()
    };
    let (moved, possible) = (free(has_counted), free(may_count));
    let (pair, reason, evidence) = match (&moved[..], &possible[..]) {
        ([left, right, ..], _) => ([*left, *right], "it counted", WheelEvidence::Motion),
        (_, [left, right]) => ([*left, *right], "the only whole numbers left", WheelEvidence::Only),
        (_, [left, right, ..]) => ([*left, *right], "whole numbers, in this order", WheelEvidence::Order),
        _ => return WheelEvidence::None,
    };
    for (index, quantity) in pair.into_iter().zip([Quantity::LeftTicks, Quantity::RightTicks]) {
        guesses[index] = Some(guess(quantity, reason));
    }
    evidence
}

fn steps(column: &TextColumn) -> impl Iterator<Item = f64> {
    column.values.windows(2).map(|pair| pair[1] - pair[0])
}

/// Largest step of a clock over its usual one: a few lines may be lost.
const MAX_STEP_RATIO: f64 = 8.0;

fn is_clock(column: &TextColumn) -> bool {
    let step = median_step(column);
    step > 0.0 && steps(column).all(|other| other > 0.0 && other <= MAX_STEP_RATIO * step)
}

fn median_step(column: &TextColumn) -> f64 {
    let mut sorted: Vec<f64> = steps(column).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// Largest factor by which a unit may miss the host's clock.
const MAX_UNIT_RATIO: f64 = 3.0;
/// A board prints at most 500 lines per second: larger steps of whole numbers are microseconds.
const LARGEST_STEP_MS: f64 = 2_000.0;

fn time_unit(column: &TextColumn, span: Option<TimeDelta>) -> Quantity {
    let passed = column.values.last().zip(column.values.first()).map_or(0.0, |(last, first)| last - first);
    if let Some(span_s) = span.map(TimeDelta::as_secs_f64).filter(|span_s| *span_s > 0.0) {
        let per_s = passed / span_s;
        let units = [(1.0, Quantity::TimeS), (1e3, Quantity::TimeMs), (1e6, Quantity::TimeUs)];
        let fits = |(unit, _): &(f64, Quantity)| (unit / MAX_UNIT_RATIO..=unit * MAX_UNIT_RATIO).contains(&per_s);
        if let Some((_, quantity)) = units.into_iter().find(fits) {
            return quantity;
        }
    }
    match median_step(column) {
        step if !column.is_whole && step < 1.0 => Quantity::TimeS,
        step if step >= LARGEST_STEP_MS => Quantity::TimeUs,
        _ => Quantity::TimeMs,
    }
}

/// Counts of less may be a shaken wheel.
const MIN_COUNTED: f64 = 10.0;
/// Least share of the way that is progress, or of the steps that are none, in what a wheel counts.
const MIN_PROGRESS: f64 = 0.5;
const MIN_REST: f64 = 0.3;

fn has_counted(column: &TextColumn) -> bool {
    let way: f64 = steps(column).map(f64::abs).sum();
    let net: f64 = steps(column).sum();
    let rests = steps(column).filter(|step| *step == 0.0).count();
    let rest_share = rests as f64 / column.values.len() as f64;
    column.is_whole && way >= MIN_COUNTED && (net.abs() >= MIN_PROGRESS * way || rest_share >= MIN_REST)
}

fn may_count(column: &TextColumn) -> bool {
    column.is_whole && (steps(column).all(|step| step == 0.0) || has_counted(column))
}

/// Least share of the steps that are some, in what a gyro reads.
const MIN_CHANGES: f64 = 0.3;

fn is_rate(column: &TextColumn) -> bool {
    let changes = steps(column).filter(|step| *step != 0.0).count();
    changes as f64 >= MIN_CHANGES * column.values.len() as f64 && !is_clock(column) && !has_counted(column)
}

fn assumed_gyro_unit(column: &TextColumn) -> Quantity {
    if column.is_whole { Quantity::GyroCounts } else { Quantity::GyroDegPerS }
}

/// What the name of a column says; `None` without a name that does.
fn by_name(column: &TextColumn, span: Option<TimeDelta>) -> Option<ColumnGuess> {
    let reason = format!("its name is {}", column.name);
    if let Some(named) = Column::from_name(&column.name) {
        return Some(ColumnGuess { column: named, reason, is_unit_assumed: false });
    }
    let words = words_of(&column.name);
    let has = |known: &[&str]| words.iter().any(|word| known.contains(&word.as_str()));
    let begins = |known: &[&str]| words.iter().any(|word| known.iter().any(|stem| word.starts_with(stem)));
    let mut is_unit_assumed = false;
    // Speeds, commands and currents of a wheel are not its counts.
    let is_other =
        begins(&["speed", "vel", "pwm", "power", "duty", "cmd", "target", "set", "curr", "volt", "rpm", "err"]);
    let quantity = if begins(&["gyro", "omega", "yawrate", "rate"]) || has(&["gz", "wz", "g", "w"]) {
        if has(&["x", "y", "gx", "gy"]) {
            return Some(ignored("another axis"));
        }
        match (has(&["deg", "dps", "degs"]), has(&["rad", "rads"])) {
            (true, false) => Quantity::GyroDegPerS,
            (false, true) => Quantity::GyroRadPerS,
            (true, true) | (false, false) => {
                is_unit_assumed = true;
                assumed_gyro_unit(column)
            }
        }
    } else if begins(&["time", "milli", "micro", "stamp", "tick_ms"]) || has(&["t", "ms", "us", "s", "sec"]) {
        time_unit(column, span)
    } else if is_other {
        return Some(ignored("no count of a wheel"));
    } else if begins(&["left"]) || has(&["l", "lt", "lft"]) {
        Quantity::LeftTicks
    } else if begins(&["right"]) || has(&["r", "rt", "rgt"]) {
        Quantity::RightTicks
    } else if begins(&["temp"]) {
        Quantity::TemperatureC
    } else if begins(&["dist", "range", "sonar", "ultra"]) {
        match (has(&["mm"]), has(&["cm"]), has(&["m"])) {
            (true, _, _) => Quantity::DistanceMm,
            (_, true, _) => Quantity::DistanceCm,
            (_, _, true) => Quantity::DistanceM,
            _ => return Some(ignored("a distance of unknown unit: name it distance_mm, distance_cm or distance_m")),
        }
    } else {
        return None;
    };
    if matches!(quantity, Quantity::LeftTicks | Quantity::RightTicks) && !column.is_whole {
        return Some(ignored("no whole numbers, so no counts"));
    }
    Some(ColumnGuess { column: Column::new(quantity), reason, is_unit_assumed })
}

/// The words of a name in lower case: `encL_ms` has enc, l and ms.
fn words_of(name: &str) -> Vec<String> {
    let mut words: Vec<String> = vec![String::new()];
    let mut was_lower = false;
    for letter in name.chars() {
        let begins = letter.is_ascii_uppercase() && was_lower;
        if begins || !letter.is_ascii_alphabetic() {
            words.push(String::new());
        }
        if let (true, Some(word)) = (letter.is_ascii_alphabetic(), words.last_mut()) {
            word.push(letter.to_ascii_lowercase());
        }
        was_lower = letter.is_ascii_lowercase();
    }
    words.retain(|word| !word.is_empty());
    words
}
