//! Bluetooth links without a radio: the error messages, and that nothing hangs.

use crate::support::port;
use posebridge_link::{ConnectRole, HostTimer};

const BRICK: &str = "bluetooth://00:16:53:AA:BB:CC?channel=1";

#[cfg(not(feature = "bluetooth"))]
#[tokio::test(start_paused = true)]
async fn a_program_without_bluetooth_reports_how_to_get_it() {
    let mut brick = port(BRICK, ConnectRole::Dial, HostTimer::start());
    let error = brick.try_open().await.expect_err("not built");
    assert!(!error.is_transient() && error.prevents_start());
    assert_eq!(
        error.to_string(),
        "Bluetooth is not built into this program: build it with the feature `bluetooth`, or bind the device with `sudo rfcomm bind 0 ADDRESS` and use serial:///dev/rfcomm0"
    );
}

#[cfg(feature = "bluetooth")]
#[tokio::test(start_paused = true)]
async fn an_unreachable_brick_is_waited_for() {
    use crate::support::down;
    use posebridge_telemetry::TimeDelta;

    let mut brick = port(BRICK, ConnectRole::Dial, HostTimer::start());
    brick.try_open().await.expect("it may be switched on later");
    let (reason, retry_in) = down(&mut brick).await;
    assert!(reason.contains("00:16:53:AA:BB:CC"), "{reason}");
    assert!(retry_in > TimeDelta::ZERO);
}
