//! The thermometers of all bricks: a filter for each, independent of the robot's.
//!
//! Gets aligned readings, gives the predicted final value of each thermometer. Readings wait here until the robot has
//! its estimate: temperatures are not used for steering.

use std::collections::BTreeMap;

use posebridge_estimator::Filter;
use posebridge_estimator::filters::thermometer::{Thermometer, ThermometerSettings};
use posebridge_telemetry::{
    BrickClock, Celsius, ChannelName, Event, HostClock, Observation, ObservationKind, RobotId, SensorId, TimeDelta,
    Timestamp,
};

use crate::config::RobotConfig;

/// Most thermometers of a brick; a brick that sends more names invents them.
const MAX_CHANNELS_PER_BRICK: usize = 16;
/// Most thermometers in total: four for each of 64 robots, the usual `station.max_robots`. Addresses can be invented as
/// well.
const MAX_CHANNELS: usize = 256;

/// A reading before its filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TemperatureReading {
    pub(crate) brick: RobotId,
    pub(crate) channel: ChannelName,
    pub(crate) arrival: Timestamp<HostClock>,
    /// By the clock of the brick that sent it.
    pub(crate) stamp: Timestamp<BrickClock>,
    pub(crate) shown: Celsius,
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
        mut emit: impl FnMut(Event),
    ) -> bool {
        let had_rejected = self.has_rejected;
        let mut waiting = std::mem::take(&mut self.pending);
        for reading in waiting.drain(..) {
            if let Some(channel) = self.channel_of(&reading, &config_of) {
                emit(channel.observe(&reading));
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
    ) -> Option<&mut ThermometerChannel> {
        let known = self.bricks.get(&reading.brick).map_or(&[][..], Vec::as_slice);
        let index = known.iter().position(|channel| channel.name == reading.channel).unwrap_or(known.len());
        if index == known.len() {
            if index >= MAX_CHANNELS_PER_BRICK || self.channel_count >= MAX_CHANNELS {
                self.has_rejected = true;
                return None;
            }
            let config = config_of(reading.brick);
            let known = config.thermometers.iter().find(|known| known.channel == reading.channel);
            let settings = known.map_or_else(ThermometerSettings::default, |known| known.settings.clone());
            let thermometer = Thermometer::new(&config.filter_config, &settings);
            let channels = self.bricks.entry(reading.brick).or_default();
            channels.push(ThermometerChannel { name: reading.channel, thermometer });
            self.channel_count += 1;
        }
        self.bricks.get_mut(&reading.brick)?.get_mut(index)
    }
}

impl ThermometerChannel {
    fn observe(&mut self, reading: &TemperatureReading) -> Event {
        let record = self.thermometer.observe(&Observation {
            sensor: SensorId::THERMOMETER,
            stamp: reading.stamp,
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Temperature(reading.shown),
        });
        Event::Temperature {
            brick: reading.brick,
            channel: self.name,
            arrival: reading.arrival,
            stamp: reading.stamp,
            shown: reading.shown,
            verdict: record.outcome,
            settled: self.thermometer.final_value(),
        }
    }
}
