//! Looking up a file by its name among those that come with the program.

/// Names of files and their texts.
pub(crate) type Bundle = &'static [(&'static str, &'static str)];

/// The text under this name.
///
/// # Errors
/// There is none; the names that exist, joined by commas.
pub(crate) fn text_of(bundle: Bundle, name: &str) -> Result<&'static str, String> {
    let found = bundle.iter().find(|(known, _)| *known == name);
    found.map(|(_, text)| *text).ok_or_else(|| {
        let names: Vec<&str> = bundle.iter().map(|(known, _)| *known).collect();
        names.join(", ")
    })
}
