//! The content of the brick's replies.

use posebridge_telemetry::severity::{INFO, NOTICE, WARNING};
use posebridge_telemetry::{
    ChannelName, EncoderTicks, Heading, HostClock, MetersPerSecondSquared, ReceiveError, Timestamp,
};

use super::codec::{NxtCodec, StatusTopic};
use super::digital::{DigitalMeasurement, DigitalSensor};
use super::gyro::{GyroReadout, RestUpdate};
use super::io_maps::{AnalogInput, FirmwareModule, IoMapData, IoMapWindow, TICK};
use super::motors::{AccelerationReading, PendingAccelerations, RequestInterval, TickAdvance};
use super::poll_schedule::{PortState, RequestFailure};
use super::requests::{NxtRequest, PendingRequest};
use super::settings::{AccelerometerMounting, MotorMounting, MotorPort, NxtSensor};
use super::telegram::{NxtReply, NxtStatus, bytes_at};
use crate::bricks::battery::plausible_battery;
use crate::bricks::codec::{CodecEvent, CodecEventSink};
use crate::bricks::counters::CounterUpdate;
use crate::message::{ImuMessage, Inertial, Message, PlanarImu, WheelTicks};

/// Replies between two host timestamps, where the brick does not report its own clock.
const REPLIES_PER_HOST_TICK: u8 = 9;
/// Type of a port without set-up.
const NO_SENSOR: u8 = 0;
/// Offset of a motor's count after the status of GETOUTPUTSTATE: port, power, mode, regulation, turn ratio, run state,
/// limit.
const COUNT_AT: usize = 10;

impl NxtCodec {
    pub(super) fn handle_reply(
        &mut self,
        now: Timestamp<HostClock>,
        request: &PendingRequest,
        reply: &NxtReply<'_>,
        sink: CodecEventSink<'_>,
    ) {
        let interval = RequestInterval { sent: request.sent, answered: now };
        self.substitute_host_clock(interval, sink);
        if let NxtRequest::Mailbox(_) = request.request {
            self.handle_mailbox(reply.status, sink);
            return;
        }
        if reply.status != NxtStatus::OK {
            self.handle_rejection(&request.request, reply.status, sink);
            return;
        }
        self.schedule.record_success(&request.request);
        match &request.request {
            NxtRequest::SyncBarrier => {
                self.handle_version(reply, sink);
                // Something was disturbed, or began: the clock may be another.
                self.schedule.request_tick();
            }
            NxtRequest::IoMap(window) => self.handle_io_map(*window, reply, interval, sink),
            NxtRequest::Motor(port) => {
                if let Some(count) = bytes_at(reply.values, COUNT_AT) {
                    self.motors.push(*port, i32::from_le_bytes(count), interval);
                    self.handle_wheels(sink);
                }
            }
            NxtRequest::Analog(port) => {
                if let Some(input) = input_of(reply) {
                    self.handle_input(*port, input, interval, sink);
                }
            }
            NxtRequest::Digital(port) => self.handle_digital(*port, reply, now, sink),
            NxtRequest::SetUp { port, .. } => self.complete_set_up(*port, now),
            NxtRequest::Battery => self.handle_battery(reply, sink),
            NxtRequest::Mailbox(_) => {}
        }
    }

    /// Uses the station's clock for a brick that does not report its own: then no stamp needs an alignment.
    fn substitute_host_clock(&mut self, interval: RequestInterval, sink: CodecEventSink<'_>) {
        if self.schedule.has_tick() {
            self.replies_since_host_tick = REPLIES_PER_HOST_TICK;
            return;
        }
        self.replies_since_host_tick += 1;
        if self.replies_since_host_tick > REPLIES_PER_HOST_TICK {
            self.replies_since_host_tick = 0;
            let peer_nanos = interval.middle().as_nanos().max(0);
            sink(CodecEvent::ClockReply { from: self.brick, sent: interval.sent, peer_nanos });
        }
    }

    fn handle_mailbox(&mut self, status: NxtStatus, sink: CodecEventSink<'_>) {
        self.mailbox.record_probe_reply(status);
        if status == NxtStatus::OK {
            self.last_texts.remove(&StatusTopic::Program);
            return;
        }
        let text = format!("the NXT takes no estimate: {}", status.meaning());
        self.report(StatusTopic::Program, NOTICE, text, sink);
    }

