//! The thermometers of all bricks: a filter for each, independent of the robot's.
//!
//! Gets aligned readings, gives the predicted final value of each thermometer. Readings wait here until the robot has
//! its estimate: temperatures are not used for steering.

use std::collections::BTreeMap;

use posebridge_estimator::Filter;
use posebridge_estimator::filters::thermometer::{Thermometer, ThermometerSettings};
use posebridge_protocol::message::{Message, NamedValue, WireStamp};
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{
    BrickClock, Celsius, ChannelName, Event, HostClock, Observation, ObservationKind, Priority, RobotId,
    ScalarEstimate, SensorId, TimeDelta, Timestamp,
};

use crate::config::{OutputKind, RobotConfig};
use crate::output_schedule::priority_of_stream;
use crate::robot_snapshot::SavedThermometer;

/// Most thermometers of a brick; a brick that sends more names invents them.
const MAX_CHANNELS_PER_BRICK: u8 = 16;
/// Most thermometers in total: four for each of 64 robots. Addresses can be invented as well.
const MAX_CHANNELS: usize = 256;

/// A reading before its filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TemperatureReading {
    pub(crate) brick: RobotId,
    /// Where it came from, and where its prediction goes.
    pub(crate) from: Endpoint,
    pub(crate) channel: ChannelName,
    pub(crate) arrival: Timestamp<HostClock>,
    /// By the clock of the brick that sent it.
    pub(crate) stamp: Timestamp<BrickClock>,
    pub(crate) shown: Celsius,
}

/// The streams of a brick's thermometers, two each, end with the last one; those of sensors come before.
const FIRST_STREAM: u8 = u8::MAX - (2 * MAX_CHANNELS_PER_BRICK - 1);

/// The final value of a thermometer, where its readings tell it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PredictedEnd {
    pub(crate) to: Endpoint,
    channel: ChannelName,
    /// The number of the channel among those of its brick.
    index: u8,
    end: ScalarEstimate,
}

impl PredictedEnd {
    /// What the brick is sent: the final value and its sigma. `temp1` is answered by `end_1` and `sd_1`, `temp` by `end` and `sd`:
    /// an answer that began with `temp` would itself be taken for a reading.
    pub(crate) fn messages(&self) -> [(Message, Priority); 2] {
        let channel = self.channel.as_str();
        let own = channel.strip_prefix("temp").unwrap_or(channel);
        let stamp = WireStamp::Micros64(u64::try_from(self.end.stamp.as_nanos() / 1_000).unwrap_or_default());
        let first_stream = FIRST_STREAM + 2 * self.index;
        [(0, "end", self.end.value), (1, "sd", self.end.sigma)].map(|(number, stem, value)| {
            let name = if own.is_empty() { stem.to_owned() } else { format!("{stem}_{}", own.trim_start_matches('_')) };
            let named = NamedValue { stamp, name: ChannelName::from_bytes(name.as_bytes()), value: value as f32 };
            (Message::NamedValue(named), priority_of_stream(OutputKind::NamedValue, first_stream + number))
        })
    }
}

/// All thermometers by brick, those of a brick in the order of their first reading. Allocates nothing while there are
/// none.
#[derive(Default)]
pub(crate) struct ThermometerBank {
    bricks: BTreeMap<RobotId, Vec<ThermometerChannel>>,
    channel_count: usize,
    pending: Vec<TemperatureReading>,
    has_rejected: bool,
}

struct ThermometerChannel {
    name: ChannelName,
    thermometer: Thermometer,
}

impl ThermometerBank {
    /// Queues a reading until [`Self::process`].
    pub(crate) fn push(&mut self, reading: TemperatureReading) {
        self.pending.push(reading);
    }

    /// The states of a brick's thermometers, in their order.
    pub(crate) fn save(&self, brick: RobotId) -> Vec<SavedThermometer> {
        let channels = self.bricks.get(&brick).into_iter().flatten();
        channels.map(|channel| (channel.name, channel.thermometer.save())).collect()
    }

