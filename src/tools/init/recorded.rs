//! The guide on a recording or a table: the motions are found in it, or named by their times.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_estimator::hand_motions::{GuideEvent, GuideStep, MotionProblem, SetupGuide};
use posebridge_protocol::bricks::text_line::{Column, Quantity};
use posebridge_protocol::text_columns::{ColumnTable, guess_columns};
use posebridge_recording::container::RecordingReader;
use posebridge_station::StationConfig;
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, PeerId, TimeDelta, Timestamp};

use super::args::GuideFlags;
use super::live::GuidedRobot;
use super::robot_source::{RobotSource, check_columns, column_lines, with_raw_counts};
use super::session::GuideSession;
use super::words;
use crate::config::{BundledRobot, Overlay, TemplateLink, config_with_overlay};
use crate::console::{print_line, print_lines};
use crate::station::input_file::{InputFile, InputKind};
use crate::station::recorded_session::for_each_input;
use crate::station::signing::recorded_station_config;
use crate::tools::import::{self, StationOptions, messages_hint};

const MAX_TABLE_BYTES: u64 = 256 << 20;
/// A longer pause of a logger is another recording.
const MAX_STEP_S: f64 = 3_600.0;
const MAVLINK: &str = "mavlink";

/// Reads the file. `link` is the link for the configuration, where the file names none.
pub(super) fn run(
    path: &Path,
    link: TemplateLink,
    base: Option<BundledRobot>,
    flags: &GuideFlags,
) -> Result<GuidedRobot> {
    let file = InputFile::open(path)?;
    let mut player = match file.kind {
        InputKind::Own | InputKind::Tlog => Player::of_recording(path, link, base, flags)?,
        InputKind::Bytes => Player::of_table(file, link, base, flags)?,
        InputKind::Messages => bail!(messages_hint(path)),
        InputKind::Descriptor => bail!(
            "`{}` describes data of others, whose robot stands in it; --from reads a recording or a table",
            path.display()
        ),
    };
    player.finish(flags)?;
    Ok(GuidedRobot { source: player.source, session: player.session })
}

/// Refuses what a reader of numbers in their order would misread: decimal commas, and cells without a number.
fn check_cells(name: &str, text: &str) -> Result<()> {
    for (index, line) in text.lines().enumerate() {
        let number = index + 1;
        let delimiter = [';', '\t'].into_iter().find(|delimiter| line.contains(*delimiter)).unwrap_or(',');
        // A logger may end each line with its delimiter.
        let line = line.trim_end().strip_suffix(delimiter).unwrap_or(line);
        let cells: Vec<&str> = line.split(delimiter).map(str::trim).collect();
        let with_point = |cell: &str| cell.replacen(',', ".", 1);
        let is_number = |cell: &str| with_point(cell).parse::<f64>().is_ok();
        // A row begins with a number; names, remarks and blank rows do not.
        if cells.len() < 2 || !cells.first().is_some_and(|cell| is_number(cell)) {
            continue;
        }
        if let Some(cell) = cells.iter().find(|cell| cell.contains(',') && is_number(cell)) {
            bail!("`{name}`, line {number}: `{cell}` has a decimal comma; write `{}` in all lines", with_point(cell));
        }
        if let Some(empty) = cells.iter().position(|cell| cell.is_empty()) {
            bail!(
                "`{name}`, line {number}: cell {} is empty, and a line's numbers are taken in their order; leave such columns out",
                empty + 1
            );
        }
    }
    Ok(())
}

struct Player {
    source: RobotSource,
    session: GuideSession,
    /// Motions are named by the user, and not taken as they come.
    has_ranges: bool,
}

impl Player {
    fn of_recording(path: &Path, link: TemplateLink, base: Option<BundledRobot>, flags: &GuideFlags) -> Result<Self> {
        let name = path.display().to_string();
        let (bytes, notes) = import::recording_bytes(path, StationOptions::default())?;
        print_lines(&notes);
        let mut reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        let config = config_with_overlay(&reader.header().config_toml, Overlay::default())?;
        let recorded = config.links.first();
        let brick = recorded.and_then(|link| link.brick.clone()).unwrap_or_else(|| MAVLINK.to_owned());
        let brick = flags.brick.clone().unwrap_or(brick);
        let link = match recorded {
            Some(own) if !own.url.starts_with("sim://") && link.is_guess => TemplateLink {
                url: own.url.clone(),
                is_listening: own.listen,
                origin: format!("as in `{name}`"),
                ..TemplateLink::default()
            },
            _ => link,
        };
        let mut source = RobotSource::new(link, format!("a recording of {brick}"), &brick, base)?;
        source.accept_mavlink1 = recorded.is_some_and(|link| link.accept_mavlink1);
        source.line.clone_from(&config.robot.line);
        if source.reads_text() && !flags.columns.is_empty() {
            source.set_columns(flags.columns.clone());
        }
        let station = with_raw_counts(recorded_station_config(&config, &[])?);
        let mut player = Self::new(source, station, flags)?;
        for_each_input(&name, &mut reader, |now, input| {
            player.handle(now, input);
            Ok(())
        })?;
        Ok(player)
    }

