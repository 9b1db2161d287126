//! What the pipeline asks of the program around it: to write the tunables down, to begin and to end a recording, to do something to the
//! simulated brick.
//!
//! What is saved is the whole configuration of the run with the tunables as they are set, as a file of its own in the run's folder:
//! `--config` reads it back. A file that this run has not written is never touched. What became of a request goes back into the
//! pipeline as a line for people, and so into the recording.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use posebridge_link::HostTimer;
use posebridge_recording::container::{FORMAT, Header};
use posebridge_sim::impairment::LinkProfile;
use posebridge_telemetry::{
    HostClock, Input, LinkId, LinkState, ParameterName, Request, SimulatorCommand, Stamp,
};
use tokio::sync::mpsc;

use super::recorder::{Kept, Recorder, Stopping};
use crate::config::Config;

/// MAV_SEVERITY_WARNING.
pub const WARNING: u8 = 4;
/// MAV_SEVERITY_INFO.
const INFO: u8 = 6;
/// So many names are tried before a file that is not there yet is given up.
const MOST_NAMES: u32 = 10_000;

/// The name of a run's first recording in its folder; those that follow have a number before the dot.
pub const RECORDING: &str = "recording.mcap";
/// The name of the saved configuration.
const SAVED: &str = "parameters.toml";

/// Carries out what the pipeline asks for.
pub struct Desk {
    folder: PathBuf,
    timer: HostTimer,
    /// As it was given, for the file that is saved.
    config: Config,
    /// As a recording needs it.
    recorded: Config,
    /// What this run has saved.
    saved: Option<PathBuf>,
    /// Which recording is being written, if any.
    current: Option<PathBuf>,
    /// Recordings that were ended while the run goes on.
    ended: Vec<(PathBuf, Stopping)>,
    links: BTreeMap<LinkId, LinkState>,
    /// The simulated brick of this station, if it has one.
    brick: Option<mpsc::Sender<SimulatorCommand>>,
}

impl Desk {
    /// For a run of this configuration in this folder; `current` is the recording that is being written.
    #[must_use]
    pub fn new(
        folder: PathBuf,
        timer: HostTimer,
        (config, recorded): (Config, Config),
        current: Option<PathBuf>,
    ) -> Self {
        Self {
            folder,
            timer,
            config,
            recorded,
            saved: None,
            current,
            ended: Vec::new(),
            links: BTreeMap::new(),
            brick: None,
        }
    }

    /// The same for a station that has a simulated brick of its own.
    #[must_use]
    pub fn with_brick(mut self, brick: Option<mpsc::Sender<SimulatorCommand>>) -> Self {
        self.brick = brick;
        self
    }

    /// Takes note of what a recording that begins later has to begin with.
    pub fn note(&mut self, input: &Input) {
        if let Input::Link { link, state } = input {
            self.links.insert(*link, *state);
        }
    }

    /// The recording that is being written.
    #[must_use]
    pub fn current(&self) -> Option<&Path> {
        self.current.as_deref()
    }

    /// The recorder has failed and is gone.
    pub fn lose_recording(&mut self) {
        self.current = None;
    }

    /// Does what is asked for now, after so many inputs; what became of it, for the pipeline. Nothing, if the pipeline has told it already.
    pub fn carry_out(
        &mut self,
        now: (Stamp<HostClock>, u64),
        request: &Request,
        recorder: &mut Option<Recorder>,
    ) -> Option<Input> {
        let outcome = match request {
            Request::SaveParameters { values } => self.save(values),
            Request::StartRecording { values } => self.start(now, values, recorder),
            Request::StopRecording => self.stop(recorder),
            Request::Simulator(command) => match self.pass_on(command) {
                // What happens to the brick stands in the command.
                Ok(()) => return None,
                Err(error) => Err(error),
            },
        };
        Some(match outcome {
            Ok(text) => Input::Report {
                severity: INFO,
                text,
            },
            Err(error) => Input::Report {
                severity: WARNING,
                text: format!("{error:#}"),
            },
        })
    }

    /// Waits for the recordings that were ended; which there are, with the number of their inputs.
    ///
    /// # Errors
    /// One of them could not be written to its end.
    pub fn finish(self) -> Result<Vec<(PathBuf, Kept)>> {
        let ended = self.ended.into_iter();
        let finished = ended.map(|(path, stopping)| Ok((path, stopping.wait()?)));
        finished.collect()
    }

