//! What people and programs ask of a running station: tunables, the pose, what is learned, sources, recordings.
//!
//! A command of the program is an input of its own. What comes over a link stands in the link's bytes, and those are the input: it is
//! carried out here when the bytes are handled and never becomes a second input, so that a replay does it once and at the same place.
//!
//! Everything that was asked leaves an [`Event::Text`]; who asked over a link and was refused hears why. Values of tunables come over
//! links as 32-bit floats and are taken as the shortest decimal number that has these bits: 0.999 there is 0.999 in the configuration.
//!
//! # Sources
//! MAVLink guide, "Parameter Protocol" and "Command Protocol"; docs/parameters.md.

use std::collections::BTreeSet;

use posebridge_estimator::{Adjustment, PARAMS, Params, StartPose};
use posebridge_protocol::dialect::commands::{CommandError, understood};
use posebridge_protocol::message::{CommandLong, CommandResult, Message};
use posebridge_telemetry::{
    Command, Event, FusionRecord, Learning, LinkId, LinkState, Observation, Output, ParameterName, ParameterStorage,
    Priority, Request, SensorId, SimulatorCommand, Span, Switch, Verdict,
};

use super::{Pipeline, SEVERITY_WARNING};

/// MAV_SEVERITY_INFO.
const SEVERITY_INFO: u8 = 6;

/// What was asked and holds until something else is asked.
pub(super) struct Standing {
    /// The tunables that were saved last, or with which the run began.
    saved: Params,
    /// Sensors that are left out.
    switched_off: BTreeSet<SensorId>,
    pub(super) learning: Learning,
    /// The link over which the program was asked for something last: there it is told what became of it.
    asked_on: Option<LinkId>,
    /// The last command of the program.
    last: Option<Command>,
}

impl Standing {
    pub(super) const fn new(params: Params) -> Self {
        Self { saved: params, switched_off: BTreeSet::new(), learning: Learning::Free, asked_on: None, last: None }
    }

    /// Whether a held key says again what it said before.
    fn is_held_key(&mut self, command: Command) -> bool {
        let is_drive = matches!(command, Command::Simulator(SimulatorCommand::Drive { .. }));
        let before = self.last.replace(command);
        is_drive && before == Some(command)
    }
}

/// What was done, or why it was not: a line for people.
type Outcome = Result<String, String>;

impl Pipeline {
    pub(super) fn handle_command(&mut self, command: Command) {
        let is_held_key = self.standing.is_held_key(command);
        let outcome = self.carry_out(command);
        // One line for a key that is held, not several each second.
        if !(is_held_key && outcome.is_ok()) {
            self.tell_outcome(&outcome);
        }
    }

    /// What became of something that the program did.
    pub(super) fn handle_report(&mut self, severity: u8, text: &str) {
        self.announce_report(severity, text);
        self.outputs.tell(Event::Text { source: self.config.own, severity, text: text.to_owned() });
        if let Some(link) = self.standing.asked_on {
            self.answer_in_words(link, severity, text);
        }
    }

    /// Somebody on a link wants a tunable to have another value.
    pub(super) fn handle_wish(&mut self, link: LinkId, index: usize, value: f32) {
        let Some(row) = PARAMS.get(index) else {
            return;
        };
        let before = (row.read)(&self.config.filter_config.params);
        let outcome = self.carry_out(Command::SetParameter {
            name: ParameterName::from_bytes(row.key.as_bytes()),
            value: as_typed(value),
        });
        if (row.read)(&self.config.filter_config.params).to_bits() == before.to_bits() {
            // A change was told; that nothing has changed is an answer, too.
            self.announce_parameter(index);
        }
        self.tell_outcome(&outcome);
        if let Err(why) = &outcome {
            self.answer_in_words(link, SEVERITY_WARNING, why);
        }
    }

    /// Somebody on a link sets a tunable by a type that cannot be read: without an answer he would ask until he gives up.
    pub(super) fn handle_unsupported_type(&mut self, link: LinkId, index: usize, kind: u8) {
        let Some(row) = PARAMS.get(index) else {
            return;
        };
        // 9 is REAL32. Short, because it has to fit into a STATUSTEXT.
        let why = format!("{}: send MAV_PARAM_TYPE 9, not {kind}", row.key);
        self.announce_parameter(index);
        self.answer_in_words(link, SEVERITY_WARNING, &why);
        self.tell_own(SEVERITY_WARNING, why);
    }

    /// Somebody on a link asks for a tunable that there is not.
    pub(super) fn handle_unknown_parameter(&mut self, link: LinkId, asked: &str) {
        let why = format!("no parameter `{}`", ParameterName::from_bytes(asked.as_bytes()));
        self.answer_in_words(link, SEVERITY_WARNING, &why);
        self.tell_own(SEVERITY_WARNING, why);
    }

