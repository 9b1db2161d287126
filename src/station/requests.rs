//! Executes the station's requests to the program: saving the tunables, starting and stopping a recording, controlling the simulated
//! brick. The outcome returns to the station as a log line, and so into the recording. It runs in the station loop, between a robot and
//! its steering: threads do what may wait for a disk.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, ensure};
use posebridge_link::HostTimer;
use posebridge_sim::impairment::LinkProfile;
use posebridge_telemetry::severity::{INFO, WARNING};
use posebridge_telemetry::{
    ChannelName, HostClock, Input, LinkId, LinkState, ParameterName, Request, RobotId, SimulatorCommand,
    SteeringSource, TimeDelta, Timestamp,
};
use tokio::sync::mpsc;

use super::recorder::{Recorder, RecordingTotals, StoppingRecorder};
use super::recording_files::{RECORDING, done_message, header, unused_path};
use super::simulator::CommandSender;
use crate::config::Config;
use crate::console::print_line;
use crate::exit::DeferredErrors;

/// Minimum interval between recordings started on request: each creates a file, and repeated clicks should not create hundreds.
const MIN_START_INTERVAL: TimeDelta = TimeDelta::from_millis(1_000);

pub struct RequestHandler {
    folder: PathBuf,
    timer: HostTimer,
    /// As loaded, for the saved file.
    config: Config,
    recorded_config: Config,
    /// The thread that saves configurations; started by the first request.
    saver: Option<ConfigSaver>,
    current: Option<PathBuf>,
    ended_recordings: Vec<(PathBuf, StoppingRecorder)>,
    /// First number to try for the next recording: lower ones are in use, or will be when the thread creates their files.
    next_number: u32,
    last_started: Option<Timestamp<HostClock>>,
    links: BTreeMap<LinkId, LinkState>,
    bricks: Vec<ReachableBrick>,
    overrides: SimulatorOverrides,
}

/// A simulated brick that accepts commands.
pub struct ReachableBrick {
    /// `None` for the only one.
    pub robot: Option<RobotId>,
    pub commands: CommandSender,
}

/// Latest settings of the simulated brick; `None` before the first change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SimulatorOverrides {
    pub steering: Option<SteeringSource>,
    pub link_profile: Option<ChannelName>,
}

impl SimulatorOverrides {
    fn record(&mut self, command: &SimulatorCommand) {
        // The others pass by themselves, or are seen in what the brick sends.
        if let SimulatorCommand::Steering(by) = command {
            self.steering = Some(*by);
        } else if let SimulatorCommand::LinkProfile(profile) = command {
            self.link_profile = *profile;
        }
    }
}

impl RequestHandler {
    /// `recorded_config` is the configuration for the header of a recording, `current` the recording being written.
    pub fn new(
        folder: PathBuf,
        timer: HostTimer,
        config: Config,
        recorded_config: Config,
        current: Option<PathBuf>,
    ) -> Self {
        Self {
            folder,
            timer,
            config,
            recorded_config,
            saver: None,
            next_number: if current.is_some() { 2 } else { 1 },
            last_started: None,
            current,
            ended_recordings: Vec::new(),
            links: BTreeMap::new(),
            bricks: Vec::new(),
            overrides: SimulatorOverrides::default(),
        }
    }

    pub fn with_bricks(mut self, bricks: Vec<ReachableBrick>) -> Self {
        self.bricks = bricks;
        self
    }

    /// Remembers inputs with which a later recording has to begin.
    pub fn on_input(&mut self, input: &Input) {
        if let Input::Link { link, state } = input {
            self.links.insert(*link, *state);
        }
    }

    pub fn current(&self) -> Option<&Path> {
        self.current.as_deref()
    }

    pub const fn overrides(&self) -> SimulatorOverrides {
        self.overrides
    }

    /// The recorder has failed.
    pub fn drop_recording(&mut self) {
        self.current = None;
    }

