//! What a user reads when something is wrong: eight texts in full, one of each kind, and one of this computer's devices.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

use crate::support::{exit_code_and_stderr, write_text};

/// What the program says when it refuses to start.
fn refusal(folder: &Path, args: &[&str]) -> String {
    let (code, stderr) = exit_code_and_stderr(folder, args);
    assert_eq!(code, Some(2), "{stderr}");
    stderr
}

#[test]
fn a_wrong_configuration_is_named_with_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let with_config = |text: &str| {
        write_text(folder.path(), "station.toml", text);
        refusal(folder.path(), &["run", "--config", "station.toml"])
    };
    insta::assert_snapshot!("wrong_key", with_config("[robot]\ntrack_with_m = 0.112\n"));
    insta::assert_snapshot!("impossible_value", with_config("[robot]\ntrack_width_m = -0.1\n"));
}

#[test]
fn wrong_arguments_and_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "noise.mcap", "this is no recording");
    write_text(folder, "scenario.toml", "seed = 1\n[drive]\nlaps = \"two\"\n");
    write_text(folder, "posebridge.toml", "");
    let snapshot = |name: &str, command: &str| {
        insta::assert_snapshot!(name, refusal(folder, &command.split(' ').collect::<Vec<_>>()));
    };
    snapshot("no_mcap", "replay noise.mcap");
    snapshot("wrong_scenario", "sim scenario.toml --listen tcp://127.0.0.1:0");
    snapshot("unknown_scheme", "run --link usb://brick");
    snapshot("unknown_accuracy_scenario", "lab accuracy --scenario camera-5hz");
    snapshot("init_there_already", "init sim");
}

#[test]
fn a_port_in_use_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let url = format!("tcp://127.0.0.1:{port}");
    let said = refusal(folder.path(), &["run", "--listen", &url, "--no-record"]);
    insta::assert_snapshot!("port_in_use", said.replace(&port, "PORT"));
}

#[test]
fn a_device_without_permission_is_named_with_the_cure() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o777)).unwrap();
    // A pseudo-terminal that belongs to somebody else: as root the program is run as nobody, else a device of root's is taken.
    let pty = nix::pty::openpty(None, None).expect("a pseudo-terminal");
    let path = nix::unistd::ttyname(&pty.slave).expect("its name");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    let program = folder.path().join("posebridge");
    // Copied by another process: a program that this one starts meanwhile would inherit the file, open for writing, and what is open
    // for writing cannot be run.
    let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_posebridge")).arg(&program).status();
    assert!(copied.unwrap().success());
    let mut command = Command::new(&program);
    command.current_dir(folder.path()).args(["run", "--no-record", "--link"]).arg(format!("serial:{}", path.display()));
    if nix::unistd::geteuid().is_root() {
        command.uid(NOBODY).gid(NOBODY);
    } else {
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o000)).unwrap();
    }
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains(path.to_str().unwrap()) && said.contains("permission denied"), "{said}");
    assert!(said.contains("group"), "it says what to do: {said}");
}

/// The user that owns nothing, on every Linux.
const NOBODY: u32 = 65_534;
