//! Command lines: those of the documentation are understood, those that make no sense are refused.

use std::path::{Path, PathBuf};

use crate::support::{assert_refused, root};
use clap::Parser;
use clap::error::ErrorKind;
use posebridge::cli::Cli;

fn pages() -> Vec<PathBuf> {
    let mut pages = vec![root().join("README.md")];
    for folder in ["docs", "docs/protocols"] {
        let files = std::fs::read_dir(root().join(folder)).unwrap().map(|entry| entry.unwrap().path());
        pages.extend(files.filter(|path| path.extension().is_some_and(|extension| extension == "md")));
    }
    pages
}

/// The commands in the fenced blocks of a page with their continuation lines, without comments and redirections.
fn commands(page: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(page).unwrap().replace("\\\n", " ");
    let blocks = text.split("\n```").skip(1).step_by(2);
    let mut commands = Vec::new();
    for line in blocks.flat_map(str::lines).filter(|line| line.starts_with("posebridge ")) {
        let ends = [" #", " > ", " | "].into_iter().filter_map(|end| line.find(end));
        let command = &line[..ends.min().unwrap_or(line.len())];
        commands.push(command.replace('\'', ""));
    }
    commands
}

#[test]
fn every_command_of_the_documentation_is_understood() {
    let mut found = 0;
    for page in pages() {
        for command in commands(&page) {
            // A value in quotes is one word.
            let words = command.split('"').enumerate().flat_map(|(number, part)| {
                if number % 2 == 1 { vec![part] } else { part.split_whitespace().collect() }
            });
            match Cli::try_parse_from(words) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::DisplayHelp => {}
                Err(error) => panic!("{}: {command}: {error}", page.display()),
            }
            found += 1;
        }
    }
    assert!(found > 60, "{found} commands");
}

/// Whoever gave such a flag would believe that it did something.
#[test]
fn flags_that_make_no_sense_or_do_not_go_together_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    assert_refused(
        folder.path(),
        &[
            // Numbers that cannot be.
            ("run --duration=-1", 2, &["--duration"]),
            ("run --duration nan", 2, &["--duration"]),
            ("run --until-silent inf", 2, &["--until-silent"]),
            ("run --laps 0", 2, &["--laps"]),
            ("play x.toml --listen pty:x --speed 0", 2, &["--speed"]),
            // Two sources.
            ("lab nxt-square --link tcp://127.0.0.1:9 --recording a.mcap", 2, &["--recording", "cannot be used with"]),
            // How a live robot is recorded, of a recording that is there.
            ("lab wall --recording a.mcap --duration 3", 2, &["--duration"]),
            ("calibrate umbmark a.mcap --config c.toml", 2, &["--config"]),
            // What only a real robot has, and what only the simulation has.
            ("identify rest --set a=1", 2, &["--set"]),
            ("identify step --recording a.csv --sim motor", 2, &["--sim"]),
            ("tune --sim camera-1hz --hold-out r", 2, &["--hold-out"]),
            ("calibrate path a.mcap --online --hold track", 2, &["--hold"]),
            ("replay x.mcap --use-every 4", 2, &["--use-every"]),
        ],
    );
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "what is refused leaves nothing behind");
}
