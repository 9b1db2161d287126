//! The bundled robots of `config/robots/`, and a commented configuration for one of them: `config/default.toml` merged with the robot's
//! file. The keys of the robot's file are kept as they are; all other keys become comments with their defaults, so that a reader sees
//! them and later defaults apply. Lines are moved, values are not parsed.

use super::load::DEFAULT_TOML;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BundledRobot {
    pub name: &'static str,
    pub text: &'static str,
}

macro_rules! bundled {
    ($($name:literal),+ $(,)?) => {
        /// Adding one: a file in `config/robots/` and a line here.
        pub const ROBOTS: &[BundledRobot] = &[
            $(BundledRobot {
                name: $name,
                text: include_str!(concat!("../../config/robots/", $name, ".toml")),
            }),+
        ];
    };
}

bundled!["arduino-2wd", "ev3-educator", "nxt-43mm", "nxt-56mm", "pybricks-spike", "sim",];

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no robot `{name}`; there are:\n{}", list())]
pub struct UnknownRobot {
    pub name: String,
}

impl BundledRobot {
    pub fn from_name(name: &str) -> Result<Self, UnknownRobot> {
        let found = ROBOTS.iter().find(|robot| robot.name == name);
        found.copied().ok_or_else(|| UnknownRobot { name: name.to_owned() })
    }

    /// The first line of the robot's file.
    pub fn summary(&self) -> &'static str {
        let line = self.text.lines().next().unwrap_or_default();
        line.strip_prefix("# ").unwrap_or_default()
    }
}

pub fn list() -> String {
    let lines = ROBOTS.iter().map(|robot| format!("  {:<15} {}", robot.name, robot.summary()));
    lines.collect::<Vec<_>>().join("\n")
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TemplateLink {
    pub url: String,
    pub is_listening: bool,
    /// Origin of the URL, for the comment after it.
    pub origin: String,
    pub notes: Vec<String>,
    /// Nobody gave it.
    pub is_guess: bool,
}

/// A header with its lines; the lines before the first header have none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct TomlSection<'a> {
    above: Vec<&'a str>,
    /// `[robot.noise]`, with the comment after it.
    header: &'a str,
    lines: Vec<&'a str>,
}

/// The configuration of a bundled robot at this link; `file` is the name in its comments.
pub fn template(robot: BundledRobot, link: &TemplateLink, file: &str) -> String {
    let name = robot.name;
    template_of(&format!("{name}; made by `posebridge init {name}`"), robot.text, link, file)
}

/// The configuration of the robot of `own_text`, a file like those of `config/robots/`; `robot` says what it is and where it is from.
pub fn template_of(robot: &str, own_text: &str, link: &TemplateLink, file: &str) -> String {
    let (_, default) = blocks_of(DEFAULT_TOML);
    let (preamble, own) = blocks_of(own_text);
    let mut text = head_of(robot, file);
    let mut waiting = Some(preamble);
    for (index, block) in default.iter().enumerate() {
        let name = name_of(block.header);
        let of_robot = own.iter().find(|own| name_of(own.header) == name);
        if name == "robot" {
            // What the robot is, before the first of its tables.
            push_part(&mut text, &waiting.take().unwrap_or_default());
        }
        push_part(&mut text, &merged(block, of_robot, link));
        let next = default.get(index + 1).map(|next| family_of(next.header));
        let family = family_of(block.header);
        if next != Some(family) {
            for further in further_blocks(&own, &default, family) {
                push_part(&mut text, &whole(further));
            }
        }
    }
    text
}

/// A value for a robot's file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TemplateValue {
    /// Such as `robot.noise`.
    pub section: &'static str,
    pub key: &'static str,
    /// As TOML writes it.
    pub value: String,
    /// Where it is from; empty for none.
    pub comment: String,
}

