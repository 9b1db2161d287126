//! The doctor on made-up computers: each cause of silence is named with its cure. And the program's report and exit code.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use crate::support::{posebridge, read_text, root};
use posebridge::tools::doctor::{
    CHECKS, DiagnosticContext, Finding, Status, SystemRoots, UserGroup, UserPermissions, run_checks,
};

/// A computer in a folder.
struct Computer {
    folder: tempfile::TempDir,
}

impl Computer {
    /// One without any device or service.
    fn bare() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in ["sys", "dev", "proc", "run"] {
            fs::create_dir(folder.path().join(name)).unwrap();
        }
        Self { folder }
    }

    fn path(&self, path: &str) -> PathBuf {
        self.folder.path().join(path)
    }

    fn with(self, path: &str, content: &str) -> Self {
        let path = self.path(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
        self
    }

    fn with_link(self, path: &str, target: &Path) -> Self {
        let path = self.path(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        symlink(target, path).unwrap();
        self
    }

    fn with_process(self, pid: u32, name: &str) -> Self {
        let computer = self.with(&format!("proc/{pid}/comm"), &format!("{name}\n"));
        fs::create_dir_all(computer.path(&format!("proc/{pid}/fd"))).unwrap();
        computer
    }

    /// An Arduino on USB: node, driver, ids and the name that stays.
    fn with_board(self) -> Self {
        let usb = "sys/devices/pci0/usb1/1-2";
        let computer = self
            .with("dev/ttyACM0", "")
            .with(&format!("{usb}/idVendor"), "2341\n")
            .with(&format!("{usb}/idProduct"), "0043\n")
            .with(&format!("{usb}/product"), "Uno\n")
            .with(&format!("{usb}/dev"), "189:5\n")
            .with(&format!("{usb}/1-2:1.0/tty/ttyACM0/dev"), "166:0\n")
            .with("sys/bus/usb/drivers/cdc_acm/bind", "");
        let interface = computer.path(&format!("{usb}/1-2:1.0"));
        let driver = computer.path("sys/bus/usb/drivers/cdc_acm");
        let tty = interface.join("tty/ttyACM0");
        computer
            .with_link(&format!("{usb}/1-2:1.0/driver"), &driver)
            .with_link(&format!("{usb}/1-2:1.0/tty/ttyACM0/device"), &interface)
            .with_link("sys/class/tty/ttyACM0", &tty)
            .with_link("dev/serial/by-id/usb-Arduino_Uno-if00", Path::new("../../ttyACM0"))
    }

    fn examination(&self) -> DiagnosticContext {
        DiagnosticContext {
            roots: SystemRoots::under(self.folder.path()),
            user: person(|_| true),
            config: None,
            links: vec![],
            listen_for_s: 0.1,
        }
    }

    fn findings(&self) -> Vec<Finding> {
        run_checks(&self.examination())
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

/// The only verdict of a check.
fn only<'a>(findings: &'a [Finding], name: &str) -> (Status, &'a str, &'a str) {
    let of_check: Vec<_> = findings.iter().filter(|finding| finding.name == name).collect();
    let [finding] = of_check[..] else {
        panic!("{name}: {of_check:?}");
    };
    let verdict = &finding.result;
    (verdict.status, &verdict.message, &verdict.advice)
}

/// Checks status and parts of what is said and advised.
fn check(findings: &[Finding], name: &str, expected: (Status, &str, &str)) {
    let (status, what, advice) = only(findings, name);
    let (expected_status, in_what, in_advice) = expected;
    assert_eq!(status, expected_status, "{name}: {what}");
    assert!(what.contains(in_what), "{name}: {what}");
    assert!(advice.contains(in_advice), "{name}: {advice}");
}

#[test]
fn every_check_says_something_and_what_is_wrong_has_a_cure() {
    for computer in [Computer::bare(), Computer::bare().with_board()] {
        let findings = computer.findings();
        for row in CHECKS {
            assert!(findings.iter().any(|finding| finding.name == row.name));
        }
        for Finding { name, result: verdict } in findings {
            let needs_cure = verdict.status > Status::Ok;
            assert_eq!(needs_cure, !verdict.advice.is_empty(), "{name}: {verdict:?}");
            assert!(!verdict.message.is_empty(), "{name}");
        }
    }
}

#[test]
fn a_board_is_described_and_a_computer_without_devices_has_no_problem() {
    let findings = Computer::bare().findings();
    check(&findings, "serial-ports", (Status::Warning, "no serial port", "plug it in"));
    for name in ["permissions", "port-holders", "bluetooth", "listening"] {
        assert_eq!(only(&findings, name).0, Status::Skipped, "{name}");
    }
    assert!(findings.iter().all(|finding| finding.result.status < Status::Problem));
    let findings = Computer::bare().with_board().findings();
    let (status, what, _) = only(&findings, "serial-ports");
    assert_eq!(status, Status::Ok);
    for part in ["/dev/ttyACM0, driver cdc_acm, USB 2341:0043 Uno, also ", "/dev/serial/by-id/usb-Arduino_Uno-if00"] {
        assert!(what.contains(part), "{what}");
    }
}

#[test]
fn a_port_that_may_not_be_opened_is_a_problem_and_names_the_cure() {
    let computer = Computer::bare().with_board();
    let port = computer.path("dev/ttyACM0");
    let mut examination = computer.examination();
    examination.user = person(|_| false);

    fs::set_permissions(&port, fs::Permissions::from_mode(0o660)).unwrap();
    let cure = "sudo usermod -aG dialout $USER";
    check(&run_checks(&examination), "permissions", (Status::Problem, "may not be opened", cure));

    examination.user.group = |_| UserGroup { name: "dialout".to_owned(), lists_user: true };
    let cure = "log out and in again";
    check(&run_checks(&examination), "permissions", (Status::Problem, "", cure));
    assert!(!only(&run_checks(&examination), "permissions").2.contains("usermod"));

    fs::set_permissions(&port, fs::Permissions::from_mode(0o600)).unwrap();
    check(&run_checks(&examination), "permissions", (Status::Problem, "", "mode 0600"));
    // A group that may only read is no help: steering needs both ways.
    fs::set_permissions(&port, fs::Permissions::from_mode(0o640)).unwrap();
    check(&run_checks(&examination), "permissions", (Status::Problem, "", "mode 0640"));
}

#[test]
fn the_program_that_holds_a_port_is_named() {
    let computer = Computer::bare().with_board().with_process(77, "minicom");
    let port = fs::canonicalize(computer.path("dev/ttyACM0")).unwrap();
    let computer = computer.with_process(8, "sh").with_link("proc/77/fd/3", &port).with_link("proc/77/fd/4", &port);
    let held = "held by minicom, process 77";
    check(&computer.findings(), "port-holders", (Status::Warning, held, "kill 77"));
}

#[test]
fn a_device_of_a_given_link_is_looked_for_too() {
    let computer = Computer::bare().with("elsewhere/tty", "").with_process(9, "cat");
    let device = fs::canonicalize(computer.path("elsewhere/tty")).unwrap();
    let computer = computer.with_link("proc/9/fd/0", &device);
    let mut examination = computer.examination();
    examination.links = vec![format!("serial:{}", device.display())];
    let findings = run_checks(&examination);
    check(&findings, "port-holders", (Status::Warning, "held by cat", "kill 9"));
    // It is a plain file: it does not open as a port.
    check(&findings, "listening", (Status::Problem, "does not open", ""));
}

#[test]
fn modem_manager_is_a_warning_unless_udev_keeps_it_away() {
    let computer = Computer::bare().with_board();
    check(&computer.findings(), "modem-manager", (Status::Ok, "does not run", ""));

    let computer = computer.with_process(5, "ModemManager");
    let rule = "ATTRS{idVendor}==\"2341\", ATTRS{idProduct}==\"0043\", ENV{ID_MM_DEVICE_IGNORE}=\"1\"";
    check(&computer.findings(), "modem-manager", (Status::Warning, "ttyACM0", rule));

    // A tag with another value does not count, and one on the whole USB device does.
    let computer = computer.with("run/udev/data/c166:0", "E:ID_MM_DEVICE_IGNORE=0\n");
    assert_eq!(only(&computer.findings(), "modem-manager").0, Status::Warning);
    let computer = computer.with("run/udev/data/c189:5", "I:1\nE:ID_MM_DEVICE_IGNORE=1\n");
    check(&computer.findings(), "modem-manager", (Status::Ok, "no port here", ""));
}

#[test]
fn a_blocked_radio_is_a_problem_and_pairings_are_listed() {
    let computer = Computer::bare()
        .with("sys/class/bluetooth/hci0/address", "")
        .with("sys/class/bluetooth/hci0:11/address", "")
        .with("sys/class/rfkill/rfkill0/type", "wlan\n")
        .with("sys/class/rfkill/rfkill0/soft", "1\n")
        .with("sys/class/rfkill/rfkill1/type", "bluetooth\n")
        .with("sys/class/rfkill/rfkill1/soft", "0\n")
        .with("sys/class/rfkill/rfkill1/hard", "0\n")
        .with_process(3, "bluetoothd")
        .with("var/lib/bluetooth/AA/settings", "")
        .with("var/lib/bluetooth/AA/00:16:53:01:02:03/info", "[General]\nName=NXT\n[LinkKey]\n");
    let said: Vec<_> = computer
        .findings()
        .into_iter()
        .filter(|finding| finding.name == "bluetooth")
        .map(|finding| (finding.result.status, finding.result.message))
        .collect();
    assert_eq!(
        said,
        [
            (Status::Ok, "adapter hci0 is not blocked".to_owned()),
            (Status::Ok, "paired: NXT 00:16:53:01:02:03".to_owned()),
        ]
    );

    let computer = computer.with("sys/class/rfkill/rfkill1/soft", "1\n");
    let findings = computer.findings();
    assert!(findings.iter().any(|finding| {
        finding.result.status == Status::Problem && finding.result.advice.contains("rfkill unblock bluetooth")
    }));
}

#[test]
fn a_date_that_nobody_keeps_is_a_warning() {
    let bare = Computer::bare();
    check(&bare.findings(), "time-sync", (Status::Warning, "no service", "set-ntp true"));
    let waiting = bare.with_process(4, "systemd-timesyn");
    check(&waiting.findings(), "time-sync", (Status::Warning, "not reached", "network"));
    let synchronised = waiting.with("run/systemd/timesync/synchronized", "");
    check(&synchronised.findings(), "time-sync", (Status::Ok, "timesyncd", ""));
    let chrony = Computer::bare().with("run/chrony/chronyd.sock", "");
    check(&chrony.findings(), "time-sync", (Status::Ok, "chronyd", ""));
}

#[test]
fn a_small_receive_buffer_is_compared_with_what_links_ask_for() {
    let limit = |bytes: &str| Computer::bare().with("proc/sys/net/core/rmem_max", bytes);
    let cure = "sysctl net.core.rmem_max=4194304";
    check(&limit("212992\n").findings(), "receive-buffer", (Status::Warning, "212992", cure));
    check(&limit("4194303\n").findings(), "receive-buffer", (Status::Warning, "", cure));
    check(&limit("4194304\n").findings(), "receive-buffer", (Status::Ok, "4194304", ""));
    check(&limit("many\n").findings(), "receive-buffer", (Status::Skipped, "rmem_max", ""));
}

#[test]
fn a_configuration_is_checked_and_its_links_are_opened() {
    let wrong = Computer::bare().with("station.toml", "[robot]\ntrack_with_m = 1\n");
    let mut examination = wrong.examination();
    examination.config = Some(wrong.path("station.toml"));
    check(&run_checks(&examination), "configuration", (Status::Problem, "line 2", "config print"));

    let text = "[[link]]\nurl = \"serial:/nowhere/tty\"\n[[link]]\nurl = \"sim://square\"\n\
                [[link]]\nurl = \"sim://sqare\"\n[[link]]\nurl = \"serial:/\"\n[[link]]\nurl = \"pty:x\"\n\
                [[link]]\nurl = \"udp://127.0.0.1:0\"\nlisten = true\n";
    let links = Computer::bare().with("station.toml", text);
    let mut examination = links.examination();
    examination.config = Some(links.path("station.toml"));
    let statuses: Vec<_> = run_checks(&examination)
        .into_iter()
        .filter(|finding| finding.name == "configuration")
        .map(|finding| finding.result.status)
        .collect();
    assert_eq!(
        statuses,
        [Status::Ok, Status::Warning, Status::Ok, Status::Problem, Status::Problem, Status::Skipped, Status::Ok,]
    );
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
    let last = checks.last().unwrap();
    assert_eq!((&last["name"], &last["status"]), (&"listening".into(), &"warning".into()));

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
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.contains("the doctor found"), "{stderr}");
}
