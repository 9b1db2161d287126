//! A recording of ours as calibrations and experiments want it: what its pipeline made of the bytes, and of which robot.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{Ending, Reader};
use posebridge_telemetry::{
    BrickClock, ChannelName, Event, HostClock, Observation, Observed, Output, RobotId, SensorId,
    Span, Stamp, Verdict,
};

use crate::config::{self, Config, RobotFile, RobotProfile, Setting};
use crate::signing;
use crate::stderr::say;

/// Everything that was observed in one session.
#[derive(Clone, Debug)]
pub struct OwnRun {
    /// The file.
    pub name: String,
    /// The robot, with the geometry that its brick has described.
    pub robot: RobotFile,
    /// What a filter of this robot is built from.
    pub config: FilterConfig,
    /// What was observed, in the order of arrival, in brick time.
    pub observations: Vec<Observation>,
    /// When each of them arrived, in brick time; `None` if the brick never answered a question for its time.
    pub arrivals: Option<Vec<Stamp<BrickClock>>>,
    /// What each thermometer showed, in the order in which they were first heard.
    pub thermometers: Vec<Thermometer>,
}

/// What one thermometer showed.
#[derive(Clone, Debug)]
pub struct Thermometer {
    /// Its channel; with the address of its brick where several bricks have one of this name (`temp1@7/158`), and with the link
    /// (`temp1@3:7/158`) where that address speaks on several.
    pub channel: String,
    /// Its readings in the order of arrival, by the clock of its brick.
    pub readings: Vec<Observation>,
}

/// A thermometer as it was heard.
#[derive(Debug)]
struct HeardThermometer {
    brick: RobotId,
    channel: ChannelName,
    readings: Vec<Observation>,
    /// The last one that its filter used, all of which are in the order of time as long as their clock runs on.
    used: Option<Stamp<BrickClock>>,
}

impl HeardThermometer {
    /// The channel with as much of the brick's name as tells it from the others.
    fn name(&self, all: &[Self]) -> String {
        let namesakes = || all.iter().filter(|one| one.channel == self.channel);
        let (channel, RobotId { link, address }) = (self.channel, self.brick);
        let at_address = namesakes().filter(|one| one.brick.address == address);
        if namesakes().count() == 1 {
            channel.to_string()
        } else if at_address.count() == 1 {
            format!("{channel}@{address}")
        } else {
            format!("{channel}@{link}:{address}")
        }
    }
}

/// An instant by both clocks.
#[derive(Clone, Copy, Debug)]
struct Aligned {
    host: Stamp<HostClock>,
    brick: Stamp<BrickClock>,
    skew_ppm: f64,
}

/// What a recording's events said.
#[derive(Debug, Default)]
struct Heard {
    observations: Vec<Observation>,
    arrivals: Vec<Stamp<HostClock>>,
    /// In the order of host time.
    aligned: Vec<Aligned>,
    thermometers: Vec<HeardThermometer>,
    restarts: u64,
    /// The first thermometer whose clock began anew without an event of its own: its brick is not the robot.
    restarted: Option<(RobotId, ChannelName)>,
}

impl Heard {
    fn take(&mut self, event: &Event) {
        match *event {
            Event::Observed {
                arrival,
                observation,
                ..
            } => {
                self.observations.push(observation);
                self.arrivals.push(arrival);
            }
            Event::Temperature {
                brick,
                channel,
                stamp,
                shown,
                verdict,
                ..
            } => {
                let reading = Observation {
                    sensor: SensorId::THERMOMETER,
                    stamp,
                    stamp_sigma: Span::ZERO,
                    observed: Observed::Temperature(shown),
                };
                self.take_reading((brick, channel), reading, verdict);
            }
            Event::BrickClockAligned {
                host,
                brick,
                skew_ppm,
                ..
            } => self.aligned.push(Aligned {
                host,
                brick,
                skew_ppm,
            }),
            Event::BrickRestarted { .. } => self.restarts += 1,
            Event::RobotSeen { .. }
            | Event::RobotLost { .. }
            | Event::Fused { .. }
            | Event::Estimated { .. }
            | Event::CameraClockAligned { .. }
            | Event::Link { .. }
            | Event::Health { .. }
            | Event::Defect { .. }
            | Event::Text { .. } => {}
        }
    }

