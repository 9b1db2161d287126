//! What must hold for any message. What must hold for any damage, `resync` shows, and for any bytes the fuzz targets.

use posebridge_protocol::dialect::{MESSAGES, decode};
use posebridge_protocol::framing::{FrameRef, SequenceTracker, WireVersion};
use posebridge_protocol::message::{Message, Odometry, OdometryPose};
use posebridge_telemetry::{Address, Heading};
use proptest::prelude::*;

use crate::support::{ROBOT, fixed_cases, framed, with_frame};

/// Payloads that mean something to most messages: floats of measurements, small and large integers, letters.
fn plausible_payload() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        4 => (-1e3_f32..1e3).prop_map(f32::to_le_bytes),
        1 => any::<[u8; 4]>(),
        1 => (0_u8..40).prop_map(|small| [small, 0, small, 0]),
        1 => "[a-z_0-9]{4}".prop_map(|text| text.as_bytes().try_into().unwrap_or_default()),
        1 => Just(*b"temp"),
        1 => Just([0; 4]),
    ];
    prop::collection::vec(piece, 0..64).prop_map(|pieces| pieces.concat())
}

fn frame(message_id: u32, payload: &[u8]) -> FrameRef<'_> {
    FrameRef { version: WireVersion::V2, message_id, source: ROBOT, sequence: 0, payload, raw: &[] }
}

fn heading_of(message: &mut Message) -> Option<&mut Heading> {
    match message {
        Message::VisionPosition(fix) | Message::MocapPosition(fix) => fix.heading.as_mut(),
        Message::Attitude { heading, .. } => Some(heading),
        Message::AttitudeQuaternion(attitude) => Some(&mut attitude.heading),
        Message::PlanarPose(planar) => Some(&mut planar.pose.heading),
        Message::Odometry(Odometry { pose: OdometryPose::Arena(pose), .. }) => Some(&mut pose.heading),
        Message::Odometry(Odometry { pose: OdometryPose::Odom(pose), .. }) => Some(&mut pose.heading),
        _ => None,
    }
}

/// The wire's 32-bit floats carry an angle to half a microradian; a quaternion doubles the error.
const ANGLE_RESOLUTION_RAD: f64 = 1e-6;

proptest! {
    #![proptest_config(fixed_cases(6_000))]

    #[test]
    fn messages_survive_the_wire(which in 0..MESSAGES.len(), payload in plausible_payload()) {
        let Ok(Some(mut message)) = decode(&frame(MESSAGES[which].id, &payload)) else {
            return Ok(());
        };
        // A text that was no UTF-8 is longer now, and is cut.
        prop_assume!(!format!("{message:?}").contains('\u{FFFD}'));
        let bytes = framed(0, Address::new(3, 4), &message);
        let decoded = with_frame(&bytes, |frame| {
            assert_eq!((frame.source, frame.sequence), (Address::new(3, 4), 0));
            decode(frame)
        });
        let mut decoded = decoded.expect("sense").expect("a use");
        let bytes_again = framed(0, Address::new(3, 4), &decoded).len();
        if let (Some(sent), Some(received)) = (heading_of(&mut message), heading_of(&mut decoded)) {
            prop_assert!((*sent - *received).0.abs() < ANGLE_RESOLUTION_RAD);
            *received = *sent;
        }
        prop_assert_eq!(format!("{decoded:?}"), format!("{message:?}"));
        prop_assert_eq!(bytes.len(), bytes_again);
    }

    /// Any bits of a number, any bytes of a name, cut anywhere: a temperature that can be, a defect, or of no use.
    #[test]
    fn no_thermometer_shows_what_cannot_be(
        is_named in any::<bool>(),
        number in prop_oneof![any::<u32>(), (-500.0_f32..5_000.0).prop_map(f32::to_bits)],
        name in prop_oneof![any::<[u8; 10]>(), any::<[u8; 6]>().prop_map(|end| {
            let mut name = *b"temp______";
            name[4..].copy_from_slice(&end);
            name
        })],
        length in 0_usize..19,
    ) {
        let mut payload = [&[1, 2, 3, 4][..], &number.to_le_bytes(), &name].concat();
        payload.truncate(length);
        match decode(&frame(if is_named { 251 } else { 29 }, &payload)) {
            Ok(Some(Message::Thermometer { channel, temperature, .. })) => {
                let name = channel.as_str();
                prop_assert!(!name.is_empty() && name.bytes().all(|byte| byte.is_ascii_graphic()), "{name:?}");
                prop_assert_eq!(is_named, name.starts_with("temp"));
                prop_assert!((-273.15..=3_500.0).contains(&temperature.0), "{temperature:?}");
            }
            Ok(other) => {
                prop_assert!(matches!(other, Some(Message::NamedValue(_))));
                prop_assert!(is_named && (length < 12 || !name.starts_with(b"temp")));
            }
            Err(error) => prop_assert_eq!(error.message_id(), if is_named { 251 } else { 29 }),
        }
    }
}

proptest! {
    #![proptest_config(fixed_cases(1_000))]

    #[test]
    fn losses_add_up_to_the_distance(steps in prop::collection::vec(1_u8..=128, 1..50)) {
        let mut tracker = SequenceTracker::new();
        let mut sequence = 0_u8;
        tracker.record_number(ROBOT, sequence);
        for step in steps {
            sequence = sequence.wrapping_add(step);
            prop_assert_eq!(tracker.record_number(ROBOT, sequence), step - 1);
        }
    }
}
