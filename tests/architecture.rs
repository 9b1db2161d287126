//! Which crate and which part of `src/` may name which, checked against the manifests and sources.
//! The dependency table is that of `ARCHITECTURE.md`, [`PARTS`] the one of `src/`. A test fails with one sentence per violation, so
//! that a boundary changes only by a decision that can be seen in a diff. Manifests and sources are read as text; no network is needed.
#![expect(
    clippy::expect_used,
    reason = "helpers outside #[test] stop with a reason when the checkout itself is broken"
)]

#[path = "support/imports.rs"]
mod imports;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use cargo_metadata::{Dependency, DependencyKind, Metadata, MetadataCommand, Package};
use imports::{Imports, rust_files};

/// One crate and what it may name: a row of the code map of `ARCHITECTURE.md`.
struct Layer {
    /// The package name without `posebridge-`; the root package is `posebridge`.
    name: String,
    /// Bytes and time come in as arguments, actions go out as values. Others may name a runtime, a socket, a port, a thread.
    is_pure: bool,
    /// Which of our crates it may name.
    may_name: Vec<String>,
}

/// What "all" in the code map means: neither what is for microcontrollers nor the tests of the others.
const ALL: &str = "telemetry, protocol, estimator, recording, station, report, lab, sim, link, dashboard, vision, camera, fleet, zenoh";

/// The code map. A row stands there before its crate does; a crate without a row is a failure.
fn layers() -> BTreeMap<String, Layer> {
    let page = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("ARCHITECTURE.md"));
    let rows = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let [_, name, kind @ ("pure" | "IO"), may_name, ..] = cells[..] else { return None };
        let may_name = match may_name {
            "nothing of ours" => "",
            "all" => ALL,
            names => names,
        };
        let name = name.trim_matches('`').to_owned();
        let may_name = may_name.split(", ").map(str::to_owned).collect();
        Some((name.clone(), Layer { name, is_pure: kind == "pure", may_name }))
    });
    rows.collect()
}

/// The parts of `src/`, with the files and folders of each. A part imports from itself and from those before it. So nothing but `cli` names
/// the lab, which the feature of that name takes out of the program.
const PARTS: &[(&str, &[&str])] = &[
    ("base", &["console.rs", "exit.rs", "runtime.rs", "stderr_writer.rs", "text_file.rs"]),
    ("config", &["config"]),
    ("flags", &["flags.rs"]),
    ("station", &["station", "virtual_station.rs"]),
    ("tools", &["tools"]),
    ("lab", &["lab"]),
    ("cli", &["cli.rs", "examples.rs", "lib.rs", "main.rs"]),
];

/// Foreign crates that bring a runtime, a socket, a port or a thread; only crates that are not pure may name them directly.
const IO_CRATES: &[&str] = &[
    "tokio",
    "tokio-serial",
    "tokio-util",
    "serialport",
    "nix",
    "socket2",
    "bluer",
    "axum",
    "hyper",
    "hyper-util",
    "mio",
    "rustix",
    "ratatui",
    "crossterm",
    "zenoh",
];

/// Paths that reach the clock or the world, each as it is written where it is used.
const IMPURE_PATHS: &[&str] = &["Instant::now", "SystemTime::now", "thread::", "net::", "fs::"];

/// A value that opens nothing.
const PURE_PATHS: &[&str] = &["net::IpAddr"];

#[test]
fn every_crate_names_only_what_its_row_allows() {
    let metadata = workspace();
    let (members, layers) = (members(&metadata), layers());
    let mut violations = Vec::new();
    for (name, package) in &members {
        let Some(layer) = layers.get(*name) else {
            violations.push(format!("{name} has no row in the code map of ARCHITECTURE.md"));
            continue;
        };
        for dependency in &package.dependencies {
            let named = short(&dependency.name);
            // A foreign crate may have the short name of one of ours: `zenoh`.
            let is_ours = members.get(named).is_some_and(|member| member.name.as_str() == dependency.name);
            if is_ours && binds(layer, dependency) && !layer.may_name.iter().any(|name| name == named) {
                violations.push(format!("{name} names {named}, but may name only [{}]", layer.may_name.join(", ")));
            }
        }
    }
    assert_none(&violations);
}

