//! `posebridge init`: writes a commented configuration for a robot.
//! The file is `config/default.toml` merged with the robot's own file ([`template`]). It is loaded like any configuration before it is
//! written, so that it is known to be valid. Without `--guide` and `--from` nothing else is opened or changed; with them the values are
//! those of three motions by hand.

mod args;
mod findings;
mod live;
mod recorded;
mod robot_source;
mod session;
mod words;

use std::fs::OpenOptions;
use std::io::{BufRead, ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use posebridge_report::tables::wrapped;

use self::args::GuideFlags;
use self::findings::Findings;
use self::live::GuidedRobot;
use super::doctor::serial_ports::{SerialPort, serial_ports};
use crate::config::{
    self, BundledRobot, Config, LinkSection, ROBOTS, TemplateLink, list_of_robots, template, template_of, with_values,
};
use crate::console::{print_line, print_lines, print_result};
use crate::exit::{ExitStage, Failure};
use crate::runtime::run_in_runtime;

/// Flags of `init`.
#[derive(Args, Clone, Debug)]
pub struct InitArgs {
    /// Robot profile to start from. Without it the program asks.
    pub robot: Option<String>,
    /// Connect to the robot on this link, e.g. serial:///dev/ttyUSB0?baud=115200. Default: a guess from the ports of this
    /// computer.
    #[arg(long, value_name = "URL", conflicts_with = "listen")]
    pub link: Option<String>,
    /// Wait for the robot to connect on this link, e.g. udp://0.0.0.0:14550.
    #[arg(long, value_name = "URL")]
    pub listen: Option<String>,
    /// Configuration file to write; - prints it.
    #[arg(long, value_name = "FILE", default_value = "posebridge.toml")]
    pub out: PathBuf,
    /// Overwrite an existing file.
    #[arg(long)]
    pub force: bool,
    /// Of the guide.
    #[command(flatten)]
    pub guide: GuideFlags,
}

pub fn robots_help() -> String {
    format!("Robots:\n{}", list_of_robots())
}

const STDOUT: &str = "-";

pub fn execute(args: &InitArgs) -> Result<(), Failure> {
    if args.guide.guide || args.guide.from.is_some() {
        return execute_guide(args);
    }
    let robot = robot(args).before_start()?;
    let link = link(args, robot).before_start()?;
    let text = template(robot, &link, &file_name(args));
    write_checked(args, &text, robot.name, &link).before_start()
}

/// Measures the robot and writes what was found.
fn execute_guide(args: &InitArgs) -> Result<(), Failure> {
    let base = args.robot.as_deref().map(BundledRobot::from_name).transpose().before_start()?;
    // An Arduino's port where nobody names one; what it speaks is heard.
    let link = link(args, base.unwrap_or(ROBOTS[0])).before_start()?;
    if !args.force && file_name(args) != STDOUT_FILE && args.out.exists() {
        return Err(exists_already(&args.out)).before_start();
    }
    let guided = match &args.guide.from {
        Some(path) => recorded::run(path, link, base, &args.guide).while_running()?,
        None => run_in_runtime(live::run(link, base, &args.guide)).before_start()?.while_running()?,
    };
    write_findings(args, &guided).while_running()
}

fn write_findings(args: &InitArgs, guided: &GuidedRobot) -> Result<()> {
    let findings = Findings::of(guided)?;
    print_lines(&[String::new(), "What was found:".to_owned()]);
    print_lines(&findings.lines);
    for note in &findings.notes {
        print_line(&format!("note: {note}"));
    }
    let text = guided_text(guided, &findings, &file_name(args));
    write_checked(args, &text, "my robot", &guided.source.link)
}

/// The configuration with what was found; `file` is the name in its comments.
fn guided_text(guided: &GuidedRobot, findings: &Findings, file: &str) -> String {
    let source = &guided.source;
    let introduction = [
        format!("Measured by motions by hand; it speaks {}.", source.speaks),
        format!("Noise and what else was not measured are assumed, those of {}:", source.base.name),
        source.base.summary().to_owned(),
    ];
    let own = with_values(source.base.text, &introduction, &findings.values);
    template_of("that you moved; made by `posebridge init --guide`", &own, &source.link, file)
}

const STDOUT_FILE: &str = "FILE";

/// The file's name in its own comments.
fn file_name(args: &InitArgs) -> String {
    if args.out.as_os_str() == STDOUT { STDOUT_FILE.to_owned() } else { args.out.display().to_string() }
}

/// Loads the text like any configuration, then writes it.
fn write_checked(args: &InitArgs, text: &str, robot: &str, link: &TemplateLink) -> Result<()> {
    let loaded = config::load_text("of posebridge init", text, &[])?;
    loaded.config.validate()?;
    if args.out.as_os_str() == STDOUT {
        return Ok(print_result(text)?);
    }
    write(args, text)?;
    let file = file_name(args);
    print_line(wrapped("", &format!("wrote `{file}`: {robot}, at {} ({})", link.url, link.origin)).trim_end());
    print_line(&format!("run it with: posebridge run --config {file}"));
    Ok(())
}

fn exists_already(path: &Path) -> anyhow::Error {
    anyhow!("`{}` is there already: name another file with --out, or write over it with --force", path.display())
}

fn robot(args: &InitArgs) -> Result<BundledRobot> {
    if let Some(name) = &args.robot {
        return Ok(BundledRobot::from_name(name)?);
    }
    let (stdin, mut stderr) = (std::io::stdin(), std::io::stderr());
    if stdin.is_terminal() && stderr.is_terminal() {
        return prompt(&mut stdin.lock(), &mut stderr);
    }
    bail!(
        "name the robot that yours is most like, for example `posebridge init nxt-56mm`; there are:\n{}",
        list_of_robots()
    )
}

fn link(args: &InitArgs, robot: BundledRobot) -> Result<TemplateLink> {
    let template_link = |url: &str, is_listening| TemplateLink {
        url: url.to_owned(),
        is_listening,
        origin: "as given to `posebridge init`".to_owned(),
        ..TemplateLink::default()
    };
    if let Some(url) = &args.link {
        return Ok(template_link(url, false));
    }
    if let Some(url) = &args.listen {
        return Ok(template_link(url, true));
    }
    let own: Config = toml::from_str(robot.text).context(robot.name)?;
    let usual = own.links.first().ok_or_else(|| anyhow!("config/robots/{}.toml names no link", robot.name))?;
    Ok(guess(usual, Path::new("/")))
}

/// Writes a new file, or overwrites one on request; a full disk never destroys an existing file.
fn write(args: &InitArgs, text: &str) -> Result<()> {
    let path = &args.out;
    let name = path.display();
    if args.force && path.exists() {
        ensure!(path.is_file(), "`{name}` is no file");
        return replace(path, text).with_context(|| format!("cannot write `{name}`"));
    }
    let mut file = match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            return Err(exists_already(path));
        }
        Err(error) => return Err(error).with_context(|| format!("cannot write `{name}`")),
    };
    let written = file.write_all(text.as_bytes());
    if written.is_err() {
        // Half a configuration is none.
        drop(std::fs::remove_file(path));
    }
    written.with_context(|| format!("cannot write `{name}`"))
}

