//! Checks of links: whether the configuration is valid and its links open, and what the given links receive, for a serial port also its
//! correct speed.
//! Nothing is sent. A brick that only answers requests stays silent here.

use std::fs;
use std::path::Path;

use posebridge_link::{
    ConnectRole, HostTimer, LineSettingsPolicy, Link, LinkEvent, LinkOpenConfig, LinkTuning, LinkUrl, OpenError,
};
use posebridge_protocol::bricks::brick_protocol;
use posebridge_protocol::detect::{Protocol, ProtocolDetection, recognise};
use posebridge_telemetry::{HostClock, LinkId, TimeDelta, Timestamp};

use super::context::{CheckResult, DiagnosticContext};
use crate::config::{self, Config, LinkTarget, load_scenario};
use crate::console::print_line;
use crate::runtime::run_in_runtime;

/// Loads the configuration, then opens and closes each link of a given file.
pub(super) fn check_configuration(context: &DiagnosticContext) -> Vec<CheckResult> {
    let path = context.config.as_deref().or(context.robot.as_deref());
    let name = path.map_or("the embedded default".to_owned(), |path| path.display().to_string());
    let loaded = match config::load(path, &[]) {
        Ok(loaded) => loaded,
        Err(error) => return vec![invalid_config(&error.to_string())],
    };
    let config = loaded.config;
    let targets = config.station_config().and_then(|_| config.targets());
    let targets = match targets {
        Ok(targets) => targets,
        Err(error) => return vec![invalid_config(&format!("{name}: {error:#}"))],
    };
    let mut verdicts = vec![CheckResult::ok(format!("{name} makes sense"))];
    // The links of a robot to set up are opened by its station.
    if context.config.is_some() {
        verdicts.extend(open_links(&config, &targets));
    }
    verdicts
}

fn invalid_config(what: &str) -> CheckResult {
    CheckResult::problem(
        what,
        "correct it there; `posebridge config print` shows every key, config/default.toml explains them",
    )
}

fn open_links(config: &Config, targets: &[(LinkTarget, ConnectRole)]) -> Vec<CheckResult> {
    use_links(async {
        let timer = HostTimer::start();
        let mut verdicts = Vec::new();
        for ((target, role), section) in targets.iter().zip(&config.links) {
            let link = format!("link `{}`", section.url);
            verdicts.push(match target {
                LinkTarget::Sim(scenario) => check_scenario(&link, scenario),
                LinkTarget::Url(url) => open_link(&link, url, *role, timer).await,
            });
        }
        verdicts
    })
}

fn check_scenario(link: &str, scenario: &str) -> CheckResult {
    match load_scenario(scenario) {
        Ok(_) => CheckResult::ok(format!("{link} is simulated")),
        Err(error) => CheckResult::problem(
            format!("{link} cannot be simulated: {error:#}"),
            "docs/simulator.md, section 4, has the keys and the bundled scenarios",
        ),
    }
}

async fn open_link(link: &str, url: &LinkUrl, role: ConnectRole, timer: HostTimer) -> CheckResult {
    let scheme = url.transport().scheme();
    if !matches!(scheme, "serial" | "tcp" | "udp") {
        // To open one of these would make or change a file.
        return CheckResult::skipped(format!("{link} is not opened before the station runs"));
    }
    match open(url, role, timer).await {
        OpenOutcome::Up(_, detail) => CheckResult::ok(format!("{link} opens: {detail}")),
        OpenOutcome::Unavailable(reason) => unavailable_result(link, &reason),
        OpenOutcome::Rejected(error) => rejected_result(link, &error),
    }
}

enum OpenOutcome {
    Up(Box<Link>, String),
    Unavailable(String),
    Rejected(OpenError),
}

