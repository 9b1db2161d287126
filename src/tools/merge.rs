//! `posebridge merge`: makes one recording of those of the stations of a fleet, on one clock, so that all commands for recordings take it.
//! docs/recordings.md states what is kept and what is lost.

mod config;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use posebridge_fleet::{ClockNote, IdentityNote, StationId};
use posebridge_recording::container::{RecordingHeader, RecordingReader, RecordingWriter, TruthSample, read_truth};
use posebridge_recording::merge::{
    AlignedClock, AlignmentSource, MeasuredOffset, MergedClock, MergedInputs, RecordingPlace, align_clocks,
};
use posebridge_station::{RecordedStations, Robot};
use posebridge_telemetry::{HostClock, Input, Output, Timestamp};

use self::config::{StationConfiguration, merge_configurations};
use crate::config::{Config, load_text};
use crate::console::{print_line, print_lines, print_result};
use crate::exit::{ExitStage, Failure};
use crate::station::input_file::{InputFile, InputKind};
use crate::station::recorded_session::{MemoryLimit, for_each_input, missing_start, own_bytes};
use crate::station::recording_files::header;
use crate::station::signing::recorded_stations;

/// Flags of `merge`.
#[derive(Args, Clone, Debug)]
pub struct MergeArgs {
    /// Recordings of the stations (*.mcap), one of each; parts that follow are read with their first. The clocks of the others are put on
    /// that of the first.
    #[arg(required = true, num_args = 2.., value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Recording to write. An existing file is not overwritten.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Key file of a signed link. Default: the key file that was used while recording. Can be repeated.
    #[arg(long = "key", value_name = "FILE")]
    pub keys: Vec<PathBuf>,
}

pub fn execute(args: &MergeArgs) -> Result<(), Failure> {
    let recordings = read_all(&args.files).before_start()?;
    let clock = align(&recordings);
    let places = places(&recordings, &clock).before_start()?;
    let config = merged_config(&recordings, &clock).before_start()?;
    let stations = recorded_stations(&config, &args.keys).before_start()?;
    let merged_header = header(&config, clock.utc_start_micros).before_start()?;
    let name = args.out.display();
    let out = File::create_new(&args.out).with_context(|| format!("creating `{name}`")).before_start()?;
    let written = write(&recordings, &places, stations, &merged_header, BufWriter::new(out));
    if written.is_err() {
        // Half a recording would be taken for a whole one.
        drop(std::fs::remove_file(&args.out));
    }
    let written = written.with_context(|| format!("writing `{name}`")).while_running()?;
    print_lines(&notes(&recordings, &clock, &written));
    print_result(&summary(&recordings, &places, &clock, &written)).while_running()?;
    print_line(&format!("wrote `{name}`: {} inputs", written.inputs));
    Ok(())
}

/// The recording of a station.
struct StationRecording {
    name: String,
    bytes: Vec<u8>,
    header: RecordingHeader,
    config: Config,
    inputs: u64,
    /// Its id in the fleet, if it says so.
    station: Option<StationId>,
    /// What it measured of other stations: of each the note with the smallest uncertainty.
    clock_notes: BTreeMap<StationId, ClockNote>,
    truth: Vec<TruthSample>,
}

/// What a merged recording holds.
struct WrittenRecording {
    inputs: u64,
    /// Of each recording: their names, else their ids in the merged one.
    robots: Vec<Vec<String>>,
    /// Samples of the truth of which nothing says which robot they are of.
    truth_left_out: usize,
}

fn read_all(files: &[PathBuf]) -> Result<Vec<StationRecording>> {
    let mut recordings: Vec<StationRecording> = Vec::new();
    for path in files {
        let recording = StationRecording::read(path)?;
        for other in &recordings {
            let name = &recording.name;
            ensure!(other.bytes != recording.bytes, "`{name}` is the same recording as `{}`: give it once", other.name);
            if let (Some(station), true) = (&recording.station, other.station == recording.station) {
                bail!(
                    "`{name}` and `{}` are both of station {station}: give one recording of each station; parts that follow are read \
                     with their first",
                    other.name
                );
            }
        }
        recordings.push(recording);
    }
    Ok(recordings)
}

