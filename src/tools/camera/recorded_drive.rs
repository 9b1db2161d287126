//! A recorded drive in a camera's sight: the tags that its pictures showed, and how long the pictures took to come.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_protocol::bricks::camera_json::{SeenTag, TagCorners, read_seen_tag};
use posebridge_recording::container::RecordingReader;
use posebridge_station::{RecordedStations, Robot};
use posebridge_telemetry::{
    Arena, Body, Event, Heading, HostClock, Input, LinkId, Meters, Output, Pose, TimeDelta, Timestamp, Transform2,
    UncertainValue,
};
use posebridge_vision::FlatTag;

use crate::config::{CameraChoice, CameraFile, Config, load_text};
use crate::console::print_lines;
use crate::station::recorded_session::for_each_input;
use crate::station::signing::recorded_stations;
use crate::tools::import::{self, StationOptions};

/// Pictures that are used; of more, each second, third, ... one.
const MAX_PICTURES: usize = 900;
/// A corner of a floor tag that moved by more shows that the camera was moved, or the sheet.
const MAX_SHIFT_PX: f64 = 2.0;
/// A robot that dead reckoning sees within this of its start has not left it.
const AT_START: (f64, f64) = (0.001, 0.002);
/// How well the delay is known before the first and before the second pass, s.
const DELAY_SIGMAS_S: [f64; 2] = [0.1, 0.02];
/// A delay whose sigma is larger was not learned, s.
const MAX_DELAY_SIGMA_S: f64 = 0.005;

/// The drive, and what its camera saw.
pub(super) struct RecordedDrive {
    pub(super) name: String,
    bytes: Vec<u8>,
    config: Config,
    link: LinkId,
    /// Width and height of the pictures, px.
    pub(super) size: (usize, usize),
    /// In the order of their pictures.
    sightings: Vec<TimedTag>,
    /// By dead reckoning, in the order of time.
    poses: Vec<(Timestamp<HostClock>, Pose<Arena>)>,
}

/// A tag, and the time of the exposure, or of reception where nobody knows that.
struct TimedTag {
    at: Timestamp<HostClock>,
    seen: SeenTag,
}

/// A tag of the floor sheet in all pictures of the drive: medians.
pub(super) struct StillTag {
    pub(super) id: u16,
    pub(super) corners: TagCorners,
}

/// How long pictures take from their exposure to their reception.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PictureDelay {
    pub(super) mean: TimeDelta,
    /// Of the mean.
    pub(super) sigma: TimeDelta,
    /// How much the delay of a single picture differs from it.
    pub(super) spread: TimeDelta,
}

impl RecordedDrive {
    /// `link` chooses among several cameras.
    pub(super) fn read(path: &Path, link: Option<u16>) -> Result<Self> {
        let name = path.display().to_string();
        let (bytes, notes) = import::recording_bytes(path, StationOptions::default())?;
        print_lines(&notes);
        let reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        let config = load_text("the recording's own configuration", &reader.header().config_toml, &[])?.config;
        // Without fixes: the camera's file is what is looked for.
        let mut blind = config.clone();
        for link in &mut blind.links {
            link.camera = None;
        }
        let mut lines = CameraLines::default();
        let mut poses = Vec::new();
        for_each_output(&name, &bytes, &blind, |now, step| match step {
            Step::Input(Input::Bytes { link, bytes, .. }) => lines.push(now, *link, bytes),
            Step::Event(Event::EstimateUpdated { estimate, .. }) => {
                poses.push((now, estimate.pose));
            }
            Step::Input(_) | Step::Event(_) => {}
        })?;
        let (link, sightings) = choose_camera(&name, lines.sightings, link)?;
        let size = picture_size(&name, &sightings)?;
        Ok(Self { name, bytes, config, link, size, sightings, poses })
    }

    /// As after `camera:` in the URL of its link.
    pub(super) fn source(&self) -> Option<String> {
        let link = self.config.links.get(usize::from(self.link.0))?;
        link.url.strip_prefix("camera:").map(str::to_owned)
    }

    fn is_on_floor(&self, tag: u32) -> bool {
        let first = u32::from(self.config.camera.floor_tags_from);
        (first..first + u32::from(posebridge_vision::FLOOR_TAGS)).contains(&tag)
    }

