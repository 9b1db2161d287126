//! Two examples at the end of the long help of every command.

use clap::Command;

/// What the commands after `posebridge` do, with two command lines each.
type Examples = (&'static [&'static str], [&'static str; 2]);

/// A new command needs a row here.
#[rustfmt::skip]
const EXAMPLES: &[Examples] = &[
    (&[], ["posebridge", "posebridge --laps 1 --open"]),
    (&["run"], [
        "posebridge run --link serial:///dev/ttyUSB0 --robot my-robot.toml",
        "posebridge run --listen udp://0.0.0.0:14550 --camera overhead.toml --tui",
    ]),
    (&["sim"], ["posebridge sim --listen pty:brick.tty --truth truth.csv", "posebridge sim square --brick nxt --listen tcp://127.0.0.1:5760"]),
    (&["play"], [
        "posebridge play config/recordings/optiodom.toml --listen tcp://127.0.0.1:5760",
        "posebridge play my-robot.toml --run square --link udp://127.0.0.1:14550",
    ]),
    (&["relay"], [
        "posebridge relay tcp://127.0.0.1:5760 --listen tcp://127.0.0.1:5761",
        "posebridge relay serial:brick.tty --listen udp://:14550 --impair bluetooth-spp",
    ]),
    (&["replay"], ["posebridge replay run/recording.mcap", "posebridge replay run/recording.mcap --estimator odometry --estimator pose"]),
    (&["export"], [
        "posebridge export run/recording.mcap --format csv,tum --out tables",
        "posebridge export flight.tlog --messages --format csv,mcap",
    ]),
    (&["import"], ["posebridge import flight.tlog --out flight.mcap", "posebridge import my-robot.toml --run square --out square.mcap"]),
    (&["merge"], ["posebridge merge left.mcap right.mcap --out both.mcap", "posebridge merge a.mcap b.mcap c.mcap --out all.mcap --key arena.key"]),
    (&["report"], ["posebridge report run/recording.mcap", "posebridge report run/recording.mcap --out report --smooth"]),
    (&["inspect"], ["posebridge inspect run/recording.mcap", "posebridge inspect flight.tlog --json"]),
    (&["lab"], ["posebridge lab nxt-square", "posebridge lab accuracy --scenario camera-10hz --runs 10"]),
    (&["lab", "accuracy"], [
        "posebridge lab accuracy --scenario camera-10hz --estimator pose",
        "posebridge lab accuracy --runs 10 --json",
    ]),
    (&["lab", "links"], ["posebridge lab links", "posebridge lab links --seed 2 --json"]),
    (&["lab", "nxt-square"], ["posebridge lab nxt-square", "posebridge lab nxt-square --recording square.mcap --out square"]),
    (&["lab", "thermometer"], [
        "posebridge lab thermometer --seed 2",
        "posebridge lab thermometer --recording first.csv second.csv --same-sensor",
    ]),
    (&["lab", "wall"], ["posebridge lab wall", "posebridge lab wall --recording approach.csv"]),
    (&["lab", "indirect"], ["posebridge lab indirect", "posebridge lab indirect --recording square.mcap"]),
    (&["calibrate"], ["posebridge calibrate path run/recording.mcap", "posebridge calibrate rest run/recording.mcap"]),
    (&["calibrate", "umbmark"], ["posebridge calibrate umbmark --ends ends.csv", "posebridge calibrate umbmark --sim --runs 5"]),
    (&["calibrate", "path"], ["posebridge calibrate path run/recording.mcap", "posebridge calibrate path run/recording.mcap --unknown-start"]),
    (&["calibrate", "rest"], ["posebridge calibrate rest run/recording.mcap", "posebridge calibrate rest run/recording.mcap --json"]),
    (&["identify"], ["posebridge identify rest --recording run/recording.mcap", "posebridge identify step --recording one.csv --save sensor.toml"]),
    (&["identify", "rest"], ["posebridge identify rest --recording run/recording.mcap", "posebridge identify rest --seed 2 --json"]),
    (&["identify", "straight"], ["posebridge identify straight --recording run/recording.mcap", "posebridge identify straight --seed 2 --json"]),
    (&["identify", "delay"], ["posebridge identify delay --recording run/recording.mcap", "posebridge identify delay --seed 2 --json"]),
    (&["identify", "step"], ["posebridge identify step --recording one.csv --save sensor.toml", "posebridge identify step --recording one.csv --value-column t_c --json"]),
    (&["identify", "wall"], ["posebridge identify wall --recording approach.csv", "posebridge identify wall --recording approach.csv --json"]),
    (&["tune"], ["posebridge tune --recording run/recording.mcap", "posebridge tune --recording run/recording.mcap --out-profile tuned.toml"]),
    (&["camera"], ["posebridge camera sheet --robots 1,2", "posebridge camera detect photo.jpg"]),
    (&["camera", "sheet"], ["posebridge camera sheet --robots 1,2", "posebridge camera sheet --side-mm 60 --out tags"]),
    (&["camera", "calibrate"], [
        "posebridge camera calibrate --drive drive/recording.mcap --out overhead.toml",
        "posebridge camera calibrate a.jpg b.jpg --sheet-at 0,0,0 --sheet-at 1.2,0.4,90",
    ]),
    (&["camera", "detect"], ["posebridge camera detect photo.jpg", "posebridge camera detect photo.jpg --camera overhead.toml --height-mm 85"]),
    (&["dialect"], ["posebridge dialect --for wireshark > posebridge_mavlink.lua", "posebridge dialect --for python --out ."]),
    (&["key"], ["posebridge key new signing.key", "posebridge key new keys/arena.key"]),
    (&["key", "new"], ["posebridge key new signing.key", "posebridge key new keys/arena.key"]),
    (&["doctor"], ["posebridge doctor", "posebridge doctor serial:///dev/ttyUSB0 --listen-for 10"]),
    (&["init"], ["posebridge init nxt-56mm", "posebridge init --guide --link serial:///dev/ttyACM0"]),
    (&["config"], ["posebridge config print", "posebridge config check --config posebridge.toml"]),
    (&["config", "print"], ["posebridge config print", "posebridge config print --set robot.track_width_m=0.118"]),
    (&["config", "check"], ["posebridge config check --config posebridge.toml", "posebridge config check --set filter.gate_prob=0.99"]),
    (&["config", "schema"], ["posebridge config schema", "posebridge config schema > schema.json"]),
    (&["config", "params"], ["posebridge config params", "posebridge config params > params.txt"]),
    (&["completions"], ["posebridge completions bash > posebridge.bash", "posebridge completions zsh > _posebridge"]),
    (&["man"], ["posebridge man", "posebridge man --out man"]),
];

/// Appends its examples to the help of a command and of all below it.
pub(crate) fn add_examples(command: Command) -> Command {
    add_below(command, &mut Vec::new())
}

fn add_below(command: Command, path: &mut Vec<String>) -> Command {
    let names: Vec<String> = command.get_subcommands().map(|below| below.get_name().to_owned()).collect();
    let mut command = command;
    if let Some((_, [first, second])) = EXAMPLES.iter().find(|(of, _)| of.iter().eq(path.iter())) {
        let before = command.get_after_long_help().or_else(|| command.get_after_help());
        let before = before.map_or_else(String::new, |help| format!("{}\n\n", help.to_string().trim_end()));
        command = command.after_long_help(format!("{before}Examples:\n  {first}\n  {second}"));
    }
    for name in names {
        path.push(name.clone());
        command = command.mut_subcommand(&name, |below| add_below(below, path));
        path.pop();
    }
    command
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    fn paths_below(command: &Command, path: &[String]) -> Vec<Vec<String>> {
        let below = command.get_subcommands().filter(|below| below.get_name() != "help").flat_map(|below| {
            let path: Vec<String> = path.iter().cloned().chain([below.get_name().to_owned()]).collect();
            paths_below(below, &path)
        });
        std::iter::once(path.to_vec()).chain(below).collect()
    }

    /// A shell redirects and takes quotes away.
    fn words_of(line: &str) -> Vec<String> {
        let command = line.split(" > ").next().unwrap();
        command.split(' ').map(|word| word.trim_matches('\'').to_owned()).collect()
    }

    #[test]
    fn every_command_has_two_examples_that_it_takes() {
        let command = add_examples(Cli::command());
        let mut wrong = Vec::new();
        for path in paths_below(&command, &[]) {
            let row = EXAMPLES.iter().find(|(of, _)| of.iter().eq(path.iter()));
            let (_, lines) = row.unwrap_or_else(|| panic!("{path:?} has no examples"));
            assert_ne!(lines[0], lines[1], "{path:?}");
            for line in lines {
                let words = words_of(line);
                let is_own = words[1..].iter().zip(&path).all(|(word, name)| word == name);
                let fits = line.len() + 2 <= 80;
                let refused = command.clone().try_get_matches_from(&words).err();
                if !is_own || !fits || refused.is_some() {
                    wrong.push(format!(
                        "{path:?}: {line}: {}",
                        refused.map_or_else(String::new, |error| error.to_string())
                    ));
                }
            }
        }
        assert!(wrong.is_empty(), "examples of others, too long, or refused:\n{}", wrong.join("\n"));
        assert_eq!(EXAMPLES.len(), paths_below(&command, &[]).len());
    }

    #[test]
    fn the_help_of_links_stays_and_examples_follow() {
        let mut command = add_examples(Cli::command());
        let help = command.find_subcommand_mut("run").unwrap().render_long_help().to_string();
        let (links, examples) = (help.find("Links:").unwrap(), help.find("Examples:").unwrap());
        assert!(links < examples, "{help}");
    }
}
