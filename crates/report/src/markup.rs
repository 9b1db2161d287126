//! Escaping of text in SVG and HTML.
//!
//! Source: characters as in W3C, XML 1.0 (fifth edition), section 2.2; percent-encoding as in RFC 3986, section 2.

use std::fmt;

use posebridge_telemetry::is_printable;

/// Escapes markup and replaces characters that XML forbids or that are not printable.
pub(crate) struct Escaped<'a>(pub(crate) &'a str);

impl fmt::Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for character in self.0.chars() {
            match character {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\t' | '\n' | '\r' => f.write_str(" ")?,
                '\u{fffe}' | '\u{ffff}' => f.write_str("\u{fffd}")?,
                other if is_printable(other) => write!(f, "{other}")?,
                _ => f.write_str("\u{fffd}")?,
            }
        }
        Ok(())
    }
}

/// Bytes as the data part of a URL.
pub(crate) struct PercentEncoded<'a>(pub(crate) &'a str);

impl fmt::Display for PercentEncoded<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for byte in self.0.bytes() {
            if byte.is_ascii_alphanumeric() || b"-._~/:=;,".contains(&byte) {
                write!(f, "{}", char::from(byte))?;
            } else {
                write!(f, "%{byte:02X}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_and_forbidden_characters_in_a_text_are_harmless() {
        assert_eq!(
            Escaped("a<b> & \"c\"\u{1}\nd\u{202e}").to_string(),
            "a&lt;b&gt; &amp; &quot;c&quot;\u{fffd} d\u{fffd}"
        );
    }

    #[test]
    fn what_a_url_cannot_hold_is_encoded_byte_by_byte() {
        assert_eq!(PercentEncoded("<a b=\"#1%\">ä").to_string(), "%3Ca%20b=%22%231%25%22%3E%C3%A4");
    }
}
