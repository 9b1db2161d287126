//! The guide with a live robot: opens the link, finds out what it carries, and hands bytes and answers to the guide.

use std::io::{BufRead, IsTerminal};
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail, ensure};
use posebridge_estimator::hand_motions::{GuideEvent, GuideStep};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkUrl, OutgoingFrame};
use posebridge_protocol::detect::{Protocol, recognise};
use posebridge_protocol::text_columns::{ColumnMapping, ColumnTable, WheelEvidence, guess_columns};
use posebridge_report::tables::wrapped;
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, TimeDelta, Timestamp};
use tokio::sync::mpsc::{Receiver, channel};

use super::args::GuideFlags;
use super::robot_source::{RobotSource, brick_of, check_columns, column_lines};
use super::session::GuideSession;
use super::words;
use crate::config::{BundledRobot, TemplateLink};
use crate::console::{print_line, print_lines};
use crate::exit::Signals;
use crate::tools::doctor::links::{ListenResult, listen, other_speeds};

/// How long a LEGO brick may take to answer over Bluetooth.
const PROBE_TIME: TimeDelta = TimeDelta::from_millis(2_500);
/// A second look at the columns, while the wheels are rolled.
const ROLL_LOOK: TimeDelta = TimeDelta::from_millis(1_000);
const MAX_ROLL_BYTES: usize = 1 << 20;
/// How long wheels may be unheard before that is said.
const QUIET: TimeDelta = TimeDelta::from_millis(8_000);
const LONGEST_ANSWER: u64 = 1_000;
/// Answers that wait; a person types slower than they are taken.
const ANSWERS: usize = 4;

/// What the guide found, and the robot that it found it of.
pub(super) struct GuidedRobot {
    pub(super) source: RobotSource,
    pub(super) session: GuideSession,
}

/// Lines that a person types; none where nobody sits at a terminal.
struct Answers(Option<Receiver<String>>);

impl Answers {
    /// Reads the terminal in a thread of its own, which ends with the program.
    fn open(flags: &GuideFlags) -> Self {
        if flags.yes || !std::io::stdin().is_terminal() {
            return Self(None);
        }
        let (sender, receiver) = channel(ANSWERS);
        std::thread::spawn(move || {
            let mut stdin = std::io::stdin().lock();
            loop {
                let mut line = String::new();
                let mut limited = std::io::Read::take(&mut stdin, LONGEST_ANSWER);
                if !limited.read_line(&mut line).is_ok_and(|bytes| bytes > 0) {
                    return;
                }
                if sender.blocking_send(line.trim().to_owned()).is_err() {
                    return;
                }
            }
        });
        Self(Some(receiver))
    }

    /// The next line; waits for ever without a person.
    async fn next(&mut self) -> Option<String> {
        match &mut self.0 {
            Some(receiver) => receiver.recv().await,
            None => std::future::pending().await,
        }
    }

    /// The answer to a question; empty where nobody is asked.
    async fn ask(&mut self, question: &str) -> Result<String> {
        for line in question.lines() {
            print_line(wrapped("", line).trim_end());
        }
        match &mut self.0 {
            Some(receiver) => receiver.recv().await.context("no answer came; every question has a flag"),
            None => Ok(String::new()),
        }
    }

    const fn has_person(&self) -> bool {
        self.0.is_some()
    }
}

/// Runs the guide on a link until the last motion.
pub(super) async fn run(link: TemplateLink, base: Option<BundledRobot>, flags: &GuideFlags) -> Result<GuidedRobot> {
    let mut signals = Signals::listen()?;
    tokio::select! {
        guided = guide(link, base, flags) => guided,
        () = signals.received() => bail!("stopped before the last motion; nothing was written"),
    }
}

async fn guide(link: TemplateLink, base: Option<BundledRobot>, flags: &GuideFlags) -> Result<GuidedRobot> {
    let timer = HostTimer::start();
    let mut answers = Answers::open(flags);
    let url = link.url.clone();
    let wait = Duration::try_from_secs_f64(flags.wait_s).unwrap_or(Duration::MAX);
    let opened = tokio::time::timeout(wait, OpenLink::open(link, timer)).await;
    let mut opened = opened.map_err(|_elapsed| {
        anyhow!(
            "`{url}` did not come up within {} s; `posebridge doctor` looks for ports and rights, --wait-s waits longer",
            flags.wait_s
        )
    })??;
    let source = identify(&mut opened, base, flags, &mut answers).await?;
    let session = GuideSession::new(source.station_config()?, flags.settings(&source), timer.now())?;
    let mut loop_ =
        GuideLoop { link: opened.link, timer, session, flags, answers, last_news: timer.now(), was_quiet: false };
    loop_.run().await?;
    Ok(GuidedRobot { source, session: loop_.session })
}