impl StationRecording {
    /// Reads the file with the parts that continue it. Damage and what is missing are printed.
    fn read(path: &Path) -> Result<Self> {
        let file = InputFile::open(path)?;
        let name = file.name.clone();
        ensure!(
            file.kind == InputKind::Own,
            "`{name}` is no recording of posebridge: make one of it with `posebridge import FILE --out RECORDING.mcap`, or give the file \
             that the station recorded"
        );
        let (bytes, notes) = own_bytes(path, file, MemoryLimit::default())?;
        print_lines(&notes);
        let mut reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        if let Some(lack) = missing_start(reader.part_header()) {
            print_line(&format!("{name}: {lack}; the estimates are not those of the live run"));
        }
        let recording_header = reader.header().clone();
        let config = load_text(&format!("the configuration in `{name}`"), &recording_header.config_toml, &[])?.config;
        let mut recording = Self {
            truth: read_truth(&bytes).with_context(|| format!("the truth in `{name}`"))?,
            name: name.clone(),
            bytes: Vec::new(),
            header: recording_header,
            config,
            inputs: 0,
            station: None,
            clock_notes: BTreeMap::new(),
        };
        for_each_input(&name, &mut reader, |_, input| recording.look_at(input))?;
        drop(reader);
        recording.bytes = bytes;
        Ok(recording)
    }

    fn look_at(&mut self, input: &Input) -> Result<()> {
        self.inputs += 1;
        // Refused before anything is written; it says what is wrong with it.
        RecordingPlace::default().input(input.clone()).with_context(|| format!("`{}`", self.name))?;
        if let Some(link) = input.link() {
            let links = self.config.links.len();
            let is_known = usize::from(link.0) < links;
            ensure!(is_known, "`{}`: an input is of link {link}, but its configuration has {links} links", self.name);
        }
        if let Input::Report { text, .. } = input {
            if let Ok(note) = text.parse::<IdentityNote>() {
                self.station = Some(note.station);
            } else if let Ok(note) = text.parse::<ClockNote>() {
                let best = self.clock_notes.entry(note.station.clone()).or_insert_with(|| note.clone());
                if note.uncertainty < best.uncertainty {
                    *best = note;
                }
            }
        }
        Ok(())
    }

    fn inputs(&self) -> Result<impl Iterator<Item = (Timestamp<HostClock>, Input)>> {
        // Damage was printed when it was read for the first time.
        Ok(RecordingReader::open(&self.bytes)?.filter_map(Result::ok))
    }

    /// Its id in the fleet, else the name of its file.
    fn station_name(&self) -> String {
        self.station.as_ref().map_or_else(|| self.name.clone(), ToString::to_string)
    }
}

fn align(recordings: &[StationRecording]) -> MergedClock {
    let mut measured = Vec::new();
    for (by, recording) in recordings.iter().enumerate() {
        for note in recording.clock_notes.values() {
            let of = recordings.iter().position(|other| other.station.as_ref() == Some(&note.station));
            measured.extend(of.map(|of| MeasuredOffset { by, of, offset: note.offset, uncertainty: note.uncertainty }));
        }
    }
    let starts: Vec<u64> = recordings.iter().map(|recording| recording.header.utc_start_micros).collect();
    align_clocks(&starts, &measured)
}

fn merged_config(recordings: &[StationRecording], clock: &MergedClock) -> Result<Config> {
    let names: Vec<String> = recordings.iter().map(StationRecording::station_name).collect();
    let parts = recordings.iter().zip(&names).zip(&clock.clocks).map(|((recording, station), clock)| {
        StationConfiguration { file: &recording.name, station, config: &recording.config, clock_ahead: clock.ahead }
    });
    merge_configurations(&parts.collect::<Vec<_>>())
}

fn places(recordings: &[StationRecording], clock: &MergedClock) -> Result<Vec<RecordingPlace>> {
    let mut links = 0;
    let places = recordings.iter().zip(&clock.clocks).enumerate().map(|(number, (recording, clock))| {
        let place = RecordingPlace {
            station: u16::try_from(number).context("there are too many recordings")?,
            first_link: u16::try_from(links).context("there are too many links")?,
            clock_ahead: clock.ahead,
        };
        links += recording.config.links.len();
        Ok(place)
    });
    places.collect()
}

