//! The thermometers of all bricks: a filter for each, beside the robot's and not in its place.
//!
//! Gets readings that are aligned already, gives what each thermometer will show in the end. Readings wait here until the robot has its
//! estimate: temperatures are not used for steering.

use posebridge_estimator::filters::thermometer::{Thermometer, ThermometerSettings};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    BrickClock, Celsius, ChannelName, Event, HostClock, Observation, ObservationKind, RobotId, SensorId, TimeDelta,
    Timestamp,
};

use crate::config::ThermometerConfig;

/// Most thermometers that are followed; a sender of more names invents them.
const MAX_CHANNELS: usize = 16;

/// A reading on its way to its filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TemperatureReading {
    pub(crate) brick: RobotId,
    pub(crate) channel: ChannelName,
    pub(crate) arrival: Timestamp<HostClock>,
    /// By the clock of the brick that sent it.
    pub(crate) stamp: Timestamp<BrickClock>,
    pub(crate) shown: Celsius,
}

/// All thermometers, in the order in which they were heard first. Without any it holds and costs nothing.
#[derive(Default)]
pub(crate) struct ThermometerBank {
    channels: Vec<ThermometerChannel>,
    pending: Vec<TemperatureReading>,
    limit_report: LimitReport,
}

/// Whether it was said that there are too many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum LimitReport {
    #[default]
    None,
    Due,
    Reported,
}

struct ThermometerChannel {
    brick: RobotId,
    name: ChannelName,
    thermometer: Thermometer,
}

impl ThermometerBank {
    /// Keeps a reading until [`Self::process`].
    pub(crate) fn push(&mut self, reading: TemperatureReading) {
        self.pending.push(reading);
    }

    /// A brick was restarted: how long its thermometers went on is not known.
    pub(crate) fn restart(&mut self, brick: RobotId) {
        for channel in &mut self.channels {
            if channel.brick == brick {
                channel.thermometer.restart_clock();
            }
        }
    }

    /// Uses what waits, oldest first.
    pub(crate) fn process(&mut self, filter: &FilterConfig, known: &[ThermometerConfig], mut tell: impl FnMut(Event)) {
        let mut waiting = std::mem::take(&mut self.pending);
        for reading in waiting.drain(..) {
            if let Some(channel) = self.channel_of(&reading, filter, known) {
                tell(channel.observe(&reading));
            }
        }
        // Its room is used again.
        self.pending = waiting;
    }

    /// Whether thermometers have been refused since this was asked last; once is enough.
    pub(crate) fn take_limit_report(&mut self) -> bool {
        let is_due = self.limit_report == LimitReport::Due;
        if is_due {
            self.limit_report = LimitReport::Reported;
        }
        is_due
    }

    fn channel_of(
        &mut self,
        reading: &TemperatureReading,
        filter: &FilterConfig,
        known: &[ThermometerConfig],
    ) -> Option<&mut ThermometerChannel> {
        let is_it = |channel: &ThermometerChannel| channel.brick == reading.brick && channel.name == reading.channel;
        let index = match self.channels.iter().position(is_it) {
            Some(index) => index,
            None if self.channels.len() < MAX_CHANNELS => {
                let told = known.iter().find(|known| known.channel == reading.channel);
                let settings = told.map_or_else(ThermometerSettings::default, |told| told.settings.clone());
                self.channels.push(ThermometerChannel {
                    brick: reading.brick,
                    name: reading.channel,
                    thermometer: Thermometer::new(filter, &settings),
                });
                self.channels.len() - 1
            }
            None => {
                if self.limit_report == LimitReport::None {
                    self.limit_report = LimitReport::Due;
                }
                return None;
            }
        };
        self.channels.get_mut(index)
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
            brick: self.brick,
            channel: self.name,
            arrival: reading.arrival,
            stamp: reading.stamp,
            shown: reading.shown,
            verdict: record.outcome,
            settled: self.thermometer.final_value(),
        }
    }
}
