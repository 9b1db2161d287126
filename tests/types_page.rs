//! `docs/types.md`: every public type of the libraries with the first sentence of its documentation, so that the vocabulary can be read
//! from end to end.

#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when the checkout itself is broken")]

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// The libraries in the order of the page, each with its folder of sources.
const LIBRARIES: &[(&str, &str)] = &[
    ("telemetry", "crates/telemetry/src"),
    ("protocol", "protocol/src"),
    ("estimator", "crates/estimator/src"),
    ("station", "crates/station/src"),
    ("recording", "crates/recording/src"),
    ("link", "crates/link/src"),
    ("dashboard", "crates/dashboard/src"),
    ("report", "crates/report/src"),
    ("lab", "crates/lab/src"),
    ("sim", "sim/src"),
];

/// A public type.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct PublicType {
    name: String,
    summary: String,
}

#[test]
fn the_page_of_types_is_up_to_date() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = root.join("docs/types.md");
    let page = render_page(root);
    if fs::read_to_string(&path).unwrap_or_default() != page {
        fs::write(&path, page).unwrap();
        panic!("docs/types.md is brought up to date: read it, then commit it with the types that it lists");
    }
}

#[test]
fn the_scan_takes_public_types_with_the_first_sentence_of_their_documentation() {
    let source = "/// A clock\n/// of 1.5 Hz. More.\n#[derive(Debug)]\npub struct Clock<C> {\n}\n/// Hidden.\npub(crate) struct Inner;\n\
                  /// Two.\npub enum Two {}\n#[cfg(test)]\nmod tests {\n/// Test.\npub struct Fake;\n}\n";
    let found = public_types(source);
    let found: Vec<_> = found.iter().map(|one| (one.name.as_str(), one.summary.as_str())).collect();
    assert_eq!(found, [("Clock", "A clock of 1.5 Hz."), ("Two", "Two.")]);
}

fn render_page(root: &Path) -> String {
    let mut page = String::from(
        "# Public types\n\nEvery public type of the libraries. `cargo test --test types_page` writes this page from the sources.\n",
    );
    for (name, folder) in LIBRARIES {
        let mut types: Vec<PublicType> = Vec::new();
        for file in rust_files(&root.join(folder)) {
            types.extend(public_types(&fs::read_to_string(&file).expect("a source can be read")));
        }
        types.sort();
        let _ = writeln!(page, "\n## {name}\n\n| type | what it is |\n|---|---|");
        let (described, named): (Vec<_>, Vec<_>) = types.into_iter().partition(|one| !one.summary.is_empty());
        for PublicType { name, summary } in described {
            let _ = writeln!(page, "| `{name}` | {} |", summary.replace('|', "\\|"));
        }
        if !named.is_empty() {
            let names: Vec<_> = named.iter().map(|one| format!("`{}`", one.name)).collect();
            let _ = writeln!(page, "\nDescribed by their names: {}.", names.join(", "));
        }
    }
    page
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry of it").path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

fn public_types(source: &str) -> Vec<PublicType> {
    let mut types = Vec::new();
    let mut documentation = String::new();
    for line in source.lines() {
        if line.starts_with("#[cfg(test)]") {
            break;
        }
        if let Some(text) = line.strip_prefix("///") {
            documentation += text;
            continue;
        }
        let item = line.strip_prefix("pub ").and_then(|item| item.split_once(' '));
        if let Some(("struct" | "enum" | "trait", rest)) = item {
            let name: String = rest.chars().take_while(|letter| letter.is_alphanumeric()).collect();
            let sentence = documentation.split_inclusive(". ").next().unwrap_or_default();
            types.push(PublicType { name, summary: sentence.trim().to_owned() });
            documentation.clear();
        } else if !line.starts_with("#[") && !line.starts_with("    ") {
            documentation.clear();
        }
    }
    types
}