    /// The tags of the sheet, if it lay in the camera's sight. Fails if they moved.
    pub(super) fn floor_tags(&self) -> Result<Vec<StillTag>> {
        let mut tags: BTreeMap<u16, Vec<&SeenTag>> = BTreeMap::new();
        for timed in self.sightings.iter().filter(|timed| self.is_on_floor(timed.seen.tag)) {
            tags.entry(timed.seen.tag as u16).or_default().push(&timed.seen);
        }
        let still = tags.into_iter().map(|(id, seen)| {
            let middle = |of: &[&SeenTag], corner: usize| -> [f64; 2] {
                std::array::from_fn(|axis| median(of.iter().map(|seen| seen.corners.corners[corner][axis])))
            };
            let shift = |early: &[&SeenTag], late: &[&SeenTag], corner: usize| {
                let (early, late) = (middle(early, corner), middle(late, corner));
                (early[0] - late[0]).hypot(early[1] - late[1])
            };
            let (early, late) = seen.split_at(seen.len() / 2);
            let shift_px = match early {
                [] => 0.0,
                early => (0..4).map(|corner| shift(early, late, corner)).fold(0.0, f64::max),
            };
            ensure!(
                shift_px <= MAX_SHIFT_PX,
                "`{}`: tag {id} of the floor moved by {shift_px:.0} pixels: camera and sheet must stay where they are; record again",
                self.name
            );
            let corners = std::array::from_fn(|corner| middle(&seen, corner).into());
            Ok(StillTag { id, corners: TagCorners { corners, ..seen[0].corners } })
        });
        still.collect()
    }

    /// The robot's tag in each picture, and its id: of several robots, of the one that was seen most.
    pub(super) fn robot_tags(&self) -> Result<(u32, Vec<FlatTag>)> {
        let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
        let robots = || self.sightings.iter().filter(|timed| !self.is_on_floor(timed.seen.tag));
        for timed in robots() {
            *counts.entry(timed.seen.tag).or_default() += 1;
        }
        let Some((tag, count)) = counts.into_iter().max_by_key(|(_, count)| *count) else {
            bail!("`{}`: no picture shows the tag of a robot; look with `posebridge camera detect`", self.name);
        };
        let stride = count.div_ceil(MAX_PICTURES);
        let camera = &self.config.camera;
        let tag_in_body =
            Transform2::<Body, Body>::new(Meters(camera.tag_x_m), Meters(camera.tag_y_m), Heading::default());
        let start = self.poses.first().map(|(_, pose)| *pose);
        let flat = |timed: &TimedTag| {
            let pose = self.pose_at(timed.at).or(start).unwrap_or_default();
            let is_held = start.is_some_and(|start| {
                let moved = start.inverse() * pose;
                moved.x.0.hypot(moved.y.0) < AT_START.0 && moved.heading.rad().abs() < AT_START.1
            });
            let tag_in_arena = pose * tag_in_body;
            FlatTag {
                corners: timed.seen.corners.corners,
                covariance: timed.seen.corners.full_covariance(),
                side_m: camera.tag_side_m,
                height_m: camera.tag_height_m,
                rough_pose: [tag_in_arena.x.0, tag_in_arena.y.0, tag_in_arena.heading.rad()].into(),
                is_held,
            }
        };
        Ok((tag, robots().filter(|timed| timed.seen.tag == tag).step_by(stride).map(flat).collect()))
    }

    /// The last one before an instant.
    fn pose_at(&self, at: Timestamp<HostClock>) -> Option<Pose<Arena>> {
        let after = self.poses.partition_point(|(then, _)| *then <= at);
        self.poses.get(after.checked_sub(1)?).map(|(_, pose)| *pose)
    }

    /// Whether the camera, or its driver, says when a picture was exposed.
    pub(super) fn is_exposure_known(&self) -> bool {
        self.sightings.iter().all(|timed| timed.seen.is_exposure_known)
    }

    /// The delay with which the calibrated camera's fixes agree best with wheels and gyro; `None` if the drive does not tell it.
    pub(super) fn delay(&self, camera: &CameraFile) -> Result<Option<PictureDelay>> {
        let mut delay_ms = self.config.camera.json.delay_ms;
        let spread_ms = self.reception_spread_ms();
        let mut learned = UncertainValue { value: 0.0, sigma: f64::INFINITY };
        for sigma in DELAY_SIGMAS_S {
            let mut config = self.config.clone();
            let camera =
                CameraFile { delay_ms: Some(delay_ms), delay_spread_ms: Some(2.0 * spread_ms), ..camera.clone() };
            config.links[usize::from(self.link.0)].camera = Some(CameraChoice::Camera(Box::new(camera)));
            config.robot.calibration.fix_delay_s = UncertainValue { value: 0.0, sigma }.into();
            let stations = for_each_output(&self.name, &self.bytes, &config, |_, _| {})?;
            let Some(calibration) = stations.robots().next().and_then(Robot::calibration) else {
                return Ok(None);
            };
            learned = calibration.fix_delay_s;
            delay_ms += 1e3 * learned.value;
        }
        let seconds = TimeDelta::from_secs_f64;
        let (mean, sigma) = (seconds(1e-3 * delay_ms), seconds(learned.sigma));
        let found = PictureDelay { mean, sigma, spread: seconds(1e-3 * spread_ms) };
        Ok((learned.sigma < MAX_DELAY_SIGMA_S).then_some(found))
    }

