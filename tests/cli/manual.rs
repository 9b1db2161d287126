//! Manual pages and completions: they name what the program has.

use std::process::Command;

use crate::support::{read_text, run};
use clap::ValueEnum;
use clap_complete::Shell;
use posebridge::cli::program;
use posebridge::tools::man::pages;

/// The program's definition and those of all its subcommands, each with the name of its page.
fn definitions() -> Vec<(String, clap::Command)> {
    fn add(command: &clap::Command, name: &str, all: &mut Vec<(String, clap::Command)>) {
        all.push((name.to_owned(), command.clone()));
        for one in command.get_subcommands() {
            add(one, &format!("{name}-{}", one.get_name()), all);
        }
    }
    let mut all = Vec::new();
    add(&program(), "posebridge", &mut all);
    all
}

fn flags_of(command: &clap::Command) -> impl Iterator<Item = &str> {
    command.get_arguments().filter(|flag| !flag.is_hide_set()).filter_map(clap::Arg::get_long)
}

#[test]
fn every_subcommand_has_a_page_that_names_its_flags_and_is_roff_without_fault() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    run(folder, &["man", "--out", "man1"]);
    let made = pages(program()).unwrap();
    let definitions = definitions();
    assert_eq!(std::fs::read_dir(folder.join("man1")).unwrap().count(), definitions.len());
    assert_eq!(made.len(), definitions.len());
    for (name, command) in definitions {
        let file = format!("{name}.1");
        let roff = read_text(&folder.join("man1"), &file);
        assert_eq!(roff, made.iter().find(|page| page.file == file).unwrap().roff);
        // Hyphens are escaped, and fonts change within a flag.
        let text = ["\\fB", "\\fI", "\\fR"].iter().fold(roff.replace("\\-", "-"), |text, font| text.replace(font, ""));
        let flags = flags_of(&command).map(|flag| format!("--{flag}"));
        let below = command.get_subcommands().map(|one| format!("{name}-{}(1)", one.get_name()));
        for word in flags.chain(below) {
            assert!(text.contains(&word), "{name} lacks {word}:\n{text}");
        }
        // Where there is a formatter on this computer, it has nothing to complain about.
        let page = folder.join("man1").join(&file);
        if let Ok(formatted) = Command::new("groff").args(["-man", "-Tutf8", "-ww", "-z"]).arg(page).output() {
            assert_eq!(String::from_utf8_lossy(&formatted.stderr), "", "{file}");
        }
    }
    assert_eq!(run(folder, &["man"]), made[0].roff);
}

#[test]
fn completion_scripts_name_every_subcommand_and_flag_and_shells_read_them() {
    let folder = tempfile::tempdir().unwrap();
    for shell in Shell::value_variants() {
        let shell = shell.to_string();
        let script = run(folder.path(), &["completions", &shell]);
        for (page, command) in definitions().into_iter().skip(1) {
            // fish writes flags without their hyphens.
            for word in flags_of(&command).chain([command.get_name()]) {
                assert!(script.contains(word), "{shell} lacks {page} {word}");
            }
        }
        // The generator has no values for some shells, and for fish only those of flags.
        let (of_flags, of_words) =
            (["ekf5-camera", "nxt-push", "bluetooth-spp"].as_slice(), ["figure-eight", "arduino-2wd"].as_slice());
        let offered = match shell.as_str() {
            "bash" | "zsh" => [of_flags, of_words].concat(),
            "fish" => of_flags.to_vec(),
            _ => Vec::new(),
        };
        for value in offered {
            assert!(script.contains(value), "{shell} does not offer {value}");
        }
        let path = folder.path().join(&shell);
        std::fs::write(&path, script).unwrap();
        if ["bash", "zsh", "fish"].contains(&shell.as_str())
            && let Ok(read) = Command::new(&shell).arg("-n").arg(&path).output()
        {
            let complaints = String::from_utf8_lossy(&read.stderr);
            assert!(read.status.success() && complaints.is_empty(), "{shell}: {complaints}");
        }
    }
}