/// Opens a link within the deadline of the transports, five seconds.
async fn open(url: &LinkUrl, role: ConnectRole, timer: HostTimer) -> OpenOutcome {
    let config = LinkOpenConfig { id: LinkId(0), url: url.clone(), role };
    let tuning = LinkTuning { line_settings: LineSettingsPolicy::Restore, ..LinkTuning::default() };
    let mut port = Link::with_tuning(config, tuning, timer);
    if let Err(error) = port.try_open().await {
        return OpenOutcome::Rejected(error);
    }
    loop {
        match port.next_event().await {
            LinkEvent::Up { detail, .. } => return OpenOutcome::Up(Box::new(port), detail),
            LinkEvent::Down { reason, .. } => return OpenOutcome::Unavailable(reason),
            // Neither comes before the link is up.
            LinkEvent::Bytes { .. } | LinkEvent::Finished { .. } => {}
        }
    }
}

/// Opens and reads links in a new runtime.
fn use_links(work: impl Future<Output = Vec<CheckResult>>) -> Vec<CheckResult> {
    run_in_runtime(work).unwrap_or_else(|error| vec![CheckResult::skipped(format!("no link can be opened: {error}"))])
}

/// The result for a link that may become available.
fn unavailable_result(link: &str, reason: &str) -> CheckResult {
    CheckResult::warning(
        format!("{link} is not there: {reason}"),
        "plug it in, switch it on or start what listens there; `posebridge run` waits for it",
    )
}

/// The result for a link that the user has to change. The errors contain the reason and, after a colon, a remedy.
fn rejected_result(link: &str, error: &OpenError) -> CheckResult {
    let message = error.to_string();
    let (what, advice) = message.split_once(": ").unwrap_or((&message, "docs/links.md says how a link is written"));
    CheckResult::problem(format!("{link} does not open: {what}"), advice)
}

/// Valid frames after which listening stops.
const ENOUGH_FRAMES: usize = 5;
/// Bound of the received bytes: more than a minute of a 115200 baud line adds nothing.
const MAX_BYTES: usize = 1 << 20;
/// Bytes between two detections, so that a fast link is not analysed for each read.
const DETECT_INTERVAL_BYTES: usize = 256;

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::tools) struct ListenResult {
    /// In the order of arrival.
    pub(in crate::tools) bytes: Vec<u8>,
    /// Arrival of the first and of the last bytes.
    pub(in crate::tools) arrivals: Option<[Timestamp<HostClock>; 2]>,
    pub(in crate::tools) lost_reason: Option<String>,
}

impl ListenResult {
    pub(in crate::tools) fn detect(&self) -> ProtocolDetection {
        recognise(&self.bytes)
    }

    fn is_enough(&self) -> bool {
        let found = self.detect();
        self.bytes.len() >= MAX_BYTES || (found.protocol.is_checked() && found.frames >= ENOUGH_FRAMES)
    }
}

/// Listens for `listen_for`, or until the protocol is certain.
pub(in crate::tools) async fn listen(port: &mut Link, timer: HostTimer, listen_for: TimeDelta) -> ListenResult {
    let end = timer.now() + listen_for;
    let mut received = ListenResult::default();
    let mut next_look = DETECT_INTERVAL_BYTES;
    loop {
        let event = tokio::select! {
            event = port.next_event() => event,
            () = timer.sleep_until(end) => return received,
        };
        match event {
            LinkEvent::Bytes { bytes, arrival, .. } => {
                let [first, _] = received.arrivals.unwrap_or([arrival; 2]);
                received.arrivals = Some([first, arrival]);
                received.bytes.extend_from_slice(&bytes);
            }
            LinkEvent::Down { reason, .. } => {
                received.lost_reason = Some(reason);
                return received;
            }
            LinkEvent::Finished { .. } => return received,
            LinkEvent::Up { .. } => {}
        }
        if received.bytes.len() >= next_look {
            next_look = received.bytes.len() + DETECT_INTERVAL_BYTES;
            if received.is_enough() {
                return received;
            }
        }
    }
}

/// Speeds tried after the configured one, the common ones first: telemetry radios and Bluetooth modules have factory settings of 57600
/// and 9600, boards are programmed for the rest.
const SPEEDS_BAUD: [u32; 8] = [115_200, 57_600, 9_600, 38_400, 19_200, 230_400, 460_800, 921_600];