/// The text of a robot's file with these values in place of its own, below another introduction. Sections that it lacks are appended.
pub fn with_values(robot_text: &str, introduction: &[String], values: &[TemplateValue]) -> String {
    let (_, sections) = blocks_of(robot_text);
    let mut text = String::new();
    let comments: Vec<String> = introduction.iter().map(|line| format!("# {line}")).collect();
    push_part(&mut text, &comments);
    let line_of = |value: &TemplateValue| {
        let TemplateValue { key, value, comment, .. } = value;
        if comment.is_empty() { format!("{key} = {value}") } else { format!("{key} = {value}    # {comment}") }
    };
    for section in &sections {
        let name = name_of(section.header);
        let own = || values.iter().filter(|value| value.section == name);
        let mut lines: Vec<String> = section.above.iter().chain([&section.header]).map(ToString::to_string).collect();
        let is_replaced = |line: &&&str| key_of(line).is_some_and(|key| own().any(|value| value.key == key));
        lines.extend(own().map(line_of));
        lines.extend(section.lines.iter().filter(|line| !is_replaced(line)).map(ToString::to_string));
        push_part(&mut text, &lines);
    }
    let is_known = |name: &str| sections.iter().any(|section| name_of(section.header) == name);
    let mut added: Vec<&str> = Vec::new();
    for value in values.iter().filter(|value| !is_known(value.section)) {
        if !added.contains(&value.section) {
            added.push(value.section);
            let own = values.iter().filter(|other| other.section == value.section);
            let lines: Vec<String> = [format!("[{}]", value.section)].into_iter().chain(own.map(line_of)).collect();
            push_part(&mut text, &lines);
        }
    }
    text
}

fn head_of(robot: &str, file: &str) -> String {
    format!(
        "# posebridge, for the robot {robot}.\n\
         # A line with `# ` before a key is the default, or an example: take `# ` away to change it. An unknown key is an error.\n\
         #   run it:    posebridge run --config {file}\n\
         #   check it:  posebridge config check --config {file}\n"
    )
}

/// Sections of the robot's file that the default lacks and whose names begin with `family`.
fn further_blocks<'a, 'b>(
    own: &'b [TomlSection<'a>],
    default: &'b [TomlSection<'a>],
    family: &'b str,
) -> impl Iterator<Item = &'b TomlSection<'a>> {
    own.iter().filter(move |block| {
        family_of(block.header) == family && default.iter().all(|other| name_of(other.header) != name_of(block.header))
    })
}

/// A section of the default merged with that of the robot's file.
fn merged(block: &TomlSection<'_>, own: Option<&TomlSection<'_>>, link: &TemplateLink) -> Vec<String> {
    let mut lines: Vec<String> = block.above.iter().map(ToString::to_string).collect();
    let mut known: Vec<&str> = Vec::new();
    let mut replaced: &[&str] = &[];
    if name_of(block.header) == "link" {
        lines.extend(link.notes.iter().map(|note| format!("# {note}")));
        lines.push(block.header.to_owned());
        lines.extend(link_lines(link));
        replaced = &["url", "listen"];
        known.push("url");
        known.extend(link.is_listening.then_some("listen"));
    } else {
        if let Some(own) = own {
            lines.extend(own.above.iter().map(ToString::to_string));
        }
        lines.push(own.map_or(block.header, |own| own.header).to_owned());
    }
    for line in own.into_iter().flat_map(|own| &own.lines) {
        let key = key_of(line);
        if key.is_none_or(|key| !replaced.contains(&key)) {
            lines.push((*line).to_owned());
            known.extend(key);
        }
    }
    if lines.last().is_some_and(String::is_empty) {
        lines.pop();
    }
    lines.extend(others(&block.lines, &known));
    lines
}

fn link_lines(link: &TemplateLink) -> Vec<String> {
    // TOML's own quoting: whatever was given on the command line stays one text.
    let url = toml::Value::String(link.url.clone());
    let mut lines = vec![format!("url = {url}    # {}", link.origin)];
    if link.is_listening {
        lines.push("listen = true    # the other side calls".to_owned());
    }
    lines
}

/// The lines of the default without the known keys, with their values commented out. A comment belongs to the key below it.
fn others(lines: &[&str], known: &[&str]) -> Vec<String> {
    let mut kept = Vec::new();
    let mut comments: Vec<String> = Vec::new();
    for line in lines {
        match key_of(line) {
            Some(key) if known.contains(&key) => comments.clear(),
            Some(_) => {
                kept.append(&mut comments);
                kept.push(format!("# {line}"));
            }
            // An example of a key that stands there.
            None if line.strip_prefix("# ").and_then(key_of).is_some_and(|key| known.contains(&key)) => {}
            None if line.is_empty() => {
                kept.append(&mut comments);
                kept.push(String::new());
            }
            None => comments.push((*line).to_owned()),
        }
    }
    kept.append(&mut comments);
    kept
}

fn whole(block: &TomlSection<'_>) -> Vec<String> {
    let above = block.above.iter();
    let lines = above.chain([&block.header]).chain(&block.lines);
    lines.map(ToString::to_string).collect()
}

/// Appends a paragraph: an empty line, then the lines without empty ones at their ends.
fn push_part<T: AsRef<str>>(text: &mut String, lines: &[T]) {
    let lines: Vec<&str> = lines.iter().map(AsRef::as_ref).collect();
    let joined = lines.join("\n");
    let part = joined.trim_matches('\n');
    if !part.is_empty() {
        text.push('\n');
        text.push_str(part);
        text.push('\n');
    }
}