    fn handle_rejection(&mut self, request: &NxtRequest, status: NxtStatus, sink: CodecEventSink<'_>) {
        if let NxtRequest::Digital(port) = request {
            if let Some(device) = device_at(&mut self.devices, *port) {
                device.keep_waiting();
            }
            if status == NxtStatus::PENDING {
                return;
            }
        }
        let (topic, what) = match request {
            NxtRequest::Battery => {
                // Told once it is not asked any more.
                self.handle_failure(request, RequestFailure::Rejected, sink);
                return;
            }
            NxtRequest::SetUp { port, .. } | NxtRequest::Analog(port) | NxtRequest::Digital(port) => {
                (StatusTopic::Port(*port), format!("sensor port {}", port + 1))
            }
            NxtRequest::Motor(port) => (StatusTopic::Motors, format!("motor port {port:?}")),
            NxtRequest::IoMap(_) => (StatusTopic::IoMaps, "reading an IO map".to_owned()),
            NxtRequest::SyncBarrier | NxtRequest::Mailbox(_) => (StatusTopic::Firmware, "the NXT".to_owned()),
        };
        let text = format!("{what}: {} (status {:02X})", status.meaning(), status.0);
        self.report(topic, WARNING, text, sink);
        self.handle_failure(request, RequestFailure::Rejected, sink);
    }

    fn handle_version(&mut self, reply: &NxtReply<'_>, sink: CodecEventSink<'_>) {
        if let Some([_, _, minor, major]) = bytes_at(reply.values, 0) {
            let text = format!("LEGO NXT with firmware {major}.{minor:02}");
            self.report(StatusTopic::Firmware, INFO, text, sink);
        }
    }

    fn handle_battery(&self, reply: &NxtReply<'_>, sink: CodecEventSink<'_>) {
        let Some(millivolts) = bytes_at(reply.values, 0).map(u16::from_le_bytes) else {
            return;
        };
        match plausible_battery(f64::from(millivolts) / 1e3) {
            Some(battery) => self.emit_message(Message::BatteryStatus(battery), sink),
            None => sink(CodecEvent::Error(ReceiveError::Payload { message_id: u32::from(reply.opcode) })),
        }
    }

    fn handle_io_map(
        &mut self,
        window: IoMapWindow,
        reply: &NxtReply<'_>,
        interval: RequestInterval,
        sink: CodecEventSink<'_>,
    ) {
        let Some(cutout) = IoMapData::from_reply(window, reply) else {
            return;
        };
        match window.module {
            FirmwareModule::Command if window == TICK => {
                if let Some(millis) = cutout.tick_millis() {
                    self.handle_tick(millis, interval, sink);
                }
            }
            FirmwareModule::Command => {}
            FirmwareModule::Output => {
                for port in MotorPort::ALL {
                    if let Some(count) = cutout.count(port.number()) {
                        self.motors.push(port, count, interval);
                    }
                }
                self.handle_wheels(sink);
            }
            FirmwareModule::Input => {
                for port in 0..4 {
                    if let Some(input) = cutout.input(port) {
                        self.handle_input(port, input, interval, sink);
                    }
                }
            }
            FirmwareModule::LowSpeed => {
                for port in 0..4 {
                    self.check_buffer(port, &cutout, interval.answered, sink);
                }
            }
        }
    }

    fn handle_tick(&mut self, millis: u32, interval: RequestInterval, sink: CodecEventSink<'_>) {
        if self.clock.push(millis, interval.middle()) == TickAdvance::Restarted {
            self.report(StatusTopic::Clock, NOTICE, "the NXT was switched off and on", sink);
            self.last_texts.remove(&StatusTopic::Clock);
            self.totals.brick_restarted();
            self.schedule.set_up_again();
            self.mailbox.reset();
        }
        let peer_nanos = i64::from(millis) * 1_000_000;
        sink(CodecEvent::ClockReply { from: self.brick, sent: interval.sent, peer_nanos });
    }

