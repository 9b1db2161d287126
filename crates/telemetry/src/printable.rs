//! Text from outside (messages, names, file contents), made safe to show in a line of a terminal, a page or a log.

/// Stands for what is not printable.
const REPLACEMENT: char = '?';

/// Whether a character may be shown: it steers no terminal, ends no line and does not change the direction of its neighbours
/// (Unicode, UAX 9: a text may pretend to be another one by that).
pub const fn is_printable(letter: char) -> bool {
    !matches!(
        letter,
        '\0'..='\u{1f}' | '\u{7f}'..='\u{9f}' | '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    )
}

/// The text with a question mark in place of each character that is not printable.
pub fn printable(text: &str) -> String {
    text.chars().map(|letter| if is_printable(letter) { letter } else { REPLACEMENT }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_or_turns_a_text_round_is_replaced_and_nothing_else() {
        assert_eq!(printable("\u{1b}[2J\u{9b}2J a\tb\r\nc\u{7f}"), "?[2J?2J a?b??c?");
        assert_eq!(printable("a\u{202e}b\u{2066}c\u{2028}d\u{200f}e"), "a?b?c?d?e");
        let names = "Müller 机器人 5 °C ± – … 😀";
        assert_eq!(printable(names), names);
        for letter in '\0'..=char::MAX {
            assert!(!(letter.is_control() && is_printable(letter)), "{letter:?}");
        }
    }
}