/// The introduction before the first header and its comment, and the sections.
fn blocks_of(text: &str) -> (Vec<&str>, Vec<TomlSection<'_>>) {
    let mut preamble = Vec::new();
    let mut blocks: Vec<TomlSection<'_>> = Vec::new();
    for line in text.lines() {
        let lines = match blocks.last_mut() {
            Some(block) => &mut block.lines,
            None => &mut preamble,
        };
        if line.starts_with('[') {
            let is_comment = |line: &&str| line.starts_with('#');
            let above = lines.iter().rev().take_while(|line| is_comment(line)).count();
            let above = lines.split_off(lines.len() - above);
            blocks.push(TomlSection { above, header: line, lines: Vec::new() });
        } else {
            lines.push(line);
        }
    }
    (preamble, blocks)
}

/// `robot.noise` of `[robot.noise]    # comment`.
fn name_of(header: &str) -> &str {
    let inner = header.trim_start_matches('[');
    inner.split(']').next().unwrap_or(inner)
}

/// `robot` of `[robot.noise]`.
fn family_of(header: &str) -> &str {
    let name = name_of(header);
    name.split('.').next().unwrap_or(name)
}

/// The key of a line `key = value`.
fn key_of(line: &str) -> Option<&str> {
    let (key, _) = line.split_once(" = ")?;
    let is_key = |character: char| character.is_ascii_alphanumeric() || character == '_';
    (!key.is_empty() && key.chars().all(is_key)).then_some(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, LinkSection, RobotProfile, load_text};

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

    fn link(url: &str) -> TemplateLink {
        TemplateLink {
            url: url.to_owned(),
            is_listening: false,
            origin: "from the test".to_owned(),
            notes: vec!["a note".to_owned()],
            is_guess: false,
        }
    }

    /// With every default live that the template has commented out; an example of the default's own stays a comment.
    fn with_defaults_live(text: &str) -> String {
        let live = |line: &str| match line.strip_prefix("# ") {
            Some(bare) if DEFAULT_TOML.lines().any(|known| known == bare) => bare.to_owned(),
            Some(_) | None => line.to_owned(),
        };
        text.lines().map(|line| live(line) + "\n").collect()
    }

    #[test]
    fn a_template_is_the_default_with_the_robot_and_the_link() {
        for robot in ROBOTS {
            let text = template(*robot, &link("tcp://127.0.0.1:1"), "a.toml");
            let loaded = load_text(robot.name, &text, &[]).unwrap().config;
            let profile = RobotProfile::from_toml(robot.text).unwrap();
            let mut expected = Config::default().with_robot(profile);
            let own: Config = toml::from_str(robot.text).unwrap();
            expected.links =
                vec![LinkSection { url: "tcp://127.0.0.1:1".to_owned(), listen: false, ..own.links[0].clone() }];
            assert_eq!(loaded, expected, "{text}");
            // What is commented out is no other value than what holds without it.
            let live = with_defaults_live(&text);
            assert!(live != text);
            let live = load_text(robot.name, &live, &[]).unwrap().config;
            assert_eq!(live.record, expected.record);
            assert_eq!(live.robot, expected.robot, "{}", robot.name);
            assert_eq!(live.dashboard, expected.dashboard);
            assert_eq!(live.world, expected.world);
        }
    }

    #[test]
    fn every_key_of_the_default_stands_in_every_template_once() {
        for robot in ROBOTS {
            let text = template(*robot, &link("sim://square"), "a.toml");
            let keys = |text: &str| {
                let mut path = String::new();
                let mut keys = Vec::new();
                for line in text.lines() {
                    let bare = line.strip_prefix("# ").unwrap_or(line);
                    if bare.starts_with('[') {
                        name_of(bare).clone_into(&mut path);
                    } else if let Some(key) = key_of(bare) {
                        keys.push(format!("{path}.{key}"));
                    }
                }
                keys
            };
            let found = keys(&text);
            for key in keys(DEFAULT_TOML) {
                let count = found.iter().filter(|found| **found == key).count();
                assert_eq!(count, 1, "{key} of {}:\n{text}", robot.name);
            }
        }
    }

    #[test]
    fn a_link_of_any_letters_stays_one_text() {
        let odd = "serial:///dev/a\"b\\c\n# [x]?baud=9600";
        let text = template(ROBOTS[0], &link(odd), "a.toml");
        let loaded = load_text("test", &text, &[]).unwrap();
        assert_eq!(loaded.config.links[0].url, odd);
    }
}