    fn take_reading(&mut self, id: (RobotId, ChannelName), reading: Observation, verdict: Verdict) {
        let is_it = |one: &HeardThermometer| (one.brick, one.channel) == id;
        let index = self.thermometers.iter().position(is_it);
        let index = index.unwrap_or_else(|| {
            self.thermometers.push(HeardThermometer {
                brick: id.0,
                channel: id.1,
                readings: Vec::new(),
                used: None,
            });
            self.thermometers.len() - 1
        });
        let Some(known) = self.thermometers.get_mut(index) else {
            return;
        };
        known.readings.push(reading);
        if matches!(verdict, Verdict::Accepted | Verdict::ResetTo) {
            if known.used.is_some_and(|used| reading.stamp < used) {
                self.restarted.get_or_insert(id);
            }
            known.used = Some(reading.stamp);
        }
    }

    /// Whether every clock ran on.
    ///
    /// # Errors
    /// A brick was restarted.
    fn check_clocks(&self, name: &str) -> Result<()> {
        if self.restarts > 0 {
            bail!(
                "`{name}`: the brick restarted {} time(s), its clock began anew; record a drive without a restart",
                self.restarts
            );
        }
        if let Some((brick, channel)) = self.restarted {
            bail!(
                "`{name}`: the brick {} of the thermometer `{channel}` restarted, its clock began anew; record again without a restart",
                brick.address
            );
        }
        Ok(())
    }

    /// The arrivals by the brick's clock, each by the alignment that was in force.
    fn arrivals_in_brick_time(&self) -> Option<Vec<Stamp<BrickClock>>> {
        let first = self.aligned.first()?;
        let converted = self.arrivals.iter().map(|arrival| {
            let after = self.aligned.partition_point(|one| one.host <= *arrival);
            let by = after
                .checked_sub(1)
                .and_then(|index| self.aligned.get(index))
                .unwrap_or(first);
            let since_s = (*arrival - by.host).as_secs_f64();
            by.brick + Span::from_secs_f64(since_s * (1.0 + 1e-6 * by.skew_ppm))
        });
        Some(converted.collect())
    }
}

/// What the thermometers showed, with names that tell them apart.
fn named(heard: Vec<HeardThermometer>) -> Vec<Thermometer> {
    let names: Vec<String> = heard.iter().map(|one| one.name(&heard)).collect();
    let named = names.into_iter().zip(heard);
    let named = named.map(|(channel, heard)| Thermometer {
        channel,
        readings: heard.readings,
    });
    named.collect()
}

/// What is laid over the configuration that a recording was made with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Overlay<'a> {
    /// Another robot.
    pub robot: Option<&'a Path>,
    /// Single keys; they go over the robot, too.
    pub settings: &'a [Setting],
}

/// Whether a path names a recording of ours and not a descriptor of somebody else's.
#[must_use]
pub fn is_own(path: &Path) -> bool {
    path.extension().is_none_or(|extension| extension != "toml")
}

/// Reads a recording as far as it goes; what is cut off or damaged is said on stderr.
///
/// # Errors
/// The file cannot be read, is no recording, holds no observation, or its brick was restarted; or what is laid over it makes no
/// sense.
pub fn read(path: &Path, overlay: Overlay<'_>) -> Result<OwnRun> {
    let name = path.display().to_string();
    let bytes = std::fs::read(path).with_context(|| format!("reading the recording `{name}`"))?;
    let mut reader = Reader::open(&bytes).with_context(|| {
        format!(
            "recording `{name}` ({} bytes): `posebridge run` writes recordings",
            bytes.len()
        )
    })?;
    let config = laid_over(&reader.header().config_toml, overlay)?;
    let mut pipeline_config = config.pipeline()?;
    signing::recall(&config, &[], &mut pipeline_config)?;
    let mut pipeline = Pipeline::new(pipeline_config, Stamp::ZERO)?;
    let mut heard = Heard::default();
    for item in &mut reader {
        match item {
            Ok((now, input)) => pipeline.handle(now, &input),
            Err(error) => say(&format!("{name}: {error}; what is whole is used")),
        }
        while let Some(output) = pipeline.poll() {
            if let Output::Event(event) = output {
                heard.take(&event);
            }
        }
    }
    if let Ending::Torn { offset, what } = reader.ending() {
        say(&format!(
            "{name}: cut off at byte {offset} ({what}); everything before is used"
        ));
    }
    ensure!(
        !(heard.observations.is_empty() && heard.thermometers.is_empty()),
        "`{name}` holds no observation: no robot was heard while it was recorded; look for the robot with `posebridge doctor` and \
         record again"
    );
    heard.check_clocks(&name)?;
    let mut filter_config = config.filter_config()?;
    filter_config.geometry = pipeline.geometry();
    Ok(OwnRun {
        name,
        robot: described(&config.robot, &filter_config),
        config: filter_config,
        arrivals: heard.arrivals_in_brick_time(),
        observations: heard.observations,
        thermometers: named(heard.thermometers),
    })
}

