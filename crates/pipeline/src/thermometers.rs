//! The thermometers of all bricks: a filter for each, beside the robot's and not in its place.
//!
//! Gets readings that are aligned already, gives what each thermometer will show in the end. Readings wait here until the robot has its
//! estimate: nobody steers by a temperature.

use posebridge_estimator::filters::thermometer::{Thermometer, ThermometerSettings};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    BrickClock, Celsius, ChannelName, Event, HostClock, Observation, Observed, RobotId, SensorId, Span, Stamp,
};

use crate::config::ThermometerConfig;

/// So many thermometers are followed; who sends more names than that makes them up.
const MOST_CHANNELS: usize = 16;

/// A reading on its way to its filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reading {
    pub(crate) brick: RobotId,
    pub(crate) channel: ChannelName,
    pub(crate) arrival: Stamp<HostClock>,
    /// By the clock of the brick that sent it.
    pub(crate) stamp: Stamp<BrickClock>,
    pub(crate) shown: Celsius,
}

/// All thermometers, in the order in which they were heard first. Without any it holds and costs nothing.
#[derive(Default)]
pub(crate) struct Thermometers {
    channels: Vec<Channel>,
    waiting: Vec<Reading>,
    refusal: Refusal,
}

/// Whether it was said that there are too many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Refusal {
    #[default]
    None,
    Due,
    Told,
}

struct Channel {
    brick: RobotId,
    name: ChannelName,
    thermometer: Thermometer,
}

impl Thermometers {
    /// Keeps a reading until [`Self::settle`].
    pub(crate) fn wait(&mut self, reading: Reading) {
        self.waiting.push(reading);
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
    pub(crate) fn settle(&mut self, filter: &FilterConfig, known: &[ThermometerConfig], mut tell: impl FnMut(Event)) {
        let mut waiting = std::mem::take(&mut self.waiting);
        for reading in waiting.drain(..) {
            if let Some(channel) = self.channel_of(&reading, filter, known) {
                tell(channel.take(&reading));
            }
        }
        // Its room is used again.
        self.waiting = waiting;
    }

    /// Whether thermometers have been refused since this was asked last; once is enough.
    pub(crate) fn take_refusal(&mut self) -> bool {
        let is_due = self.refusal == Refusal::Due;
        if is_due {
            self.refusal = Refusal::Told;
        }
        is_due
    }

    fn channel_of(
        &mut self,
        reading: &Reading,
        filter: &FilterConfig,
        known: &[ThermometerConfig],
    ) -> Option<&mut Channel> {
        let is_it = |channel: &Channel| channel.brick == reading.brick && channel.name == reading.channel;
        let index = match self.channels.iter().position(is_it) {
            Some(index) => index,
            None if self.channels.len() < MOST_CHANNELS => {
                let told = known.iter().find(|known| known.channel == reading.channel);
                let settings = told.map_or_else(ThermometerSettings::default, |told| told.settings.clone());
                self.channels.push(Channel {
                    brick: reading.brick,
                    name: reading.channel,
                    thermometer: Thermometer::new(filter, &settings),
                });
                self.channels.len() - 1
            }
            None => {
                if self.refusal == Refusal::None {
                    self.refusal = Refusal::Due;
                }
                return None;
            }
        };
        self.channels.get_mut(index)
    }
}

impl Channel {
    fn take(&mut self, reading: &Reading) -> Event {
        let record = self.thermometer.observe(&Observation {
            sensor: SensorId::THERMOMETER,
            stamp: reading.stamp,
            stamp_sigma: Span::ZERO,
            observed: Observed::Temperature(reading.shown),
        });
        Event::Temperature {
            brick: self.brick,
            channel: self.name,
            arrival: reading.arrival,
            stamp: reading.stamp,
            shown: reading.shown,
            verdict: record.verdict,
            settled: self.thermometer.settled(),
        }
    }
}
