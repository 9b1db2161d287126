//! The doctor on made-up computers: each cause of silence is named with its cure. And the program's report and exit code.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use crate::support::{posebridge, read_text, root};
use posebridge::tools::doctor::{CHECKS, DiagnosticContext, Finding, Status, UserGroup, UserPermissions, run_checks};
use serde::Deserialize;

#[derive(Deserialize)]
struct Computers {
    board: Files,
    computer: Vec<Computer>,
}

/// Below the root folder.
#[derive(Deserialize)]
struct Files {
    files: BTreeMap<String, String>,
    /// Symbolic links with their targets.
    links: BTreeMap<String, String>,
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Computer {
    name: String,
    has_board: bool,
    files: BTreeMap<String, String>,
    links: BTreeMap<String, String>,
    config: Option<String>,
    listen: Vec<String>,
    /// Check, status, and parts of what is said and of the cure.
    says: Vec<[String; 4]>,
}

impl Computers {
    fn read() -> Self {
        toml::from_str(&read_text(&root(), "tests/data/doctor.toml")).unwrap()
    }

    /// Makes a computer in a folder.
    fn build(&self, computer: &Computer, folder: &Path) -> DiagnosticContext {
        let path = |name: &str| {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            path
        };
        let board = computer.has_board.then_some(&self.board);
        for (name, content) in board.iter().flat_map(|board| &board.files).chain(&computer.files) {
            fs::write(path(name), content).unwrap();
        }
        for (name, target) in board.iter().flat_map(|board| &board.links).chain(&computer.links) {
            symlink(folder.join(target), path(name)).unwrap();
        }
        let listen = computer.listen.iter();
        DiagnosticContext {
            root: folder.to_owned(),
            user: person(|_| true),
            config: computer.config.as_ref().map(|name| folder.join(name)),
            links: listen.map(|url| url.replace("{root}", folder.to_str().unwrap())).collect(),
            listen_for_s: 0.1,
            robot: None,
        }
    }
}

/// Somebody in no group, who may open what `may_open` says.
fn person(may_open: fn(&Path) -> bool) -> UserPermissions {
    UserPermissions {
        groups: vec![],
        can_open: may_open,
        group: |_| UserGroup { name: "dialout".to_owned(), lists_user: false },
    }
}

/// A temporary folder with its path as the system names it.
fn computer_folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = fs::canonicalize(folder.path()).unwrap();
    (folder, path)
}

#[test]
fn each_cause_is_named_with_its_cure_and_every_check_says_something() {
    let computers = Computers::read();
    for computer in &computers.computer {
        let name = &computer.name;
        let (_folder, path) = computer_folder();
        let findings = run_checks(&computers.build(computer, &path));
        for check in CHECKS {
            let found: Vec<_> = findings.iter().filter(|finding| finding.name == check.name).collect();
            assert!(!found.is_empty(), "{name}: {}", check.name);
            let expected: Vec<_> = computer.says.iter().filter(|row| row[0] == check.name).collect();
            assert!(expected.is_empty() || expected.len() == found.len(), "{name}: {found:?}");
            for ([_, status, what, advice], finding) in expected.into_iter().zip(found) {
                let result = &finding.result;
                assert_eq!(result.status.as_str(), status, "{name}: {finding:?}");
                let what = what.replace("{root}", path.to_str().unwrap());
                assert!(result.message.contains(&what) && result.advice.contains(advice), "{name}: {finding:?}");
            }
        }
        assert!(computer.says.iter().all(|row| CHECKS.iter().any(|check| check.name == row[0])), "{name}");
        for finding in &findings {
            let Finding { result, .. } = finding;
            assert_eq!(result.status > Status::Ok, !result.advice.is_empty(), "{name}: {finding:?}");
            assert!(!result.message.is_empty(), "{name}: {finding:?}");
        }
        let problems = findings.iter().filter(|finding| finding.result.status == Status::Problem).count();
        assert_eq!(problems, computer.says.iter().filter(|row| row[1] == "problem").count(), "{name}");
    }
}

#[test]
fn a_port_that_may_not_be_opened_is_a_problem_and_names_the_cure() {
    let (_folder, path) = computer_folder();
    let computer = Computer { has_board: true, ..Computer::default() };
    let mut context = Computers::read().build(&computer, &path);
    context.user = person(|_| false);
    let port = path.join("dev/ttyACM0");
    let set_mode = |mode| fs::set_permissions(&port, fs::Permissions::from_mode(mode)).unwrap();
    let cure = |context: &DiagnosticContext| {
        let mut findings = run_checks(context).into_iter().filter(|finding| finding.name == "permissions");
        let result = findings.next().unwrap().result;
        assert_eq!((result.status, findings.next()), (Status::Problem, None));
        assert!(result.message.contains("may not be opened"), "{}", result.message);
        result.advice
    };
    set_mode(0o660);
    assert!(cure(&context).contains("sudo usermod -aG dialout $USER"));
    context.user.group = |_| UserGroup { name: "dialout".to_owned(), lists_user: true };
    let listed = cure(&context);
    assert!(listed.contains("log out and in again") && !listed.contains("usermod"), "{listed}");
    // A group that may only read is no help: steering needs both ways.
    for (mode, text) in [(0o600, "mode 0600"), (0o640, "mode 0640")] {
        set_mode(mode);
        assert!(cure(&context).contains(text), "{text}");
    }
}

#[test]
fn the_object_has_its_keys_and_a_problem_is_exit_code_1_and_stands_in_the_report() {
    let folder = tempfile::tempdir().unwrap();
    let report = posebridge(folder.path()).args(["doctor", "--json", "serial:/nowhere/tty"]).output().unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
    let keys = |value: &serde_json::Value| -> Vec<String> { value.as_object().unwrap().keys().cloned().collect() };
    assert_eq!(keys(&report), ["checks", "problems", "version", "warnings"]);
    let checks = report["checks"].as_array().unwrap();
    for line in checks {
        assert_eq!(keys(line), ["advice", "name", "status", "what"]);
    }
    let [.., listening, set_up] = checks.as_slice() else { panic!("{checks:?}") };
    assert_eq!((&listening["name"], &listening["status"]), (&"listening".into(), &"warning".into()));
    assert_eq!((&set_up["name"], &set_up["status"]), (&"set-up".into(), &"skipped".into()));

    let page = read_text(&root(), "docs/getting-started.md");
    for row in CHECKS {
        assert!(page.contains(&format!("| `{}` |", row.name)), "{}", row.name);
    }
    let output = posebridge(folder.path()).args(["doctor", "ttyUSB0"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let report = String::from_utf8(output.stdout).unwrap();
    let line = report.lines().find(|line| line.starts_with("problem  listening ")).unwrap();
    assert!(line.contains("`ttyUSB0` has no scheme"), "{line}");
    assert!(report.contains("cure: docs/links.md"), "{report}");
    assert!(report.lines().all(|line| line.chars().count() <= 80), "{report}");
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.contains("the doctor found"), "{stderr}");
}
