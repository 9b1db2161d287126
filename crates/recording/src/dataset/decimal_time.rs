//! Timestamps of tables: decimal numbers to nanoseconds, exactly.

/// More than any clock prints; further digits of a fraction are dropped.
const MAX_DIGITS: u32 = 30;
/// Beyond any time in use; keeps the arithmetic inside 128 bits.
const MAX_EXPONENT: i32 = 40;

/// Nanoseconds of a decimal number in units of ten to the `unit_exponent` seconds, rounded to the nearest (half away from zero); `None`
/// if it is not a decimal number or overflows.
///
/// Exact: a Unix time with nanoseconds has 19 digits and does not fit an `f64`, which is off by up to 0.1 microseconds and can make two
/// timestamps equal.
pub(super) fn decimal_nanos(text: &str, unit_exponent: i32) -> Option<i64> {
    let (negative, digits) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let (number, exponent) = match digits.split_once(['e', 'E']) {
        Some((number, exponent)) => (number, exponent.parse::<i32>().ok()?),
        None => (digits, 0),
    };
    if !(-MAX_EXPONENT..=MAX_EXPONENT).contains(&exponent) {
        return None;
    }
    let (mantissa, fraction_digits) = mantissa(number)?;
    let magnitude = scale(mantissa, exponent + unit_exponent + 9 - fraction_digits)?;
    i64::try_from(if negative { -magnitude } else { magnitude }).ok()
}

/// The digits as one integer, and the number of decimals.
fn mantissa(number: &str) -> Option<(i128, i32)> {
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    let (mut mantissa, mut digits, mut fraction_digits) = (0_i128, 0_u32, 0_i32);
    for (position, byte) in whole.bytes().chain(fraction.bytes()).enumerate() {
        if !byte.is_ascii_digit() {
            return None;
        }
        let is_fraction = position >= whole.len();
        if digits >= MAX_DIGITS {
            if is_fraction {
                continue;
            }
            return None;
        }
        mantissa = mantissa * 10 + i128::from(byte - b'0');
        digits += u32::from(mantissa != 0);
        fraction_digits += i32::from(is_fraction);
    }
    Some((mantissa, fraction_digits))
}

/// `value` times ten to the `power`, rounded half up.
fn scale(value: i128, power: i32) -> Option<i128> {
    let factor = 10_i128.checked_pow(power.unsigned_abs());
    if power >= 0 {
        return match value {
            0 => Some(0),
            _ => value.checked_mul(factor?),
        };
    }
    // A divisor beyond 128 bits leaves nothing of a number of at most 30 digits.
    Some(factor.map_or(0, |divisor| (value + divisor / 2) / divisor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_keep_every_nanosecond() {
        assert_eq!(decimal_nanos("1493325165.641284114", 0), Some(1_493_325_165_641_284_114));
        assert_eq!(decimal_nanos("0.0500000000000114", 0), Some(50_000_000));
        assert_eq!(decimal_nanos("378", -3), Some(378_000_000));
        assert_eq!(decimal_nanos("-1.5", -3), Some(-1_500_000));
        assert_eq!(decimal_nanos("12043.0", -3), Some(12_043_000_000));
        assert_eq!(decimal_nanos("1.5e3", -6), Some(1_500_000));
        assert_eq!(decimal_nanos("+.25", 0), Some(250_000_000));
        assert_eq!(decimal_nanos("0.6", -9), Some(1));
        assert_eq!(decimal_nanos("-0.5", -9), Some(-1));
        assert_eq!(decimal_nanos("0.00000000000000000000000000000000000000001", 0), Some(0));
    }

    #[test]
    fn what_is_not_a_decimal_number_is_refused() {
        for text in [
            "",
            "-",
            ".",
            "e5",
            "1e",
            "1e99",
            "nan",
            "inf",
            "1.2.3",
            "0x10",
            "1 2",
            "٣",
            "9223372037",
            "99999999999999999999999999999999999999999999",
        ] {
            assert_eq!(decimal_nanos(text, 0), None, "{text:?}");
        }
    }
}
