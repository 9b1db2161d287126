//! Any text as a configuration: it is rejected with a key or a line, or it can be printed, read again and built.

use posebridge::config::{Config, Loaded, load_text, print};

/// Input: the text of a configuration file.
pub(crate) fn check(data: &[u8]) {
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
