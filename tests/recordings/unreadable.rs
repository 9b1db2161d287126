//! Files in which nothing can be read: no command takes one for a success.

use std::path::Path;

use posebridge::config::Config;
use posebridge::station::recording_files::header;
use posebridge_recording::container::RecordingWriter;
use posebridge_telemetry::{Input, Timestamp};

use crate::support::exit_code_and_stderr;

const DESCRIPTOR: &str = "name = \"d\"\nsource = \"s\"\nlicence = \"none\"\ndefault_run = \"only\"\n\
    [robot]\nleft_wheel_radius_m = 0.03\nright_wheel_radius_m = 0.03\ntrack_width_m = 0.1\nticks_per_turn = 360.0\n\
    [[runs]]\nname = \"only\"\n[files.data]\npath = \"data.csv\"\nheader_lines = 1\ntime = { column = \"t\" }\n\
    [[gyro]]\nfile = \"data\"\nturn_rate = \"rate\"\n";

/// A recording with so many inputs.
fn recording(inputs: i64) -> Vec<u8> {
    let header = header(&Config::default(), 1_700_000_000_000_000).unwrap();
    let mut writer = RecordingWriter::create(std::io::Cursor::new(Vec::new()), &header).unwrap();
    for second in 0..inputs {
        writer.record(Timestamp::from_millis(1_000 * second), &Input::Tick).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Each file with what a command must say of it.
fn write_files(folder: &Path) -> Vec<(&'static str, &'static str)> {
    let empty = recording(0);
    // The inputs are what it has more than one without them, and the header is before them.
    let whole = recording(200);
    let header_end = whole.iter().zip(&empty).take_while(|(one, other)| one == other).count();
    let mut damaged = whole.clone();
    damaged[header_end..].fill(0x55);
    let files: [(&str, &[u8], &str); 10] = [
        ("empty.mcap", &empty, "empty.mcap"),
        ("cut.mcap", &whole[..header_end], "cut.mcap"),
        ("damaged.mcap", &damaged, "damaged.mcap"),
        ("nothing.mcap", b"", "nothing.mcap"),
        ("nothing.tlog", b"", "nothing.tlog"),
        ("damaged.tlog", &[0x55; 4_096], "damaged.tlog"),
        ("nothing.raw", b"", "nothing.raw"),
        ("damaged.raw", &[0x55; 4_096], "damaged.raw"),
        ("d.toml", DESCRIPTOR.as_bytes(), "data.csv"),
        ("data.csv", b"t,rate\nx,1\ny,2\n", ""),
    ];
    for (name, bytes, _) in files {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
    files.into_iter().filter(|(.., says)| !says.is_empty()).map(|(name, _, says)| (name, says)).collect()
}

#[test]
fn no_command_takes_a_file_in_which_nothing_can_be_read_for_a_success() {
    let folder = tempfile::tempdir().unwrap();
    for (name, says) in write_files(folder.path()) {
        for command in [
            "inspect",
            "replay",
            "report --out page",
            "export --format csv --out tables",
            "export --format tum --out tables",
            "export --format tlog --out tables",
            "export --format mcap --out tables",
            "import --out imported.mcap",
        ] {
            let arguments: Vec<&str> =
                [command.split(' ').next().unwrap(), name].into_iter().chain(command.split(' ').skip(1)).collect();
            let (code, said) = exit_code_and_stderr(folder.path(), &arguments);
            assert!(matches!(code, Some(1 | 2)), "{command} {name}: {code:?} {said}");
            assert!(said.contains(says) || said.contains(name), "{command} {name}: {said}");
            assert!(!folder.path().join("imported.mcap").exists(), "{command} {name}");
        }
    }
}