    fn handle_wheels(&mut self, sink: CodecEventSink<'_>) {
        let (left, right) = (self.settings.left_motor, self.settings.right_motor);
        let Some(both) = self.motors.take_pair(left.port, right.port) else {
            return;
        };
        let totals = match self.totals.push(&both) {
            CounterUpdate::Total(totals) => totals,
            CounterUpdate::Rebased(totals) => {
                // A program began or ended: the ports are as it left them, and the brick may even be another.
                let text = "the NXT's counters began anew: a program was started or stopped";
                self.report(StatusTopic::Motors, NOTICE, text, sink);
                self.last_texts.remove(&StatusTopic::Motors);
                self.schedule.set_up_again();
                self.schedule.request_tick();
                totals
            }
            CounterUpdate::Rejected => {
                let message_id = FirmwareModule::Output.id();
                sink(CodecEvent::Error(ReceiveError::Payload { message_id }));
                return;
            }
        };
        let [left_total, right_total] = totals.map(EncoderTicks);
        let ticks = WheelTicks {
            stamp: both.interval.stamp(),
            left: apply_mounting(left_total, left.mounting),
            right: apply_mounting(right_total, right.mounting),
        };
        self.emit_message(Message::WheelTicks(ticks), sink);
    }

    fn complete_set_up(&mut self, port: u8, now: Timestamp<HostClock>) {
        if let Some(state) = self.schedule.ports.get_mut(usize::from(port)) {
            *state = PortState::Settling;
        }
        if let Some(device) = device_at(&mut self.devices, port) {
            device.restart(now);
        }
    }

    fn handle_input(&mut self, port: u8, input: AnalogInput, interval: RequestInterval, sink: CodecEventSink<'_>) {
        let Some(state) = self.schedule.ports.get_mut(usize::from(port)) else {
            return;
        };
        match state {
            // A program has begun that does not know the sensor.
            PortState::Ready if input.kind == NO_SENSOR => {
                *state = PortState::Unconfigured;
                return;
            }
            PortState::Settling if input.is_valid => *state = PortState::Ready,
            PortState::Ready if input.is_valid => {}
            PortState::Unused
            | PortState::Unconfigured
            | PortState::Configuring
            | PortState::Settling
            | PortState::Ready => return,
        }
        self.handle_gyro(port, input.raw, interval, sink);
    }

    fn handle_gyro(&mut self, port: u8, raw: u16, interval: RequestInterval, sink: CodecEventSink<'_>) {
        let wheels = self.motors.wheel_state(interval.answered);
        let Some((_, gyro)) = self.gyro.as_mut().filter(|(at, _)| *at == port) else {
            return;
        };
        let (turning, taught) = gyro.push(interval.answered, raw, wheels);
        let number = port + 1;
        match taught {
            RestUpdate::Unchanged => {}
            RestUpdate::First(rest) => {
                let text = format!("the gyro at port {number} reads {rest:.1} at rest");
                self.report(StatusTopic::Gyro, INFO, text, sink);
            }
            RestUpdate::Corrected(rest) => {
                let text = format!(
                    "the gyro at port {number} reads {rest:.1} at rest, as three calm seconds say; what was learnt before was a turn, or it has drifted"
                );
                self.report(StatusTopic::Gyro, NOTICE, text, sink);
            }
        }
        match turning {
            GyroReadout::Unknown => {}
            GyroReadout::RestTimeout => {
                let text = format!(
                    "the gyro at port {number} is not used yet: let the robot stand for two seconds, or set gyro_rest"
                );
                self.report(StatusTopic::Gyro, WARNING, text, sink);
            }
            GyroReadout::Disconnected => {
                let text = format!("sensor port {number} reads as empty: is the gyro plugged in?");
                self.report(StatusTopic::Port(port), WARNING, text, sink);
            }
            GyroReadout::Rate(turn_rate) => {
                self.last_texts.remove(&StatusTopic::Port(port));
                let inertial = Inertial { turn_rate: Some(turn_rate), ..Inertial::empty(interval.stamp()) };
                self.emit_message(Message::Inertial(inertial), sink);
            }
        }
    }

