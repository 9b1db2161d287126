//! Command lines: those of the documentation are understood, those that make no sense are refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::support::{assert_refused, committed_data, descriptor, read_text, root, write_text};
use clap::Parser;
use clap::error::ErrorKind;
use posebridge::cli::{Cli, Command};
use posebridge::station::run::configuration;
use serde::Deserialize;

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
    let (mut found, mut with_bricks) = (0, 0);
    for page in pages() {
        for command in commands(&page) {
            // A value in quotes is one word.
            let words = command.split('"').enumerate().flat_map(|(number, part)| {
                if number % 2 == 1 { vec![part] } else { part.split_whitespace().collect() }
            });
            match Cli::try_parse_from(words) {
                // Those of the pages about bricks have what they name.
                Ok(Cli { command: Some(Command::Run(args)), .. }) if command.contains("config/robots") => {
                    configuration(&args).unwrap_or_else(|error| panic!("{command}: {error:#}"));
                    with_bricks += 1;
                }
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::DisplayHelp => {}
                Err(error) => panic!("{}: {command}: {error}", page.display()),
            }
            found += 1;
        }
    }
    assert!(found > 60 && with_bricks >= 5, "{found} commands, {with_bricks} with bricks");
}

#[derive(Deserialize)]
struct RefusedCommands {
    files: BTreeMap<String, String>,
    refused: Vec<RefusedCommand>,
}

#[derive(Deserialize)]
struct RefusedCommand {
    command: String,
    #[serde(default = "could_not_start")]
    code: i32,
    words: Vec<String>,
}

const fn could_not_start() -> i32 {
    2
}

#[test]
fn what_makes_no_sense_is_refused_with_a_reason_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let file: RefusedCommands = toml::from_str(&read_text(&root(), "tests/data/refused_commands.toml")).unwrap();
    for (name, text) in &file.files {
        write_text(folder, name, text);
    }
    assert!(file.refused.len() > 50);
    for RefusedCommand { command, code, words } in &file.refused {
        let command = command.replace("{data}", &committed_data()).replace("{optiodom}", &descriptor("optiodom.toml"));
        let command = command.replace("{lego}", &descriptor("lego-nxt-camera.toml"));
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        assert_refused(folder, &[(&command, *code, &words)]);
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), file.files.len(), "{command}");
    }
}
