//! The promises of every transport, checked for each entry of the table.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use crate::support::{down, next_beside, poll_once, port, up};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkUrl, TRANSPORTS};
use posebridge_telemetry::TimeDelta;

/// How the two ends of a link over one transport are made. The far end listens.
struct EndUrls {
    /// `None` dials the address that the far end has got.
    near: Option<String>,
    far: String,
    /// The near end notices when the far end closes.
    detects_loss: bool,
}

fn plan(scheme: &str, device: &Path) -> Option<EndUrls> {
    let device = device.display();
    let (near, far, detects_loss) = match scheme {
        "serial" => (Some(format!("serial:{device}")), format!("pty:{device}"), true),
        "pty" => (Some(format!("pty:{device}")), format!("serial:{device}"), false),
        "tcp" => (None, "tcp://127.0.0.1:0".to_owned(), true),
        "udp" => (None, "udp://127.0.0.1:0".to_owned(), false),
        // A radio and a paired device would be needed; a file is one-way; an EV3 must be a brick; a camera is opened elsewhere. Their
        // own tests bear their names.
        "bluetooth" | "file" | "ev3" | "camera" => return None,
        other => panic!("say here what the far end of a {other} link is"),
    };
    Some(EndUrls { near, far, detects_loss })
}

/// The two ends of a link, with what is needed to make the far end again.
struct LinkEnds {
    near: Link,
    far: Link,
    far_url: String,
    detects_loss: bool,
    timer: HostTimer,
    _directory: tempfile::TempDir,
}

impl LinkEnds {
    async fn new(scheme: &str) -> Option<Self> {
        let timer = HostTimer::start();
        let directory = tempfile::tempdir().expect("a temporary directory");
        let plan = plan(scheme, &directory.path().join("brick.tty"))?;
        let mut far = port(&plan.far, ConnectRole::Listen, timer);
        let (near_url, far_url) = if let Some(near_url) = plan.near {
            (near_url, plan.far)
        } else {
            up(&mut far).await;
            let address = far.local_address().expect("it listens");
            let url = format!("{scheme}://{address}");
            (url.clone(), url)
        };
        let mut ends = Self {
            near: port(&near_url, ConnectRole::Dial, timer),
            far,
            far_url,
            detects_loss: plan.detects_loss,
            timer,
            _directory: directory,
        };
        ends.both_up().await;
        Some(ends)
    }

    async fn both_up(&mut self) {
        while !(self.near.is_up() && self.far.is_up()) {
            let near = next_beside(&mut self.near, &mut self.far);
            // The near end may be up already and then has no event while the far end still opens.
            drop(tokio::time::timeout(Duration::from_secs(1), near).await);
        }
    }

    /// The near end sends first, as a station does over UDP.
    async fn exchange(&mut self) {
        self.near.send(b"ping");
        let received = beside(&mut self.far, &mut self.near, 4).await;
        assert_eq!(received, b"ping");
        self.far.send(b"pong!");
        let received = beside(&mut self.near, &mut self.far, 5).await;
        assert_eq!(received, b"pong!");
    }

    fn restart_far(&mut self) {
        let fresh = port(&self.far_url, ConnectRole::Listen, self.timer);
        self.far = fresh;
    }
}

/// Waits for bytes on one end while the other works too; what else happens there does not matter.
async fn beside(to: &mut Link, from: &mut Link, count: usize) -> Vec<u8> {
    let mut all = Vec::new();
    while all.len() < count {
        if let LinkEvent::Bytes { bytes, .. } = next_beside(to, from).await {
            all.extend(bytes);
        }
    }
    all
}

#[test]
fn every_transport_is_selected_by_its_example_and_explained_and_accepts_its_own_defaults() {
    let schemes: BTreeSet<_> = TRANSPORTS.iter().map(|transport| transport.scheme()).collect();
    assert_eq!(schemes.len(), TRANSPORTS.len(), "every scheme stands once");
    for transport in TRANSPORTS {
        let scheme = transport.scheme();
        assert!(scheme.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit()), "{scheme}");
        let url = LinkUrl::parse(transport.example()).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(url.transport().scheme(), scheme);
        assert_eq!(url.to_string(), transport.example());
        assert!(!transport.summary().is_empty(), "{scheme}");
        assert!(transport.options().iter().any(|option| option.name == "rate"), "{scheme}");
        for option in transport.options() {
            assert!(!option.help.is_empty(), "{}", option.name);
            let base = transport.example().split('?').next().expect("the target");
            let text = format!("{base}?{}={}", option.name, option.kind.default_text());
            let url = LinkUrl::parse(&text).expect("the default is a value");
            assert_eq!(url.option_text(option), option.kind.default_text());
        }
    }
}

