//! The robots of `config/robots/`, within the program.

/// A robot that the program knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BundledRobot {
    /// Its name, that of its file.
    pub name: &'static str,
    /// Its file.
    pub text: &'static str,
}

macro_rules! bundled {
    ($($name:literal),+ $(,)?) => {
        /// Every robot of `config/robots/`, by name. Adding one: a file there and a line here.
        pub const ROBOTS: &[BundledRobot] = &[
            $(BundledRobot {
                name: $name,
                text: include_str!(concat!("../../config/robots/", $name, ".toml")),
            }),+
        ];
    };
}

bundled!["arduino-2wd", "ev3-educator", "nxt-43mm", "nxt-56mm", "pybricks-spike", "sim",];

/// There is no such robot.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no robot `{name}`; there are:\n{}", list())]
pub struct UnknownRobot {
    /// What was asked for.
    pub name: String,
}

impl BundledRobot {
    /// The one of this name.
    ///
    /// # Errors
    /// There is none; the error lists all.
    pub fn from_name(name: &str) -> Result<Self, UnknownRobot> {
        let found = ROBOTS.iter().find(|robot| robot.name == name);
        found.copied().ok_or_else(|| UnknownRobot { name: name.to_owned() })
    }

    /// What it is, as the first line of its file says.
    pub fn summary(&self) -> &'static str {
        first_line_of_comment(self.text)
    }
}

/// All names with what they are, a line each.
pub fn list() -> String {
    let lines = ROBOTS.iter().map(|robot| format!("  {:<15} {}", robot.name, robot.summary()));
    lines.collect::<Vec<_>>().join("\n")
}

/// The first line of a file that begins with a comment, without its mark; empty if it begins otherwise.
fn first_line_of_comment(text: &'static str) -> &'static str {
    let line = text.lines().next().unwrap_or_default();
    line.strip_prefix("# ").unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_in_the_table_and_says_what_it_is() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/config/robots");
        let files = std::fs::read_dir(folder).unwrap();
        let mut stems: Vec<String> = files
            .map(|file| file.unwrap().path())
            .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
            .collect();
        stems.sort();
        let names: Vec<&str> = ROBOTS.iter().map(|robot| robot.name).collect();
        assert_eq!(names, stems);
        for robot in ROBOTS {
            assert!(robot.summary().len() > 20, "{}", robot.name);
        }
    }

    #[test]
    fn an_unknown_robot_is_told_with_those_that_there_are() {
        let error = BundledRobot::from_name("nxt").unwrap_err().to_string();
        assert!(error.starts_with("there is no robot `nxt`; there are:\n  arduino-2wd     The two-"), "{error}");
        assert_eq!(error.lines().count(), 1 + ROBOTS.len());
    }
}