    /// Executes a request made after `input_count` inputs and returns its outcome as an input of the station; `None` if the station has
    /// already reported it. Outcomes of longer requests come from [`Self::next_report`].
    pub fn execute(
        &mut self,
        now: Timestamp<HostClock>,
        input_count: u64,
        request: &Request,
        recorder: &mut Option<Recorder>,
    ) -> Option<Input> {
        let outcome = match request {
            Request::SaveParameters { values } => match self.save_config(values) {
                Ok(()) => return None,
                Err(error) => Err(error),
            },
            Request::StartRecording { values } => self.start(now, input_count, values, recorder),
            Request::StopRecording => self.stop(recorder),
            // The fleet's.
            Request::ShareFix { .. } => return None,
            Request::Simulator { robot, command } => match self.forward_to_simulator(*robot, command) {
                // What happens to the brick stands in the command.
                Ok(()) => return None,
                Err(error) => Err(error),
            },
        };
        Some(report_input(outcome))
    }

    /// The outcome of the next longer request; pending forever if there is none. Cancel safe.
    pub async fn next_report(&mut self) -> Input {
        match &mut self.saver {
            Some(saver) => saver.next_report().await,
            None => std::future::pending().await,
        }
    }

    /// Waits for pending saves and ended recordings; returns these with their totals. A failed one does not prevent the report of the
    /// others.
    pub fn finish(self, failures: &mut DeferredErrors) -> Vec<(PathBuf, RecordingTotals)> {
        if let Some(saver) = self.saver {
            saver.finish();
        }
        let ended = self.ended_recordings.into_iter();
        let finished = ended.filter_map(|(path, stopping)| {
            let kept = stopping.wait().context("the recording is not whole");
            Some((path, failures.record(kept)?))
        });
        finished.collect()
    }

    /// Sends a command to a robot's simulated brick, or to the first; never waits.
    fn forward_to_simulator(&mut self, robot: Option<RobotId>, command: &SimulatorCommand) -> Result<()> {
        let name = command.name();
        let is_target = |brick: &ReachableBrick| robot.is_none() || brick.robot.is_none() || brick.robot == robot;
        let index = self.bricks.iter().position(is_target);
        let index = index.with_context(|| match robot {
            Some(robot) if !self.bricks.is_empty() => format!("{name}: {robot} is no simulated brick of this station"),
            _ => format!("{name}: this station has no simulated brick of its own"),
        })?;
        let brick = &self.bricks[index];
        if let SimulatorCommand::LinkProfile(Some(profile)) = command {
            LinkProfile::bundled(profile.as_str()).with_context(|| name.to_owned())?;
        }
        brick.commands.try_send(*command).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => anyhow!("{name}: too many at a time"),
            mpsc::error::TrySendError::Closed(_) => anyhow!("{name}: the brick has stopped"),
        })?;
        // What is shown as set is the first one's.
        if index == 0 {
            self.overrides.record(command);
        }
        Ok(())
    }

    fn save_config(&mut self, values: &[(ParameterName, f64)]) -> Result<()> {
        let config = with_tunables(&self.config, values);
        let saver = match self.saver.take() {
            Some(saver) => saver,
            None => ConfigSaver::start(self.folder.clone())?,
        };
        self.saver.insert(saver).save(config)
    }

    fn start(
        &mut self,
        now: Timestamp<HostClock>,
        input_count: u64,
        values: &[(ParameterName, f64)],
        recorder: &mut Option<Recorder>,
    ) -> Result<String> {
        if let Some(path) = &self.current {
            return Err(anyhow!(done_message("already recording", path)));
        }
        ensure!(
            self.last_started.is_none_or(|last| now - last >= MIN_START_INTERVAL),
            "not recording: the last one began less than {} s ago",
            MIN_START_INTERVAL.as_secs_f64()
        );
        let (path, number) = unused_path(&self.folder, RECORDING, self.next_number)?;
        let config = with_tunables(&self.recorded_config, values);
        ensure!(self.folder.is_dir(), done_message("not recording, its folder is gone:", &path));
        let header = header(&config, self.timer.utc_start())?;
        let limits = config.record.limits();
        // A replay begins with all links down, as a run does: their states stand in the place of the inputs that reported them.
        let before = input_count.saturating_sub(self.links.len() as u64);
        let mut begun = Recorder::start_in_session(&path, &header, limits, before)?;
        for (link, state) in &self.links {
            let (link, state) = (*link, *state);
            begun.record(now, Input::Link { link, state })?;
        }
        *recorder = Some(begun);
        self.next_number = number + 1;
        self.last_started = Some(now);
        let message = done_message("recording", &path);
        self.current = Some(path);
        Ok(message)
    }

    fn stop(&mut self, recorder: &mut Option<Recorder>) -> Result<String> {
        let (Some(path), Some(recorder)) = (self.current.take(), recorder.take()) else {
            return Err(anyhow!("nothing is being recorded"));
        };
        let message = done_message("recorded", &path);
        // The disk may be behind: the station loop does not wait for it.
        self.ended_recordings.push((path, recorder.stop()));
        Ok(message)
    }
}

