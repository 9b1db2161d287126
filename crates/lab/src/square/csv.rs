//! Sensor tables as text: the export format of a brick's log, for students' own programs.
//!
//! ```text
//! # anything behind a hash is a remark
//! time_s,left_counts,right_counts,gyro_deg_per_s,accel_left_m_per_s2,accel_right_m_per_s2,camera_x_m,camera_y_m,camera_theta_deg
//! 0,0,0,,,,,,
//! 0.05,0,0,1,0.01,-0.02,0.001,0.002,0.4
//! ```
//! The first line that is not a comment names the columns, in any order. `time_s` (or `time_ms`, as a brick without fractions counts) and
//! both encoders are required, the others optional; an empty cell is a missing reading. What a brick reserved for the file and did not
//! write (zero bytes at the end) is no row. Numbers are written in the shortest form that reads back as the same number, to the last bit.

use super::table::{EncoderUnit, MeasuredPose, SensorRow, SensorTable};

pub fn parse(text: &str) -> Result<SensorTable, SensorTextError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text).trim_end_matches('\0');
    let mut lines = text.lines().enumerate().filter_map(|(index, line)| {
        let line = line.split('#').next().unwrap_or_default().trim();
        (!line.is_empty()).then_some((index + 1, line))
    });
    let (line, header) = lines.next().ok_or(SensorTextError::NoHeader)?;
    let layout = ColumnLayout::from_header(line, header)?;
    let mut rows: Vec<SensorRow> = Vec::new();
    for (line, text) in lines {
        if rows.len() == MAX_ROWS {
            return Err(SensorTextError::TooMany { line });
        }
        let row = layout.row(line, text)?;
        if let Some(before) = rows.last().filter(|before| before.time_s >= row.time_s) {
            return Err(SensorTextError::Time { line, time_s: row.time_s, before_s: before.time_s });
        }
        rows.push(row);
    }
    if rows.len() < 2 {
        return Err(SensorTextError::TooFew { rows: rows.len() });
    }
    Ok(SensorTable { unit: layout.unit, rows })
}

/// Omits columns without data.
pub fn write(table: &SensorTable, remark: &str) -> String {
    let has_values = |column: &&Column| table.rows.iter().any(|row| (column.value)(table.unit, row).is_some());
    let columns: Vec<&Column> = COLUMNS.iter().filter(has_values).collect();
    let mut text = String::new();
    for line in remark.lines() {
        text += "# ";
        text += line;
        text.push('\n');
    }
    text += &columns.iter().map(|column| column.name).collect::<Vec<_>>().join(",");
    text.push('\n');
    for row in &table.rows {
        let cells = columns.iter().map(|column| {
            let value = (column.value)(table.unit, row);
            value.map_or_else(String::new, |value| value.to_string())
        });
        text += &cells.collect::<Vec<_>>().join(",");
        text.push('\n');
    }
    text
}

struct ColumnLayout {
    /// Index in the file of each column of [`COLUMNS`].
    indices: [Option<usize>; COLUMNS.len()],
    width: usize,
    unit: EncoderUnit,
}

impl ColumnLayout {
    fn from_header(line: usize, header: &str) -> Result<Self, SensorTextError> {
        let mut indices = [None; COLUMNS.len()];
        let names = header.split(',').map(str::trim);
        let mut width = 0;
        for name in names {
            let Some(slot) = column_index(name).and_then(|index| indices.get_mut(index)) else {
                return Err(SensorTextError::UnknownColumn { line, name: name.to_owned() });
            };
            if slot.replace(width).is_some() {
                return Err(SensorTextError::RepeatedColumn { line, name: name.to_owned() });
            }
            width += 1;
        }
        let mut layout = Self { indices, width, unit: EncoderUnit::Counts };
        layout.unit = layout.validate(line)?;
        Ok(layout)
    }

    fn has(&self, name: &str) -> bool {
        self.index_of(name).is_some()
    }

    fn index_of(&self, name: &str) -> Option<usize> {
        column_index(name).and_then(|index| self.indices[index])
    }

