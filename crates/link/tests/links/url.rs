//! URLs of links: accepted forms and error messages.

use std::path::Path;

use posebridge_link::{BluetoothAddress, LinkUrl, TRANSPORTS, Target, UrlError};

fn check_target(text: &str, scheme: &str, target: &Target) {
    let url = LinkUrl::parse(text).unwrap_or_else(|error| panic!("{text}: {error}"));
    assert_eq!(url.transport().scheme(), scheme, "{text}");
    assert_eq!(url.target(), target, "{text}");
    assert_eq!(url.to_string(), text);
}

fn host(host: &str, port: u16) -> Target {
    Target::Host { host: host.to_owned(), port }
}

fn check_error(text: &str, message: &str) {
    let error = LinkUrl::parse(text).expect_err(text);
    assert_eq!(error.to_string(), message);
}

#[test]
fn the_usual_links_are_understood_and_printed_back() {
    let path = |path: &str| Target::Path(path.into());
    check_target("serial:///dev/rfcomm0?baud=57600", "serial", &path("/dev/rfcomm0"));
    check_target("serial:brick.tty", "serial", &path("brick.tty"));
    check_target("pty:brick.tty", "pty", &path("brick.tty"));
    check_target("pty:///run/user/brick.tty", "pty", &path("/run/user/brick.tty"));
    check_target("file://run.bin", "file", &path("run.bin"));
    check_target("camera:/dev/video0?exposure_us=5000", "camera", &path("/dev/video0"));
    // What follows the question mark is for the phone.
    check_target("camera:http://phone:8080/video?fps=5", "camera", &path("http://phone:8080/video?fps=5"));
    check_target("tcp://robot.local:5760", "tcp", &host("robot.local", 5760));
    check_target("tcp://[fe80::1]:5760/", "tcp", &host("fe80::1", 5760));
    check_target("udp://:14550", "udp", &host("", 14550));
    check_target("udp://127.0.0.1:0", "udp", &host("127.0.0.1", 0));
}

#[test]
fn the_spelling_with_and_without_slashes_is_the_same_link() {
    let parse = |text| LinkUrl::parse(text).expect("a link");
    assert_eq!(parse("serial:brick.tty"), parse("serial://brick.tty"));
    assert_ne!(parse("serial:brick.tty"), parse("pty:brick.tty"));
    assert_ne!(parse("serial:a"), parse("serial:a?baud=9600"));
    assert_eq!(parse("file:a?mode=append&chunk=1"), parse("file:a?chunk=1&mode=append"));
    assert_eq!(parse("serial:brick.tty").path(), Path::new("brick.tty"));
}

#[test]
fn options_have_the_default_of_the_table_until_they_are_given() {
    let serial = TRANSPORTS.iter().find(|transport| transport.scheme() == "serial").expect("it is there");
    let baud = &serial.options()[0];
    let parse = |text| LinkUrl::parse(text).expect("a link");
    assert_eq!(parse("serial:a").integer(baud), 115_200);
    assert_eq!(parse("serial:a?baud=921600").integer(baud), 921_600);
    assert_eq!(parse("serial:a?").integer(baud), 115_200);
}

#[test]
fn a_wrong_link_or_option_is_refused_with_the_error_and_the_valid_form() {
    let table = include_str!("../data/refused_urls.tsv");
    for line in table.lines().filter(|line| !line.starts_with('#')) {
        let (text, message) = line.split_once('\t').expect("a text and its message");
        check_error(text, message);
    }
}

#[test]
fn a_bluetooth_address_is_six_bytes_with_colons() {
    let brick = Target::Bluetooth(BluetoothAddress([0x00, 0x16, 0x53, 0xaa, 0xbb, 0xcc]));
    check_target("bluetooth://00:16:53:AA:BB:CC?channel=1", "bluetooth", &brick);
    check_target("bluetooth:00:16:53:aa:bb:cc/", "bluetooth", &brick);
    assert_eq!(BluetoothAddress([0, 0x16, 0x53, 0xaa, 0xbb, 0xcc]).to_string(), "00:16:53:AA:BB:CC");
    for wrong in ["", "00:16:53:AA:BB", "00:16:53:AA:BB:CC:DD", "00:16:53:AA:BB:+C", "0:16:53:AA:BB:CCC"] {
        check_error(
            &format!("bluetooth://{wrong}"),
            &format!(
                "`{wrong}` in `bluetooth://{wrong}` is not a Bluetooth address: write it like bluetooth://00:16:53:AA:BB:CC?channel=1"
            ),
        );
    }
}

#[test]
fn the_last_question_mark_begins_the_options() {
    let parse = |text| LinkUrl::parse(text).expect("a link");
    let pattern = parse("serial:///dev/ttyUSB??baud=57600");
    assert_eq!(pattern.path(), Path::new("/dev/ttyUSB?"));
    assert_eq!(parse("serial:///dev/ttyUSB??").path(), Path::new("/dev/ttyUSB?"));
    assert_eq!(parse("serial:///dev/ttyUSB*").path(), Path::new("/dev/ttyUSB*"));
    assert_eq!(parse("serial:///dev/ttyUSB?baud=57600").path(), Path::new("/dev/ttyUSB"));
}

#[test]
fn no_text_makes_the_parser_panic() {
    let pieces = ["serial", "udp", ":", "//", "[", "]", "?", "&", "=", "baud", "é", "\0", "9"];
    for a in pieces {
        for b in pieces {
            for c in pieces {
                for d in pieces {
                    let text = [a, b, c, d].concat();
                    if let Ok(url) = LinkUrl::parse(&text) {
                        assert_eq!(url.to_string(), text);
                    }
                }
            }
        }
    }
}

#[test]
fn a_link_from_a_path_takes_the_path_as_it_is() {
    let path = Path::new("/srv/runs?baud=7/brick&co");
    for (url, scheme) in [(LinkUrl::pty(path), "pty"), (LinkUrl::serial(path), "serial")] {
        let url = url.expect("a path");
        assert_eq!(url.transport().scheme(), scheme);
        assert_eq!(url.path(), path);
        assert_eq!(url.to_string(), format!("{scheme}:/srv/runs?baud=7/brick&co"));
    }
    assert_eq!(LinkUrl::pty(Path::new("a/brick.tty")), LinkUrl::parse("pty:a/brick.tty"));
    for bad in ["", "a\0b"] {
        let error = LinkUrl::serial(Path::new(bad)).expect_err(bad);
        assert!(matches!(error, UrlError::NoPath { .. }), "{error:?}");
    }
}