    /// Does what a command from a link asks for, and tells what became of it.
    pub(super) fn obey(&mut self, link: LinkId, command: &CommandLong) -> CommandResult {
        let outcome = match understood(command) {
            Ok(wanted) => {
                self.standing.asked_on = Some(link);
                self.carry_out(wanted)
            }
            Err(CommandError::Unknown { .. }) => return CommandResult::Unsupported,
            Err(error) => Err(error.to_string()),
        };
        self.tell_outcome(&outcome);
        match outcome {
            Ok(_) => CommandResult::Accepted,
            Err(why) => {
                self.answer_in_words(link, SEVERITY_WARNING, &why);
                CommandResult::Denied
            }
        }
    }

    /// What a sensor that is switched off says: it is shown, but not used.
    pub(super) fn left_out(&self, observation: &Observation) -> Option<FusionRecord> {
        let is_off = self.standing.switched_off.contains(&observation.sensor);
        is_off.then(|| FusionRecord {
            sensor: observation.sensor,
            kind: observation.observed.kind(),
            stamp: observation.stamp,
            lag: Span::ZERO,
            verdict: Verdict::Unused,
            innovation: [0.0; 3],
            innovation_covariance: [[0.0; 3]; 3],
            nis: 0.0,
            degrees_of_freedom: 0,
            log_likelihood: 0.0,
        })
    }

    fn carry_out(&mut self, command: Command) -> Outcome {
        match command {
            Command::SetPose { pose, position_sigma_m, heading_sigma_rad } => {
                self.set_pose(&StartPose { pose, position_sigma_m, heading_sigma_rad })
            }
            Command::ResetPose => self.reset_pose(),
            Command::SetParameter { name, value } => self.set_parameter(name, value),
            Command::Parameters(storage) => self.store_parameters(storage),
            Command::Learning(learning) => {
                self.adjust(&Adjustment::Learning(learning), "does not learn")?;
                self.standing.learning = learning;
                Ok(match learning {
                    Learning::Frozen => "calibration frozen".to_owned(),
                    Learning::Free => "calibration learned further".to_owned(),
                })
            }
            Command::ResetCalibration => {
                self.adjust(&Adjustment::ForgetCalibration, "does not learn")?;
                Ok("calibration reset to what is configured".to_owned())
            }
            Command::SwitchSource { sensor, to } => Ok(self.switch(sensor, to)),
            Command::StartRecording => {
                let values = self.parameter_values();
                self.request(Request::StartRecording { values });
                Ok("a new recording was asked for".to_owned())
            }
            Command::StopRecording => {
                self.request(Request::StopRecording);
                Ok("the recording's end was asked for".to_owned())
            }
            Command::Simulator(command) => {
                command.check().map_err(|error| error.to_string())?;
                self.request(Request::Simulator(command));
                Ok(command.to_string())
            }
        }
    }

    fn set_pose(&mut self, start: &StartPose) -> Outcome {
        self.is_news = true;
        if self.filter.set_pose(start) == Verdict::Malformed {
            return Err("the pose was not set: a number is not finite or a sigma is negative".to_owned());
        }
        let pose = &start.pose;
        Ok(format!("pose set to x {:.3} m, y {:.3} m, {:.1} deg", pose.x.0, pose.y.0, pose.heading.rad().to_degrees()))
    }

    fn reset_pose(&mut self) -> Outcome {
        if let Some(start) = self.config.filter_config.start {
            return self.set_pose(&start);
        }
        self.adjust(&Adjustment::ForgetPose, "cannot forget its pose")?;
        self.is_news = true;
        Ok("pose forgotten: the next fix decides".to_owned())
    }

    fn set_parameter(&mut self, name: ParameterName, value: f64) -> Outcome {
        let row = PARAMS.iter().find(|row| row.key == name.as_str());
        let row = row.ok_or_else(|| format!("no parameter `{name}`"))?;
        if !row.range.contains(&value) {
            // Short, because it has to fit into a STATUSTEXT.
            let (low, high) = (row.range.start(), row.range.end());
            return Err(format!("{name} {value:?} not in {low}..{high}"));
        }
        let mut params = self.config.filter_config.params;
        let before = (row.read)(&params);
        (row.write)(&mut params, value);
        self.go_by(params)?;
        Ok(format!("{name} set to {value} (was {before})"))
    }