/// A link that is up, and how it is written.
struct OpenLink {
    link: Link,
    template: TemplateLink,
    timer: HostTimer,
}

impl OpenLink {
    async fn open(template: TemplateLink, timer: HostTimer) -> Result<Self> {
        let url = LinkUrl::parse(&template.url)?;
        let role = if template.is_listening { ConnectRole::Listen } else { ConnectRole::Dial };
        let mut link = Link::new(LinkOpenConfig { id: LinkId(0), url, role }, timer);
        link.try_open().await.with_context(|| format!("opening `{}`", template.url))?;
        loop {
            match link.next_event().await {
                LinkEvent::Up { .. } => return Ok(Self { link, template, timer }),
                LinkEvent::Down { reason, .. } => print_line(&format!("{}: {reason}; it is tried again", template.url)),
                LinkEvent::Bytes { .. } | LinkEvent::Finished { .. } => {}
            }
        }
    }

    /// The same link anew, perhaps at another speed.
    async fn reopen(&mut self, url: String) -> Result<()> {
        let template = TemplateLink { url, ..self.template.clone() };
        // A device must be closed before it is opened again.
        let idle =
            LinkOpenConfig { id: LinkId(0), url: LinkUrl::parse("udp://127.0.0.1:0")?, role: ConnectRole::Listen };
        self.link = Link::new(idle, self.timer);
        *self = Self::open(template, self.timer).await?;
        Ok(())
    }

    async fn listen(&mut self, listen_for: TimeDelta) -> ListenResult {
        listen(&mut self.link, self.timer, listen_for).await
    }
}

/// Finds out what the link carries, and asks what only a person knows.
async fn identify(
    opened: &mut OpenLink,
    base: Option<BundledRobot>,
    flags: &GuideFlags,
    answers: &mut Answers,
) -> Result<RobotSource> {
    let listen_for = TimeDelta::from_secs_f64(flags.listen_for);
    print_line(&format!("listening on {} for up to {} s", opened.template.url, flags.listen_for));
    let mut received = opened.listen(listen_for).await;
    let mut protocol = received.detect().protocol;
    if let Some(brick) = &flags.brick {
        let mut source = RobotSource::new(opened.template.clone(), format!("--brick {brick}"), brick, base)?;
        source.accept_mavlink1 = protocol == Protocol::Mavlink1;
        if source.reads_text() {
            map_columns(opened, received, &mut source, flags, answers).await?;
        }
        return Ok(source);
    }
    if protocol == Protocol::Unrecognized {
        for other in other_speeds(opened.link.url()) {
            print_line(&format!("noise; listening on {other}"));
            opened.reopen(other.to_string()).await?;
            received = opened.listen(listen_for).await;
            protocol = received.detect().protocol;
            if protocol.is_known() {
                "the speed at which the robot was understood".clone_into(&mut opened.template.origin);
                break;
            }
        }
    }
    if protocol == Protocol::NoData {
        protocol = probe(opened, flags, answers).await?;
    }
    let brick = brick_of(protocol)?;
    print_line(&format!("it speaks {}", protocol.name()));
    let mut source = RobotSource::new(opened.template.clone(), protocol.name().to_owned(), brick, base)?;
    source.accept_mavlink1 = protocol == Protocol::Mavlink1;
    if source.reads_text() {
        map_columns(opened, received, &mut source, flags, answers).await?;
    }
    Ok(source)
}