    /// Replaces a brick's thermometers by those that another station has saved; returns the number of those that are not used.
    pub(crate) fn restore(&mut self, brick: RobotId, config: &RobotConfig, saved: &[SavedThermometer]) -> usize {
        if saved.is_empty() {
            return 0;
        }
        let before = self.bricks.remove(&brick).map_or(0, |channels| channels.len());
        self.channel_count -= before;
        let room = usize::from(MAX_CHANNELS_PER_BRICK).min(MAX_CHANNELS - self.channel_count);
        let mut channels: Vec<ThermometerChannel> = Vec::new();
        for (name, state) in saved.iter().take(room) {
            let mut channel = ThermometerChannel::new(*name, config);
            let is_new = channels.iter().all(|known| known.name != *name);
            if is_new && channel.thermometer.restore(state).is_ok() {
                channels.push(channel);
            }
        }
        let refused = saved.len() - channels.len();
        self.channel_count += channels.len();
        if !channels.is_empty() {
            self.bricks.insert(brick, channels);
        }
        refused
    }

    /// The channel that a brick sent first.
    pub(crate) fn first_channel(&self, brick: RobotId) -> Option<ChannelName> {
        let known = self.bricks.get(&brick).and_then(|channels| channels.first()).map(|channel| channel.name);
        let pending = || self.pending.iter().find(|reading| reading.brick == brick).map(|reading| reading.channel);
        known.or_else(pending)
    }

    /// After a restart of a brick the length of the break in its readings is unknown.
    pub(crate) fn restart(&mut self, brick: RobotId) {
        for channel in self.bricks.get_mut(&brick).into_iter().flatten() {
            channel.thermometer.restart_clock();
        }
    }

    /// Uses the queued readings, oldest first; `config_of` returns the configuration of a brick. True if a thermometer was
    /// rejected for the first time.
    pub(crate) fn process<'a>(
        &mut self,
        config_of: impl Fn(RobotId) -> &'a RobotConfig,
        mut emit: impl FnMut(Event, Option<PredictedEnd>),
    ) -> bool {
        let had_rejected = self.has_rejected;
        let mut waiting = std::mem::take(&mut self.pending);
        for reading in waiting.drain(..) {
            if let Some((index, channel)) = self.channel_of(&reading, &config_of) {
                let (event, predicted) = channel.observe(index, &reading);
                emit(event, predicted);
            }
        }
        // Its room is used again.
        self.pending = waiting;
        self.has_rejected && !had_rejected
    }

    fn channel_of<'a>(
        &mut self,
        reading: &TemperatureReading,
        config_of: impl Fn(RobotId) -> &'a RobotConfig,
    ) -> Option<(u8, &mut ThermometerChannel)> {
        let known = self.bricks.get(&reading.brick).map_or(&[][..], Vec::as_slice);
        let position = known.iter().position(|channel| channel.name == reading.channel).unwrap_or(known.len());
        let index = u8::try_from(position).ok().filter(|index| *index < MAX_CHANNELS_PER_BRICK);
        if position == known.len() {
            if index.is_none() || self.channel_count >= MAX_CHANNELS {
                self.has_rejected = true;
                return None;
            }
            let channel = ThermometerChannel::new(reading.channel, config_of(reading.brick));
            self.bricks.entry(reading.brick).or_default().push(channel);
            self.channel_count += 1;
        }
        let channel = self.bricks.get_mut(&reading.brick)?.get_mut(position)?;
        Some((index?, channel))
    }
}

impl ThermometerChannel {
    fn new(name: ChannelName, config: &RobotConfig) -> Self {
        let known = config.thermometers.iter().find(|known| known.channel == name);
        let unlisted = || ThermometerSettings::from_config(&config.filter_config);
        let settings = known.map_or_else(unlisted, |known| known.settings.clone());
        Self { name, thermometer: Thermometer::new(&config.filter_config, &settings) }
    }

    /// Its event, and what the brick is sent: nothing for a reading that was not used.
    fn observe(&mut self, index: u8, reading: &TemperatureReading) -> (Event, Option<PredictedEnd>) {
        let record = self.thermometer.observe(&Observation {
            sensor: SensorId::THERMOMETER,
            stamp: reading.stamp,
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Temperature(reading.shown),
        });
        let settled = self.thermometer.final_value();
        let is_used = record.outcome.is_used();
        let predicted =
            settled.filter(|_| is_used).map(|end| PredictedEnd { to: reading.from, channel: self.name, index, end });
        let event = Event::Temperature {
            brick: reading.brick,
            channel: self.name,
            arrival: reading.arrival,
            stamp: reading.stamp,
            shown: reading.shown,
            verdict: record.outcome,
            settled,
        };
        (event, predicted)
    }
}