    fn validate(&self, line: usize) -> Result<EncoderUnit, SensorTextError> {
        let missing = |name, advice| Err(SensorTextError::MissingColumn { line, name, advice });
        if self.has("time_s") == self.has("time_ms") {
            return missing(
                "time_s",
                "the filters need the time of each row, in seconds, or as `time_ms` in milliseconds; give one",
            );
        }
        for (one, other) in
            [("accel_left_m_per_s2", "accel_right_m_per_s2"), ("camera_x_m", "camera_y_m"), ("truth_x_m", "truth_y_m")]
        {
            for (present, absent) in [(one, other), (other, one)] {
                if self.has(present) && !self.has(absent) {
                    return missing(absent, "its partner stands there alone; give both or none");
                }
            }
        }
        let unit =
            if self.has("left_deg") || self.has("right_deg") { EncoderUnit::Degrees } else { EncoderUnit::Counts };
        let required = match unit {
            EncoderUnit::Degrees => ["left_deg", "right_deg"],
            EncoderUnit::Counts => ["left_counts", "right_counts"],
        };
        for name in required {
            if !self.has(name) {
                return missing(name, "both wheels are needed, both in counts or both in degrees");
            }
        }
        Ok(unit)
    }

    fn row(&self, line: usize, text: &str) -> Result<SensorRow, SensorTextError> {
        let cells: Vec<&str> = text.split(',').map(str::trim).collect();
        if cells.len() != self.width {
            return Err(SensorTextError::Cells { line, found: cells.len(), expected: self.width });
        }
        let at = RowCells { layout: self, line, values: cells };
        let reason = "wheels and time are what every filter lives on";
        let [left, right] = match self.unit {
            EncoderUnit::Counts => ["left_counts", "right_counts"],
            EncoderUnit::Degrees => ["left_deg", "right_deg"],
        };
        let pair = |one, other| -> Result<Option<[f64; 2]>, SensorTextError> {
            let reason = "its partner has one";
            match (at.number(one)?, at.number(other)?) {
                (None, None) => Ok(None),
                (one_value, other_value) => {
                    Ok(Some([at.require(one, one_value, reason)?, at.require(other, other_value, reason)?]))
                }
            }
        };
        let measured_pose = |x, y, theta| -> Result<Option<MeasuredPose>, SensorTextError> {
            let theta_deg = at.number(theta)?;
            Ok(pair(x, y)?.map(|[x_m, y_m]| MeasuredPose { x_m, y_m, theta_deg }))
        };
        Ok(SensorRow {
            time_s: if self.has("time_ms") {
                at.require("time_ms", at.number("time_ms")?, reason)? / 1e3
            } else {
                at.require("time_s", at.number("time_s")?, reason)?
            },
            encoders: [at.require(left, at.number(left)?, reason)?, at.require(right, at.number(right)?, reason)?],
            gyro_deg_per_s: at.number("gyro_deg_per_s")?,
            accelerations_m_per_s2: pair("accel_left_m_per_s2", "accel_right_m_per_s2")?,
            camera: measured_pose("camera_x_m", "camera_y_m", "camera_theta_deg")?,
            compass_deg: at.number("compass_deg")?,
            truth: measured_pose("truth_x_m", "truth_y_m", "truth_theta_deg")?,
        })
    }
}

struct RowCells<'a> {
    layout: &'a ColumnLayout,
    line: usize,
    values: Vec<&'a str>,
}

impl RowCells<'_> {
    /// `None` if the column is missing or the cell is empty.
    fn number(&self, name: &'static str) -> Result<Option<f64>, SensorTextError> {
        let cell = self.layout.index_of(name).and_then(|index| self.values.get(index));
        let Some(text) = cell.filter(|text| !text.is_empty()) else {
            return Ok(None);
        };
        match text.parse::<f64>() {
            Ok(number) if number.abs() <= MAX_VALUE => Ok(Some(number)),
            _ => Err(SensorTextError::Number { line: self.line, column: name, text: (*text).to_owned() }),
        }
    }

    fn require(&self, column: &'static str, value: Option<f64>, reason: &'static str) -> Result<f64, SensorTextError> {
        value.ok_or(SensorTextError::Empty { line: self.line, column, reason })
    }
}

