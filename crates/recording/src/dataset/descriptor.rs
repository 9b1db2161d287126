//! A validated descriptor: the input of `load`.
//!
//! Everything that needs no files is checked here, so that an invalid key is found before a long read.

use std::collections::BTreeMap;
use std::ops::Range;

use toml::Spanned;

use super::column::ColumnRef;
use super::schema::{
    BeaconRanges, FileEntry, LandmarkSightings, RawDescriptor, RawRun, RawStart, StartSource, Stream, TagPosition,
};
use posebridge_telemetry::{Heading, Meters, Pose, StartPose};

/// Why a descriptor is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptorError {
    /// A missing or unknown key, or a value of the wrong type.
    #[error("line {line}: {message}, in `{text}`")]
    Key { line: usize, message: String, text: String },
    /// Keys that contradict each other.
    #[error("line {line}: {key}: {message}")]
    Rule { line: usize, key: String, message: String },
}

/// A foreign recording, as its TOML descriptor describes it.
#[derive(Clone, Debug)]
pub struct Descriptor {
    pub name: String,
    pub source: String,
    pub licence: String,
    /// Geometry and noise as in the descriptor; [`Descriptor::robot_for`] merges a run's own.
    pub robot: toml::Table,
    /// Tunables for this robot, as in the descriptor; one set for all runs.
    pub filter: toml::Table,
    /// Prefix of the default runs.
    pub default_run: String,
    /// In the descriptor's order.
    pub runs: Vec<String>,
    pub(super) resolved: Vec<ResolvedRun>,
    pub(super) raw: RawDescriptor,
}

/// A run with its own keys and file names resolved.
#[derive(Clone, Debug)]
pub(super) struct ResolvedRun {
    pub(super) name: String,
    pub(super) values: BTreeMap<String, String>,
    pub(super) robot: toml::Table,
    pub(super) start: Option<RunStart>,
    pub(super) tag: Option<TagPosition>,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum RunStart {
    /// A pose in the descriptor.
    Pose(StartPose),
    /// A pose from the files.
    Source { source: StartSource, position_sigma_m: f64, heading_sigma_rad: f64 },
}

impl Descriptor {
    /// Parses and validates a descriptor.
    ///
    /// # Errors
    /// Invalid TOML, a missing or unknown key, a value of the wrong type, or keys that contradict each other; each error names the line
    /// and the key.
    pub fn from_toml(text: &str) -> Result<Self, DescriptorError> {
        let mut raw: RawDescriptor = toml::from_str(text).map_err(|error| key_error(text, &error))?;
        raw.files.values_mut().for_each(FileEntry::fill_topic_defaults);
        let check = DescriptorValidator { text, raw: &raw };
        let resolved = check.resolve_runs()?;
        check.validate_default_run(&resolved)?;
        check.validate_files()?;
        check.validate_all_streams(&resolved)?;
        check.validate_maps()?;
        Ok(Self {
            name: raw.name.clone(),
            source: raw.source.clone(),
            licence: raw.licence.clone(),
            robot: raw.robot.clone(),
            filter: raw.filter.clone(),
            default_run: raw.default_run.get_ref().clone(),
            runs: resolved.iter().map(|run| run.name.clone()).collect(),
            resolved,
            raw,
        })
    }

    /// Runs whose names begin with `prefix`, in the descriptor's order.
    pub fn select(&self, prefix: &str) -> Vec<&str> {
        let names = self.runs.iter().map(String::as_str);
        names.filter(|name| name.starts_with(prefix)).collect()
    }

    /// The robot's table with the run's own keys merged over it; an unknown run changes nothing.
    pub fn robot_for(&self, run: &str) -> toml::Table {
        let mut robot = self.robot.clone();
        if let Some(own) = self.resolved.iter().find(|known| known.name == run) {
            merge(&mut robot, &own.robot);
        }
        robot
    }
}

/// Merges `over` into `table`, recursively.
fn merge(table: &mut toml::Table, over: &toml::Table) {
    for (key, value) in over {
        match (table.get_mut(key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(over)) => merge(inner, over),
            _ => {
                table.insert(key.clone(), value.clone());
            }
        }
    }
}

fn line_number(text: &str, offset: usize) -> usize {
    let before = text.get(..offset).unwrap_or_default();
    1 + before.matches('\n').count()
}

fn key_error(text: &str, error: &toml::de::Error) -> DescriptorError {
    let line = line_number(text, error.span().unwrap_or_default().start);
    DescriptorError::Key {
        line,
        message: error.message().trim().replace('\n', ", "),
        text: text.lines().nth(line - 1).unwrap_or_default().trim().to_owned(),
    }
}

struct DescriptorValidator<'a> {
    text: &'a str,
    raw: &'a RawDescriptor,
}