/// The recording's configuration with another robot, if there is one, and single keys on top.
fn laid_over(header: &str, overlay: Overlay<'_>) -> Result<Config> {
    let origin = "the recording's own configuration";
    let mut config = config::load_text(origin, header, overlay.settings)?.config;
    if let Some(path) = overlay.robot {
        config = config.with_robot(RobotProfile::read(path)?);
        for setting in overlay.settings {
            config = config::lay_over(&config, setting)?;
        }
    }
    Ok(config)
}

/// The robot with the geometry that its brick has described.
fn described(robot: &RobotFile, config: &FilterConfig) -> RobotFile {
    RobotFile {
        left_wheel_radius_m: config.geometry.left_wheel_radius.0,
        right_wheel_radius_m: config.geometry.right_wheel_radius.0,
        track_width_m: config.geometry.track_width.0,
        ticks_per_turn: std::f64::consts::TAU / config.geometry.tick.0,
        ..robot.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::WireVersion;
    use posebridge_protocol::message::{Message, WireStamp};
    use posebridge_telemetry::{Address, Celsius, Input, LinkId, LinkState, PeerId};

    const BATH: Address = Address::new(7, 158);
    const OVEN: Address = Address::new(8, 158);

    /// What is heard of a thermometer each 0.5 s whose clock shows this, in ms.
    fn heard(readings: &[u32]) -> Heard {
        let config = Config::default().pipeline().unwrap();
        let mut pipeline = Pipeline::new(config, Stamp::ZERO).unwrap();
        let mut heard = Heard::default();
        let link = LinkId(0);
        let up = Input::Link {
            link,
            state: LinkState::Up,
        };
        let said = readings.iter().map(|millis| {
            let message = Message::Thermometer {
                stamp: WireStamp::Millis32(*millis),
                channel: ChannelName::from_bytes(b"temp1"),
                temperature: Celsius(20.0),
            };
            let mut bytes = Vec::new();
            Encoder::new(WireVersion::V2).encode(BATH, &message, &mut bytes);
            let peer = PeerId::default();
            Input::Bytes { link, peer, bytes }
        });
        for (k, input) in (0..).zip(std::iter::once(up).chain(said)) {
            pipeline.handle(Stamp::from_millis(500 * k), &input);
            while let Some(output) = pipeline.poll() {
                if let Output::Event(event) = output {
                    heard.take(&event);
                }
            }
        }
        heard
    }

    #[test]
    fn a_thermometer_whose_brick_restarts_is_refused_and_one_that_comes_late_is_not() {
        let runs_on = |millis: &[u32]| heard(millis).check_clocks("run.mcap");
        assert!(runs_on(&[60_000, 60_500, 61_000, 60_900, 62_000]).is_ok());
        let error = runs_on(&[60_000, 60_500, 61_000, 300, 800, 1_300]).unwrap_err();
        assert!(error.to_string().contains("7/158"), "{error}");
        assert!(error.to_string().contains("restarted"), "{error}");
    }

    #[test]
    fn thermometers_of_one_name_are_told_apart_by_their_bricks() {
        let names = |bricks: &[(u16, Address)]| -> Vec<String> {
            let heard = bricks.iter().map(|(link, address)| HeardThermometer {
                brick: RobotId {
                    link: LinkId(*link),
                    address: *address,
                },
                channel: ChannelName::from_bytes(b"temp1"),
                readings: vec![],
                used: None,
            });
            let named = named(heard.collect());
            named.into_iter().map(|one| one.channel).collect()
        };
        assert_eq!(names(&[(0, BATH)]), ["temp1"]);
        assert_eq!(
            names(&[(0, BATH), (0, OVEN)]),
            ["temp1@7/158", "temp1@8/158"]
        );
        assert_eq!(
            names(&[(0, BATH), (1, BATH), (0, OVEN)]),
            ["temp1@0:7/158", "temp1@1:7/158", "temp1@8/158"]
        );
    }
}
