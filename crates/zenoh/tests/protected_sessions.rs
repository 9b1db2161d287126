//! Sessions with certificates, a user and a password, as docs/fleet.md sets them up: who has not all of them sees nothing.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop with a reason when the set-up is broken")]

mod support;

use std::path::{Path, PathBuf};

use posebridge_fleet::Input;
use posebridge_zenoh::{Connection, FleetCommand};

use crate::support::{Member, free_endpoint};

const PASSWORD: &str = "4kf8-2jd9-s01k";

/// A configuration of Zenoh with the certificates of a folder and a password.
fn protected(folder: &Path, name: &str, certificates: &str, password: &str) -> PathBuf {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(certificates);
    let file = |name: &str| serde_json::json!(data.join(name).to_str().expect("a path"));
    let users = folder.join("users.txt");
    std::fs::write(&users, format!("lab:{PASSWORD}\n")).expect("a file");
    let config = serde_json::json!({
        "transport": {
            "auth": { "usrpwd": { "user": "lab", "password": password, "dictionary_file": users.to_str() } },
            "link": { "tls": {
                "root_ca_certificate": file("authority.pem"),
                "listen_private_key": file("localhost.key"),
                "listen_certificate": file("localhost.pem"),
                "connect_private_key": file("localhost.key"),
                "connect_certificate": file("localhost.pem"),
                "enable_mtls": true,
            } },
        },
    });
    let path = folder.join(format!("{name}.json5"));
    std::fs::write(&path, config.to_string()).expect("a file");
    path
}

#[tokio::test]
async fn who_has_no_certificate_or_no_password_sees_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (_, port) = free_endpoint().rsplit_once(':').map(|(host, port)| (host.to_owned(), port.to_owned())).unwrap();
    let endpoint = format!("tls/localhost:{port}");
    let with = |name: &str, certificates: &str, password: &str| Connection {
        join: vec![endpoint.clone()],
        zenoh_config: Some(protected(folder.path(), name, certificates, password)),
        ..Connection::default()
    };
    let first = Connection { join: Vec::new(), listen: vec![endpoint.clone()], ..with("first", ".", PASSWORD) };
    let mut first = Member::start("lab", "a", first);
    let mut strangers = [
        Member::start("lab", "x", with("other-authority", "stranger", PASSWORD)),
        Member::start("lab", "y", with("wrong-password", ".", "password")),
        Member::start("lab", "z", Connection { join: vec![format!("tcp/localhost:{port}")], ..Connection::default() }),
    ];
    let mut friend = Member::start("lab", "b", with("friend", ".", PASSWORD));
    friend.wait_for_input(Input::StationAppeared(first.id.clone())).await;
    first.wait_for_input(Input::StationAppeared(friend.id.clone())).await;
    for stranger in &mut strangers {
        stranger.session.send(FleetCommand::Confirm);
        stranger.wait_for_input(Input::FleetDisconnected).await;
        assert!(stranger.session.try_next_event().is_none());
    }
}
