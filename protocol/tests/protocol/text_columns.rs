//! Numbers in columns, as sketches of others print them, and what each column is taken for.

use posebridge_protocol::bricks::text_line::{Column, LineLayout, Separator, TextLineSettings};
use posebridge_protocol::bricks::{CodecEvent, CodecSettings};
use posebridge_protocol::message::{Message, WireStamp};
use posebridge_protocol::text_columns::{ColumnTable, WheelEvidence, guess_columns};
use posebridge_telemetry::TimeDelta;
use proptest::prelude::*;

use crate::support::at;

/// What the columns are taken for, and by what the wheels are known.
fn guessed(text: &str, span_ms: Option<i64>) -> (Vec<String>, WheelEvidence) {
    let table = ColumnTable::read(text.as_bytes()).expect("there are columns");
    let mapping = guess_columns(&table, span_ms.map(TimeDelta::from_millis));
    (mapping.guesses.iter().map(|guess| guess.column.to_string()).collect(), mapping.wheels)
}

/// Twenty lines, 50 ms apart, with what `print` makes of their number.
fn lines(print: impl Fn(i64) -> String) -> String {
    (0..20).map(|number| print(number) + "\r\n").collect()
}

#[test]
fn names_say_what_columns_are() {
    // As Arduino's serial plotter, Fast Robots' boards and plain sketches print them.
    let expected = ["time_ms", "left_ticks", "right_ticks", "gyro_deg_per_s"].map(str::to_owned);
    for text in [
        lines(|n| format!("{},{},{},0.5", 50 * n, n, 2 * n)).replacen("0,0", "time_ms,left,right,gyro_dps\r\n0,0", 1),
        lines(|n| format!("t:{}|l:{}|r:{}|gz_dps:0.1", 50 * n, n, n)),
        lines(|n| format!("ms={} encL={} encR={} gyroZ={}.1", 50 * n, n, n, n)),
        lines(|n| format!("Time: {} ms; Left: {}; Right: {}; Gyro deg/s: -1.5", 50 * n, n, n)),
        lines(|n| format!("{}\t{n}\t{n}\t0.5", 50 * n)).replacen("0\t0", "# t\tL\tR\tgyro (deg)\r\n0\t0", 1),
    ] {
        assert_eq!(guessed(&text, Some(950)), (expected.to_vec(), WheelEvidence::Names), "{text}");
    }
}

#[test]
fn without_names_the_columns_that_count_are_the_wheels_and_the_noise_is_the_gyro() {
    // A constant, the battery, stands before the counts; the wheels roll after the tenth line.
    let text = lines(|n| {
        let rolled = 7 * (n - 10).max(0);
        format!("{} 7900 {} {} {}", 50 * n + 12_345, -rolled, rolled + 3, [17, -4, 9][n as usize % 3])
    });
    let expected = ["time_ms", "ignore", "left_ticks", "right_ticks", "gyro_counts"].map(str::to_owned);
    assert_eq!(guessed(&text, None), (expected.to_vec(), WheelEvidence::Motion));
    let (_, at_rest) = guessed(&lines(|n| format!("{n} 7900 0 0")), None);
    assert_eq!(at_rest, WheelEvidence::Order, "the battery may be a wheel until one has moved");
    let (columns, only) = guessed(&lines(|n| format!("{n} 0 0 0.{n}")), None);
    assert_eq!((columns[1].as_str(), only), ("left_ticks", WheelEvidence::Only));
    let (_, none) = guessed(&lines(|n| format!("{n}.5 {n}.25")), None);
    assert_eq!(none, WheelEvidence::None);
}

#[test]
fn the_unit_of_time_is_that_of_the_hosts_clock_and_else_that_of_the_step() {
    for (step, span_ms, expected) in [
        (50, Some(950), "time_ms"),
        (50_000, Some(950), "time_us"),
        (50_000, None, "time_us"),
        // A line a second.
        (1_000, Some(19_000), "time_ms"),
        (1, Some(19_000), "time_s"),
        (20, None, "time_ms"),
    ] {
        let (columns, _) = guessed(&lines(|n| format!("{},0,0", step * n)), span_ms);
        assert_eq!(columns[0], expected, "{step} {span_ms:?}");
    }
    let (columns, _) = guessed(&lines(|n| format!("{:.2},0,0", 0.05 * n as f64)), None);
    assert_eq!(columns[0], "time_s");
}