fn with_tunables(config: &Config, values: &[(ParameterName, f64)]) -> Config {
    let mut config = config.clone();
    let values = values.iter().map(|(name, value)| (name.as_str().to_owned(), *value));
    config.filter.params.extend(values);
    config
}

/// File name of the saved configuration.
const SAVED: &str = "parameters.toml";
/// Queued configurations; each is a user's request.
const QUEUE_CAPACITY: usize = 4;

struct ConfigSaver {
    jobs: SyncSender<Config>,
    reports: mpsc::Receiver<Input>,
    thread: JoinHandle<()>,
}

impl ConfigSaver {
    /// Starts the thread. All configurations of this run go into one file of the folder; foreign files are never overwritten.
    fn start(folder: PathBuf) -> Result<Self> {
        let (jobs, waiting) = sync_channel(QUEUE_CAPACITY);
        let (reports, waiting_reports) = mpsc::channel(QUEUE_CAPACITY);
        let thread = std::thread::Builder::new()
            .name("saver".to_owned())
            .spawn(move || save_all(&folder, &waiting, &reports))
            .context("starting the thread that saves")?;
        Ok(Self { jobs, reports: waiting_reports, thread })
    }

    fn save(&self, config: Config) -> Result<()> {
        self.jobs.try_send(config).map_err(|refused| match refused {
            TrySendError::Full(_) => anyhow!("not saved: the disk is behind, ask again"),
            TrySendError::Disconnected(_) => anyhow!("not saved: the thread that saves died"),
        })
    }

    /// The outcome of the next save; pending forever if there is none.
    async fn next_report(&mut self) -> Input {
        match self.reports.recv().await {
            Some(report) => report,
            None => std::future::pending().await,
        }
    }

    /// Waits for pending saves; prints results that were not received yet.
    fn finish(mut self) {
        drop(self.jobs);
        self.reports.close();
        if self.thread.join().is_err() {
            print_line("the thread that saves died");
        }
        while let Ok(Input::Report { text, .. }) = self.reports.try_recv() {
            print_line(&text);
        }
    }

    /// The outcome of the next save, for tests without a runtime.
    #[cfg(test)]
    fn wait(&mut self) -> Option<Input> {
        self.reports.blocking_recv()
    }
}

fn save_all(folder: &Path, jobs: &Receiver<Config>, reports: &mpsc::Sender<Input>) {
    let mut saved = None;
    for config in jobs {
        let report = report_input(save(folder, &mut saved, &config));
        if let Err(unheard) = reports.blocking_send(report)
            && let Input::Report { text, .. } = unheard.0
        {
            print_line(&text);
        }
    }
}

fn save(folder: &Path, saved: &mut Option<PathBuf>, config: &Config) -> Result<String> {
    let path = match saved {
        Some(path) => path.clone(),
        None => unused_path(folder, SAVED, 1)?.0,
    };
    let text = format!(
        "# The configuration of a run with the parameters that were saved in it: posebridge run --config {SAVED}\n\n{}",
        toml::to_string(config).context("writing the configuration")?
    );
    // Atomic: a reader finds the old file or the new one.
    let beside = path.with_extension("toml.new");
    std::fs::write(&beside, text)
        .and_then(|()| std::fs::rename(&beside, &path))
        .with_context(|| done_message("not saved", &path))?;
    let message = done_message("saved", &path);
    *saved = Some(path);
    Ok(message)
}

