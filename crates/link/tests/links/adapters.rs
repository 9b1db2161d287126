//! Serial adapters on a simulated computer: which one is opened, and what happens to its line settings.

use crate::serial::Bench;
use crate::support::{bytes, down, poll_once, port, up};
use crate::udev::{PluggedAdapter, directories, plug_in};
use nix::fcntl::OFlag;
use nix::sys::stat::Mode;
use nix::sys::termios::{ControlFlags, SetArg, tcgetattr, tcsetattr};
use posebridge_link::{ConnectRole, LineSettingsPolicy, Link, LinkOpenConfig, LinkTuning, LinkUrl};
use posebridge_telemetry::LinkId;
use rustix::termios::{self, ControlModes, OptionalActions};

/// A computer whose devices are described in the bench's directory.
fn tuning(bench: &Bench) -> LinkTuning {
    LinkTuning { device_directories: directories(bench.directory.path()), ..LinkTuning::default() }
}

/// A station on such a computer.
fn station_at(bench: &Bench, url: &str) -> Link {
    tuned(bench, url, tuning(bench))
}

fn tuned(bench: &Bench, url: &str, tuning: LinkTuning) -> Link {
    let config = LinkOpenConfig {
        id: LinkId(1),
        url: LinkUrl::parse(url).expect("the test's own link"),
        role: ConnectRole::Dial,
    };
    Link::with_tuning(config, tuning, bench.timer)
}

#[tokio::test(start_paused = true)]
async fn a_guest_puts_every_setting_back_and_leaves_the_adapter_alone() {
    let bench = Bench::new();
    let _pty = bench.plugged_pty().await;
    let number = bench.path().canonicalize().expect("a terminal");
    let adapter = bench.directory.path().join("usb-serial").join(number.file_name().expect("a number"));
    let latency_timer = adapter.join("latency_timer");
    std::fs::create_dir_all(&adapter).expect("own directory");
    std::fs::write(&latency_timer, "16\n").expect("own directory");
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK;
    let line = nix::fcntl::open(&bench.path(), flags, Mode::empty()).expect("a foreign reader");
    let settings = || termios::tcgetattr(&line).expect("a terminal");
    let mut unlike = settings();
    unlike.control_modes.insert(ControlModes::HUPCL);
    // A usual speed of MIDI lines, for which termios has no name.
    unlike.set_speed(31_250).expect("any speed");
    termios::tcsetattr(&line, OptionalActions::Now, &unlike).expect("a terminal");
    let before = format!("{:?}", settings());

    let url = format!("serial:{}?baud=57600", bench.path().display());
    let with = |line_settings| LinkTuning { line_settings, ..tuning(&bench) };
    let mut guest = tuned(&bench, &url, with(LineSettingsPolicy::Restore));
    up(&mut guest).await;
    assert_eq!(settings().output_speed(), 57_600);
    drop(guest);
    assert_eq!(format!("{:?}", settings()), before);
    assert_eq!(settings().output_speed(), 31_250);
    let timer_text = || std::fs::read_to_string(&latency_timer).expect("it is there");
    assert_eq!(timer_text(), "16\n");

    let mut station = tuned(&bench, &url, with(LineSettingsPolicy::Keep));
    assert!(up(&mut station).await.contains("latency timer 1 ms"));
    drop(station);
    assert!(!settings().control_modes.contains(ControlModes::HUPCL));
    assert_eq!(timer_text(), "1");
}

/// An adapter that the system calls `name`: a pseudo-terminal, and its entries.
async fn adapter(bench: &Bench, name: &str, plug: PluggedAdapter<'_>) -> Link {
    let device = bench.directory.path().join(name);
    let mut pty = port(&format!("pty:{}", device.display()), ConnectRole::Listen, bench.timer);
    up(&mut pty).await;
    plug_in(bench.directory.path(), name, plug);
    pty
}