#[test]
fn only_io_crates_name_a_runtime_a_socket_or_a_port() {
    let (metadata, layers) = (workspace(), layers());
    let mut violations = Vec::new();
    for (name, package) in members(&metadata) {
        let is_pure = layers.get(name).is_none_or(|layer| layer.is_pure);
        for dependency in &package.dependencies {
            let is_io = IO_CRATES.contains(&dependency.name.as_str());
            if is_pure && is_io && dependency.kind == DependencyKind::Normal {
                violations
                    .push(format!("{name} is pure but depends on {}: hand it bytes and time instead", dependency.name));
            }
        }
    }
    assert_none(&violations);
}

#[test]
fn pure_sources_touch_neither_clock_nor_world() {
    let (metadata, layers) = (workspace(), layers());
    let mut violations = Vec::new();
    for (name, package) in members(&metadata) {
        if layers.get(name).is_none_or(|layer| !layer.is_pure) {
            continue;
        }
        let folder = package.manifest_path.with_file_name("src");
        let files = rust_files(folder.as_std_path());
        assert!(!files.is_empty(), "{name} has no sources under {folder}");
        for file in files {
            for (line, path) in impure_lines(&read(&file)) {
                violations.push(format!(
                    "{name} is pure but {}:{line} says `{path}`: take time and bytes as arguments",
                    file.strip_prefix(&metadata.workspace_root).unwrap_or(&file).display()
                ));
            }
        }
    }
    assert_none(&violations);
}

#[test]
fn the_source_scan_sees_code_and_skips_comments_and_tests() {
    let source = "//! fs:: in prose\nuse std::fs::File;\nuse std::net::IpAddr; let offs::x;\n#[cfg(test)]\nmod tests;\n\
                  std::thread::spawn(f);\n#[cfg(test)]\nmod tests {\n    use std::net::TcpStream;\n}\n";
    assert_eq!(impure_lines(source), [(2, "fs::"), (6, "thread::")]);
}

#[test]
fn the_parts_of_the_program_import_only_from_those_before_them() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut violations = Vec::new();
    for file in rust_files(&src) {
        let file = file.strip_prefix(&src).expect("it lies below the folder");
        if part(file).is_none() {
            violations.push(format!("src/{} is in no row of PARTS", file.display()));
        }
    }
    for (file, imported) in &Imports::read(&src).edges {
        for (target, name) in imported.iter().filter(|(target, _)| part(target) > part(file)) {
            violations.push(format!("src/{} imports `{name}` from src/{}", file.display(), target.display()));
        }
    }
    assert_none(&violations);
}

/// In no crate. Methods of one type may stand in several files: `impl Station` in `commands.rs` and `observations.rs` imports from
/// `station.rs`, and a call of such a method is no import, because no path names its file. So the file that defines a type imports nothing
/// from those that add methods to it: what both need stands in a third file, such as `operator.rs` or `severity.rs`.
#[test]
fn no_files_of_a_crate_import_each_other_in_a_circle() {
    let metadata = workspace();
    let members = members(&metadata);
    let mut violations = Vec::new();
    for (name, package) in &members {
        let src = package.manifest_path.with_file_name("src");
        let circle = Imports::read(src.as_std_path()).circle();
        violations.extend(circle.map(|circle| format!("{name}: {circle}")));
    }
    assert_none(&violations);
}