#[tokio::test(start_paused = true)]
async fn every_link_carries_every_byte_in_both_directions() {
    let all: Vec<u8> = (0..=255).collect();
    for transport in TRANSPORTS {
        let Some(mut ends) = LinkEnds::new(transport.scheme()).await else {
            continue;
        };
        ends.exchange().await;
        let counters = ends.near.counters();
        assert_eq!((counters.bytes_in, counters.bytes_out, counters.drops_out), (5, 4, 0), "{}", transport.scheme());
        ends.near.send(&all);
        assert_eq!(beside(&mut ends.far, &mut ends.near, 256).await, all, "{}", transport.scheme());
        ends.far.send(&all);
        assert_eq!(beside(&mut ends.near, &mut ends.far, 256).await, all, "{}", transport.scheme());
    }
}

#[tokio::test(start_paused = true)]
async fn dropping_next_loses_nothing() {
    for transport in TRANSPORTS {
        let Some(mut ends) = LinkEnds::new(transport.scheme()).await else {
            continue;
        };
        ends.exchange().await;
        let mut received = Vec::new();
        for number in 0..50_u8 {
            ends.far.send(&[number]);
            // Each round starts `next`, polls it once and drops it, whether or not it had an event.
            while received.len() <= usize::from(number) {
                if let Some(LinkEvent::Bytes { bytes, .. }) = poll_once(&mut ends.near).await {
                    received.extend(bytes);
                } else {
                    tokio::task::yield_now().await;
                }
            }
        }
        let sent: Vec<u8> = (0..50).collect();
        assert_eq!(received, sent, "{}", transport.scheme());
    }
}

#[tokio::test(start_paused = true)]
async fn every_link_works_again_after_the_far_end_was_restarted() {
    for transport in TRANSPORTS {
        let Some(mut ends) = LinkEnds::new(transport.scheme()).await else {
            continue;
        };
        for restart in 1..=3 {
            // Closing before opening again: the address or the name has to be free.
            ends.far = port("file:/dev/null/nowhere", ConnectRole::Dial, ends.timer);
            if ends.detects_loss {
                let (reason, retry_in) = down(&mut ends.near).await;
                assert!(reason.contains("other end is gone"), "{reason}");
                assert!(retry_in > TimeDelta::ZERO && retry_in < TimeDelta::from_millis(1_000));
            }
            ends.restart_far();
            ends.both_up().await;
            ends.exchange().await;
            let expected = if ends.detects_loss { restart } else { 0 };
            assert_eq!(ends.near.counters().reconnects, expected, "{}", transport.scheme());
        }
    }
}

#[tokio::test(start_paused = true)]
async fn frames_for_a_link_that_is_down_are_dropped_and_counted() {
    let timer = HostTimer::start();
    let mut port = port("serial:/nowhere/at/all", ConnectRole::Dial, timer);
    port.send(b"early");
    assert!(matches!(poll_once(&mut port).await, None | Some(LinkEvent::Down { .. })));
    port.send(b"still");
    assert_eq!(port.counters().drops_out, 2);
    assert_eq!(port.counters().bytes_out, 0);
    assert!(!port.is_up());
}

#[tokio::test(start_paused = true)]
async fn datagram_links_keep_the_bounds_of_datagrams() {
    for transport in TRANSPORTS.iter().filter(|transport| transport.is_datagram()) {
        let mut ends = LinkEnds::new(transport.scheme()).await.expect("it has two ends");
        assert!(ends.near.is_datagram());
        for frame in [&b"one"[..], b"twotwo", b"3"] {
            ends.near.send(frame);
        }
        for frame in [&b"one"[..], b"twotwo", b"3"] {
            assert_eq!(beside(&mut ends.far, &mut ends.near, 1).await, frame);
        }
    }
}

#[test]
fn the_page_about_links_names_every_scheme_example_and_option() {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/links.md");
    let page = std::fs::read_to_string(page).expect("the page is part of the repository");
    for transport in TRANSPORTS {
        let example = format!("`{}`", transport.example());
        assert!(page.contains(&example), "{example} is missing");
        for option in transport.options() {
            let row = format!(
                "| `{}` | `{}` | {} | {} |",
                transport.scheme(),
                option.name,
                option.kind,
                option.kind.default_text()
            );
            assert!(page.contains(&row), "{row} is missing");
        }
    }
}
