//! Asks a person which robot it is.

use std::io::{BufRead, Write};

use anyhow::{Context, Result, bail};

use crate::config::{BundledRobot, ROBOTS};

/// So often a person may err.
const TRIES: u32 = 3;
/// No answer is longer, in bytes.
const LONGEST_ANSWER: u64 = 1_000;

/// Shows the robots with numbers and takes a number or a name.
///
/// # Errors
/// The answers end, or none of them is a robot.
pub(super) fn prompt(answers: &mut impl BufRead, terminal: &mut impl Write) -> Result<BundledRobot> {
    writeln!(terminal, "Which robot is it most like?")?;
    for (number, robot) in (1..).zip(ROBOTS) {
        writeln!(terminal, "{number:>3}  {:<15} {}", robot.name, robot.summary())?;
    }
    for _ in 0..TRIES {
        write!(terminal, "Number or name: ")?;
        terminal.flush()?;
        let mut answer = String::new();
        let mut limited = std::io::Read::take(&mut *answers, LONGEST_ANSWER);
        let read = limited.read_line(&mut answer).context("reading the answer")?;
        if read == 0 {
            bail!("no robot was chosen; give its name: posebridge init {}", ROBOTS[0].name);
        }
        let answer = answer.trim();
        match parse_choice(answer) {
            Some(robot) => return Ok(robot),
            None => writeln!(
                terminal,
                "`{}` is none of them: a number from 1 to {} or a name",
                answer.escape_debug(),
                ROBOTS.len()
            )?,
        }
    }
    bail!("no robot was chosen in {TRIES} tries; give its name: posebridge init {}", ROBOTS[0].name)
}

fn parse_choice(answer: &str) -> Option<BundledRobot> {
    let by_number = |number: usize| ROBOTS.get(number.checked_sub(1)?).copied();
    match answer.parse() {
        Ok(number) => by_number(number),
        Err(_no_number) => BundledRobot::from_name(answer).ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prompt_with(answers: &str) -> (Result<&'static str, String>, String) {
        let mut shown = Vec::new();
        let robot = prompt(&mut answers.as_bytes(), &mut shown);
        let shown = String::from_utf8(shown).unwrap();
        let name = robot.map(|robot| robot.name);
        (name.map_err(|error| error.to_string()), shown)
    }

    #[test]
    fn a_number_or_a_name_chooses() {
        for answer in ["4\n", " nxt-56mm \n", "nxt-56mm", "0\nseven\n4\n"] {
            let (robot, shown) = prompt_with(answer);
            assert_eq!(robot.as_deref(), Ok("nxt-56mm"), "{answer}");
            assert!(shown.contains("  4  nxt-56mm        LEGO NXT with 56 mm"), "{shown}");
        }
        let (_, shown) = prompt_with("0\nseven\n4\n");
        assert!(shown.contains("`seven` is none of them: a number from 1 to 6 or a name"), "{shown}");
    }

    #[test]
    fn who_does_not_answer_or_only_nonsense_is_told_what_to_do() {
        let (robot, _) = prompt_with("");
        let error = robot.unwrap_err();
        assert_eq!(error, "no robot was chosen; give its name: posebridge init arduino-2wd");
        let (robot, shown) = prompt_with("a\n\u{1b}[2J\nc\n4\n");
        assert!(robot.unwrap_err().starts_with("no robot was chosen in 3 tries"));
        assert!(!shown.contains('\u{1b}'), "no escape comes back to the terminal");
    }
}
