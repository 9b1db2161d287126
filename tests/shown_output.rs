//! What the pages show of the program's output is what it prints.
//!
//! Behind `<!-- shows: ARGS -->` stands a fenced block with what `posebridge ARGS` prints, or with `lines=N` its first lines. `shows page: NAME`
//! is a manual page as a reader sees it, `shows in bash: WORDS` what the completion offers. After a change
//! `POSEBRIDGE_WRITE_DOCS=1 cargo test --test shown_output` writes the blocks anew.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::process::Command;

use clap::CommandFactory;
use posebridge::cli::Cli;
use posebridge::tools::man::pages;
use support::{posebridge, root, stdout_of};

const PAGES: [&str; 2] = ["README.md", "docs/getting-started.md"];
/// A page is shown as on a terminal of this width.
const WIDTH: usize = 80;

/// A block that shows something.
struct OutputBlock {
    /// What stands between `shows` and the end of the comment.
    what: String,
    /// Its lines, and where the first of them stands in the page.
    lines: Vec<String>,
    begin: usize,
}

fn shown_in(page: &str) -> Vec<OutputBlock> {
    let lines: Vec<&str> = page.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let Some(what) = line.strip_prefix("<!-- shows") else {
            continue;
        };
        assert!(lines[at + 1].starts_with("```"), "{line} needs a block behind it");
        let begin = at + 2;
        let end = lines[begin..].iter().position(|line| *line == "```").unwrap();
        found.push(OutputBlock {
            what: what.trim_end_matches("-->").trim().to_owned(),
            lines: lines[begin..begin + end].iter().map(ToString::to_string).collect(),
            begin,
        });
    }
    found
}

/// What is really printed, and how many lines of it are shown; `None` where this computer lacks what shows it.
fn real(what: &str) -> (Option<Vec<String>>, Option<usize>) {
    let (what, count) = match what.split_once(" lines=") {
        Some((what, count)) => (what, Some(count.parse().unwrap())),
        None => (what, None),
    };
    let lines = if let Some(name) = what.strip_prefix("page: ") {
        page_as_read(name)
    } else if let Some(words) = what.strip_prefix("in bash: ") {
        offered_by_bash(words)
    } else {
        let folder = tempfile::tempdir().unwrap();
        let args = what.strip_prefix(": ").unwrap().split(' ');
        Some(stdout_of(posebridge(folder.path()).args(args)))
    };
    let lines = lines.map(|text| text.lines().map(|line| line.trim_end().to_owned()).collect());
    (lines, count)
}

fn page_as_read(name: &str) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let made = pages(Cli::command()).unwrap();
    let page = made.iter().find(|page| page.file == format!("{name}.1"));
    let path = folder.path().join("page.1");
    // Neither stretched nor hyphenated: it shall look and be compared alike whoever formats it.
    let (head, rest) = page.unwrap().roff.split_once("\n.SH NAME").unwrap();
    std::fs::write(&path, format!("{head}\n.na\n.nh\n.SH NAME{rest}")).unwrap();
    let read =
        Command::new("groff").args(["-man", "-Tutf8", "-P-cbou", &format!("-rLL={WIDTH}n")]).arg(path).output().ok()?;
    Some(String::from_utf8(read.stdout).unwrap())
}

fn offered_by_bash(words: &str) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let script = stdout_of(posebridge(folder.path()).args(["completions", "bash"]));
    let last = words.split(' ').count() - 1;
    let asked = format!(
        "{script}\nCOMP_WORDS=({words}); COMP_CWORD={last}\n\
         _posebridge posebridge \"${{COMP_WORDS[{last}]}}\" \"${{COMP_WORDS[{}]}}\"\n\
         echo \"${{COMPREPLY[*]}}\"\n",
        last - 1
    );
    let offered = Command::new("bash").args(["--norc", "-c", &asked]).output().ok()?;
    Some(String::from_utf8(offered.stdout).unwrap())
}

/// Formatters differ in where they break lines, so pages are compared by their words.
fn words_of(lines: &[String]) -> Vec<&str> {
    lines.iter().flat_map(|line| line.split_whitespace()).collect()
}

#[test]
fn what_the_pages_show_is_what_is_printed() {
    let is_writing = std::env::var_os("POSEBRIDGE_WRITE_DOCS").is_some();
    let mut seen = 0;
    for name in PAGES {
        let path = root().join(name);
        let text = std::fs::read_to_string(&path).unwrap();
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        for shown in shown_in(&text).into_iter().rev() {
            seen += 1;
            let (Some(real), count) = real(&shown.what) else {
                continue;
            };
            let all = words_of(&real);
            let count = count.unwrap_or(real.len()).min(real.len());
            let real = &real[..count];
            if is_writing {
                let end = shown.begin + shown.lines.len();
                lines.splice(shown.begin..end, real.iter().cloned());
            } else if shown.what.starts_with("page: ") {
                let words = words_of(&shown.lines);
                assert!(!words.is_empty(), "{name}: {}", shown.what);
                assert_eq!(words, all[..words.len()], "{name}: {}", shown.what);
            } else {
                assert_eq!(shown.lines, real, "{name}: {}", shown.what);
            }
        }
        if is_writing {
            std::fs::write(&path, lines.join("\n") + "\n").unwrap();
        }
    }
    assert!(seen >= 4, "{seen} blocks");
}