fn report_input(outcome: Result<String>) -> Input {
    match outcome {
        Ok(text) => Input::Report { severity: INFO, text },
        Err(error) => Input::Report { severity: WARNING, text: format!("{error:#}") },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config;

    fn handler(folder: &Path) -> RequestHandler {
        let config = Config::default();
        let timer = HostTimer::start();
        RequestHandler::new(folder.to_owned(), timer, config.clone(), config, None)
    }

    fn tuned(value: f64) -> Request {
        Request::SaveParameters { values: vec![(ParameterName::from_bytes(b"slip_nis"), value)] }
    }

    #[test]
    fn what_is_saved_is_read_back_and_a_file_of_somebody_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("parameters.toml");
        std::fs::write(&own, "# mine\n").unwrap();
        let mut handler = handler(folder.path());
        for value in [20.0, 30.0] {
            assert_eq!(handler.execute(Timestamp::ZERO, 0, &tuned(value), &mut None), None);
            let report = handler.saver.as_mut().unwrap().wait();
            let Some(Input::Report { severity: 6, text }) = report else {
                panic!("{report:?}");
            };
            let path = folder.path().join("parameters-2.toml");
            let folder = folder.path().display();
            assert_eq!(text, format!("saved parameters-2.toml in {folder}"));
            let loaded = config::load(Some(&path), &[]).unwrap().config;
            assert_eq!(loaded.filter.params["slip_nis"], value);
            assert_eq!(loaded.links, Config::default().links);
        }
        assert_eq!(std::fs::read_to_string(own).unwrap(), "# mine\n");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_folder_that_is_gone_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let mut handler = handler(&folder.path().join("gone"));
        for (request, beginning) in [
            (tuned(20.0), "not saved parameters.toml in "),
            (Request::StartRecording { values: vec![] }, "not recording, its folder is gone: recording.mcap"),
            (Request::StopRecording, "nothing is being recorded"),
        ] {
            let report = handler.execute(Timestamp::ZERO, 0, &request, &mut None);
            let report = report.or_else(|| handler.saver.as_mut()?.wait());
            let Some(Input::Report { severity: 4, text }) = report else {
                panic!("{report:?}");
            };
            assert!(text.starts_with(beginning), "{text}");
        }
    }

    #[test]
    fn only_a_station_with_a_simulated_brick_does_things_to_it_and_never_waits_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let kidnap = SimulatorCommand::Kidnap { forward_m: 0.0, left_m: 0.3, turn_rad: 0.0 };
        let report_of = |handler: &mut RequestHandler, command| {
            let request = Request::Simulator { robot: None, command };
            match handler.execute(Timestamp::ZERO, 0, &request, &mut None) {
                Some(Input::Report { severity: 4, text }) => text,
                None => "done".to_owned(),
                other => panic!("{other:?}"),
            }
        };
        let mut without = handler(folder.path());
        assert_eq!(report_of(&mut without, kidnap), "kidnap: this station has no simulated brick of its own");
        let (sender, mut receiver) = mpsc::channel(1);
        let mut with = handler(folder.path()).with_bricks(vec![ReachableBrick { robot: None, commands: sender }]);
        assert_eq!(report_of(&mut with, kidnap), "done");
        assert_eq!(report_of(&mut with, kidnap), "kidnap: too many at a time");
        assert_eq!(receiver.try_recv(), Ok(kidnap));
        let profile = |name: &[u8]| SimulatorCommand::LinkProfile(Some(ParameterName::from_bytes(name)));
        let unknown = report_of(&mut with, profile(b"string"));
        assert!(unknown.starts_with("link-profile: "), "{unknown}");
        assert!(unknown.contains("string") && unknown.contains("usb"), "{unknown}");
        assert_eq!(with.overrides(), SimulatorOverrides::default(), "what was refused does not hold");
        assert_eq!(report_of(&mut with, profile(b"usb")), "done");
        let usb = ChannelName::from_bytes(b"usb");
        assert_eq!(with.overrides().link_profile, Some(usb));
        drop(receiver);
        assert_eq!(report_of(&mut with, kidnap), "kidnap: the brick has stopped");
    }

    #[test]
    fn recordings_follow_one_another_under_names_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let mut handler = handler(folder.path());
        let mut recorder = None;
        let start = Request::StartRecording { values: vec![] };
        let up = Input::Link { link: LinkId(0), state: LinkState::Up };
        handler.on_input(&up);
        for (now_s, name) in (0..).zip(["recording.mcap", "recording-2.mcap"]) {
            for (request, what) in
                [(&start, "recording"), (&start, "already recording"), (&Request::StopRecording, "recorded")]
            {
                let expected = done_message(what, &folder.path().join(name));
                let now = Timestamp::from_millis(1_000 * now_s);
                let report = handler.execute(now, 0, request, &mut recorder);
                let Some(Input::Report { text, .. }) = report else {
                    panic!("{report:?}");
                };
                assert_eq!(text, expected);
            }
        }
        let mut failures = DeferredErrors::default();
        let ended = handler.finish(&mut failures);
        let inputs: Vec<u64> = ended.iter().map(|ended| ended.1.inputs).collect();
        assert_eq!(inputs, [1, 1], "the link that was up");
        failures.into_result().unwrap();
    }

    #[test]
    fn a_recording_that_could_not_be_written_does_not_cost_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let mut handler = handler(folder.path());
        let start = Request::StartRecording { values: vec![] };
        let mut recorder = None;
        // Gone between the look at the folder and the file: the recorder's thread cannot make it.
        let missing = folder.path().join("gone/recording.mcap");
        let lost = Recorder::start_in_session(
            &missing,
            &header(&Config::default(), 0).unwrap(),
            Config::default().record.limits(),
            0,
        );
        handler.ended_recordings.push((missing, lost.unwrap().stop()));
        handler.execute(Timestamp::ZERO, 0, &start, &mut recorder);
        handler.execute(Timestamp::ZERO, 0, &Request::StopRecording, &mut recorder);
        let mut failures = DeferredErrors::default();
        let ended = handler.finish(&mut failures);
        let names: Vec<_> = ended.iter().map(|(path, _)| path.file_name()).collect();
        assert_eq!(names, [Some("recording.mcap".as_ref())]);
        let error = format!("{:#}", failures.into_result().unwrap_err());
        assert!(error.contains("gone/recording.mcap"), "{error}");
    }

    #[test]
    fn who_asks_for_recordings_without_end_gets_one_a_second() {
        let folder = tempfile::tempdir().unwrap();
        let mut handler = handler(folder.path());
        let start = Request::StartRecording { values: vec![] };
        let mut recorder = None;
        for now_ms in (0..3_000).step_by(10) {
            let now = Timestamp::from_millis(now_ms);
            for request in [&start, &Request::StopRecording] {
                handler.execute(now, 0, request, &mut recorder);
            }
        }
        let mut failures = DeferredErrors::default();
        let ended = handler.finish(&mut failures);
        let names: Vec<_> = ended.iter().filter_map(|(path, _)| path.file_name()).collect();
        let expected = ["recording.mcap", "recording-2.mcap", "recording-3.mcap"];
        assert_eq!(names, expected);
    }

    #[test]
    fn files_that_are_there_already_keep_their_names() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.toml", "a-2.toml", "a-4.toml"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        for (first, expected) in [(1, 3), (2, 3), (3, 3), (4, 5), (9, 9)] {
            let (path, number) = unused_path(folder.path(), "a.toml", first).unwrap();
            assert_eq!(number, expected);
            assert_eq!(path, folder.path().join(format!("a-{expected}.toml")));
        }
        let first = unused_path(folder.path(), "b.toml", 1).unwrap();
        assert_eq!(first, (folder.path().join("b.toml"), 1));
    }
}
