//! What the brick's answers mean.

use posebridge_telemetry::{ChannelName, Defect, EncoderTicks, Heading, HostClock, MetersPerSecondSquared, Stamp};

use super::codec::Nxt;
use super::conversation::Asked;
use super::digital::{Device, Measured};
use super::gyro::{Taught, Turning};
use super::io_maps::{Cutout, Input, Module, TICK, Window};
use super::notes::{INFO, NOTICE, Topic, WARNING};
use super::plan::{Failure, Port};
use super::question::Question;
use super::settings::{AccelerometerPlace, MotorPort, Mounting, NxtSensor};
use super::status::Status;
use super::telegram::{Reply, bytes_at};
use super::tick::Ran;
use crate::bricks::Heard;
use crate::bricks::counters::Counted;
use crate::message::{Inertial, Message, PlanarImu, WheelTicks, WireStamp};

/// Answers between two instants of the station's clock, where the brick does not tell its own.
const BETWEEN_OWN_TICKS: u8 = 9;
/// Type of a port that is not set up.
const NO_SENSOR: u8 = 0;
/// Where a motor's count stands behind the status of GETOUTPUTSTATE: port, power, mode, regulation, turn ratio, run state, limit.
const COUNT_AT: usize = 10;

/// Between which instants something was looked up.
type Between = (Stamp<HostClock>, Stamp<HostClock>);
type Sink<'a> = &'a mut dyn FnMut(Heard<'_>);

const fn stamp_of((sent, answered): Between) -> WireStamp {
    WireStamp::Asked { sent, answered }
}

fn middle_of((sent, answered): Between) -> Stamp<HostClock> {
    Stamp::from_nanos(i64::midpoint(sent.as_nanos(), answered.as_nanos()))
}

impl Nxt {
    /// A question was answered.
    pub(super) fn answered(&mut self, now: Stamp<HostClock>, asked: &Asked, reply: &Reply<'_>, sink: Sink<'_>) {
        let between = (asked.sent, now);
        self.stand_in_for_clock(between, sink);
        if let Question::Mailbox(_) = asked.question {
            self.hear_mailbox(reply.status, sink);
            return;
        }
        if reply.status != Status::OK {
            self.refused(&asked.question, reply.status, sink);
            return;
        }
        self.plan.succeeded(&asked.question);
        match &asked.question {
            Question::Fence => {
                self.hear_version(reply, sink);
                // Something was disturbed, or began: the clock may be another.
                self.plan.want_tick();
            }
            Question::Map(window) => self.hear_map(*window, reply, between, sink),
            Question::Motor(port) => {
                if let Some(count) = bytes_at(reply.values, COUNT_AT) {
                    self.motors.take(*port, i32::from_le_bytes(count), between);
                    self.hear_wheels(sink);
                }
            }
            Question::Analog(port) => {
                if let Some(input) = input_of(reply) {
                    self.hear_input(*port, input, between, sink);
                }
            }
            Question::Digital(port) => self.hear_digital(*port, reply, now, sink),
            Question::SetUp { port, .. } => self.is_set_up(*port, now),
            Question::Mailbox(_) => {}
        }
    }

    /// A brick that does not tell its clock lives by the station's: then no stamp needs an alignment.
    fn stand_in_for_clock(&mut self, between: Between, sink: Sink<'_>) {
        if self.plan.has_tick() {
            self.since_own_tick = BETWEEN_OWN_TICKS;
            return;
        }
        self.since_own_tick += 1;
        if self.since_own_tick > BETWEEN_OWN_TICKS {
            self.since_own_tick = 0;
            sink(Heard::Time { from: self.brick, sent: between.0, peer_nanos: middle_of(between).as_nanos().max(0) });
        }
    }

    fn hear_mailbox(&mut self, status: Status, sink: Sink<'_>) {
        self.mailbox.answered(status);
        if status == Status::OK {
            self.notes.clear(Topic::Program);
            return;
        }
        let text = format!("the NXT takes no estimate: {}", status.meaning());
        self.note((Topic::Program, NOTICE), text, sink);
    }

    fn refused(&mut self, question: &Question, status: Status, sink: Sink<'_>) {
        if let Question::Digital(port) = question {
            if let Some(device) = device_at(&mut self.devices, *port) {
                device.wait_on();
            }
            if status == Status::PENDING {
                return;
            }
        }
        let (topic, what) = match question {
            Question::SetUp { port, .. } | Question::Analog(port) | Question::Digital(port) => {
                (Topic::Port(*port), format!("sensor port {}", port + 1))
            }
            Question::Motor(port) => (Topic::Motors, format!("motor port {port:?}")),
            Question::Map(_) => (Topic::Maps, "reading an IO map".to_owned()),
            Question::Fence | Question::Mailbox(_) => (Topic::Firmware, "the NXT".to_owned()),
        };
        let text = format!("{what}: {} (status {:02X})", status.meaning(), status.0);
        self.note((topic, WARNING), text, sink);
        self.fail(question, Failure::Refused, sink);
    }

    fn hear_version(&mut self, reply: &Reply<'_>, sink: Sink<'_>) {
        if let Some([_, _, minor, major]) = bytes_at(reply.values, 0) {
            let text = format!("LEGO NXT with firmware {major}.{minor:02}");
            self.note((Topic::Firmware, INFO), text, sink);
        }
    }

    fn hear_map(&mut self, window: Window, reply: &Reply<'_>, between: Between, sink: Sink<'_>) {
        let Some(cutout) = Cutout::of(window, reply) else {
            return;
        };
        match window.module {
            Module::Command if window == TICK => {
                if let Some(millis) = cutout.tick_millis() {
                    self.hear_tick(millis, between, sink);
                }
            }
            Module::Command => {}
            Module::Output => {
                for port in MotorPort::ALL {
                    if let Some(count) = cutout.count(port.number()) {
                        self.motors.take(port, count, between);
                    }
                }
                self.hear_wheels(sink);
            }
            Module::Input => {
                for port in 0..4 {
                    if let Some(input) = cutout.input(port) {
                        self.hear_input(port, input, between, sink);
                    }
                }
            }
            Module::LowSpeed => {
                for port in 0..4 {
                    self.look_at_buffer(port, &cutout, between.1, sink);
                }
            }
        }
    }

    fn hear_tick(&mut self, millis: u32, between: Between, sink: Sink<'_>) {
        if self.clock.take(millis, middle_of(between)) == Ran::Anew {
            self.note((Topic::Clock, NOTICE), "the NXT was switched off and on", sink);
            self.notes.clear(Topic::Clock);
            self.totals.brick_restarted();
            self.plan.set_up_again();
            self.mailbox.begin();
        }
        sink(Heard::Time { from: self.brick, sent: between.0, peer_nanos: i64::from(millis) * 1_000_000 });
    }

    fn hear_wheels(&mut self, sink: Sink<'_>) {
        let (left, right) = (self.settings.left_motor, self.settings.right_motor);
        let Some(both) = self.motors.both(left.port, right.port) else {
            return;
        };
        let between = (both.sent, both.answered);
        let totals = match self.totals.take(&both) {
            Counted::Total(totals) => totals,
            Counted::Rebased(totals) => {
                // A program began or ended: the ports are as it left them, and the brick may even be another.
                let text = "the NXT's counters began anew: a program was started or stopped";
                self.note((Topic::Motors, NOTICE), text, sink);
                self.notes.clear(Topic::Motors);
                self.plan.set_up_again();
                self.plan.want_tick();
                totals
            }
            Counted::Doubted => {
                let message_id = Module::Output.id();
                sink(Heard::Defect(Defect::Payload { message_id }));
                return;
            }
        };
        let [left_total, right_total] = totals.map(EncoderTicks);
        self.tell(
            Message::WheelTicks(WheelTicks {
                stamp: stamp_of(between),
                left: mounted(left_total, left.mounting),
                right: mounted(right_total, right.mounting),
            }),
            sink,
        );
    }

    fn is_set_up(&mut self, port: u8, now: Stamp<HostClock>) {
        if let Some(stands) = self.plan.ports.get_mut(usize::from(port)) {
            *stands = Port::Settling;
        }
        if let Some(device) = device_at(&mut self.devices, port) {
            device.begin(now);
        }
    }

    fn hear_input(&mut self, port: u8, input: Input, between: Between, sink: Sink<'_>) {
        let Some(stands) = self.plan.ports.get_mut(usize::from(port)) else {
            return;
        };
        match stands {
            // A program has begun that does not know the sensor.
            Port::Ready if input.kind == NO_SENSOR => {
                *stands = Port::Wanted;
                return;
            }
            Port::Settling if input.is_valid => *stands = Port::Ready,
            Port::Ready if input.is_valid => {}
            Port::Unused | Port::Wanted | Port::Told | Port::Settling | Port::Ready => return,
        }
        self.hear_gyro(port, input.raw, between, sink);
    }

    fn hear_gyro(&mut self, port: u8, raw: u16, between: Between, sink: Sink<'_>) {
        let wheels = self.motors.wheels(between.1);
        let Some((_, gyro)) = self.gyro.as_mut().filter(|(at, _)| *at == port) else {
            return;
        };
        let (turning, taught) = gyro.take(between.1, raw, wheels);
        let number = port + 1;
        match taught {
            Taught::Nothing => {}
            Taught::First(rest) => {
                let text = format!("the gyro at port {number} reads {rest:.1} at rest");
                self.note((Topic::Gyro, INFO), text, sink);
            }
            Taught::Other(rest) => {
                let text = format!(
                    "the gyro at port {number} reads {rest:.1} at rest, as three calm seconds say; what was learnt before was a turn, or it has drifted"
                );
                self.note((Topic::Gyro, NOTICE), text, sink);
            }
        }
        match turning {
            Turning::Unknown => {}
            Turning::Overdue => {
                let text = format!(
                    "the gyro at port {number} is not used yet: let the robot stand for two seconds, or set gyro_rest"
                );
                self.note((Topic::Gyro, WARNING), text, sink);
            }
            Turning::Empty => {
                let text = format!("sensor port {number} reads as empty: is the gyro plugged in?");
                self.note((Topic::Port(port), WARNING), text, sink);
            }
            Turning::Rate(turn_rate) => {
                self.notes.clear(Topic::Port(port));
                self.tell(
                    Message::Inertial(Inertial {
                        stamp: stamp_of(between),
                        turn_rate: Some(turn_rate),
                        turn: None,
                        wheel_accelerations: None,
                    }),
                    sink,
                );
            }
        }
    }

    fn look_at_buffer(&mut self, port: u8, cutout: &Cutout<'_>, now: Stamp<HostClock>, sink: Sink<'_>) {
        let Some(device) = device_at(&mut self.devices, port) else {
            return;
        };
        let (Some(written), Some(buffer)) = (device.asked(), cutout.buffer(port)) else {
            return;
        };
        let measured = device.look(buffer);
        self.hear_device(port, measured, (written, now), sink);
    }

    fn hear_digital(&mut self, port: u8, reply: &Reply<'_>, now: Stamp<HostClock>, sink: Sink<'_>) {
        let Some(device) = device_at(&mut self.devices, port) else {
            return;
        };
        let (Some(written), Some([said]), Some(data)) =
            (device.asked(), bytes_at(reply.values, 0), bytes_at(reply.values, 1))
        else {
            return;
        };
        let measured = device.fetched(said, data);
        self.hear_device(port, measured, (written, now), sink);
    }

    fn hear_device(&mut self, port: u8, measured: Option<Measured>, between: Between, sink: Sink<'_>) {
        let Some(measured) = measured else {
            let is_silent = device_at(&mut self.devices, port).is_some_and(|device| device.is_silent());
            if is_silent {
                // A program may have set up the port for something else.
                if let Some(stands) = self.plan.ports.get_mut(usize::from(port)) {
                    *stands = Port::Wanted;
                }
                let text = format!(
                    "sensor port {}: the sensor does not answer; is it plugged in, and is it the configured one?",
                    port + 1
                );
                self.note((Topic::Port(port), WARNING), text, sink);
            }
            return;
        };
        self.notes.clear(Topic::Port(port));
        let stamp = stamp_of(between);
        let message = match measured {
            Measured::NoEcho => return,
            Measured::Range(range) => Message::DistanceSensor { stamp, range, sigma: None },
            Measured::Temperature(temperature) => Message::Thermometer {
                stamp,
                channel: ChannelName::from_bytes(&[b't', b'e', b'm', b'p', b'1' + port]),
                temperature,
            },
            Measured::CompassDegrees(degrees) => {
                // Clockwise on the device, counter-clockwise here.
                let turned_deg = self.settings.compass_zero_deg - degrees;
                Message::Compass { stamp, heading: Heading::from_rad(turned_deg.to_radians()) }
            }
            Measured::Acceleration(along) => {
                let Some(message) = self.accelerated(port, along, between) else {
                    return;
                };
                message
            }
        };
        self.tell(message, sink);
    }

    /// Both wheels' accelerations once both are known; that of the middle at once.
    fn accelerated(&mut self, port: u8, along: MetersPerSecondSquared, between: Between) -> Option<Message> {
        let sensor = self.settings.sensors.get(usize::from(port)).copied();
        let Some(NxtSensor::HtAccelerometer { place, .. }) = sensor else {
            return None;
        };
        match place {
            AccelerometerPlace::Centre => {
                return Some(Message::ScaledImu(PlanarImu {
                    stamp: stamp_of(between),
                    turn_rate: None,
                    forward_acceleration: Some(along),
                }));
            }
            AccelerometerPlace::Left => self.accelerations.left = Some((along, between)),
            AccelerometerPlace::Right => self.accelerations.right = Some((along, between)),
        }
        let (left, right) = (self.accelerations.left?, self.accelerations.right?);
        self.accelerations = Accelerations::default();
        let between = (left.1.0.min(right.1.0), left.1.1.max(right.1.1));
        Some(Message::Inertial(Inertial {
            stamp: stamp_of(between),
            turn_rate: None,
            turn: None,
            wheel_accelerations: Some((left.0, right.0)),
        }))
    }

    fn tell(&self, message: Message, sink: Sink<'_>) {
        let from = self.brick;
        sink(Heard::Message { from, message });
    }
}

/// Accelerations at the wheels that wait for each other.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Accelerations {
    left: Option<(MetersPerSecondSquared, Between)>,
    right: Option<(MetersPerSecondSquared, Between)>,
}

fn device_at(devices: &mut [Option<Device>; 4], port: u8) -> Option<&mut Device> {
    devices.get_mut(usize::from(port))?.as_mut()
}

/// GETINPUTVALUES: port, valid, calibrated, type, mode, raw.
fn input_of(reply: &Reply<'_>) -> Option<Input> {
    let [_, valid, _, kind, _] = bytes_at(reply.values, 0)?;
    Some(Input { raw: u16::from_le_bytes(bytes_at(reply.values, 5)?), kind, is_valid: valid != 0 })
}

const fn mounted(total: EncoderTicks, mounting: Mounting) -> EncoderTicks {
    match mounting {
        Mounting::Forward => total,
        Mounting::Backward => EncoderTicks(-total.0),
    }
}