pub(super) fn check_listening(context: &DiagnosticContext) -> Vec<CheckResult> {
    if context.robot.is_some() {
        return vec![CheckResult::skipped("the set-up below opens the links itself")];
    }
    if context.links.is_empty() {
        return vec![CheckResult::skipped(
            "no link was given: `posebridge doctor serial:///dev/ttyUSB0` listens there",
        )];
    }
    let listener =
        LinkListener { timer: HostTimer::start(), listen_for: TimeDelta::from_secs_f64(context.listen_for_s) };
    use_links(async {
        let mut verdicts = Vec::new();
        for link in &context.links {
            verdicts.push(listener.listen_on(link).await);
        }
        verdicts
    })
}

#[derive(Clone, Copy, Debug)]
struct LinkListener {
    timer: HostTimer,
    listen_for: TimeDelta,
}

impl LinkListener {
    async fn listen_on(self, link: &str) -> CheckResult {
        let url = match LinkUrl::parse(link) {
            Ok(url) => url,
            Err(error) => {
                return CheckResult::problem(error.to_string(), "docs/links.md says how a link is written");
            }
        };
        match url.transport().scheme() {
            "serial" => try_speeds(&url, async |url: &LinkUrl| self.attempt(url).await).await,
            "tcp" | "udp" => match self.attempt(&url).await {
                Ok(received) => classify(link, &received),
                Err(verdict) => verdict,
            },
            scheme => CheckResult::skipped(format!(
                "{link}: serial, tcp and udp links can be listened on, {scheme} links cannot"
            )),
        }
    }

    /// Opens the link, listens and closes it; the error is the result of a failed open.
    async fn attempt(self, url: &LinkUrl) -> Result<ListenResult, CheckResult> {
        let link = url.to_string();
        print_line(&format!("listening on {link}"));
        match open(url, role_of(url), self.timer).await {
            OpenOutcome::Up(mut port, _) => Ok(listen(&mut port, self.timer, self.listen_for).await),
            OpenOutcome::Unavailable(reason) => Err(unavailable_result(&link, &reason)),
            OpenOutcome::Rejected(error) => Err(rejected_result(&link, &error)),
        }
    }
}

/// Listens at the link's own speed and, if that gives noise, at the others.
async fn try_speeds(
    url: &LinkUrl,
    mut attempt: impl AsyncFnMut(&LinkUrl) -> Result<ListenResult, CheckResult>,
) -> CheckResult {
    let first = match attempt(url).await {
        Ok(received) => received,
        Err(verdict) => return verdict,
    };
    if let Some(line) = fixed_speed_kind(url.path()) {
        let endpoint = format!("{url} ({line}, where the speed does not matter)");
        return classify(&endpoint, &first);
    }
    let own_baud = baud_of(url);
    let at_own = classify(&format!("{url} at {own_baud} baud"), &first);
    if first.detect().protocol != Protocol::Unrecognized {
        return at_own;
    }
    for other in other_speeds(url) {
        match attempt(&other).await {
            Err(verdict) => return verdict,
            Ok(received) if received.detect().protocol.is_known() => {
                return wrong_speed(&other, own_baud, &received);
            }
            Ok(_) => {}
        }
    }
    let bytes = first.bytes.len();
    CheckResult {
        message: format!("{url}: noise at {own_baud} baud ({bytes} bytes) and at every other usual speed"),
        ..at_own
    }
}

/// TCP without a host and UDP wait for the robot: a UDP robot at its own address replies only after a datagram was sent.
fn role_of(url: &LinkUrl) -> ConnectRole {
    let (host, _) = url.host_and_port();
    match url.transport().scheme() {
        "udp" => ConnectRole::Listen,
        "tcp" if host.is_empty() => ConnectRole::Listen,
        _ => ConnectRole::Dial,
    }
}

/// The same link at each other usual speed; none where the speed does not matter.
pub(in crate::tools) fn other_speeds(url: &LinkUrl) -> Vec<LinkUrl> {
    if url.transport().scheme() != "serial" || fixed_speed_kind(url.path()).is_some() {
        return Vec::new();
    }
    let own_baud = baud_of(url);
    SPEEDS_BAUD.into_iter().filter(|baud| *baud != own_baud).filter_map(|baud| at_speed(url, baud)).collect()
}