    /// Hands a command to the simulated brick; never waits.
    fn pass_on(&self, command: &SimulatorCommand) -> Result<()> {
        let name = command.name();
        let brick = self.brick.as_ref();
        let brick = brick
            .with_context(|| format!("{name}: this station has no simulated brick of its own"))?;
        if let SimulatorCommand::LinkProfile(Some(profile)) = command {
            LinkProfile::bundled(profile.as_str()).with_context(|| name.to_owned())?;
        }
        brick.try_send(*command).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => anyhow!("{name}: too many at a time"),
            mpsc::error::TrySendError::Closed(_) => anyhow!("{name}: the brick has stopped"),
        })
    }

    fn save(&mut self, values: &[(ParameterName, f64)]) -> Result<String> {
        let path = match &self.saved {
            Some(path) => path.clone(),
            None => self.free_name(SAVED)?,
        };
        let config = with_tunables(&self.config, values);
        let text = format!(
            "# The configuration of a run with the parameters that were saved in it: posebridge run --config {SAVED}\n\n{}",
            toml::to_string(&config).context("writing the configuration")?
        );
        // In one step: whoever looks finds the old file or the new one.
        let beside = path.with_extension("toml.new");
        std::fs::write(&beside, text)
            .and_then(|()| std::fs::rename(&beside, &path))
            .with_context(|| done("not saved", &path))?;
        let told = done("saved", &path);
        self.saved = Some(path);
        Ok(told)
    }

    fn start(
        &mut self,
        (now, given): (Stamp<HostClock>, u64),
        values: &[(ParameterName, f64)],
        recorder: &mut Option<Recorder>,
    ) -> Result<String> {
        if let Some(path) = &self.current {
            return Err(anyhow!(done("already recording", path)));
        }
        let path = self.free_name(RECORDING)?;
        let config = with_tunables(&self.recorded, values);
        ensure!(
            self.folder.is_dir(),
            done("not recording, its folder is gone:", &path)
        );
        let header = header(&config, &self.timer)?;
        let limits = config.record.limits();
        // A replay begins with all links down, as a run does: their states stand in the place of the inputs that told of them.
        let before = given.saturating_sub(self.links.len() as u64);
        let mut begun = Recorder::start_in_session(&path, &header, limits, before)?;
        for (link, state) in &self.links {
            let (link, state) = (*link, *state);
            begun.record(now, Input::Link { link, state })?;
        }
        *recorder = Some(begun);
        let told = done("recording", &path);
        self.current = Some(path);
        Ok(told)
    }

    /// This name in the folder, with a number before its dot if there is such a file already or if one will be as soon as the disk
    /// comes to it.
    fn free_name(&self, name: &str) -> Result<PathBuf> {
        let folder = &self.folder;
        let (stem, ending) = name.split_once('.').unwrap_or((name, ""));
        let names = (2..MOST_NAMES).map(|number| format!("{stem}-{number}.{ending}"));
        let is_free =
            |path: &PathBuf| !path.exists() && self.ended.iter().all(|(ended, _)| ended != path);
        std::iter::once(name.to_owned())
            .chain(names)
            .map(|name| folder.join(name))
            .find(is_free)
            .with_context(|| format!("no free name for {name} in {}", folder.display()))
    }

    fn stop(&mut self, recorder: &mut Option<Recorder>) -> Result<String> {
        let (Some(path), Some(recorder)) = (self.current.take(), recorder.take()) else {
            return Err(anyhow!("nothing is being recorded"));
        };
        let told = done("recorded", &path);
        // The disk may be behind: nobody who steers by us waits for it.
        self.ended.push((path, recorder.stop()));
        Ok(told)
    }
}

/// The header of a recording of this configuration.
///
/// # Errors
/// The configuration cannot be written as text.
pub fn header(config: &Config, timer: &HostTimer) -> Result<Header> {
    Ok(Header {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros: timer.utc_start(),
        config_toml: toml::to_string(config)
            .context("writing the configuration into the recording")?,
        links: config.links.iter().map(|link| link.url.clone()).collect(),
    })
}

/// What was done with which file: its name first, because the end of a long text is cut on its way to a ground station.
fn done(what: &str, path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().display();
    let folder = path.parent().unwrap_or(path).display();
    format!("{what} {name} in {folder}")
}

