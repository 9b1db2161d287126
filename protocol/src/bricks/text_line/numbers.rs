//! The numbers in a text, whatever stands between them.

/// A number and where it begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NumberText<'a> {
    pub(crate) at: usize,
    pub(crate) text: &'a str,
}

/// The numbers in `text`: digits with a sign, a point and an exponent. Digits in a name (`enc1`) and a minus behind a digit (`3-4`) are
/// no part of one; a unit may follow (`12mm`).
pub(crate) fn numbers(text: &str) -> Vec<NumberText<'_>> {
    let bytes = text.as_bytes();
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let before = at.checked_sub(1).and_then(|before| bytes.get(before)).copied();
        let begins = before.is_none_or(|byte| !(byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'.')));
        let length = if begins { number_length(bytes.get(at..).unwrap_or_default()) } else { 0 };
        if length == 0 {
            at += 1;
            continue;
        }
        found.extend(text.get(at..at + length).map(|text| NumberText { at, text }));
        at += length;
    }
    found
}

/// The length of the number at the beginning; 0 if there is none.
fn number_length(bytes: &[u8]) -> usize {
    let digits_from = |from: usize| bytes.iter().skip(from).take_while(|byte| byte.is_ascii_digit()).count();
    let is_at = |at: usize, letters: &[u8]| bytes.get(at).is_some_and(|byte| letters.contains(byte));
    let sign = usize::from(is_at(0, b"+-"));
    let whole = digits_from(sign);
    let mut end = sign + whole;
    let fraction = if is_at(end, b".") { digits_from(end + 1) } else { 0 };
    if whole + fraction == 0 {
        return 0;
    }
    if fraction > 0 || is_at(end, b".") {
        end += 1 + fraction;
    }
    if is_at(end, b"eE") {
        let sign = usize::from(is_at(end + 1, b"+-"));
        let exponent = digits_from(end + 1 + sign);
        if exponent > 0 {
            end += 1 + sign + exponent;
        }
    }
    end
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_among_words_units_and_names() {
        let cases: &[(&str, &[&str])] = &[
            ("L 100 R -200", &["100", "-200"]),
            ("t:12,l=+3;r=.5 g 1e-3", &["12", "+3", ".5", "1e-3"]),
            ("enc1: 7 enc_2: 8 d=12mm 3.5s", &["7", "8", "12", "3.5"]),
            ("3-4 1.2.3 5. - . e5 nan", &["3", "4", "1.2", "5."]),
            ("", &[]),
        ];
        for (text, expected) in cases {
            let found: Vec<&str> = numbers(text).iter().map(|number| number.text).collect();
            assert_eq!(found, *expected, "{text}");
        }
    }
}
