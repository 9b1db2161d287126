//! Any bytes to a brick: what it takes for an estimate is finite and lay there whole, what it answers the station understands.

use posebridge_brick::{Link, Received, Receiver};
use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Scanned, Scanner, ScannerConfig};
use posebridge_protocol::message::Message;
use posebridge_telemetry::Stamp;

/// The shortest frame: one byte of payload.
const SHORTEST: usize = 13;

/// Input: the bytes of a link.
pub(crate) fn check(data: &[u8]) {
    let (mut receiver, mut link) = (Receiver::new(), Link::new(1, 1));
    let mut frames = 0;
    for byte in data {
        receiver.push(*byte);
        while let Some(received) = receiver.poll() {
            frames += 1;
            match received {
                Received::Pose(pose) => {
                    let numbers = [pose.x_m, pose.y_m, pose.heading_rad];
                    assert!(numbers.iter().chain(&pose.covariance).all(|x| x.is_finite()));
                }
                Received::TimeRequest(request) => {
                    link.answer_time(&request, 7, &mut |answer: &[u8]| assert_answer(answer));
                }
            }
        }
    }
    assert!(frames * SHORTEST <= data.len(), "{frames} frames");
}

/// The answer is one frame, and in it the brick's 7 microseconds.
fn assert_answer(answer: &[u8]) {
    let mut answers = 0;
    let mut take = |found: Scanned<'_>| {
        if let Scanned::Frame(frame) = found {
            assert_eq!(frame.raw, answer);
            let message = decode(&frame).ok().flatten();
            assert!(matches!(message, Some(Message::TimeSync(sync)) if sync.answer_nanos == 7_000), "{message:?}");
            answers += 1;
        }
    };
    let mut scanner = Scanner::new(ScannerConfig::default());
    scanner.push(Stamp::ZERO, answer, &mut take);
    scanner.finish(&mut take);
    assert_eq!(answers, 1);
}