fn with_tunables(config: &Config, values: &[(ParameterName, f64)]) -> Config {
    let mut config = config.clone();
    let values = values
        .iter()
        .map(|(name, value)| (name.as_str().to_owned(), *value));
    config.filter.params.extend(values);
    config
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config;

    fn desk(folder: &Path) -> Desk {
        let config = Config::default();
        let timer = HostTimer::start();
        Desk::new(folder.to_owned(), timer, (config.clone(), config), None)
    }

    fn tuned(value: f64) -> Request {
        Request::SaveParameters {
            values: vec![(ParameterName::from_bytes(b"slip_nis"), value)],
        }
    }

    #[test]
    fn what_is_saved_is_read_back_and_a_file_of_somebody_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("parameters.toml");
        std::fs::write(&own, "# mine\n").unwrap();
        let mut desk = desk(folder.path());
        for value in [20.0, 30.0] {
            let report = desk.carry_out((Stamp::ZERO, 0), &tuned(value), &mut None);
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
    fn a_folder_that_is_gone_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let mut desk = desk(&folder.path().join("gone"));
        for (request, beginning) in [
            (tuned(20.0), "not saved parameters.toml in "),
            (
                Request::StartRecording { values: vec![] },
                "not recording, its folder is gone: recording.mcap",
            ),
            (Request::StopRecording, "nothing is being recorded"),
        ] {
            let report = desk.carry_out((Stamp::ZERO, 0), &request, &mut None);
            let Some(Input::Report { severity: 4, text }) = report else {
                panic!("{report:?}");
            };
            assert!(text.starts_with(beginning), "{text}");
        }
    }

    #[test]
    fn only_a_station_with_a_simulated_brick_does_things_to_it_and_never_waits_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let kidnap = SimulatorCommand::Kidnap {
            forward_m: 0.0,
            left_m: 0.3,
            turn_rad: 0.0,
        };
        let told = |desk: &mut Desk, command| {
            let request = Request::Simulator(command);
            match desk.carry_out((Stamp::ZERO, 0), &request, &mut None) {
                Some(Input::Report { severity: 4, text }) => text,
                None => "done".to_owned(),
                other => panic!("{other:?}"),
            }
        };
        let mut without = desk(folder.path());
        assert_eq!(
            told(&mut without, kidnap),
            "kidnap: this station has no simulated brick of its own"
        );
        let (sender, mut receiver) = mpsc::channel(1);
        let mut with = desk(folder.path()).with_brick(Some(sender));
        assert_eq!(told(&mut with, kidnap), "done");
        assert_eq!(told(&mut with, kidnap), "kidnap: too many at a time");
        assert_eq!(receiver.try_recv(), Ok(kidnap));
        let profile =
            |name: &[u8]| SimulatorCommand::LinkProfile(Some(ParameterName::from_bytes(name)));
        let unknown = told(&mut with, profile(b"string"));
        assert!(unknown.starts_with("link-profile: "), "{unknown}");
        assert!(
            unknown.contains("string") && unknown.contains("usb"),
            "{unknown}"
        );
        assert_eq!(told(&mut with, profile(b"usb")), "done");
        drop(receiver);
        assert_eq!(told(&mut with, kidnap), "kidnap: the brick has stopped");
    }

    #[test]
    fn recordings_follow_one_another_under_names_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let mut desk = desk(folder.path());
        let mut recorder = None;
        let start = Request::StartRecording { values: vec![] };
        let up = Input::Link {
            link: LinkId(0),
            state: LinkState::Up,
        };
        desk.note(&up);
        for name in ["recording.mcap", "recording-2.mcap"] {
            for (request, what) in [
                (&start, "recording"),
                (&start, "already recording"),
                (&Request::StopRecording, "recorded"),
            ] {
                let told = done(what, &folder.path().join(name));
                let report = desk.carry_out((Stamp::ZERO, 0), request, &mut recorder);
                let Some(Input::Report { text, .. }) = report else {
                    panic!("{report:?}");
                };
                assert_eq!(text, told);
            }
        }
        let inputs: Vec<u64> = desk
            .finish()
            .unwrap()
            .iter()
            .map(|ended| ended.1.inputs)
            .collect();
        assert_eq!(inputs, [1, 1], "the link that was up");
    }
}
