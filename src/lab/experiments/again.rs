//! The command that gives a page again: the one that was typed, not a list of known flags.

/// How a live robot is recorded. Its recording holds the robot and the keys that were set.
const LIVE_ROBOT_FLAGS: [&str; 6] = ["--link", "--listen", "--duration", "--config", "--robot", "--set"];

/// Where results go, which is nothing that a page shows.
const OUTPUT_FLAG: &str = "--out";
/// How they are printed; without a value.
const JSON_FLAG: &str = "--json";

/// The arguments of this process that a page depends on; with what a live robot left in the robot's place.
pub(super) fn rerun_command(live_recording: Option<&str>) -> String {
    let args = std::env::args_os().skip(1);
    let args: Vec<String> = args.map(|arg| arg.to_string_lossy().into_owned()).collect();
    command_line(&args, live_recording)
}

fn command_line(args: &[String], live_recording: Option<&str>) -> String {
    let mut words = vec!["posebridge".to_owned()];
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        let (flag, has_value) = match arg.split_once('=') {
            Some((flag, _)) => (flag, true),
            None => (arg.as_str(), false),
        };
        let is_of_live = live_recording.is_some() && LIVE_ROBOT_FLAGS.contains(&flag);
        let is_left_out = is_of_live || flag == OUTPUT_FLAG;
        if !is_left_out && flag != JSON_FLAG {
            words.push(quoted(arg));
        }
        if is_left_out && !has_value {
            args.next();
        }
    }
    if let Some(recording) = live_recording {
        words.extend(["--recording".to_owned(), quoted(recording)]);
    }
    words.join(" ")
}

/// As a shell takes it for one word.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "-_./:=,+@%?".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command_line_of(args: &[&str], live_recording: Option<&str>) -> String {
        let args: Vec<String> = args.iter().map(|arg| (*arg).to_owned()).collect();
        command_line(&args, live_recording)
    }

    #[test]
    fn a_command_is_told_as_it_was_typed_and_fits_through_a_shell() {
        let args = ["lab", "wall", "--out", "o", "--json", "--run", "step one", "--set", "a=it's"];
        assert_eq!(command_line_of(&args, None), r"posebridge lab wall --run 'step one' --set 'a=it'\''s'");
    }

    #[test]
    fn the_recording_takes_the_place_of_the_live_robot() {
        let args = [
            "lab",
            "indirect",
            "--link",
            "tcp://a:1",
            "--judge",
            "start",
            "--duration=6",
            "--set",
            "robot.track_width_m=0.1",
            "--out",
            "o",
        ];
        assert_eq!(
            command_line_of(&args, Some("o/live.mcap")),
            "posebridge lab indirect --judge start --recording o/live.mcap"
        );
    }
}