#[test]
fn the_import_scan_follows_re_exports_and_skips_tests() {
    let crate_of = |files: &[(&str, &str)]| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (name, text) in files {
            fs::write(folder.path().join(name), text).expect("a file in it");
        }
        Imports::read(folder.path())
    };
    let root = "mod a; mod b; pub use a::One;";
    let b = "pub struct Two(u8); #[cfg(test)] mod tests { use crate::a::One; }";
    // By the root's re-export, in a bracket, and not by what only tests import.
    let one_way = crate_of(&[("lib.rs", root), ("a.rs", "use crate::b::{Two as T}; pub struct One(T);"), ("b.rs", b)]);
    assert_eq!(one_way.circle(), None);
    assert_eq!(one_way.edges[Path::new("a.rs")][Path::new("b.rs")], "crate::b::Two");
    let circle = crate_of(&[
        ("lib.rs", root),
        ("a.rs", "use crate::b::Two; pub struct One(Two);"),
        ("b.rs", "pub struct Two(u8); fn f(x: &crate::One) { x.g() }"),
    ]);
    let said = "a.rs imports `crate::b::Two` from b.rs, b.rs imports `crate::One` from a.rs";
    assert_eq!(circle.circle().as_deref(), Some(said));
    // A parent that uses what it re-exports, and a child that uses its parent.
    let parent = crate_of(&[
        ("lib.rs", "mod a; pub use a::One; pub trait Root {} pub const ALL: [One; 0] = [];"),
        ("a.rs", "use super::Root; pub struct One; impl Root for One {}"),
    ]);
    let said = "a.rs imports `super::Root` from lib.rs, lib.rs imports `a::One` from a.rs";
    assert_eq!(parent.circle().as_deref(), Some(said));
}

/// The place in [`PARTS`] of a file below `src/`.
fn part(file: &Path) -> Option<usize> {
    let first = file.iter().next()?;
    PARTS.iter().position(|(_, content)| content.iter().any(|name| first == *name))
}

/// Whether a dependency binds its crate to the table. Tests may look further than the code that they test, except in
/// the simulator, whose tests must not be written with the filter in view.
fn binds(layer: &Layer, dependency: &Dependency) -> bool {
    dependency.kind != DependencyKind::Development || layer.name == "sim"
}

/// What Cargo knows about the members alone; resolves nothing and so needs no network.
fn workspace() -> Metadata {
    MetadataCommand::new()
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .no_deps()
        .other_options(["--offline".to_owned()])
        .exec()
        .expect("cargo metadata reads the manifests that Cargo has just built from")
}

/// The workspace's members by short name.
fn members(metadata: &Metadata) -> BTreeMap<&str, &Package> {
    let packages = metadata.workspace_packages();
    assert!(packages.len() > 1, "the workspace has no members");
    packages.into_iter().map(|package| (short(&package.name), package)).collect()
}

/// A package's name as the table writes it.
fn short(package: &str) -> &str {
    package.strip_prefix("posebridge-").unwrap_or(package)
}

/// Lines, counted from 1, whose code names an impure path. Unit tests stand last in a file and are left out.
fn impure_lines(source: &str) -> Vec<(usize, &'static str)> {
    let lines: Vec<&str> = source.lines().map(str::trim).collect();
    let end =
        lines.windows(2).position(|pair| pair[0] == "#[cfg(test)]" && pair[1].ends_with('{')).unwrap_or(lines.len());
    let mut found = Vec::new();
    for (index, line) in lines[..end].iter().enumerate() {
        let is_code = !line.starts_with("//") && !PURE_PATHS.iter().any(|path| names_path(line, path));
        for path in IMPURE_PATHS {
            if is_code && names_path(line, path) {
                found.push((index + 1, *path));
            }
        }
    }
    found
}

/// Whether `path` stands in `line` as a path of its own and not as the tail of a longer name.
fn names_path(line: &str, path: &str) -> bool {
    line.match_indices(path).any(|(start, _)| {
        let before = line[..start].chars().next_back();
        before.is_none_or(|c| !c.is_alphanumeric() && c != '_')
    })
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).expect("a file of the checkout can be read")
}

fn assert_none(violations: &[String]) {
    assert!(violations.is_empty(), "\n{}", violations.join("\n"));
}
