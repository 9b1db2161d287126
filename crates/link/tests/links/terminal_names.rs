//! The names of ports and pseudo-terminals: which are replaced, which are kept, which are refused.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::Path;

use crate::serial::Bench;
use crate::support::{bytes, poll_once, port, up};
use posebridge_link::{ConnectRole, Link, LinkOpenConfig, LinkUrl, OpenError, UrlError};
use posebridge_telemetry::LinkId;

#[tokio::test(start_paused = true)]
async fn a_link_that_was_left_behind_is_replaced() {
    let bench = Bench::new();
    symlink("/dev/pts/4000000", bench.path()).expect("a free name");
    let pty = bench.plugged_pty().await;
    let device = std::fs::read_link(bench.path()).expect("our link");
    assert!(device.exists(), "{} leads to a terminal", device.display());
    drop(pty);
    assert!(!bench.path().is_symlink(), "the name goes with the terminal");
}

#[tokio::test(start_paused = true)]
async fn the_name_of_a_successor_is_left_alone() {
    let bench = Bench::new();
    let old = bench.plugged_pty().await;
    // Somebody removes the name, so it is free while its first owner lives.
    std::fs::remove_file(bench.path()).expect("our link");
    let new = bench.plugged_pty().await;
    drop(old);
    assert!(bench.path().is_symlink());
    drop(new);
    assert!(!bench.path().is_symlink());
}

#[tokio::test(start_paused = true)]
async fn the_name_of_a_living_terminal_is_not_taken_over() {
    let bench = Bench::new();
    let mut first = bench.plugged_pty().await;
    let device = std::fs::read_link(bench.path()).expect("our link");
    let mut station = bench.serial();
    up(&mut station).await;

    let shown = bench.path();
    let shown = shown.display();
    check_refusal(
        bench.pty(),
        &format!(
            "{shown} is the pseudo-terminal of another program that is still running: stop that program \
             (`fuser -v {shown}` names it) or choose another path"
        ),
    )
    .await;
    assert_eq!(std::fs::read_link(bench.path()).ok(), Some(device));
    first.send(b"undisturbed");
    assert_eq!(poll_once(&mut first).await, None);
    assert_eq!(bytes(&mut station, 11).await, b"undisturbed");

    drop(first);
    bench.plugged_pty().await;
}

#[tokio::test(start_paused = true)]
async fn a_name_whose_number_went_to_a_terminal_window_is_replaced() {
    let bench = Bench::new();
    let window = nix::pty::openpty(None, None).expect("a foreign terminal");
    let device = nix::unistd::ttyname(&window.slave).expect("it has a name");
    symlink(&device, bench.path()).expect("a free name");
    let pty = bench.plugged_pty().await;
    assert_ne!(std::fs::read_link(bench.path()).expect("our link"), device);
    drop(pty);
}

#[tokio::test(start_paused = true)]
async fn a_link_from_a_path_opens_in_a_folder_of_any_name() {
    let bench = Bench::new();
    let awkward = OsStr::from_bytes(b"what?baud=9 \xff");
    let folder = bench.directory.path().join(awkward);
    std::fs::create_dir(&folder).expect("own directory");
    let device = folder.join("brick.tty");
    let open = |url: Result<LinkUrl, UrlError>, role| {
        let config = LinkOpenConfig { id: LinkId(1), url: url.expect("a path"), role };
        Link::new(config, bench.timer)
    };
    let mut pty = open(LinkUrl::pty(&device), ConnectRole::Listen);
    up(&mut pty).await;
    assert!(device.is_symlink());
    let mut station = open(LinkUrl::serial(&device), ConnectRole::Dial);
    up(&mut station).await;
    pty.send(b"hello");
    assert_eq!(poll_once(&mut pty).await, None);
    assert_eq!(bytes(&mut station, 5).await, b"hello");
}

async fn check_refusal(mut port: Link, message: &str) {
    let error: OpenError = port.try_open().await.expect_err(message);
    assert!(!error.is_transient() && error.prevents_start());
    assert_eq!(error.to_string(), message);
}

#[tokio::test(start_paused = true)]
async fn what_is_not_ours_is_not_replaced() {
    let bench = Bench::new();
    let path = bench.path();
    std::fs::write(&path, "precious").expect("own directory");
    let shown = path.display();
    check_refusal(bench.pty(), &format!("{shown} is a regular file, not a link that may be replaced")).await;
    assert_eq!(std::fs::read_to_string(&path).expect("still there"), "precious");

    std::fs::remove_file(&path).expect("own file");
    symlink("/dev/null", &path).expect("a free name");
    check_refusal(
        bench.pty(),
        &format!("{shown} is a symbolic link to something else, not a link that may be replaced"),
    )
    .await;
    assert_eq!(std::fs::read_link(&path).expect("still there"), Path::new("/dev/null"));
}

#[tokio::test(start_paused = true)]
async fn a_serial_port_that_is_something_else_is_refused() {
    let bench = Bench::new();
    let path = bench.path();
    std::fs::create_dir(&path).expect("own directory");
    let shown = path.display();
    check_refusal(bench.serial(), &format!("{shown} is a directory, not a serial port")).await;
    std::fs::remove_dir(&path).expect("own directory");
    std::fs::write(&path, "").expect("own directory");
    check_refusal(bench.serial(), &format!("{shown} is a regular file, not a serial port")).await;
}

#[tokio::test(start_paused = true)]
async fn a_pty_in_a_directory_that_does_not_exist_is_refused() {
    let bench = Bench::new();
    let directory = bench.directory.path().join("missing");
    let pty = port(&format!("pty:{}/brick.tty", directory.display()), ConnectRole::Listen, bench.timer);
    check_refusal(pty, &format!("{} does not exist: create the directory first", directory.display())).await;
}
