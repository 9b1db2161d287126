//! Any text that people or programs give: a link, a configuration, a command of the dashboard. It is rejected with the place or the
//! reason, or it can be printed and read again.

use posebridge::config::{Config, LinkTarget, Loaded, load_text, print};
use posebridge_dashboard::command::{COMMANDS, parse};
use posebridge_link::{LinkUrl, OptionKind};
use posebridge_telemetry::Command;

/// Input: the text; bytes that are none are replaced.
pub(crate) fn check_url(data: &[u8]) {
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
            OptionKind::Choice { choices } => {
                let word = url.option_text(option);
                assert!(choices.contains(&word.as_str()), "{printed:?}");
            }
            OptionKind::HexDigits { count } => {
                let digits = url.option_text(option).len();
                assert!(digits == 0 || digits == count, "{printed:?}");
            }
        }
    }
}

/// Input: the text of a configuration file.
pub(crate) fn check_config(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        // The program reads the file as text; what is none never comes this far.
        return;
    };
    match load_text("fuzz.toml", text, &[]) {
        Ok(loaded) => check_loaded(&loaded),
        Err(error) => assert_names_a_place(&error.to_string()),
    }
}

fn check_loaded(loaded: &Loaded) {
    let config = &loaded.config;
    if let Err(error) = config.targets() {
        assert_names_a_place(&format!("{error:#}"));
    }
    if let Err(error) = config.station_config() {
        assert_names_a_place(&format!("{error:#}"));
    }
    assert!(print(loaded).is_ok(), "a configuration cannot be printed");
    let written = written(config);
    match load_text("again.toml", &written, &[]) {
        // Compared as text, because a number that is none differs from itself.
        Ok(again) => assert_eq!(written, self::written(&again.config)),
        Err(error) => panic!("{error}\n{written}"),
    }
}

/// The configuration as the file that holds all of it; recordings keep it in this form.
fn written(config: &Config) -> String {
    match toml::to_string(config) {
        Ok(text) => text,
        Err(error) => panic!("a configuration cannot be written: {error}"),
    }
}

/// Somebody who reads the message must find the place: a line of the file, or a key between backticks.
fn assert_names_a_place(message: &str) {
    let inside = message.strip_prefix("configuration `fuzz.toml`: ").unwrap_or(message);
    assert!(inside.contains("line ") || inside.contains('`'), "neither a line nor a key: {message}");
}

/// Longer than the longest refusal, which lists all commands.
const LONGEST_REFUSAL: usize = 1_000;

/// Input: the text.
pub(crate) fn check_dashboard_command(data: &[u8]) {
    match parse(data) {
        Ok(parsed) => {
            let name = parsed.name;
            assert!(COMMANDS.iter().any(|row| row.name == name), "{name}");
            if let Command::Simulator(simulated) = parsed.command {
                assert_eq!(simulated.name(), name);
                assert_eq!(simulated.validate(), Ok(()));
            }
            assert_eq!(parse(data), Ok(parsed), "the same text twice");
        }
        Err(error) => {
            let why = error.to_string();
            assert!(!why.is_empty() && why.len() < LONGEST_REFUSAL, "{why}");
            assert!(!why.contains(char::is_control), "{why:?}");
        }
    }
}