/// Asks a silent link as a NXT, then as an EV3, for what their codecs ask first: only if the user agrees.
async fn probe(opened: &mut OpenLink, flags: &GuideFlags, answers: &mut Answers) -> Result<Protocol> {
    let agrees = flags.probe || {
        let question =
            "silence. A LEGO brick answers only when it is asked; the question changes nothing on it. Ask? [y/N]";
        answers.has_person() && matches!(answers.ask(question).await?.as_str(), "y" | "Y" | "yes")
    };
    if !agrees {
        return Ok(Protocol::NoData);
    }
    for (brick, expected) in [("nxt", Protocol::Nxt), ("ev3", Protocol::Ev3)] {
        print_line(&format!("asking: is it an {}?", brick.to_uppercase()));
        let source = RobotSource::new(opened.template.clone(), String::new(), brick, None)?;
        let mut session = GuideSession::new(source.station_config()?, flags.settings(&source), opened.timer.now())?;
        session.handle(opened.timer.now(), &Input::Link { link: LinkId(0), state: LinkState::Up });
        let bytes = exchange(opened, &mut session, expected).await;
        if recognise(&bytes).protocol == expected {
            return Ok(expected);
        }
        let url = opened.template.url.clone();
        opened.reopen(url).await?;
    }
    Ok(Protocol::NoData)
}

/// Lets a codec talk to the link; returns what came back.
async fn exchange(opened: &mut OpenLink, session: &mut GuideSession, expected: Protocol) -> Vec<u8> {
    let end = opened.timer.now() + PROBE_TIME;
    let mut received = Vec::new();
    loop {
        send_all(&mut opened.link, session);
        let wake = session.deadline().map_or(end, |deadline| deadline.min(end));
        let input = tokio::select! {
            event = opened.link.next_event() => event,
            () = opened.timer.sleep_until(wake) => {
                if opened.timer.now() >= end || recognise(&received).protocol == expected {
                    return received;
                }
                session.handle(opened.timer.now(), &Input::Tick);
                continue;
            }
        };
        if let LinkEvent::Bytes { peer, arrival, bytes } = input {
            received.extend_from_slice(&bytes);
            session.handle(arrival, &Input::Bytes { link: LinkId(0), peer, bytes });
        }
    }
}

fn send_all(link: &mut Link, session: &mut GuideSession) {
    for (to, priority, frame) in session.outgoing.drain(..) {
        link.send_outgoing(&OutgoingFrame { to, priority, frame: &frame });
    }
}

/// Finds what each column is: by the flag, or by a guess that a person confirms.
async fn map_columns(
    opened: &mut OpenLink,
    mut received: ListenResult,
    source: &mut RobotSource,
    flags: &GuideFlags,
    answers: &mut Answers,
) -> Result<()> {
    if !flags.columns.is_empty() {
        // Without rows yet, a wrong number of columns is told by the codec.
        if let Some(table) = ColumnTable::read(&received.bytes) {
            check_columns(&flags.columns, table.columns.len())?;
        }
        source.set_columns(flags.columns.clone());
        return Ok(());
    }
    let mut mapping = guess(&received)?;
    if mapping.1.wheels == WheelEvidence::Order {
        print_line("roll the robot a little, forward and back, so that the columns of the wheels show");
        let end = opened.timer.now() + TimeDelta::from_secs_f64(flags.wait_s);
        while mapping.1.wheels == WheelEvidence::Order && received.bytes.len() < MAX_ROLL_BYTES {
            ensure!(opened.timer.now() < end, "no column counted; name them with --columns");
            let more = opened.listen(ROLL_LOOK).await;
            received.bytes.extend_from_slice(&more.bytes);
            if let (Some([first, _]), Some([_, last])) = (received.arrivals, more.arrivals) {
                received.arrivals = Some([first, last]);
            }
            mapping = guess(&received)?;
        }
    }
    let (table, mapping) = mapping;
    print_lines(&column_lines(&table, &mapping.guesses));
    let guessed: Vec<String> = mapping.guesses.iter().map(|guess| guess.column.to_string()).collect();
    let columns = loop {
        let answer = if answers.has_person() {
            answers.ask("Enter takes this; or write all names, such as time_ms,left_ticks,right_ticks:").await?
        } else {
            String::new()
        };
        if answer.is_empty() {
            break guessed;
        }
        let named: Vec<String> = answer.split(',').map(|name| name.trim().to_owned()).collect();
        match check_columns(&named, table.columns.len()) {
            Ok(()) => break named,
            Err(error) => print_line(&error.to_string()),
        }
    };
    let has = |name: &str| columns.iter().any(|column| column.trim_start_matches('-') == name);
    ensure!(
        has("left_ticks") && has("right_ticks"),
        "no columns of the wheels' counts are known; name them with --columns, such as time_ms,left_ticks,right_ticks"
    );
    source.set_columns(columns);
    Ok(())
}