struct Column {
    name: &'static str,
    value: fn(EncoderUnit, &SensorRow) -> Option<f64>,
}

const fn column(name: &'static str, value: fn(EncoderUnit, &SensorRow) -> Option<f64>) -> Column {
    Column { name, value }
}

const COLUMNS: [Column; 16] = [
    column("time_s", |_, row| Some(row.time_s)),
    column("time_ms", |_, _| None),
    column("left_counts", |unit, row| (unit == EncoderUnit::Counts).then_some(row.encoders[0])),
    column("right_counts", |unit, row| (unit == EncoderUnit::Counts).then_some(row.encoders[1])),
    column("left_deg", |unit, row| (unit == EncoderUnit::Degrees).then_some(row.encoders[0])),
    column("right_deg", |unit, row| (unit == EncoderUnit::Degrees).then_some(row.encoders[1])),
    column("gyro_deg_per_s", |_, row| row.gyro_deg_per_s),
    column("accel_left_m_per_s2", |_, row| Some(row.accelerations_m_per_s2?[0])),
    column("accel_right_m_per_s2", |_, row| Some(row.accelerations_m_per_s2?[1])),
    column("camera_x_m", |_, row| Some(row.camera?.x_m)),
    column("camera_y_m", |_, row| Some(row.camera?.y_m)),
    column("camera_theta_deg", |_, row| row.camera?.theta_deg),
    column("compass_deg", |_, row| row.compass_deg),
    column("truth_x_m", |_, row| Some(row.truth?.x_m)),
    column("truth_y_m", |_, row| Some(row.truth?.y_m)),
    column("truth_theta_deg", |_, row| row.truth?.theta_deg),
];

fn column_index(name: &str) -> Option<usize> {
    COLUMNS.iter().position(|column| column.name == name)
}

/// Longer than any lap: fourteen hours at 20 Hz.
pub const MAX_ROWS: usize = 1_000_000;
/// Larger than any reading of a robot's sensor in any of the units.
pub(super) const MAX_VALUE: f64 = 1e9;

