//! Any text as a link: a URL prints as it was written, and an error names what is wrong.

use posebridge::config::LinkTarget;
use posebridge_link::{LinkUrl, OptionKind};

/// Input: the text; bytes that are none are replaced.
pub(crate) fn check(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    // The station reads links through this; it must not disagree with the parser about what is a link of a transport.
    let target = LinkTarget::parse(&text);
    match LinkUrl::parse(&text) {
        Ok(url) => {
            assert!(matches!(target, Ok(LinkTarget::Url(_))), "{text:?}");
            check_link(&url);
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            assert!(!matches!(target, Ok(LinkTarget::Url(_))), "{text:?}");
        }
    }
}

fn check_link(url: &LinkUrl) {
    let printed = url.to_string();
    assert_eq!(LinkUrl::parse(&printed).as_ref(), Ok(url), "{printed:?}");
    for option in url.transport().options() {
        match option.kind {
            OptionKind::Integer { min, max, .. } => {
                assert!((min..=max).contains(&url.integer(option)), "{printed:?}");
            }
            OptionKind::Choice { words } => {
                let word = url.option_text(option);
                assert!(words.contains(&word.as_str()), "{printed:?}");
            }
            OptionKind::HexDigits { count } => {
                let digits = url.option_text(option).len();
                assert!(digits == 0 || digits == count, "{printed:?}");
            }
        }
    }
}