fn guess(received: &ListenResult) -> Result<(ColumnTable, ColumnMapping)> {
    let table = ColumnTable::read(&received.bytes).context(
        "no lines with the same number of numbers came; print one line for each reading, or name the layout with --columns",
    )?;
    let span = received.arrivals.map(|[first, last]| last - first);
    let mapping = guess_columns(&table, span);
    Ok((table, mapping))
}

struct GuideLoop<'a> {
    link: Link,
    timer: HostTimer,
    session: GuideSession,
    flags: &'a GuideFlags,
    answers: Answers,
    /// When something last happened that brings the guide on.
    last_news: Timestamp<HostClock>,
    was_quiet: bool,
}

impl GuideLoop<'_> {
    async fn run(&mut self) -> Result<()> {
        self.session.handle(self.timer.now(), &Input::Link { link: LinkId(0), state: LinkState::Up });
        self.prompt();
        while self.session.guide.step().is_some() {
            send_all(&mut self.link, &mut self.session);
            let give_up = self.last_news + TimeDelta::from_secs_f64(self.flags.wait_s);
            let quiet = if self.was_quiet { give_up } else { self.last_news + QUIET };
            let wake = self.session.deadline().map_or(give_up, |due| due.min(give_up)).min(quiet);
            let events = tokio::select! {
                event = self.link.next_event() => self.on_link_event(event)?,
                answer = self.answers.next() => self.on_answer(answer)?,
                () = self.timer.sleep_until(wake) => self.session.handle(self.timer.now(), &Input::Tick),
            };
            for text in self.session.texts.drain(..) {
                print_line(&format!("  {text}"));
            }
            for event in events {
                self.on_guide_event(&event);
            }
            self.check_patience()?;
        }
        Ok(())
    }

    fn on_link_event(&mut self, event: LinkEvent) -> Result<Vec<GuideEvent>> {
        let link = LinkId(0);
        let (now, input) = match event {
            LinkEvent::Bytes { peer, arrival, bytes } => (arrival, Input::Bytes { link, peer, bytes }),
            LinkEvent::Up { at, .. } => (at, Input::Link { link, state: LinkState::Up }),
            LinkEvent::Down { at, reason, .. } => {
                print_line(&format!("the link is down: {reason}; it is tried again"));
                (at, Input::Link { link, state: LinkState::Down })
            }
            LinkEvent::Finished { .. } => bail!("the link ended before the last motion"),
        };
        Ok(self.session.handle(now, &input))
    }

    fn on_answer(&mut self, answer: Option<String>) -> Result<Vec<GuideEvent>> {
        let Some(answer) = answer else {
            // Nobody types any more; the counts still show when a motion ends.
            self.answers = Answers(None);
            return Ok(Vec::new());
        };
        self.last_news = self.timer.now();
        match answer.as_str() {
            "" => return Ok(self.session.guide.end_motion().into_iter().collect()),
            "a" => self.session.guide.repeat(),
            "s" => self.session.guide.skip(),
            "q" => bail!("stopped before the last motion; nothing was written"),
            _ => print_line("  that is none of the answers:"),
        }
        self.prompt();
        Ok(Vec::new())
    }

    fn on_guide_event(&mut self, event: &GuideEvent) {
        self.last_news = self.timer.now();
        self.was_quiet = false;
        print_lines(&words::event_lines(event, &self.session.guide));
        if !matches!(event, GuideEvent::MotionBegan(_)) {
            self.prompt();
        }
    }

    fn prompt(&self) {
        if let Some(step) = self.session.guide.step() {
            print_lines(&words::prompt_lines(step, self.session.guide.settings()));
            if self.answers.has_person() {
                print_line(words::KEYS);
            }
        }
    }

    fn check_patience(&mut self) -> Result<()> {
        let waited = self.timer.now() - self.last_news;
        let has_wheels = self.session.guide.log().has_wheels();
        if waited >= QUIET && !has_wheels && !self.was_quiet {
            self.was_quiet = true;
            print_line("  no counts of wheels were heard yet: does the robot send them, and is its program running?");
        }
        let step = self.session.guide.step().map_or("", GuideStep::flag_name);
        ensure!(
            waited < TimeDelta::from_secs_f64(self.flags.wait_s),
            "{} within {} s; --wait-s waits longer, --skip leaves it out",
            if has_wheels {
                format!("the motion `{step}` was not seen")
            } else {
                "no counts of wheels were heard".to_owned()
            },
            self.flags.wait_s
        );
        Ok(())
    }
}