    fn check_buffer(&mut self, port: u8, cutout: &IoMapData<'_>, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        let Some(device) = device_at(&mut self.devices, port) else {
            return;
        };
        let (Some(written), Some(buffer)) = (device.pending_since(), cutout.buffer(port)) else {
            return;
        };
        let measured = device.read_ring(buffer);
        self.handle_measurement(port, measured, RequestInterval { sent: written, answered: now }, sink);
    }

    fn handle_digital(&mut self, port: u8, reply: &NxtReply<'_>, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        let Some(device) = device_at(&mut self.devices, port) else {
            return;
        };
        let (Some(written), Some([length]), Some(data)) =
            (device.pending_since(), bytes_at(reply.values, 0), bytes_at(reply.values, 1))
        else {
            return;
        };
        let measured = device.read_fetched(length, data);
        self.handle_measurement(port, measured, RequestInterval { sent: written, answered: now }, sink);
    }

    fn handle_measurement(
        &mut self,
        port: u8,
        measured: Option<DigitalMeasurement>,
        interval: RequestInterval,
        sink: CodecEventSink<'_>,
    ) {
        let Some(measured) = measured else {
            let is_silent = device_at(&mut self.devices, port).is_some_and(|device| device.is_silent());
            if is_silent {
                // A program may have set up the port for something else.
                if let Some(state) = self.schedule.ports.get_mut(usize::from(port)) {
                    *state = PortState::Unconfigured;
                }
                let text = format!(
                    "sensor port {}: the sensor does not answer; is it plugged in, and is it the configured one?",
                    port + 1
                );
                self.report(StatusTopic::Port(port), WARNING, text, sink);
            }
            return;
        };
        self.last_texts.remove(&StatusTopic::Port(port));
        let stamp = interval.stamp();
        let message = match measured {
            DigitalMeasurement::NoEcho => return,
            DigitalMeasurement::Range(range) => Message::DistanceSensor { stamp, range, sigma: None },
            DigitalMeasurement::Temperature(temperature) => Message::Thermometer {
                stamp,
                channel: ChannelName::from_bytes(&[b't', b'e', b'm', b'p', b'1' + port]),
                temperature,
            },
            DigitalMeasurement::CompassDegrees(degrees) => {
                // Clockwise on the device, counter-clockwise here.
                let turned_deg = self.settings.compass_zero_deg - degrees;
                Message::Compass { stamp, heading: Heading::from_rad(turned_deg.to_radians()) }
            }
            DigitalMeasurement::Acceleration(along) => {
                let Some(message) = self.acceleration_message(port, along, interval) else {
                    return;
                };
                message
            }
        };
        self.emit_message(message, sink);
    }

    /// Emits both wheels' accelerations once both are known; one at the centre at once.
    fn acceleration_message(
        &mut self,
        port: u8,
        along: MetersPerSecondSquared,
        interval: RequestInterval,
    ) -> Option<Message> {
        let sensor = self.settings.sensors.get(usize::from(port)).copied();
        let Some(NxtSensor::HtAccelerometer { place, .. }) = sensor else {
            return None;
        };
        match place {
            AccelerometerMounting::Centre => {
                return Some(Message::Imu(PlanarImu {
                    message: ImuMessage::Scaled,
                    stamp: interval.stamp(),
                    turn_rate: None,
                    forward_acceleration: Some(along),
                }));
            }
            AccelerometerMounting::Left => self.accelerations.left = Some(AccelerationReading { along, interval }),
            AccelerometerMounting::Right => self.accelerations.right = Some(AccelerationReading { along, interval }),
        }
        let (left, right) = (self.accelerations.left?, self.accelerations.right?);
        self.accelerations = PendingAccelerations::default();
        let stamp = left.interval.union(right.interval).stamp();
        let wheel_accelerations = Some((left.along, right.along));
        Some(Message::Inertial(Inertial { wheel_accelerations, ..Inertial::empty(stamp) }))
    }

    fn emit_message(&self, message: Message, sink: CodecEventSink<'_>) {
        let from = self.brick;
        sink(CodecEvent::Message { from, message });
    }
}

fn device_at(devices: &mut [Option<DigitalSensor>; 4], port: u8) -> Option<&mut DigitalSensor> {
    devices.get_mut(usize::from(port))?.as_mut()
}

/// GETINPUTVALUES: port, valid, calibrated, type, mode, raw.
fn input_of(reply: &NxtReply<'_>) -> Option<AnalogInput> {
    let [_, valid, _, kind, _] = bytes_at(reply.values, 0)?;
    Some(AnalogInput { raw: u16::from_le_bytes(bytes_at(reply.values, 5)?), kind, is_valid: valid != 0 })
}

const fn apply_mounting(total: EncoderTicks, mounting: MotorMounting) -> EncoderTicks {
    match mounting {
        MotorMounting::Forward => total,
        MotorMounting::Backward => EncoderTicks(-total.0),
    }
}
