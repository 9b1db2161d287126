//! Names of robots as parts of ROS topics and frames.

use posebridge_telemetry::RobotId;

/// The name in characters that ROS accepts in a topic: letters, digits and single underscores, a letter first. `None` if nothing is left.
///
/// Source: "Topic and Service name mapping to DDS", ROS 2 design.
pub(super) fn ros_name(name: &str) -> Option<String> {
    let words = name.split(|letter: char| !letter.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let joined = words.collect::<Vec<_>>().join("_");
    match joined.chars().next()? {
        '0'..='9' => Some(format!("robot_{joined}")),
        _ => Some(joined),
    }
}

/// For a robot without a name beside others.
pub(super) fn id_name(robot: RobotId) -> String {
    format!("robot_{}_{}_{}", robot.link, robot.address.system, robot.address.component)
}

/// The name, with a number if another robot has it.
pub(super) fn unique_name(name: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let mut unique = name.to_owned();
    let mut number = 1;
    while is_taken(&unique) {
        number += 1;
        unique = format!("{name}_{number}");
    }
    unique
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_name_becomes_one_that_ros_accepts() {
        for (name, expected) in [
            ("left", Some("left")),
            ("My robot #1", Some("My_robot_1")),
            ("__a--b__", Some("a_b")),
            ("7 of 9", Some("robot_7_of_9")),
            ("h\u{fc}pfer", Some("h_pfer")),
            ("", None),
            ("\u{e4}/", None),
        ] {
            assert_eq!(ros_name(name).as_deref(), expected, "{name}");
        }
    }

    #[test]
    fn two_robots_do_not_share_a_name() {
        let taken = ["a", "a_2"];
        assert_eq!(unique_name("a", |name| taken.contains(&name)), "a_3");
    }
}