#[tokio::test(start_paused = true)]
async fn an_adapter_that_comes_back_under_another_number_is_found() {
    let bench = Bench::new();
    let shown = bench.directory.path().display().to_string();
    let plug = PluggedAdapter { socket: "socket-1", id: "usb-mine-if00", serial: Some("mine") };
    let mine = adapter(&bench, "ttyUSB0", plug).await;
    let mut station = station_at(&bench, &format!("serial:{shown}/ttyUSB0"));
    assert_eq!(up(&mut station).await, format!("{shown}/ttyUSB0 ({shown}/by-id/usb-mine-if00) at 115200 baud"));
    drop(mine);
    down(&mut station).await;
    // Somebody else's adapter takes the number; ours comes back as the next one.
    let theirs = PluggedAdapter { socket: "socket-2", id: "usb-other-if00", serial: Some("other") };
    let mut other = adapter(&bench, "ttyUSB0", theirs).await;
    std::fs::remove_file(bench.directory.path().join("by-id/usb-mine-if00")).expect("our link");
    let (reason, _) = down(&mut station).await;
    assert_eq!(reason, format!("{shown}/by-id/usb-mine-if00 is not there: plug the device in or check the name"));
    let elsewhere = PluggedAdapter { socket: "socket-3", ..plug };
    let mut mine = adapter(&bench, "ttyUSB1", elsewhere).await;
    let detail = up(&mut station).await;
    assert_eq!(detail, format!("{shown}/by-id/usb-mine-if00 at 115200 baud"));
    mine.send(b"mine");
    other.send(b"other");
    assert_eq!(poll_once(&mut mine).await, None);
    assert_eq!(bytes(&mut station, 4).await, b"mine");
}

#[tokio::test(start_paused = true)]
async fn a_pattern_opens_the_first_device_that_is_free_and_heals() {
    let bench = Bench::new();
    let shown = bench.directory.path().display().to_string();
    let pattern = format!("serial:{shown}/ttyACM*");
    let mut first = station_at(&bench, &pattern);
    first.try_open().await.expect("a device may come");
    let (reason, _) = down(&mut first).await;
    assert_eq!(reason, format!("{shown}/ttyACM* is not there: plug the device in or check the name"));
    let board = |id| PluggedAdapter { socket: id, id, serial: Some(id) };
    let _b = adapter(&bench, "ttyACM1", board("usb-b")).await;
    let a = adapter(&bench, "ttyACM0", board("usb-a")).await;
    assert_eq!(up(&mut first).await, format!("{shown}/ttyACM0 at 115200 baud"));
    // One question mark is part of the name, the other begins the options.
    let mut second = station_at(&bench, &format!("serial:{shown}/ttyACM??baud=9600"));
    assert_eq!(up(&mut second).await, format!("{shown}/ttyACM1 at 9600 baud"));
    let mut third = station_at(&bench, &pattern);
    let error = third.try_open().await.expect_err("both are taken");
    assert!(error.prevents_start() && error.is_transient());
    let busy = format!("port {shown}/ttyACM0 is in use by another program");
    assert!(error.to_string().starts_with(&busy), "{error}");

    drop(a);
    down(&mut first).await;
    assert!(down(&mut first).await.0.contains("ttyACM1 is in use"));
    let _c = adapter(&bench, "ttyACM7", board("usb-c")).await;
    assert_eq!(up(&mut first).await, format!("{shown}/ttyACM7 at 115200 baud"));
}

#[tokio::test(start_paused = true)]
async fn closing_a_port_does_not_drop_dtr_with_any_options() {
    let bench = Bench::new();
    let _pty = bench.plugged_pty().await;
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK;
    let line = nix::fcntl::open(&bench.path(), flags, Mode::empty()).expect("a foreign reader");
    for dtr in ["keep", "on", "off"] {
        let mut settings = tcgetattr(&line).expect("a terminal");
        settings.control_flags.insert(ControlFlags::HUPCL);
        tcsetattr(&line, SetArg::TCSANOW, &settings).expect("a terminal");
        // A pseudo-terminal has no DTR; that is no reason to refuse it.
        let url = format!("serial:{}?dtr={dtr}", bench.path().display());
        let mut station = station_at(&bench, &url);
        up(&mut station).await;
        let settings = tcgetattr(&line).expect("a terminal");
        assert!(!settings.control_flags.contains(ControlFlags::HUPCL), "dtr={dtr}");
    }
}