fn replace(path: &Path, text: &str) -> Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".new");
    std::fs::write(&beside, text)?;
    std::fs::rename(&beside, path)?;
    Ok(())
}

const TRIES: u32 = 3;
/// Limit of an answer, in bytes.
const LONGEST_ANSWER: u64 = 1_000;

/// Prints the robots with numbers and reads a number or a name.
fn prompt(answers: &mut impl BufRead, terminal: &mut impl Write) -> Result<BundledRobot> {
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

const SERIAL: &str = "serial://";
/// A board on a USB cable has one or the other, depending on its chip.
const USB_PREFIXES: [&str; 2] = ["ttyACM", "ttyUSB"];
const MAX_LISTED: usize = 8;

/// The robot's default link, with an existing port in place of its own.
fn guess(usual: &LinkSection, root: &Path) -> TemplateLink {
    let as_usual = |origin: &str, notes| TemplateLink {
        url: usual.url.clone(),
        is_listening: usual.listen,
        origin: origin.to_owned(),
        notes,
        is_guess: true,
    };
    let Some(device) = serial_device(&usual.url) else {
        return as_usual("how this robot is usually reached", Vec::new());
    };
    let ports = serial_ports(root);
    let (fitting, others): (Vec<_>, Vec<_>) = ports.iter().partition(|port| is_alike(&port.name, &device));
    let Some((first, further)) = fitting.split_first() else {
        let notes = describe_ports(&others, "no such port is there now; there is");
        return as_usual("a guess, no such port is there: `posebridge doctor` shows which are", notes);
    };
    let path = first.by_id.as_ref().unwrap_or(&first.device).display();
    let further: Vec<&SerialPort> = further.iter().chain(&others).copied().collect();
    TemplateLink {
        url: format!("{SERIAL}{path}{}", options_of(&usual.url)),
        is_listening: false,
        origin: format!("a guess: {} is there", describe_port(first)),
        notes: describe_ports(&further, "also there:"),
        is_guess: true,
    }
}

fn serial_device(url: &str) -> Option<String> {
    let path = url.strip_prefix(SERIAL)?;
    let path = path.split('?').next().unwrap_or(path);
    Some(Path::new(path).file_name()?.to_string_lossy().into_owned())
}

fn options_of(url: &str) -> &str {
    url.find('?').and_then(|at| url.get(at..)).unwrap_or("")
}

fn is_alike(name: &str, usual: &str) -> bool {
    let kind = |name: &str| {
        let stem = name.trim_end_matches(|character: char| character.is_ascii_digit());
        let is_usb = USB_PREFIXES.contains(&stem);
        if is_usb { USB_PREFIXES[0] } else { stem }.to_owned()
    };
    kind(name) == kind(usual)
}

fn describe_ports(ports: &[&SerialPort], what: &str) -> Vec<String> {
    let lines = ports.iter().take(MAX_LISTED).map(|port| format!("{what} {}", describe_port(port)));
    lines.collect()
}

/// Device and connected hardware; foreign device names are reduced to one line.
fn describe_port(port: &SerialPort) -> String {
    let device = port.device.display();
    let name = port.usb.as_ref().map(|usb| usb.name.as_str());
    match name.filter(|name| !name.is_empty()) {
        Some(name) => {
            let name: String =
                name.chars().map(|character| if character.is_control() { ' ' } else { character }).collect();
            format!("{device} ({name})")
        }
        None => device.to_string(),
    }
}

#[cfg(test)]
mod guide_tests;

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

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

    fn usual(url: &str) -> LinkSection {
        LinkSection::new(url)
    }

    /// A computer with these device nodes, and its folder of them.
    fn computer(names: &[&str]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let dev = folder.path().join("dev");
        fs::create_dir_all(&dev).unwrap();
        for name in names {
            fs::write(dev.join(name), "").unwrap();
        }
        (folder, dev)
    }

    #[test]
    fn a_port_of_the_usual_kind_takes_its_place_and_keeps_the_options() {
        let (folder, dev) = computer(&["rfcomm0", "tty0", "ttyUSB3", "ttyUSB7"]);
        let found = guess(&usual("serial:///dev/ttyACM0?baud=57600"), folder.path());
        let device = dev.join("ttyUSB3");
        let expected = format!("serial://{}?baud=57600", device.display());
        assert_eq!(found.url, expected);
        assert_eq!(found.origin, format!("a guess: {} is there", device.display()));
        let dev = dev.display();
        let notes = [format!("also there: {dev}/ttyUSB7"), format!("also there: {dev}/rfcomm0")];
        assert_eq!(found.notes, notes);
    }

    #[test]
    fn a_name_that_stays_is_taken_before_a_number() {
        let (folder, dev) = computer(&["ttyACM0"]);
        let by_id = dev.join("serial/by-id");
        fs::create_dir_all(&by_id).unwrap();
        std::os::unix::fs::symlink("../../ttyACM0", by_id.join("usb-board")).unwrap();
        let found = guess(&usual("serial:///dev/ttyACM0"), folder.path());
        assert_eq!(found.url, format!("serial://{}", by_id.join("usb-board").display()));
    }

    #[test]
    fn without_a_fitting_port_the_usual_link_stands_and_the_others_are_named() {
        let (folder, _) = computer(&["ttyACM0"]);
        let found = guess(&usual("serial:///dev/rfcomm0"), folder.path());
        assert_eq!(found.url, "serial:///dev/rfcomm0");
        assert!(found.origin.starts_with("a guess, no such port"), "{}", found.origin);
        assert_eq!(found.notes.len(), 1, "{:?}", found.notes);
    }

    #[test]
    fn a_link_that_is_no_port_stays_as_it_is() {
        let (folder, _) = computer(&["ttyACM0"]);
        let listening = LinkSection { listen: true, ..usual("tcp://127.0.0.1:5760") };
        let found = guess(&listening, folder.path());
        assert_eq!((found.url.as_str(), found.is_listening), ("tcp://127.0.0.1:5760", true));
    }
}
