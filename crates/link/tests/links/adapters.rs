//! USB adapters: found again under another number, picked by a pattern, closed without a reset of the board.

use std::os::unix::fs::symlink;

use crate::serial::Bench;
use crate::support::{bytes, down, poll_once, port, up};
use nix::fcntl::OFlag;
use nix::sys::stat::Mode;
use nix::sys::termios::{ControlFlags, SetArg, tcgetattr, tcsetattr};
use posebridge_link::{DeviceDirectories, LinkUrl, Port, PortConfig, PortTuning, Role};
use posebridge_telemetry::LinkId;

/// A station on a computer whose udev links lie in the bench's directory.
fn tuned(bench: &Bench, url: &str) -> Port {
    let config = PortConfig {
        id: LinkId(1),
        url: LinkUrl::parse(url).expect("the test's own link"),
        role: Role::Dial,
    };
    let tuning = PortTuning {
        directories: DeviceDirectories {
            serial_by_id: bench.directory.path().join("by-id"),
            usb_serial: bench.directory.path().join("usb-serial"),
        },
        ..PortTuning::default()
    };
    Port::tuned(config, tuning, bench.timer)
}

/// An adapter that the system calls `name`: a pseudo-terminal, and udev's link to it.
async fn adapter(bench: &Bench, name: &str, id: &str) -> Port {
    let device = bench.directory.path().join(name);
    let mut pty = port(
        &format!("pty:{}", device.display()),
        Role::Listen,
        bench.timer,
    );
    up(&mut pty).await;
    let by_id = bench.directory.path().join("by-id");
    std::fs::create_dir_all(&by_id).expect("own directory");
    drop(std::fs::remove_file(by_id.join(id)));
    symlink(&device, by_id.join(id)).expect("a free name");
    pty
}

#[tokio::test(start_paused = true)]
async fn an_adapter_that_comes_back_under_another_number_is_found() {
    let bench = Bench::new();
    let shown = bench.directory.path().display().to_string();
    let mine = adapter(&bench, "ttyUSB0", "usb-mine-if00").await;
    let mut station = tuned(&bench, &format!("serial:{shown}/ttyUSB0"));
    assert_eq!(
        up(&mut station).await,
        format!("{shown}/ttyUSB0 ({shown}/by-id/usb-mine-if00) at 115200 baud")
    );
    drop(mine);
    down(&mut station).await;
    // Somebody else's adapter takes the number; ours comes back as the next one.
    let mut other = adapter(&bench, "ttyUSB0", "usb-other-if00").await;
    std::fs::remove_file(bench.directory.path().join("by-id/usb-mine-if00")).expect("our link");
    let (reason, _) = down(&mut station).await;
    assert_eq!(
        reason,
        format!("{shown}/by-id/usb-mine-if00 is not there: plug the device in or check the name")
    );
    let mut mine = adapter(&bench, "ttyUSB1", "usb-mine-if00").await;
    let detail = up(&mut station).await;
    assert_eq!(
        detail,
        format!("{shown}/by-id/usb-mine-if00 at 115200 baud")
    );
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
    let mut first = tuned(&bench, &pattern);
    first.open_first().await.expect("a device may come");
    let (reason, _) = down(&mut first).await;
    assert_eq!(
        reason,
        format!("{shown}/ttyACM* is not there: plug the device in or check the name")
    );
    let _b = adapter(&bench, "ttyACM1", "usb-b").await;
    let a = adapter(&bench, "ttyACM0", "usb-a").await;
    assert_eq!(
        up(&mut first).await,
        format!("{shown}/ttyACM0 at 115200 baud")
    );
    // One question mark is part of the name, the other begins the options.
    let mut second = tuned(&bench, &format!("serial:{shown}/ttyACM??baud=9600"));
    assert_eq!(
        up(&mut second).await,
        format!("{shown}/ttyACM1 at 9600 baud")
    );
    let mut third = tuned(&bench, &pattern);
    let error = third.open_first().await.expect_err("both are taken");
    assert!(error.stops_start() && error.can_heal());
    let busy = format!("port {shown}/ttyACM0 is in use by another program");
    assert!(error.to_string().starts_with(&busy), "{error}");

    drop(a);
    down(&mut first).await;
    assert!(down(&mut first).await.0.contains("ttyACM1 is in use"));
    let _c = adapter(&bench, "ttyACM7", "usb-c").await;
    assert_eq!(
        up(&mut first).await,
        format!("{shown}/ttyACM7 at 115200 baud")
    );
}

#[tokio::test(start_paused = true)]
async fn closing_a_port_does_not_drop_dtr_whatever_is_asked_for() {
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
        let mut station = tuned(&bench, &url);
        up(&mut station).await;
        let settings = tcgetattr(&line).expect("a terminal");
        assert!(
            !settings.control_flags.contains(ControlFlags::HUPCL),
            "dtr={dtr}"
        );
    }
}