#[test]
fn what_would_be_read_wrongly_is_ignored() {
    let (columns, wheels) =
        guessed(&lines(|n| format!("left_speed={n}.5 right_speed={n}.5 left={n} dist={n}.5")), None);
    assert_eq!(columns, ["ignore"; 4]);
    assert_eq!(wheels, WheelEvidence::None, "one wheel has no column");
    let (columns, _) = guessed(&lines(|n| format!("l={n} r={n} gx=1 temp=20.5 dist_cm=12 l={n}")), None);
    assert_eq!(columns, ["left_ticks", "right_ticks", "ignore", "temperature_c", "distance_cm", "ignore"]);
}

#[test]
fn text_for_people_and_few_lines_are_no_table() {
    for text in ["1,2\n3,4\n", "hello\nworld\nagain\n", "1\n2\n3\n4\n", "a 1 2\nb 1\nc 1 2 3\nd 1 2 3 4\n", ""] {
        assert_eq!(ColumnTable::read(text.as_bytes()), None, "{text}");
    }
    // The rear part of a line, what is not finished, and a remark are no rows.
    let table = ColumnTable::read(b"5,6\n7,8\n9,10\n# now\n11,12\n13,1").unwrap();
    assert_eq!((table.rows, table.columns[0].values.clone()), (3, vec![7.0, 9.0, 11.0]));
}

/// Wheels and turn rates that the codec `columns` reads.
fn decoded(layout: &[&str], text: &str, chunk: usize) -> Vec<String> {
    let columns = layout.iter().map(|name| Column::from_name(name).expect("the name is known"));
    let line = TextLineSettings {
        layout: LineLayout::Columns { columns: columns.collect(), separator: Separator::Comma },
        gyro_counts_per_deg_per_s: 10.0,
        ..TextLineSettings::default()
    };
    let mut codec = crate::support::codec("columns", &CodecSettings { line, ..CodecSettings::default() });
    codec.on_link_up(at(0));
    let mut found = Vec::new();
    for bytes in text.as_bytes().chunks(chunk) {
        codec.push(at(1), bytes, &mut |event| match event {
            CodecEvent::Message { message: Message::WheelTicks(ticks), .. } => {
                let stamp = match ticks.stamp {
                    WireStamp::Micros32(micros) => format!("{micros} us"),
                    other => format!("{other:?}"),
                };
                found.push(format!("{stamp} {} {}", ticks.left.0, ticks.right.0));
            }
            CodecEvent::Message { message: Message::Inertial(inertial), .. } => {
                let rate = inertial.turn_rate.expect("a rate is said");
                found.push(format!("{:.1} deg/s", rate.0.to_degrees()));
            }
            CodecEvent::StatusText { text, .. } => found.push(text),
            _ => {}
        });
    }
    found
}

#[test]
fn the_codec_reads_numbers_between_any_words_and_skips_remarks() {
    let text = "cut\r\n# ready\r\nt=0.25s enc1: 100, enc2: -200 gyro 15*00\r\n\r\nhello\r\nt=0.3 enc1: 101 enc2: -201 gyro -20\r\n1 2\r\n";
    let layout = ["time_s", "left_ticks", "-right_ticks", "gyro_counts"];
    let expected = [
        "250000 us 100 200",
        "1.5 deg/s",
        "300000 us 101 201",
        "-2.0 deg/s",
        "the line `1 2` is not understood: it has 2 values and not 4; expected \
         `time_s .. left_ticks .. -right_ticks .. gyro_counts`",
    ];
    let text = text.replace("*00", "");
    for chunk in 1..text.len() {
        assert_eq!(decoded(&layout, &text, chunk), expected, "{chunk}");
    }
}

proptest! {
    #[test]
    fn any_text_has_a_mapping_of_its_width(text in "([0-9a-zA-Z,.;:=| \\t+\\-e*$#]{0,40}\n){0,12}") {
        if let Some(table) = ColumnTable::read(text.as_bytes()) {
            let mapping = guess_columns(&table, Some(TimeDelta::from_millis(1_000)));
            prop_assert_eq!(mapping.guesses.len(), table.columns.len());
            prop_assert!(table.columns.iter().all(|column| column.values.len() == table.rows));
        }
    }

    #[test]
    fn any_bytes_may_be_looked_at(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        drop(ColumnTable::read(&bytes));
    }
}
