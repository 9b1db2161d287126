//! A complete session, byte for byte, and commands: written by hand from LEGO's developer kit and the firmware's interface files.

use posebridge_protocol::bricks::nxt::{
    MotorPort, NxtSensor, NxtSettings, OutputState, ReplyRequest, framed, message_write, set_output_state,
    start_program, stop_program,
};
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{EncoderTicks, Timestamp};

use crate::support::{at, from_hex};

/// What is written, in one telegram each, and what is answered.
const SESSION: &str = include_str!("../../data/nxt_session.txt");

fn lines_of(mark: &'static str) -> impl Iterator<Item = Vec<u8>> {
    SESSION.lines().filter_map(move |line| line.strip_prefix(mark)).map(from_hex)
}

fn codec() -> Box<dyn BrickCodec> {
    let nxt = NxtSettings {
        sensors: [NxtSensor::None, NxtSensor::HtGyro, NxtSensor::None, NxtSensor::HtCompass],
        gyro_rest_counts: Some(600.0),
        ..NxtSettings::default()
    };
    crate::support::codec("nxt", &CodecSettings { nxt, ..CodecSettings::default() })
}

/// Requests and messages of the codec; of the clock, when each request left, and its reply, nanoseconds.
struct TranscriptRun {
    requests: Vec<Vec<u8>>,
    messages: Vec<Message>,
    times: Vec<(i64, i64)>,
}

/// Plays the transcript with answers cut into chunks.
fn play(chunk: usize) -> TranscriptRun {
    let mut codec = codec();
    let (mut requests, mut messages, mut times) = (Vec::new(), Vec::new(), Vec::new());
    codec.on_link_up(Timestamp::ZERO);
    for (step, reply) in lines_of("<").enumerate() {
        while let Some(bytes) = codec.poll() {
            requests.push(bytes);
        }
        let now = at(30 * (step as i64 + 1));
        for part in reply.chunks(chunk) {
            codec.push(now, part, &mut |event| match event {
                CodecEvent::Message { message, .. } => messages.push(message),
                CodecEvent::ClockReply { sent, peer_nanos, .. } => times.push((sent.as_nanos(), peer_nanos)),
                CodecEvent::StatusText { .. } => {}
                other => panic!("{other:?}"),
            });
        }
    }
    TranscriptRun { requests, messages, times }
}

#[test]
fn every_request_is_these_bytes_in_this_order() {
    let TranscriptRun { requests, .. } = play(usize::MAX);
    assert_eq!(requests, lines_of(">").collect::<Vec<_>>());
}

#[test]
fn every_answer_means_this_in_chunks_of_every_size() {
    for chunk in 1..=120 {
        let TranscriptRun { requests, messages, times } = play(chunk);
        assert_eq!(requests.len(), 18, "chunk size {chunk}");
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