    fn store_parameters(&mut self, storage: ParameterStorage) -> Outcome {
        let params = match storage {
            ParameterStorage::Save => {
                self.standing.saved = self.config.filter_config.params;
                let values = self.parameter_values();
                self.request(Request::SaveParameters { values });
                return Ok("parameters handed over to be saved".to_owned());
            }
            ParameterStorage::Reload => self.standing.saved,
            ParameterStorage::Default => Params::default(),
        };
        self.go_by(params)?;
        Ok(match storage {
            ParameterStorage::Default => "parameters set to their defaults".to_owned(),
            ParameterStorage::Save | ParameterStorage::Reload => "parameters as saved last".to_owned(),
        })
    }

    /// Gives the filter other tunables and tells those that changed.
    fn go_by(&mut self, params: Params) -> Result<(), String> {
        // Thermometers have filters of their own, which begin with the tunables of the station.
        self.adjust(&Adjustment::Params(params), "is tuned only by its start")?;
        let before = std::mem::replace(&mut self.config.filter_config.params, params);
        for (index, row) in PARAMS.iter().enumerate() {
            if (row.read)(&before).to_bits() != (row.read)(&params).to_bits() {
                self.announce_parameter(index);
            }
        }
        Ok(())
    }

    /// Tells on every link where somebody has asked for tunables which value one of them has.
    fn announce_parameter(&mut self, index: usize) {
        let Some(row) = PARAMS.get(index) else {
            return;
        };
        let value = (row.read)(&self.config.filter_config.params) as f32;
        let told: Vec<(LinkId, Message)> = self
            .links
            .iter_mut()
            .filter_map(|(id, link)| Some((*id, link.session.parameter_stands(index, value)?)))
            .collect();
        for (link, message) in told {
            self.send_on(link, &message);
        }
    }

    fn adjust(&mut self, adjustment: &Adjustment, otherwise: &str) -> Result<(), String> {
        if self.filter.adjust(adjustment) == Verdict::Accepted {
            return Ok(());
        }
        Err(format!("the filter {} {otherwise}", self.config.filter))
    }

    /// The sensors that are left out, by their numbers.
    pub fn switched_off(&self) -> impl Iterator<Item = SensorId> {
        self.standing.switched_off.iter().copied()
    }

    fn switch(&mut self, sensor: SensorId, to: Switch) -> String {
        let off = &mut self.standing.switched_off;
        let is = match to {
            Switch::On => {
                off.remove(&sensor);
                "used"
            }
            Switch::Off => {
                off.insert(sensor);
                "left out"
            }
        };
        format!("source {sensor} ({}) is {is}", sensor.name())
    }

    fn parameter_values(&self) -> Vec<(ParameterName, f64)> {
        let params = &self.config.filter_config.params;
        let named = PARAMS.iter().map(|row| {
            let name = ParameterName::from_bytes(row.key.as_bytes());
            (name, (row.read)(params))
        });
        named.collect()
    }

    fn request(&mut self, request: Request) {
        self.outputs.push(Output::Request(request));
    }

    /// A line to whom a question came from; ground stations read it anyway, as they do all that the station tells.
    fn answer_in_words(&mut self, link: LinkId, severity: u8, words: &str) {
        let hears_all = self.links.get(&link).is_none_or(|link| link.voice.is_some());
        if hears_all {
            return;
        }
        for part in self.announcer.parts(severity, words) {
            self.send_on(link, &part);
        }
    }

    fn send_on(&mut self, link: LinkId, message: &Message) {
        let is_up = self.links.get(&link).is_some_and(|link| link.state == LinkState::Up);
        // Who has gone does not wait for an answer.
        if is_up {
            self.transmit(link, message, Priority::Command);
        }
    }

    fn tell_outcome(&mut self, outcome: &Outcome) {
        match outcome {
            Ok(done) => self.tell_own(SEVERITY_INFO, done.clone()),
            Err(why) => self.tell_own(SEVERITY_WARNING, why.clone()),
        }
    }

    pub(super) fn tell_own(&mut self, severity: u8, text: String) {
        let source = self.config.own;
        self.tell(Event::Text { source, severity, text });
    }
}

/// The number that somebody typed who sends these bits: the shortest decimal that has them.
fn as_typed(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| f64::from(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_over_a_link_is_the_decimal_that_was_typed() {
        for typed in [0.999, 0.000_03, 148.0, 0.1, 1e-10, 500.0, -0.3] {
            assert_eq!(as_typed(typed as f32), typed);
        }
        assert!(as_typed(f32::NAN).is_nan());
        assert_eq!(as_typed(f32::NEG_INFINITY), f64::NEG_INFINITY);
        assert!(as_typed(f32::MAX).is_finite());
    }

    #[test]
    fn both_ends_of_every_range_can_be_set_over_a_link() {
        for row in PARAMS {
            for end in [*row.range.start(), *row.range.end()] {
                assert!(row.range.contains(&as_typed(end as f32)), "{}", row.key);
            }
        }
    }
}
