//! How fast a recording goes through the engine again, and what its report costs.
//! An hour of the simulated brick, 50 Hz of telemetry and a camera of 10 Hz, is driven and recorded in virtual time, as `posebridge run`
//! would have recorded it but without the estimates beside the inputs; then the real program replays it three times, and makes its page.
//! Ten minutes of the same give the size of a page. Run with `cargo bench --bench replay`.

#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints its figures and stops when its set-up is broken"
)]

#[path = "../tests/support/virtual_drive.rs"]
mod virtual_drive;

use std::path::Path;
use std::process::Command;

use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use virtual_drive::record_drive;

/// A lap takes 14.3 s.
const LAP_S: f64 = std::f64::consts::TAU * 0.5 / 0.22;
const ROUNDS: usize = 3;

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (name, minutes) in [("ten-minutes", 10.0), ("hour", 60.0)] {
        let path = folder.join(format!("{name}.mcap"));
        record_drive(&path, scenario(minutes), TimeDelta::ZERO);
        measure(folder, name);
    }
}

fn scenario(minutes: f64) -> Scenario {
    let laps = (minutes * 60.0 / LAP_S).ceil();
    let text = format!(
        "seed = 3\nsteering = \"estimate\"\n[path.circle]\nradius_m = 0.5\n[drive]\nlaps = {laps}\nspeed_m_per_s = 0.22\n\
         [brick]\ntelemetry_hz = 50.0\n[camera]\nrate_hz = 10.0\n"
    );
    Scenario::from_toml(&text).unwrap()
}

fn measure(folder: &Path, name: &str) {
    let recording = format!("{name}.mcap");
    let bytes = std::fs::metadata(folder.join(&recording)).unwrap().len();
    for _ in 0..ROUNDS {
        let json = printed(folder, &["replay", &recording, "--json"]);
        let number = |key: &str| json[key].as_f64().unwrap();
        let (recorded_s, cpu_s) = (number("recorded_seconds"), number("cpu_seconds"));
        println!(
            "{name}: {recorded_s:.0} s in {bytes} bytes, {} observations, replayed in {:.3} s ({:.0} times real time), {cpu_s:.3} CPU s \
             ({:.0} times)",
            json["observations"],
            number("wall_seconds"),
            number("times_real_time"),
            recorded_s / cpu_s,
        );
    }
    printed(folder, &["report", &recording, "--json", "--out", name]);
    let page = folder.join(name).join("report.html");
    let page = std::fs::metadata(page).unwrap().len();
    println!("{name}: its page has {page} bytes");
}

fn printed(folder: &Path, args: &[&str]) -> Value {
    let program = env!("CARGO_BIN_EXE_posebridge");
    let output = Command::new(program).current_dir(folder).args(args).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    serde_json::from_slice(&output.stdout).unwrap()
}
