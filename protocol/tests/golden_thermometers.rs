//! Temperatures in frames made by a foreign implementation; see golden.rs.

#![expect(clippy::expect_used, reason = "helpers of tests")]

#[path = "support/golden.rs"]
mod frames;

use frames::{check, decode_golden};
use posebridge_protocol::message::{Message, NamedValue, SCALED_PRESSURE_CHANNEL, WireStamp};
use posebridge_telemetry::{Celsius, ChannelName};

/// What a thermometer of SCALED_PRESSURE says.
fn scaled_pressure(temperature: f64) -> Message {
    Message::Thermometer {
        stamp: WireStamp::Millis32(123_456),
        channel: ChannelName::from_bytes(SCALED_PRESSURE_CHANNEL),
        temperature: Celsius(temperature),
    }
}

/// What a named thermometer says at the last instant of a counter of milliseconds.
fn named_temperature(name: &str, temperature: f64) -> Message {
    Message::Thermometer {
        stamp: WireStamp::Millis32(u32::MAX),
        channel: ChannelName::from_bytes(name.as_bytes()),
        temperature: Celsius(temperature),
    }
}

#[test]
fn thermometers() {
    // The pressures of the frame are of no use here.
    assert_eq!(decode_golden("scaled_pressure").unwrap(), Some(scaled_pressure(-12.34)));
    check("scaled_pressure_without_pressures", &scaled_pressure(48.71));
    check("named_temperature", &named_temperature("temp1", 36.25));
    check("named_temperature_without_terminator", &named_temperature("temp_water", -40.5));
    check(
        "named_value_of_another_kind",
        &Message::NamedValue(NamedValue {
            stamp: WireStamp::Millis32(u32::MAX),
            name: ChannelName::from_bytes(b"voltage"),
            value: 7.5,
        }),
    );
}

#[test]
fn temperatures_that_cannot_be_are_refused() {
    for (name, message_id) in [
        ("scaled_pressure_below_absolute_zero", 29),
        ("named_temperature_not_a_number", 251),
        ("named_temperature_infinite", 251),
        ("named_temperature_too_hot", 251),
    ] {
        let refused = decode_golden(name).expect_err(name);
        assert_eq!(refused.message_id(), message_id, "{name}");
    }
}