fn baud_of(url: &LinkUrl) -> u32 {
    let options = url.transport().options();
    let baud = options.iter().find(|option| option.name == "baud");
    baud.map_or(0, |option| url.integer(option))
}

/// The same port and options at another speed; `None` for a path that cannot be written as a URL.
fn at_speed(url: &LinkUrl, baud: u32) -> Option<LinkUrl> {
    let path = url.path().to_str()?;
    let others = url.transport().options().iter().filter_map(|option| {
        let value = url.option_text(option);
        let is_written = option.name != "baud" && value != option.kind.default_text();
        is_written.then(|| format!("&{}={value}", option.name))
    });
    let others: String = others.collect();
    let other = LinkUrl::parse(&format!("serial:{path}?baud={baud}{others}")).ok()?;
    (other.path() == url.path()).then_some(other)
}

/// The kind of a line without a physical speed: a pseudo-terminal or a Bluetooth link.
fn fixed_speed_kind(path: &Path) -> Option<&'static str> {
    let device = fs::canonicalize(path).ok()?;
    let name = device.file_name()?.to_str()?;
    if device.starts_with("/dev/pts") {
        Some("a pseudo-terminal")
    } else {
        name.starts_with("rfcomm").then_some("Bluetooth")
    }
}

/// Classifies the received data and its meaning for the station.
fn classify(endpoint: &str, received: &ListenResult) -> CheckResult {
    let found = received.detect();
    let description = describe(endpoint, received, found);
    match found.protocol {
        Protocol::NoData => silent_result(endpoint, received),
        Protocol::Unrecognized => CheckResult::problem(
            description,
            "check_listening the speed, the wires (ground too) and that both ends speak one protocol",
        ),
        Protocol::Mavlink1 => CheckResult::warning(
            description,
            "let the robot send MAVLink 2, or set `accept_mavlink1 = true` for its link",
        ),
        Protocol::Nmea => {
            CheckResult::warning(description, "this is a satellite receiver: the robot is on another port")
        }
        Protocol::Rosserial | Protocol::MicroRos => CheckResult::warning(
            description,
            "posebridge does not read ROS messages: let the board send MAVLink, or print its counts (docs/protocols/boards.md)",
        ),
        Protocol::Columns => {
            CheckResult::ok(format!("{description}; `posebridge init --guide` finds what each column is"))
        }
        Protocol::Mavlink2 | Protocol::Nxt | Protocol::Ev3 | Protocol::Text => {
            let is_read = found.protocol.codec().and_then(brick_protocol).is_some();
            if is_read {
                return CheckResult::ok(description);
            }
            CheckResult::warning(
                description,
                "posebridge does not read this: the robot has to send MAVLink 2 (docs/getting-started.md)",
            )
        }
    }
}

fn describe(endpoint: &str, received: &ListenResult, found: ProtocolDetection) -> String {
    let name = found.protocol.name();
    let bytes = received.bytes.len();
    if found.protocol.is_known() {
        let (frames, of) = (found.frames, found.frame_bytes);
        format!("{endpoint}: {name}, whole frames {frames}, with {of} of {bytes} bytes")
    } else {
        format!("{endpoint}: {name}, {bytes} bytes")
    }
}

fn silent_result(endpoint: &str, received: &ListenResult) -> CheckResult {
    if let Some(reason) = &received.lost_reason {
        return CheckResult::problem(
            format!("{endpoint}: the link was lost before a byte came: {reason}"),
            "check_listening the cable and the power of the robot",
        );
    }
    CheckResult::warning(
        format!("{endpoint}: silence"),
        "is the robot on and its program running, are its sending and receiving wires crossed? \
         A brick without a program only answers when it is asked",
    )
}

fn wrong_speed(url: &LinkUrl, own_baud: u32, received: &ListenResult) -> CheckResult {
    let baud = baud_of(url);
    let endpoint = format!("{} at {baud} baud", url.path().display());
    let result = classify(&endpoint, received);
    let link = format!("write the link as {url}");
    let advice = match result.advice.as_str() {
        "" => link,
        further => format!("{link}; {further}"),
    };
    CheckResult::warning(format!("{}; at {own_baud} baud it is noise", result.message), advice)
}

#[cfg(test)]
mod tests;
