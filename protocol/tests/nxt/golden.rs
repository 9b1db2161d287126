//! Bytes of LEGO's developer kit and of the firmware's interface files, written by hand from their tables.

use posebridge_protocol::bricks::nxt::{
    MotorPort, NxtSensor, NxtSettings, OutputState, ReplyRequest, framed, message_write, set_output_state,
    start_program, stop_program,
};
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings, brick_protocol};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{EncoderTicks, Timestamp};

const VERSION_REQUEST: &[u8] = &[0x02, 0x00, 0x01, 0x88];
/// Protocol 1.124, firmware 1.31.
const VERSION_REPLY: &[u8] = &[0x07, 0x00, 0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01];
const TICK_REQUEST: &[u8] = &[0x0A, 0x00, 0x01, 0x94, 0x01, 0x00, 0x01, 0x00, 0x14, 0x00, 0x04, 0x00];
/// 0x00012345 ms.
const TICK_REPLY: &[u8] = &[0x0D, 0x00, 0x02, 0x94, 0x00, 0x01, 0x00, 0x01, 0x00, 0x04, 0x00, 0x45, 0x23, 0x01, 0x00];
const MOTORS_REQUEST: &[u8] = &[0x0A, 0x00, 0x01, 0x94, 0x01, 0x00, 0x02, 0x00, 0x00, 0x00, 0x60, 0x00];
const INPUTS_REQUEST: &[u8] = &[0x0A, 0x00, 0x01, 0x94, 0x01, 0x00, 0x03, 0x00, 0x00, 0x00, 0x50, 0x00];
const BUFFERS_REQUEST: &[u8] = &[0x0A, 0x00, 0x01, 0x94, 0x01, 0x00, 0x0B, 0x00, 0x00, 0x00, 0x4C, 0x00];

/// B at 360 degrees, C at -2.
fn motors_reply() -> Vec<u8> {
    let mut reply = vec![0x69, 0x00, 0x02, 0x94, 0x00, 0x01, 0x00, 0x02, 0x00, 0x60, 0x00];
    let data = reply.len();
    reply.resize(data + 96, 0);
    reply[data + 32..data + 36].copy_from_slice(&[0x68, 0x01, 0x00, 0x00]);
    reply[data + 64..data + 68].copy_from_slice(&[0xFE, 0xFF, 0xFF, 0xFF]);
    reply
}

/// Port 2 is a gyro of type 06 that reads 0x02A0, 672 counts; port 4 is on the bus, type 0B.
fn inputs_reply() -> Vec<u8> {
    let mut reply = vec![0x59, 0x00, 0x02, 0x94, 0x00, 0x01, 0x00, 0x03, 0x00, 0x50, 0x00];
    let data = reply.len();
    reply.resize(data + 80, 0);
    reply[data + 22..data + 24].copy_from_slice(&[0xA0, 0x02]);
    reply[data + 28] = 0x06;
    reply[data + 68] = 0x0B;
    reply
}

/// Port 4's compass has answered so many times, 2 * 100 + 1 degrees.
fn buffers_reply(answers: u8) -> Vec<u8> {
    let mut reply = vec![0x55, 0x00, 0x02, 0x94, 0x00, 0x01, 0x00, 0x0B, 0x00, 0x4C, 0x00];
    let data = reply.len();
    reply.resize(data + 76, 0);
    for answer in 0..usize::from(answers) {
        let at = data + 57 + 2 * answer;
        reply[at..at + 2].copy_from_slice(&[0x64, 0x01]);
    }
    reply[data + 73] = 2 * answers;
    reply
}

/// What is asked, in one write each, and what is answered.
fn transcript() -> Vec<(Vec<&'static [u8]>, Vec<u8>)> {
    let keep_alive: &[u8] = &[0x02, 0x00, 0x80, 0x0D];
    let gyro: &[u8] = &[0x05, 0x00, 0x00, 0x05, 0x01, 0x06, 0x00];
    let compass: &[u8] = &[0x05, 0x00, 0x00, 0x05, 0x03, 0x0B, 0x00];
    let ask_compass: &[u8] = &[0x07, 0x00, 0x80, 0x0F, 0x03, 0x02, 0x02, 0x02, 0x42];
    let set_up = vec![0x03, 0x00, 0x02, 0x05, 0x00];
    vec![
        (vec![VERSION_REQUEST], VERSION_REPLY.to_vec()),
        (vec![keep_alive, TICK_REQUEST], TICK_REPLY.to_vec()),
        (vec![TICK_REQUEST], TICK_REPLY.to_vec()),
        (vec![TICK_REQUEST], TICK_REPLY.to_vec()),
        (vec![gyro], set_up.clone()),
        (vec![compass], set_up),
        (vec![MOTORS_REQUEST], motors_reply()),
        (vec![MOTORS_REQUEST], motors_reply()),
        (vec![INPUTS_REQUEST], inputs_reply()),
        (vec![ask_compass, MOTORS_REQUEST], motors_reply()),
        (vec![INPUTS_REQUEST], inputs_reply()),
        // It may be of any time.
        (vec![BUFFERS_REQUEST], buffers_reply(1)),
        (vec![MOTORS_REQUEST], motors_reply()),
        // A tenth of a second after the last time.
        (vec![ask_compass, INPUTS_REQUEST], inputs_reply()),
        (vec![BUFFERS_REQUEST], buffers_reply(2)),
    ]
}

