//! The bytes of an estimate.

use posebridge_fleet::{Epoch, EstimateError, FleetEstimate};
use posebridge_telemetry::{Estimate, Heading, Meters, MetersPerSecond, Pose, RadiansPerSecond, Timestamp, Validity};
use proptest::prelude::*;

fn estimate() -> FleetEstimate {
    let stamp = Timestamp::from_nanos(1);
    let mut covariance = [[0.0; 5]; 5];
    covariance[0] = [4.0, 0.5, -0.5, 9.0, 9.0];
    covariance[1] = [0.5, 2.0, 0.25, 9.0, 9.0];
    covariance[2] = [-0.5, 0.25, 1.0, 9.0, 9.0];
    let estimate = Estimate {
        stamp,
        pose: Pose::new(Meters(1.5), Meters(-2.0), Heading::from_rad(0.5)),
        forward_speed: MetersPerSecond(0.25),
        turn_rate: RadiansPerSecond(-1.0),
        covariance,
        validity: Validity { position: true, heading: false, speeds: true },
        is_dead_reckoning: true,
        fix_age: None,
        reset_counter: 3,
        last_correction: None,
        missing: None,
    };
    let epoch = Epoch::new(0x0102_0304).expect("not zero");
    FleetEstimate::new(epoch, 0x0a0b_0c0d, Timestamp::from_nanos(-2), &estimate)
}

/// By hand from the table in the documentation; an IEEE 754 number of 64 bits has its sign and exponent in the last two bytes.
const GOLDEN: [u8; 100] = [
    1, 13, 3, 0, // version, flags 1 + 4 + 8, reset counter, zero
    4, 3, 2, 1, // epoch
    0x0d, 0x0c, 0x0b, 0x0a, // sequence
    0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, // -2 ns
    0, 0, 0, 0, 0, 0, 0xf8, 0x3f, // x 1.5
    0, 0, 0, 0, 0, 0, 0x00, 0xc0, // y -2
    0, 0, 0, 0, 0, 0, 0xe0, 0x3f, // heading 0.5
    0, 0, 0, 0, 0, 0, 0x10, 0x40, // xx 4
    0, 0, 0, 0, 0, 0, 0xe0, 0x3f, // xy 0.5
    0, 0, 0, 0, 0, 0, 0xe0, 0xbf, // xh -0.5
    0, 0, 0, 0, 0, 0, 0x00, 0x40, // yy 2
    0, 0, 0, 0, 0, 0, 0xd0, 0x3f, // yh 0.25
    0, 0, 0, 0, 0, 0, 0xf0, 0x3f, // hh 1
    0, 0, 0x80, 0x3e, // forward speed 0.25
    0, 0, 0x80, 0xbf, // turn rate -1
];

#[test]
fn an_estimate_is_these_bytes_and_they_are_the_estimate() {
    assert_eq!(estimate().encode(), GOLDEN);
    assert_eq!(FleetEstimate::decode(&GOLDEN), Ok(estimate()));
}

#[test]
fn damaged_bytes_are_refused_with_their_reason() {
    let nan = f64::NAN.to_le_bytes();
    let with = |offset: usize, bytes: &[u8]| {
        let mut damaged = GOLDEN;
        damaged[offset..offset + bytes.len()].copy_from_slice(bytes);
        FleetEstimate::decode(&damaged)
    };
    assert_eq!(FleetEstimate::decode(&[]), Err(EstimateError::Length(0)));
    assert_eq!(FleetEstimate::decode(&GOLDEN[..99]), Err(EstimateError::Length(99)));
    assert_eq!(FleetEstimate::decode(&[&GOLDEN[..], &[0]].concat()), Err(EstimateError::Length(101)));
    assert_eq!(with(0, &[2]), Err(EstimateError::Version(2)));
    assert_eq!(with(1, &[16]), Err(EstimateError::Reserved(16)));
    assert_eq!(with(3, &[1]), Err(EstimateError::Reserved(13)));
    assert_eq!(with(4, &[0; 4]), Err(EstimateError::Epoch));
    for offset in (20..92).step_by(8) {
        assert_eq!(with(offset, &nan), Err(EstimateError::Number), "{offset}");
    }
    assert_eq!(with(36, &3.2_f64.to_le_bytes()), Err(EstimateError::Number), "not a wrapped heading");
    for offset in [44, 68, 84] {
        assert_eq!(with(offset, &(-1.0_f64).to_le_bytes()), Err(EstimateError::Number), "{offset}");
    }
    assert_eq!(with(92, &f32::INFINITY.to_le_bytes()), Err(EstimateError::Number));
    assert_eq!(EstimateError::Length(99).to_string(), "an estimate has 100 bytes, not 99");
}

proptest! {
    #[test]
    fn any_bytes_are_refused_or_encode_to_themselves(
        mut bytes in prop::collection::vec(any::<u8>(), 0..130),
        is_likely in any::<bool>(),
    ) {
        if is_likely {
            bytes.resize(100, 0);
            let (flags, heading_rad) = (bytes[1] % 16, f64::from(bytes[36]) / 128.0);
            bytes[..4].copy_from_slice(&[1, flags, 7, 0]);
            bytes[36..44].copy_from_slice(&heading_rad.to_le_bytes());
        }
        if let Ok(estimate) = FleetEstimate::decode(&bytes) {
            prop_assert_eq!(&estimate.encode()[..], &bytes[..]);
        }
    }
}
