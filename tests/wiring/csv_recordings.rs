//! Recordings as CSV: a fault is named by `replay --fix-wiring`, with the lines that undo it, and these lines undo it. What is wrong
//! with a file is named with file, line and column.

#[path = "../support/mod.rs"]
mod support;

use std::fmt::Write as _;
use std::path::Path;

use posebridge_estimator::wiring::WiringFault;
use posebridge_sim::montecarlo::CameraSees;
use posebridge_telemetry::ObservationKind;

use self::support::{exit_code_and_stderr, run};
use crate::drives::{broken, broken_geometry, filter_config, short_square};

/// Writes a drive with a fault as a descriptor and three tables.
fn write_recording(folder: &Path, fault: WiringFault) {
    let drive = short_square(Some(CameraSees::Pose)).drive(2);
    let (mut wheels, mut gyro, mut fixes) =
        ("t_s,left,right\n".to_owned(), "t_s,rate\n".to_owned(), "t_s,at_s,x,y,heading\n".to_owned());
    for arrival in &drive.arrivals {
        let time_s = arrival.observation.stamp.as_secs_f64();
        match broken(fault, arrival.observation.measurement) {
            ObservationKind::WheelAngles { left, right } => {
                writeln!(wheels, "{time_s},{},{}", left.0, right.0).unwrap();
            }
            ObservationKind::TurnRate(rate) => writeln!(gyro, "{time_s},{}", rate.0).unwrap(),
            ObservationKind::Fix(fix) => {
                let (at_s, heading_rad) = (drive.time_at(arrival.step).as_secs_f64(), fix.heading.unwrap().rad());
                writeln!(fixes, "{time_s},{at_s},{},{},{heading_rad}", fix.position.x.0, fix.position.y.0).unwrap();
            }
            _ => {}
        }
    }
    let geometry = broken_geometry(fault, filter_config(&drive).geometry);
    let descriptor = format!(
        "name = \"broken\"\nsource = \"simulated\"\nlicence = \"none\"\ndefault_run = \"only\"\n\n\
         [robot]\nleft_wheel_radius_m = {}\nright_wheel_radius_m = {}\ntrack_width_m = {}\nticks_per_turn = {}\n\n\
         [[runs]]\nname = \"only\"\n\n\
         [files.wheels]\npath = \"wheels.csv\"\nheader_lines = 1\ntime = {{ column = \"t_s\" }}\n\
         [files.gyro]\npath = \"gyro.csv\"\nheader_lines = 1\ntime = {{ column = \"t_s\" }}\n\
         [files.fixes]\npath = \"fixes.csv\"\nheader_lines = 1\ntime = {{ column = \"t_s\" }}\narrival = {{ column = \"at_s\" }}\n\n\
         [[wheels]]\nfile = \"wheels\"\ncounting = \"absolute\"\nleft = {{ column = \"left\", unit = \"rad\" }}\n\
         right = {{ column = \"right\", unit = \"rad\" }}\n\
         [[gyro]]\nfile = \"gyro\"\nturn_rate = \"rate\"\n\
         [[fixes]]\nfile = \"fixes\"\nx = \"x\"\ny = \"y\"\nheading = \"heading\"\n",
        geometry.left_wheel_radius.0, geometry.right_wheel_radius.0, geometry.track_width.0, 360.0
    );
    for (name, text) in [("d.toml", descriptor), ("wheels.csv", wheels), ("gyro.csv", gyro), ("fixes.csv", fixes)] {
        std::fs::write(folder.join(name), text).unwrap();
    }
}