fn codec() -> Box<dyn BrickCodec> {
    let nxt = NxtSettings {
        sensors: [NxtSensor::None, NxtSensor::HtGyro, NxtSensor::None, NxtSensor::HtCompass],
        gyro_rest_counts: Some(600.0),
        ..NxtSettings::default()
    };
    let settings = CodecSettings { nxt, ..CodecSettings::default() };
    (brick_protocol("nxt").expect("the row is there").open)(&settings)
}

/// What the codec asked and heard; of the clock, when the question left and what was answered, nanoseconds.
struct TranscriptRun {
    asked: Vec<Vec<u8>>,
    messages: Vec<Message>,
    times: Vec<(i64, i64)>,
}

/// Plays the transcript with answers cut into chunks.
fn play(chunk: usize) -> TranscriptRun {
    let mut codec = codec();
    let (mut asked, mut messages, mut times) = (Vec::new(), Vec::new(), Vec::new());
    codec.on_link_up(Timestamp::ZERO);
    for (step, (_, reply)) in transcript().iter().enumerate() {
        while let Some(bytes) = codec.poll() {
            asked.push(bytes);
        }
        let now = Timestamp::from_millis(30 * (step as i64 + 1));
        for part in reply.chunks(chunk) {
            codec.push(now, part, &mut |heard| match heard {
                CodecEvent::Message { message, .. } => messages.push(message),
                CodecEvent::ClockReply { sent, peer_nanos, .. } => times.push((sent.as_nanos(), peer_nanos)),
                CodecEvent::StatusText { .. } => {}
                other => panic!("{other:?}"),
            });
        }
    }
    TranscriptRun { asked, messages, times }
}

#[test]
fn every_question_is_these_bytes_in_this_order() {
    let TranscriptRun { asked, .. } = play(usize::MAX);
    let expected: Vec<&[u8]> = transcript().into_iter().flat_map(|(asked, _)| asked).collect();
    assert_eq!(asked, expected);
}

#[test]
fn every_answer_means_this_in_chunks_of_every_size() {
    for chunk in 1..=120 {
        let TranscriptRun { asked, messages, times } = play(chunk);
        assert_eq!(asked.len(), 18, "chunk size {chunk}");
        assert_eq!(times.first(), Some(&(30_000_000, 0x12345 * 1_000_000)));
        assert_eq!(times.len(), 3);
        let ticks: Vec<_> = messages
            .iter()
            .filter_map(|message| match message {
                Message::WheelTicks(ticks) => Some((ticks.left, ticks.right)),
                _ => None,
            })
            .collect();
        assert_eq!(ticks, [(EncoderTicks(360), EncoderTicks(-2)); 4]);
        let rates: Vec<_> = messages
            .iter()
            .filter_map(|message| match message {
                Message::Inertial(inertial) => inertial.turn_rate,
                _ => None,
            })
            .collect();
        assert_eq!(rates.len(), 3, "chunk size {chunk}");
        assert!(rates.iter().all(|rate| (rate.0.to_degrees() - 72.0).abs() < 1e-9));
        let compass = messages.iter().find_map(|message| match message {
            Message::Compass { heading, .. } => Some(heading.rad().to_degrees()),
            _ => None,
        });
        assert!((compass.unwrap() - 159.0).abs() < 1e-9, "chunk size {chunk}");
        let beats = messages.iter().filter(|message| matches!(message, Message::Heartbeat(_))).count();
        assert_eq!(beats, 1);
    }
}

#[test]
fn commands_to_drive_are_these_bytes() {
    // Motor C at 75 per cent, regulated speed, for 360 degrees: layout of SETOUTPUTSTATE.
    let state = OutputState { tacho_limit: 360, ..OutputState::run(MotorPort::C, 75) };
    let bytes = framed(&set_output_state(&state, ReplyRequest::NotRequired));
    let expected = [0x0C, 0x00, 0x80, 0x04, 0x02, 0x4B, 0x07, 0x01, 0x00, 0x20, 0x68, 0x01, 0x00, 0x00];
    assert_eq!(bytes, expected);

    let back = OutputState::run(MotorPort::A, -100);
    let bytes = set_output_state(&back, ReplyRequest::Required);
    let expected = [0x00, 0x04, 0x00, 0x9C, 0x07, 0x01, 0x00, 0x20, 0, 0, 0, 0];
    assert_eq!(bytes, expected);

    let all = set_output_state(&OutputState::coast(), ReplyRequest::NotRequired);
    assert_eq!(all, [0x80, 0x04, 0xFF, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
}

#[test]
fn commands_to_programs_are_these_bytes() {
    let start = framed(&start_program("pose.rxe", ReplyRequest::Required));
    let mut expected = vec![0x16, 0x00, 0x00, 0x00];
    expected.extend_from_slice(b"pose.rxe");
    expected.extend_from_slice(&[0; 12]);
    assert_eq!(start, expected);
    // A name that is too long keeps its final zero.
    let long = start_program("a-name-of-more-than-nineteen-bytes.rxe", ReplyRequest::NotRequired);
    assert_eq!((long.len(), long[0], long[21]), (22, 0x80, 0));
    assert_eq!(stop_program(ReplyRequest::NotRequired), [0x80, 0x01]);

    let message = message_write(3, b"hi", ReplyRequest::NotRequired).unwrap();
    let bytes = framed(&message);
    assert_eq!(bytes, [0x07, 0x00, 0x80, 0x09, 0x03, 0x03, b'h', b'i', 0x00]);
    assert!(message_write(3, &[0; 58], ReplyRequest::Required).is_some());
    assert!(message_write(3, &[0; 59], ReplyRequest::Required).is_none());
}
