//! Temperatures at the station: from a message to the bank of thermometers, and predictions back to their senders.

use posebridge_estimator::EstimatedQuantity;
use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{
    Celsius, ChannelName, Observation, ObservationKind, RobotId, SensorId, TimeDelta, severity,
};

use crate::observations::MessageSender;
use crate::observers::ObserverAddress;
use crate::sender_identity::MessageOrigin;
use crate::station::Station;
use crate::thermometer_bank::TemperatureReading;

impl Station {
    /// Aligns a thermometer's reading and queues it for [`Self::process_temperatures`]; ignores other messages.
    ///
    /// A thermometer may be on a robot or on any other brick. That one's clock is kept like a camera's, but never
    /// converted: the thermometer's filter needs only the time between two readings.
    pub(crate) fn handle_temperature(
        &mut self,
        sender: &MessageSender,
        stamp: WireStamp,
        channel: ChannelName,
        temperature: Celsius,
    ) {
        let MessageOrigin { home, address, is_new, .. } = sender.origin;
        if !is_new && sender.robot.is_none() {
            return;
        }
        let mut brick = RobotId { link: home, address };
        let time = if let Some(index) = sender.robot {
            brick = self.robots.get(index).id;
            self.align_robot_time(sender.received, index, stamp).map(|(time, _)| time)
        } else {
            let observer = ObserverAddress { home, address };
            let aligned = self.observers.own_time(observer, sender.received, stamp);
            if aligned.has_restarted {
                self.restart_thermometers(brick);
                self.request_time_burst(observer);
            }
            if aligned.time.is_none() {
                self.report_unaligned(home, address);
            }
            aligned.time
        };
        if let Some(stamp) = time {
            let arrival = sender.received.host_time;
            let from = sender.received.endpoint;
            self.thermometers.push(TemperatureReading { brick, from, channel, arrival, stamp, shown: temperature });
            // A filter of one temperature follows the first thermometer.
            if let Some(index) = sender.robot
                && self.robots.get(index).estimator.quantity() == EstimatedQuantity::Temperature
                && self.thermometers.first_channel(brick) == Some(channel)
            {
                let measurement = ObservationKind::Temperature(temperature);
                let sensor = SensorId::THERMOMETER;
                let reading = Observation { sensor, stamp, stamp_sigma: TimeDelta::ZERO, measurement };
                self.observe(index, address, arrival, reading);
            }
        }
    }

    /// Uses the queued temperatures, which are not urgent: they steer nothing.
    pub(crate) fn process_temperatures(&mut self) {
        let Self { config, robots, outputs, thermometers, .. } = self;
        let config_of = |brick: RobotId| match robots.find(brick) {
            Some(index) => config.robot_config(robots.get(index).block),
            None => robots.config_for(config, brick.link, brick.address),
        };
        let mut predictions = Vec::new();
        let has_rejected = thermometers.process(config_of, |event, predicted| {
            outputs.emit(event);
            predictions.extend(predicted);
        });
        for predicted in &predictions {
            for (message, priority) in predicted.messages() {
                self.transmitter().send_to_peer(predicted.to, &message, priority);
            }
        }
        if has_rejected {
            let text = "there are more thermometers than are followed; those heard last are left out".to_owned();
            self.report_own_text(severity::WARNING, text);
        }
    }

    /// Readings from before a restart are used before it.
    pub(crate) fn restart_thermometers(&mut self, brick: RobotId) {
        self.process_temperatures();
        self.thermometers.restart(brick);
    }
}
