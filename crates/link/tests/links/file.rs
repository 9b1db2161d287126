//! Files as links: read to the end, or written.

use crate::support::{bytes, poll_once, port, up};
use posebridge_link::{ConnectRole, HostTimer, LinkEvent};

#[tokio::test]
async fn a_file_is_played_to_its_end_in_chunks() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("run.bin");
    let content: Vec<u8> = (0..=255).cycle().take(1_000).collect();
    std::fs::write(&path, &content).expect("own directory");
    for chunk in [1, 7, 999, 1_000, 4_096] {
        let url = format!("file://{}?chunk={chunk}", path.display());
        let mut file = port(&url, ConnectRole::Dial, HostTimer::start());
        file.try_open().await.expect("it exists");
        assert_eq!(up(&mut file).await, format!("playing {}", path.display()));
        let mut played = Vec::new();
        loop {
            match file.next_event().await {
                LinkEvent::Bytes { bytes, .. } => {
                    let left = content.len() - played.len();
                    assert_eq!(bytes.len(), chunk.min(left));
                    played.extend(bytes);
                }
                LinkEvent::Finished { .. } => break,
                event => panic!("{event:?} while playing"),
            }
        }
        assert_eq!(played, content);
        assert!(!file.is_up());
        assert_eq!(poll_once(&mut file).await, None, "nothing follows the end");
    }
}

/// One flood of a hundred thousand chunks against one datagram: a reader of the file alone never sees the socket.
#[tokio::test(flavor = "current_thread")]
async fn a_file_leaves_the_runtime_its_turns() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("run.bin");
    std::fs::write(&path, vec![0; 100_000]).expect("own directory");
    let url = format!("file://{}?chunk=1", path.display());
    let mut file = port(&url, ConnectRole::Dial, HostTimer::start());
    up(&mut file).await;

    let (near, far) = tokio::net::UnixDatagram::pair().expect("two sockets");
    far.try_send(b"x").expect("room");
    // Like signals and timers, a socket is read only when the runtime gets round to polling the system.
    let reader = tokio::spawn(async move { near.recv(&mut [0; 1]).await });
    while !reader.is_finished() {
        let event = file.next_event().await;
        assert!(matches!(event, LinkEvent::Bytes { .. }), "{event:?} before the socket was heard");
    }
    let count = reader.await.expect("it ends").expect("it reads");
    assert_eq!(count, 1);
}

#[tokio::test]
async fn appended_frames_follow_the_existing_content() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("run.bin");
    let url = format!("file://{}?mode=append", path.display());
    for frame in [b"one", b"two"] {
        let mut file = port(&url, ConnectRole::Dial, HostTimer::start());
        up(&mut file).await;
        file.send(frame);
        assert_eq!(file.counters().bytes_out, 3);
        assert_eq!(poll_once(&mut file).await, None);
    }
    let mut reader = port(&format!("file://{}", path.display()), ConnectRole::Dial, HostTimer::start());
    up(&mut reader).await;
    assert_eq!(bytes(&mut reader, 6).await, b"onetwo");
}

#[tokio::test]
async fn a_file_that_cannot_be_played_is_refused_at_the_start() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let shown = directory.path().display();
    let mut missing = port(&format!("file://{shown}/run.bin"), ConnectRole::Dial, HostTimer::start());
    let error = missing.try_open().await.expect_err("it is not there");
    assert_eq!(error.to_string(), format!("{shown}/run.bin does not exist: check the name and the directory"));
    let mut wrong = port(&format!("file://{shown}"), ConnectRole::Dial, HostTimer::start());
    let error = wrong.try_open().await.expect_err("a directory");
    assert_eq!(error.to_string(), format!("{shown} is a directory, not a regular file"));
}