/// Writes the inputs of all recordings, with the events that follow from them for viewers, and the truth.
fn write<W: Write + Seek>(
    recordings: &[StationRecording],
    places: &[RecordingPlace],
    mut stations: RecordedStations,
    merged_header: &RecordingHeader,
    out: W,
) -> Result<WrittenRecording> {
    let mut writer = RecordingWriter::create(out, merged_header)?;
    let sources = recordings.iter().zip(places).map(|(recording, place)| Ok((*place, recording.inputs()?)));
    let mut written = WrittenRecording { inputs: 0, robots: Vec::new(), truth_left_out: 0 };
    for merged in MergedInputs::new(sources.collect::<Result<Vec<_>>>()?) {
        let merged = merged?;
        written.inputs += 1;
        writer.record(merged.time, &merged.input)?;
        stations.handle(merged.time, &merged.input);
        while let Some(output) = stations.poll() {
            if let Output::Event(event) = output {
                writer.record_event(merged.time, &event)?;
            }
        }
    }
    for (recording, place) in recordings.iter().zip(places) {
        let links = links_of(recording, place);
        let robots: Vec<&Robot> =
            stations.detected_robots().filter(|robot| links.contains(&usize::from(robot.id().link.0))).collect();
        let label = |robot: &&Robot| robot.name().map_or_else(|| robot.id().path(), str::to_owned);
        let only = if let [only] = robots.as_slice() { Some(only.id()) } else { None };
        let truth = recording.truth.iter().map(|sample| place.truth(*sample, only));
        let (truth, unknown): (Vec<TruthSample>, Vec<TruthSample>) =
            truth.collect::<Result<Vec<_>, _>>()?.into_iter().partition(|sample| sample.robot.is_some());
        written.truth_left_out += unknown.len();
        writer.record_truth(Timestamp::ZERO, &truth)?;
        written.robots.push(robots.iter().map(label).collect());
    }
    writer.finish()?.flush()?;
    Ok(written)
}

fn links_of(recording: &StationRecording, place: &RecordingPlace) -> Range<usize> {
    let first = usize::from(place.first_link);
    first..first + recording.config.links.len()
}

/// What is not as in the single recordings.
fn notes(recordings: &[StationRecording], clock: &MergedClock, written: &WrittenRecording) -> Vec<String> {
    let by_date = recordings.iter().zip(&clock.clocks).filter(|(_, clock)| clock.source == AlignmentSource::StartDate);
    let mut notes: Vec<String> = by_date
        .map(|(recording, _)| {
            format!(
                "WARNING: `{}`: no station measured its clock, so that it was aligned by the computers' dates at the start, which may be off \
                 by seconds",
                recording.name
            )
        })
        .collect();
    if written.truth_left_out > 0 {
        notes.push(format!("left out: {} true poses that say no robot, beside several", written.truth_left_out));
    }
    notes.push(
        "left out: log lines and learned constants for viewers; the estimates for viewers are computed anew".to_owned(),
    );
    notes
}

/// A line for each recording.
fn summary(
    recordings: &[StationRecording],
    places: &[RecordingPlace],
    clock: &MergedClock,
    written: &WrittenRecording,
) -> String {
    let Some(reference) = clock.clocks.first() else {
        return String::new();
    };
    let parts = recordings.iter().zip(places).zip(&clock.clocks).zip(&written.robots);
    let lines = parts.map(|(((recording, place), clock), robots)| {
        let station = recording.station.as_ref().map_or_else(String::new, |station| format!("station {station}, "));
        let links = links_of(recording, place);
        let links = match links.len() {
            0 => "no link".to_owned(),
            1 => format!("link {}", links.start),
            _ => format!("links {} to {}", links.start, links.end - 1),
        };
        let names: Vec<&str> = robots.iter().map(String::as_str).collect();
        let robots = match names.as_slice() {
            [] => "no robot".to_owned(),
            [only] => format!("robot {only}"),
            several => format!("robots {}", several.join(", ")),
        };
        let alignment = alignment_text(clock, reference);
        format!("`{}`: {station}{links}, {} inputs, {robots}; {alignment}\n", recording.name, recording.inputs)
    });
    lines.collect()
}

fn alignment_text(clock: &AlignedClock, first: &AlignedClock) -> String {
    let ahead = (clock.ahead - first.ahead).as_secs_f64();
    match clock.source {
        AlignmentSource::Reference => "the others are put on its clock".to_owned(),
        AlignmentSource::Measured { uncertainty } => {
            format!("its clock is {ahead:.9} s ahead, measured by the stations to {:.6} s", uncertainty.as_secs_f64())
        }
        AlignmentSource::StartDate => {
            format!("its clock is {ahead:.6} s ahead by the dates at the start, to an unknown error")
        }
    }
}
