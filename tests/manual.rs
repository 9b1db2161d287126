//! Manual pages and completions: they name what the program has.

mod support;

use std::path::Path;
use std::process::{Command, Stdio};

use clap::{CommandFactory, ValueEnum};
use clap_complete::Shell;
use posebridge::cli::Cli;
use posebridge::tools::man::{ManPage, pages};
use support::{posebridge, stdout_of};

/// The program's definition and those of all its subcommands, each with the name of its page.
fn definitions() -> Vec<(String, clap::Command)> {
    fn add(command: &clap::Command, name: &str, all: &mut Vec<(String, clap::Command)>) {
        all.push((name.to_owned(), command.clone()));
        for one in command.get_subcommands() {
            add(one, &format!("{name}-{}", one.get_name()), all);
        }
    }
    let mut all = Vec::new();
    add(&Cli::command(), "posebridge", &mut all);
    all
}

fn flags_of(command: &clap::Command) -> Vec<String> {
    let flags = command.get_arguments().filter(|flag| !flag.is_hide_set());
    flags.filter_map(|flag| flag.get_long().map(|long| format!("--{long}"))).collect()
}

/// Roff as it is read: hyphens are escaped there, and fonts changed.
fn plain(roff: &str) -> String {
    let mut text = roff.replace("\\-", "-");
    for font in ["\\fB", "\\fI", "\\fR"] {
        text = text.replace(font, "");
    }
    text
}

#[test]
fn there_is_a_page_of_every_subcommand_and_it_names_every_flag() {
    let made = pages(Cli::command()).unwrap();
    let mut files: Vec<&str> = made.iter().map(|page| page.file.as_str()).collect();
    let mut expected: Vec<String> = definitions().into_iter().map(|(name, _)| name + ".1").collect();
    files.sort_unstable();
    expected.sort();
    assert_eq!(files, expected);
    for (name, command) in definitions() {
        let page = made.iter().find(|page| page.file == format!("{name}.1"));
        let text = plain(&page.unwrap().roff);
        for flag in flags_of(&command) {
            assert!(text.contains(&flag), "{name} lacks {flag}:\n{text}");
        }
        for one in command.get_subcommands() {
            let below = format!("{name}-{}(1)", one.get_name());
            assert!(text.contains(&below), "{name} lacks {below}:\n{text}");
        }
        assert!(text.starts_with(".ie") || text.contains(".TH "), "{text}");
    }
}

/// What a formatter complains about; nothing, where there is none on this computer.
fn complaints(page: &ManPage, folder: &Path) -> String {
    let path = folder.join(&page.file);
    let formatted =
        Command::new("groff").args(["-man", "-Tutf8", "-ww", "-z"]).arg(&path).stdin(Stdio::null()).output();
    match formatted {
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(_no_groff) => String::new(),
    }
}

#[test]
fn the_pages_are_written_into_a_folder_and_are_roff_without_fault() {
    let folder = tempfile::tempdir().unwrap();
    let written = folder.path().join("man1");
    stdout_of(posebridge(folder.path()).args(["man", "--out", "man1"]));
    let made = pages(Cli::command()).unwrap();
    assert_eq!(std::fs::read_dir(&written).unwrap().count(), made.len());
    for page in &made {
        let text = std::fs::read_to_string(written.join(&page.file)).unwrap();
        assert_eq!(text, page.roff);
        assert_eq!(complaints(page, &written), "", "{}", page.file);
    }
    let printed = stdout_of(posebridge(folder.path()).arg("man"));
    assert_eq!(printed, made[0].roff);
}

#[test]
fn every_completion_script_names_every_subcommand_and_flag() {
    let folder = tempfile::tempdir().unwrap();
    for shell in Shell::value_variants() {
        let name = shell.to_string();
        let script = stdout_of(posebridge(folder.path()).args(["completions", &name]));
        for (page, command) in definitions().into_iter().skip(1) {
            let word = command.get_name();
            assert!(script.contains(word), "{name} lacks {page}");
            // fish writes flags without their hyphens.
            for flag in flags_of(&command) {
                let bare = flag.trim_start_matches('-');
                assert!(script.contains(bare), "{name} lacks {page} {flag}");
            }
        }
    }
}

/// The shells that are on this computer read their script without a word.
#[test]
fn shells_read_their_scripts() {
    let folder = tempfile::tempdir().unwrap();
    for (shell, check) in [("bash", "-n"), ("zsh", "-n"), ("fish", "-n")] {
        let script = stdout_of(posebridge(folder.path()).args(["completions", shell]));
        let path = folder.path().join(shell);
        std::fs::write(&path, script).unwrap();
        if let Ok(read) = Command::new(shell).arg(check).arg(&path).output() {
            let said = String::from_utf8_lossy(&read.stderr);
            assert!(read.status.success() && said.is_empty(), "{shell}: {said}");
        }
    }
}
