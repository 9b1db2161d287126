//! Foreign tables: any bytes end in rows, bad rows or a refusal, and no number is read as another one than was written.

use posebridge_telemetry::{ObservationKind, Radians};

use crate::dataset::load_file;

const DESCRIPTOR: &str = r#"
name = "table"
source = "made"
licence = "none"
default_run = "only"

[[runs]]
name = "only"

[files.data]
path = "data.csv"
header_lines = 1
time = { column = "t" }

[[wheels]]
file = "data"
counting = "absolute"
left = { column = "left", unit = "rad" }
right = { column = "right", unit = "rad" }
"#;

/// Input: one byte that says whether the rest is a file, or numbers that are written with some delimiter and decimal mark.
pub(crate) fn check(data: &[u8]) {
    let [kind, rest @ ..] = data else {
        return;
    };
    if kind & 1 == 0 {
        // What it reads is up to the file; that it ends, and names a line of the file, is not.
        let lines = rest.split(|byte| *byte == b'\n').count();
        if let Ok(run) = load_file(DESCRIPTOR, "only", rest) {
            assert!(run.bad_rows.listed.iter().all(|row| (1..=lines).contains(&row.line)));
        }
    } else {
        check_made(*kind, rest);
    }
}

/// Each row has a number twice; each of three bytes has its digits and its decimals.
fn check_made(kind: u8, bytes: &[u8]) {
    let delimiter = [",", ";", "\t"][usize::from(kind >> 1) % 3];
    let mark = if kind & 0x80 == 0 { '.' } else { ',' };
    let numbers: Vec<String> = bytes
        .chunks_exact(3)
        .map(|bytes| {
            let digits = i32::from(i16::from_le_bytes([bytes[0], bytes[1]]));
            let decimals = usize::from(bytes[2] % 5);
            let sign = if digits < 0 { "-" } else { "" };
            let padded = format!("{:0width$}", digits.unsigned_abs(), width = decimals + 1);
            let (whole, fraction) = padded.split_at(padded.len() - decimals);
            if fraction.is_empty() { format!("{sign}{whole}") } else { format!("{sign}{whole}.{fraction}") }
        })
        .collect();
    let mut file = ["t", "left", "right"].join(delimiter) + "\n";
    for (index, number) in numbers.iter().enumerate() {
        let written = number.replace('.', &mark.to_string());
        file += &[index.to_string().as_str(), &written, &written].join(delimiter);
        file.push('\n');
    }
    let Ok(run) = load_file(DESCRIPTOR, "only", file.as_bytes()) else {
        return;
    };
    for timed in run.observations.iter() {
        let row = timed.observation.stamp.as_secs_f64().round() as usize;
        let expected: f64 = numbers.get(row).and_then(|number| number.parse().ok()).unwrap_or(f64::NAN);
        let ObservationKind::WheelAngles { left, right } = timed.observation.measurement else {
            panic!("{timed:?} is no row of wheels");
        };
        // Angles are summed from their differences.
        let is_it = |angle: Radians| (angle.0 - expected).abs() < 1e-6;
        assert!(is_it(left) && is_it(right), "{timed:?}, not {expected}, in {file}");
    }
}