impl DescriptorValidator<'_> {
    fn rule_error(&self, span: Range<usize>, key: &str, message: impl Into<String>) -> DescriptorError {
        DescriptorError::Rule { line: line_number(self.text, span.start), key: key.to_owned(), message: message.into() }
    }

    fn resolve_runs(&self) -> Result<Vec<ResolvedRun>, DescriptorError> {
        let default = self.raw.start.as_ref().map(|start| self.resolve_start(start)).transpose()?;
        let mut resolved: Vec<ResolvedRun> = Vec::new();
        for entry in &self.raw.runs {
            for run in self.expand(entry, default)? {
                if resolved.iter().any(|known| known.name == run.name) {
                    let message = format!("the run `{}` is there twice", run.name);
                    return Err(self.rule_error(entry.span(), "runs", message));
                }
                resolved.push(run);
            }
        }
        Ok(resolved)
    }

    fn expand(&self, entry: &Spanned<RawRun>, default: Option<RunStart>) -> Result<Vec<ResolvedRun>, DescriptorError> {
        let run = entry.get_ref();
        let start = run.start.as_ref().map(|start| self.resolve_start(start)).transpose()?.or(default);
        let one = |each: Option<&String>| {
            let mut values = run.values.clone();
            if let Some(each) = each {
                values.insert("each".to_owned(), each.clone());
            }
            let name = expand_template(&run.name, &values)
                .map_err(|message| self.rule_error(entry.span(), "runs", message))?;
            values.insert("run".to_owned(), name.clone());
            Ok(ResolvedRun { name, values, robot: run.robot.clone(), start, tag: run.tag })
        };
        match &run.each {
            None => Ok(vec![one(None)?]),
            Some(each) => each.iter().map(|each| one(Some(each))).collect(),
        }
    }

    fn resolve_start(&self, spanned: &Spanned<RawStart>) -> Result<RunStart, DescriptorError> {
        let start = spanned.get_ref();
        let position_sigma_m = start.position_sigma_m.0;
        let heading_sigma_rad = start.heading_sigma_rad.0;
        let components = (start.x_m, start.y_m, start.heading_rad, start.heading_deg);
        let heading_rad = match (start.from, components) {
            (Some(source), (None, None, None, None)) => {
                return Ok(RunStart::Source { source, position_sigma_m, heading_sigma_rad });
            }
            (None, (Some(_), Some(_), Some(heading_rad), None)) => heading_rad.0,
            (None, (Some(_), Some(_), None, Some(heading_deg))) => heading_deg.0.to_radians(),
            _ => {
                let message = "either `from`, or x_m, y_m and one of heading_rad and heading_deg";
                return Err(self.rule_error(spanned.span(), "start", message));
            }
        };
        Ok(RunStart::Pose(StartPose {
            pose: Pose::new(
                Meters(start.x_m.unwrap_or_default().0),
                Meters(start.y_m.unwrap_or_default().0),
                Heading::from_rad(heading_rad),
            ),
            position_sigma_m,
            heading_sigma_rad,
        }))
    }

    fn validate_default_run(&self, runs: &[ResolvedRun]) -> Result<(), DescriptorError> {
        let default = &self.raw.default_run;
        if runs.iter().any(|run| run.name.starts_with(default.get_ref())) {
            return Ok(());
        }
        let message = format!("no run's name begins with `{}`", default.get_ref());
        Err(self.rule_error(default.span(), "default_run", message))
    }

    fn validate_files(&self) -> Result<(), DescriptorError> {
        for (name, file) in &self.raw.files {
            let key = format!("files.{name}");
            let named = [&file.time, &file.arrival].into_iter().flatten();
            let plus = named.clone().filter_map(|time| time.plus.as_ref());
            let columns = named
                .map(|time| &time.column)
                .chain(plus.map(|part| &part.column))
                .chain(file.filter.as_ref().map(|filter| &filter.column));
            self.named_columns_need_a_header(file, columns, file.path.span(), &key)?;
            if file.topic.is_none() && (file.joints.is_some() || file.bearing_deg.is_some()) {
                let message = "joints and bearing_deg are for a `topic` of a ROS 2 bag";
                return Err(self.rule_error(file.path.span(), &key, message));
            }
            if file.comment.as_deref() == Some("") {
                let message = "an empty comment prefix makes every line a comment";
                return Err(self.rule_error(file.path.span(), &key, message));
            }
        }
        Ok(())
    }

    fn named_columns_need_a_header<'p>(
        &self,
        file: &FileEntry,
        mut columns: impl Iterator<Item = &'p ColumnRef>,
        span: Range<usize>,
        key: &str,
    ) -> Result<(), DescriptorError> {
        if file.header_lines > 0 {
            return Ok(());
        }
        match columns.find(|column| matches!(column, ColumnRef::Name(_))) {
            None => Ok(()),
            Some(column) => {
                let message = format!("the column `{column}` goes by its name, but the file has no header_lines");
                Err(self.rule_error(span, key, message))
            }
        }
    }

    fn file(&self, name: &Spanned<String>, key: &str) -> Result<&FileEntry, DescriptorError> {
        self.raw.files.get(name.get_ref()).ok_or_else(|| {
            let known: Vec<&str> = self.raw.files.keys().map(String::as_str).collect();
            let (requested, known) = (name.get_ref(), known.join(", "));
            let message = format!("there is no [files.{requested}]: use one of: {known}");
            self.rule_error(name.span(), key, message)
        })
    }

    fn validate_all_streams(&self, runs: &[ResolvedRun]) -> Result<(), DescriptorError> {
        self.validate_streams(&self.raw.wheels, runs)?;
        self.validate_streams(&self.raw.odometer, runs)?;
        self.validate_streams(&self.raw.body_velocity, runs)?;
        self.validate_streams(&self.raw.gyro, runs)?;
        self.validate_streams(&self.raw.accelerometers, runs)?;
        self.validate_streams(&self.raw.landmark_sightings, runs)?;
        self.validate_streams(&self.raw.beacon_ranges, runs)?;
        self.validate_streams(&self.raw.wall_range, runs)?;
        self.validate_streams(&self.raw.compass, runs)?;
        self.validate_streams(&self.raw.temperature, runs)?;
        self.validate_streams(&self.raw.fixes, runs)?;
        self.validate_streams(&self.raw.truth, runs)
    }

    fn validate_streams<S: Stream>(&self, streams: &[S], runs: &[ResolvedRun]) -> Result<(), DescriptorError> {
        for stream in streams {
            let common = stream.common();
            let span = common.file.span();
            let file = self.file(common.file, S::KEY)?;
            if file.time.is_none() {
                let message = format!("[files.{}] has no `time`", common.file.get_ref());
                return Err(self.rule_error(span, S::KEY, message));
            }
            let columns = stream.column_refs().into_iter();
            self.named_columns_need_a_header(file, columns, span.clone(), S::KEY)?;
            let mut prefixes = common.runs.unwrap_or_default().iter();
            let is_idle = |prefix: &&String| !runs.iter().any(|run| run.name.starts_with(*prefix));
            if let Some(prefix) = prefixes.find(is_idle) {
                let message = format!("no run's name begins with `{prefix}`");
                return Err(self.rule_error(span, S::KEY, message));
            }
            stream.check().map_err(|message| self.rule_error(span, S::KEY, message))?;
        }
        Ok(())
    }

    fn validate_maps(&self) -> Result<(), DescriptorError> {
        let raw = self.raw;
        let maps = [(raw.landmarks.as_ref(), "landmarks"), (raw.beacons.as_ref(), "beacons")].into_iter();
        let points = maps.filter_map(|(map, key)| map.map(|map| (&map.file, map.column_refs(), key)));
        let mapped = raw.landmark_sightings.iter().filter_map(|sightings| sightings.ids.as_ref());
        let ids = mapped.map(|ids| (&ids.file, ids.column_refs(), "landmark_sightings.ids"));
        for (name, columns, key) in points.chain(ids) {
            let file = self.file(name, key)?;
            self.named_columns_need_a_header(file, columns.into_iter(), name.span(), key)?;
        }
        let needs = [
            (
                raw.landmark_sightings.first().map(Stream::common),
                &raw.landmarks,
                LandmarkSightings::KEY,
                "sightings need [landmarks]",
            ),
            (raw.beacon_ranges.first().map(Stream::common), &raw.beacons, BeaconRanges::KEY, "ranges need [beacons]"),
        ];
        for (stream, map, key, need) in needs {
            if let (Some(common), None) = (stream, map) {
                let message = format!("{need}, the map of their places");
                return Err(self.rule_error(common.file.span(), key, message));
            }
        }
        Ok(())
    }
}

/// Replaces each `{name}` in `template` by its value.
pub(super) fn expand_template(template: &str, values: &BTreeMap<String, String>) -> Result<String, String> {
    let mut filled = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        let (name, behind) = after.split_once('}').ok_or_else(|| format!("`{template}` has a {{ without its }}"))?;
        let value = values
            .get(name)
            .ok_or_else(|| format!("`{template}` wants `{name}`, which the run's values do not have"))?;
        filled.push_str(before);
        filled.push_str(value);
        rest = behind;
    }
    filled.push_str(rest);
    Ok(filled)
}
