//! Any bytes to a brick: an accepted estimate is finite and was in the bytes as a whole, and the station understands
//! every reply.

use posebridge_brick::{Link, Received, Receiver};
use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_protocol::message::Message;
use posebridge_telemetry::Timestamp;

/// The shortest frame: one byte of payload.
const MIN_ANSWER_BYTES: usize = 13;

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
    assert!(frames * MIN_ANSWER_BYTES <= data.len(), "{frames} frames");
}

/// The answer is one frame, and in it the brick's 7 microseconds.
fn assert_answer(answer: &[u8]) {
    let mut answers = 0;
    let mut take = |found: FramerOutput<'_>| {
        if let FramerOutput::Frame(frame) = found {
            assert_eq!(frame.raw, answer);
            let message = decode(&frame).ok().flatten();
            assert!(matches!(message, Some(Message::TimeSync(sync)) if sync.answer_nanos == 7_000), "{message:?}");
            answers += 1;
        }
    };
    let mut framer = Framer::new(FramerConfig::default());
    framer.push(Timestamp::ZERO, answer, &mut take);
    framer.finish(&mut take);
    assert_eq!(answers, 1);
}