#[test]
fn a_recording_with_a_fault_is_named_and_its_lines_undo_it() {
    let faults = [
        (WiringFault::GyroInDegrees, Some("gyro_unit = \"deg/s\"")),
        (WiringFault::GyroReversed, Some("reverse_gyro = true")),
        (WiringFault::WheelsSwapped, Some("swap_wheels = true")),
        (WiringFault::LeftWheelReversed, Some("reverse_left = true")),
        (WiringFault::RightWheelReversed, Some("reverse_right = true")),
        (WiringFault::BothWheelsReversed, Some("reverse_left = true\nreverse_right = true")),
        (WiringFault::CameraInMillimeters, Some("camera_unit = \"mm\"")),
        (WiringFault::CameraYDown, Some("camera_y_down = true")),
        (WiringFault::TrackTooWide, None),
        (WiringFault::TrackTooNarrow, None),
    ];
    for (fault, lines) in faults {
        let folder = tempfile::tempdir().unwrap();
        write_recording(folder.path(), fault);
        let found = run(folder.path(), &["replay", "d.toml", "--fix-wiring"]);
        // The line of the answer, wherever it is wrapped.
        let words = found.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains(&format!("{} (--fix-wiring prints", fault.conclusion())), "{fault:?}: {found}");
        let Some(lines) = lines else {
            assert!(found.contains("[robot]\ntrack_width_m = 0.112\n"), "{found}");
            continue;
        };
        assert!(found.contains(&format!("[robot.wiring]\n{lines}\n")), "{fault:?}: {found}");
        let mut arguments = vec!["replay", "d.toml", "--fix-wiring"];
        let settings: Vec<String> = lines.lines().map(|line| format!("wiring.{}", line.replace(' ', ""))).collect();
        arguments.extend(settings.iter().flat_map(|setting| ["--set", setting.as_str()]));
        let undone = run(folder.path(), &arguments);
        assert!(undone.contains("nothing wrong was found"), "{fault:?}: {undone}");
    }
}

fn use_wheels_alone(folder: &Path) {
    let descriptor = std::fs::read_to_string(folder.join("d.toml")).unwrap();
    let wheels = descriptor.split("[[gyro]]").next().unwrap();
    std::fs::write(folder.join("wheels.toml"), wheels).unwrap();
}

#[test]
fn a_table_of_a_spreadsheet_with_another_locale_is_read_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    write_recording(folder.path(), WiringFault::GyroReversed);
    use_wheels_alone(folder.path());
    let usual = run(folder.path(), &["replay", "wheels.toml"]);
    let table = std::fs::read_to_string(folder.path().join("wheels.csv")).unwrap();
    for (delimiter, words) in
        [(";", "columns between semicolons, decimal commas"), ("\t", "columns between tabs, decimal commas")]
    {
        let exported = table.replace(',', delimiter).replace('.', ",");
        std::fs::write(folder.path().join("wheels.csv"), exported).unwrap();
        assert_eq!(run(folder.path(), &["replay", "wheels.toml"]), usual, "{words}");
        let (_, said) = exit_code_and_stderr(folder.path(), &["replay", "wheels.toml"]);
        assert!(said.contains(&format!("wheels.csv: {words}")), "{said}");
    }
}

#[test]
fn what_is_wrong_with_a_table_is_named_with_file_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    write_recording(folder.path(), WiringFault::GyroReversed);
    use_wheels_alone(folder.path());
    let refused = |text: &str| {
        std::fs::write(folder.path().join("wheels.csv"), text).unwrap();
        let (code, said) = exit_code_and_stderr(folder.path(), &["replay", "wheels.toml"]);
        assert_ne!(code, Some(0), "{said}");
        said
    };
    for (text, words) in [
        ("", "wheels.csv is empty: line 1 should be the header"),
        ("t_s,left,right\n", "no row follows the headers of its files"),
        ("t_s,links,right\n0,1,1\n", "wheels.csv:1: there is no column `left`, the header has: t_s, links, right"),
        ("t_s;left;right\n0;1,500;1\n", "wheels.csv:2: a number like 1,234 may be 1.234 or 1234"),
        (
            "t_s;left;right\n0;1.5;1\n1;1,5;1\n",
            "wheels.csv:3: numbers with decimal points and numbers with decimal commas",
        ),
        ("t_s,left,right\n0,00,1,5,1,5\n", "wheels.csv:2: 6 fields for 3 columns: commas are the delimiter and"),
        (
            "t_s,left,right\n0,\"1,5\",1\n",
            "wheels.csv:2: not a number: column `left`: `1,5`: a decimal comma; write 1.5",
        ),
        ("t_s,left,right\n0,1\n", "wheels.csv:2: missing column: column `right` is wanted, the row has 2"),
    ] {
        let said = refused(text);
        assert!(said.contains(words), "{text:?}: {said}");
    }
}