    /// A table is what a board with columns would have printed, at the times of its own column.
    fn of_table(file: InputFile, link: TemplateLink, base: Option<BundledRobot>, flags: &GuideFlags) -> Result<Self> {
        let name = file.name.clone();
        let mut bytes = file.read_all(MAX_TABLE_BYTES)?;
        bytes.push(b'\n');
        check_cells(&name, &String::from_utf8_lossy(&bytes))?;
        let table = ColumnTable::read(&bytes).with_context(|| {
            format!("`{name}` has no rows with the same number of numbers: it is no table that --from can read")
        })?;
        let mapping = guess_columns(&table, None);
        let mut source = RobotSource::new(link, format!("the table `{name}`"), "columns", base)?;
        let guessed = mapping.guesses.iter().map(|guess| guess.column.to_string()).collect();
        if flags.columns.is_empty() {
            print_lines(&column_lines(&table, &mapping.guesses));
            source.set_columns(guessed);
        } else {
            check_columns(&flags.columns, table.columns.len())?;
            source.set_columns(flags.columns.clone());
        }
        let columns = source.line.iter().flat_map(|line| &line.columns);
        let unit = columns.enumerate().find_map(|(index, name)| Some((index, seconds_per_unit(name)?)));
        let (time, unit_s) = unit.with_context(|| {
            format!(
                "`{name}` has no column of the time; name it with --columns, such as time_ms,left_ticks,right_ticks"
            )
        })?;
        let station = source.station_config()?;
        let mut player = Self::new(source, station, flags)?;
        player.handle(Timestamp::ZERO, &Input::Link { link: LinkId(0), state: LinkState::Up });
        let times = &table.columns.get(time).context("a column of the time")?.values;
        let start = times.first().copied().unwrap_or(0.0);
        if table.is_cut {
            print_line(&format!("`{name}`: only the first {} rows are read", table.rows));
        }
        let mut before = start;
        for (row, at) in times.iter().enumerate() {
            let step_s = (at - before) * unit_s;
            ensure!(
                (0.0..=MAX_STEP_S).contains(&step_s),
                "`{name}`, row {}: the time goes from {before} to {at}, which is {step_s} s; cut the table there, or name the \
                 column of the time with --columns",
                row + 1
            );
            before = *at;
            let values = table.columns.iter().filter_map(|column| column.values.get(row));
            let line: Vec<String> = values.map(f64::to_string).collect();
            let arrival = Timestamp::ZERO + TimeDelta::from_secs_f64((at - start) * unit_s);
            player.handle_due(arrival);
            let bytes = format!("{}\n", line.join(",")).into_bytes();
            player.handle(arrival, &Input::Bytes { link: LinkId(0), peer: PeerId::default(), bytes });
        }
        Ok(player)
    }

    fn new(source: RobotSource, station: StationConfig, flags: &GuideFlags) -> Result<Self> {
        let session = GuideSession::new(station, flags.settings(&source), Timestamp::ZERO)?;
        Ok(Self { source, session, has_ranges: !flags.motions.is_empty() })
    }

    fn handle_due(&mut self, until: Timestamp<HostClock>) {
        while let Some(due) = self.session.deadline().filter(|due| *due < until) {
            self.handle(due, &Input::Tick);
        }
    }

    fn handle(&mut self, now: Timestamp<HostClock>, input: &Input) {
        let events = self.session.handle(now, input);
        self.session.outgoing.clear();
        if !self.has_ranges {
            for event in events {
                self.on_guide_event(&event);
            }
        }
    }

    fn on_guide_event(&mut self, event: &GuideEvent) {
        let guide = &mut self.session.guide;
        // In a recording without a turned wheel the first motion is that of both.
        if let GuideEvent::StepFailed(GuideStep::WheelTurn, MotionProblem::BothWheels { .. }) = event {
            guide.skip();
            let again = guide.repeat_motion();
            if let Some(event) = again {
                self.on_guide_event(&event);
            }
            return;
        }
        report(event, guide);
    }

    /// Takes the motions that the user names, or the last one; what is missing is an error.
    fn finish(&mut self, flags: &GuideFlags) -> Result<()> {
        print_lines(&self.session.texts);
        let guide = &mut self.session.guide;
        let (first, _) = guide.log().span().context("no counts of wheels were heard in it")?;
        if self.has_ranges {
            guide.restart();
            for range in &flags.motions {
                let at = |seconds: f64| first + TimeDelta::from_secs_f64(seconds);
                let name = range.motion.step().flag_name();
                let motion = guide.log().motion_between(at(range.from_s), at(range.to_s));
                let motion = motion.with_context(|| format!("--motions {name}: there are no counts in that time"))?;
                guide.go_to(range.motion.step());
                if let Some(event) = guide.apply(&motion) {
                    report(&event, guide);
                    if let GuideEvent::StepFailed(step, problem) = event {
                        bail!("--motions {}: {problem}", step.flag_name());
                    }
                }
            }
        } else if let Some(event) = guide.end_motion() {
            self.on_guide_event(&event);
        }
        let figures = self.session.guide.figures();
        ensure!(
            figures.straight.is_some() || flags.skip.iter().any(|skipped| skipped.step() == GuideStep::Straight),
            "no motion straight on was found; name the motions by their times, such as --motions wheel=2-6,straight=9-14,turn=17-23"
        );
        Ok(())
    }
}

fn report(event: &GuideEvent, guide: &SetupGuide) {
    match event {
        GuideEvent::MotionBegan(_) => {}
        GuideEvent::StepDone(_) => print_lines(&words::event_lines(event, guide)),
        GuideEvent::StepFailed(step, problem) => {
            print_lines(&[format!("  no motion `{}`: {problem}", step.flag_name())]);
        }
    }
}

/// The unit of a column of the time.
fn seconds_per_unit(name: &str) -> Option<f64> {
    let column = Column::from_name(name)?;
    #[expect(clippy::wildcard_enum_match_arm, reason = "no other quantity is a time")]
    match column.quantity {
        Quantity::TimeMs => Some(1e-3),
        Quantity::TimeUs => Some(1e-6),
        Quantity::TimeS => Some(1.0),
        _ => None,
    }
}