    /// How unevenly the pictures came: standard deviation from an even rate.
    fn reception_spread_ms(&self) -> f64 {
        let mut times: Vec<f64> = self.sightings.iter().map(|timed| timed.at.as_secs_f64()).collect();
        times.dedup_by(|one, other| (*one - *other).abs() < 1e-3);
        let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
        let period = median(gaps.clone());
        // Of two gaps beside one late picture one is longer and one shorter: half of their variance is the picture's.
        let even: Vec<f64> = gaps.map(|gap| gap - period).filter(|gap| gap.abs() < period / 2.0).collect();
        let variance = even.iter().map(|gap| gap * gap).sum::<f64>() / even.len().max(1) as f64;
        1e3 * (variance / 2.0).sqrt()
    }
}

/// An input of a recording, or an event that followed from it.
enum Step<'a> {
    Input(&'a Input),
    Event(&'a Event),
}

/// Runs the station of a configuration over the recording.
fn for_each_output(
    name: &str,
    bytes: &[u8],
    config: &Config,
    mut take: impl FnMut(Timestamp<HostClock>, Step<'_>),
) -> Result<RecordedStations> {
    let mut reader = RecordingReader::open(bytes)?;
    let mut stations = recorded_stations(config, &[])?;
    for_each_input(name, &mut reader, |now, input| {
        take(now, Step::Input(input));
        stations.handle(now, input);
        while let Some(output) = stations.poll() {
            if let Output::Event(event) = output {
                take(now, Step::Event(&event));
            }
        }
        Ok(())
    })?;
    Ok(stations)
}

/// The lines of all links, whole or in pieces.
#[derive(Default)]
struct CameraLines {
    started: BTreeMap<LinkId, Vec<u8>>,
    sightings: BTreeMap<LinkId, Vec<TimedTag>>,
}

impl CameraLines {
    /// Bytes without an end of line are no camera's.
    const MAX_LINE: usize = 4_096;

    fn push(&mut self, now: Timestamp<HostClock>, link: LinkId, bytes: &[u8]) {
        let started = self.started.entry(link).or_default();
        started.extend_from_slice(bytes);
        while let Some(end) = started.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = started.drain(..=end).collect();
            if let Some(seen) = read_seen_tag(&line) {
                self.sightings.entry(link).or_default().push(TimedTag { at: now - seen.age, seen });
            }
        }
        if started.len() > Self::MAX_LINE {
            started.clear();
        }
    }
}

fn choose_camera(
    name: &str,
    mut sightings: BTreeMap<LinkId, Vec<TimedTag>>,
    link: Option<u16>,
) -> Result<(LinkId, Vec<TimedTag>)> {
    if let Some(link) = link {
        sightings.retain(|id, _| id.0 == link);
    }
    ensure!(
        sightings.len() <= 1,
        "`{name}` holds the pictures' tags of several links: choose one with --link ({})",
        sightings.keys().map(|id| id.0.to_string()).collect::<Vec<_>>().join(", ")
    );
    sightings.pop_first().with_context(|| {
        format!(
            "`{name}` holds no tag of a camera's pictures: record with `posebridge run --camera SOURCE --record`, and look with \
             `posebridge camera detect SOURCE`"
        )
    })
}

fn picture_size(name: &str, sightings: &[TimedTag]) -> Result<(usize, usize)> {
    let sizes = || sightings.iter().map(|timed| timed.seen.corners.picture_px);
    let first = sizes().next().flatten();
    let [width, height] = first.with_context(|| format!("`{name}`: the camera's lines have no `picture_px`"))?;
    ensure!(
        sizes().all(|size| size == first),
        "`{name}`: the size of the pictures changed: calibrate each size by itself"
    );
    Ok((width, height))
}

/// Zero of nothing.
fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.collect();
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or_default()
}