/// Why a text is not a table; lines and columns count from 1.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorTextError {
    #[error("there is no line with the names of the columns; begin with time_s,left_counts,right_counts")]
    NoHeader,
    #[error("line {line}: no column is called `{name}`; there are {}", COLUMNS.map(|column| column.name).join(", "))]
    UnknownColumn { line: usize, name: String },
    #[error("line {line}: the column `{name}` stands there twice")]
    RepeatedColumn { line: usize, name: String },
    #[error("line {line}: there is no column `{name}`; {advice}")]
    MissingColumn { line: usize, name: &'static str, advice: &'static str },
    #[error("line {line} has {found} cells, the header has {expected}; leave a cell empty where a sensor said nothing")]
    Cells { line: usize, found: usize, expected: usize },
    #[error("line {line}, column `{column}`: `{text}` is not a finite number of sensible size")]
    Number { line: usize, column: &'static str, text: String },
    #[error("line {line}, column `{column}`: a number is needed in every row, because {reason}")]
    Empty { line: usize, column: &'static str, reason: &'static str },
    #[error(
        "line {line}, column `time_s`: {time_s} s does not come after {before_s} s; sort the rows and drop repeated ones"
    )]
    Time { line: usize, time_s: f64, before_s: f64 },
    #[error("there are {rows} rows; a drive has at least 2")]
    TooFew { rows: usize },
    #[error("line {line}: more than {MAX_ROWS} rows; cut the file")]
    TooMany { line: usize },
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "\u{feff}# NXT of Tuesday\n\ntime_s, right_counts, left_counts ,gyro_deg_per_s\n0,2,1,\n0.05,3,2,-1.5 # turned\n";

    #[test]
    fn columns_stand_in_any_order_and_empty_cells_are_silence() {
        let table = parse(GOOD).unwrap();
        assert_eq!(table.rows[0].encoders, [1.0, 2.0]);
        assert_eq!(table.rows[0].gyro_deg_per_s, None);
        assert_eq!(table.rows[1].gyro_deg_per_s, Some(-1.5));
        assert_eq!(table.rows[1].camera, None);
    }

    #[test]
    fn the_file_of_the_bricks_own_writer_is_read() {
        let text = include_str!("../../../../brick/vectors/square_log.csv");
        let table = parse(&format!("{text}\0\0")).unwrap();
        let row = table.rows[1];
        assert_eq!((row.time_s, row.encoders, row.gyro_deg_per_s), (0.05, [3.0, -4.0], Some(2.0)));
        assert_eq!((row.accelerations_m_per_s2, row.compass_deg), (Some([0.1, -0.25]), Some(359.0)));
        assert_eq!((table.rows.len(), table.rows[2].gyro_deg_per_s), (3, Some(-1.0)));
        let both = "time_s,time_ms,left_counts,right_counts\n";
        assert!(parse(both).unwrap_err().to_string().contains("give one"));
    }

    #[test]
    fn what_is_written_reads_back_to_the_last_bit() {
        let row = |time_s: f64, x: f64| SensorRow {
            time_s,
            encoders: [x, -x],
            gyro_deg_per_s: Some(x / 3.0),
            accelerations_m_per_s2: Some([x * 1e-17, -0.1]),
            camera: Some(MeasuredPose { x_m: x.sqrt(), y_m: 1e300_f64.ln(), theta_deg: None }),
            compass_deg: None,
            truth: Some(MeasuredPose { x_m: 0.1 + 0.2, y_m: -x / 7.0, theta_deg: Some(x) }),
        };
        for unit in [EncoderUnit::Counts, EncoderUnit::Degrees] {
            let mut rows = vec![row(-0.1, 0.3), row(1.0 / 3.0, 1e9)];
            rows[1].camera = None;
            let table = SensorTable { unit, rows };
            let text = write(&table, "two\nlines");
            assert!(text.starts_with("# two\n# lines\ntime_s,"), "{text}");
            assert_eq!(parse(&text).unwrap(), table);
        }
    }

    #[test]
    fn every_fault_of_the_header_is_named_with_its_line() {
        let cases = [
            ("", "no line with the names"),
            ("time_s,left_counts,right\n", "line 1: no column is called `right`"),
            ("time_s,time_s\n", "line 1: the column `time_s` stands there twice"),
            ("left_deg,right_deg\n", "line 1: there is no column `time_s`"),
            ("time_s,left_counts\n", "line 1: there is no column `right_counts`"),
            ("time_s,left_deg,right_counts\n", "line 1: there is no column `right_deg`"),
            ("time_s,left_deg,right_deg,camera_y_m\n", "line 1: there is no column `camera_x_m`"),
            ("time_s,left_deg,right_deg\n0,1\n", "line 2 has 2 cells, the header has 3"),
        ];
        for (text, expected) in cases {
            let message = parse(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }

    #[test]
    fn every_fault_of_a_row_is_named_with_line_and_column() {
        let header = "time_s,left_counts,right_counts,camera_x_m,camera_y_m\n";
        let rows = [
            ("0,1,1,,\n0,2,2,,\n", "line 3, column `time_s`: 0 s does not come after 0 s"),
            ("0,1,1,,\nnan,2,2,,\n", "line 3, column `time_s`: `nan` is not"),
            ("0,1,inf,,\n", "line 2, column `right_counts`: `inf` is not"),
            ("0,1,1e10,,\n", "line 2, column `right_counts`: `1e10` is not"),
            ("0,,1,,\n", "line 2, column `left_counts`: a number is needed"),
            ("0,1,1,0.5,\n", "line 2, column `camera_y_m`: a number is needed"),
            ("0,1,1,,\n", "there are 1 rows"),
        ];
        for (text, expected) in rows {
            let message = parse(&(header.to_owned() + text)).unwrap_err().to_string();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }
}
