//! What is plugged in, and whether it is set up.
//!
//! Setting a mode makes the brick wait until the sensor has changed over, so it is done once and on its own: then an error says which port
//! it means. A sensor that is not there is asked for again now and then; the wheels do not wait for it.
//!
//! A firmware may also wait for a sensor that never comes, and answer nothing. Such a set-up costs the wheels' readings for as long as an answer is
//! waited for: it is tried again less and less often, and only while the wheels stand.

use posebridge_telemetry::{HostClock, Meters, Span, Stamp};

use super::bytecode::{DirectCommand, Mode};
use super::cycle::Included;
use super::settings::{DistanceKind, Ev3Settings, GyroReading, GyroSettings, SensorPort};

/// A sensor that is not there is asked for again after so long.
const AGAIN_AFTER: Span = Span::from_millis(10_000);
/// That time is doubled by each set-up in a row that was not answered, so often at most: five minutes.
const MOST_DOUBLINGS: u32 = 5;
/// A sensor that shows nothing for so long is held to be gone.
const GONE_AFTER: Span = Span::from_millis(2_000);
/// No distance: what the ultrasonic sensors show for it, and from where on.
const NO_ECHO_CM: f64 = 255.0;
/// The infrared sensor's proximity of 100 (LEGO's manual: about 70 cm), cm per step.
const INFRARED_CM: f64 = 0.7;
/// What the infrared sensor shows for nothing in sight.
const NOTHING_IN_SIGHT: f64 = 100.0;

/// What a sensor is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Gyro(GyroSettings),
    Distance(DistanceKind),
}

/// One sensor.
#[derive(Clone, Copy, Debug)]
struct Sensor {
    role: Role,
    port: SensorPort,
    state: State,
    /// Its absence was told.
    is_told: bool,
    /// Set-ups in a row that were not answered.
    unanswered: u32,
}

/// Whether the wheels stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wheels {
    Standing,
    Turning,
}

/// How a set-up failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Failed {
    /// The brick said at once that nothing is there.
    AtOnce,
    /// The brick said nothing.
    InSilence,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// To be set up when this instant has come.
    Awaited { from: Stamp<HostClock> },
    /// Set up; shows nothing since then.
    Ready { silent_since: Option<Stamp<HostClock>> },
}

/// The sensors of one brick, in the order of their values in an answer.
#[derive(Clone, Debug)]
pub(super) struct Sensors(Vec<Sensor>);

impl Sensors {
    pub(super) fn new(settings: &Ev3Settings, now: Stamp<HostClock>) -> Self {
        let gyro = settings.gyro.map(|gyro| (Role::Gyro(gyro), gyro.port));
        let distance = settings.distance.map(|distance| (Role::Distance(distance.kind), distance.port));
        let plugged = [gyro, distance].into_iter().flatten();
        let sensors = plugged.map(|(role, port)| Sensor {
            role,
            port,
            state: State::Awaited { from: now },
            is_told: false,
            unanswered: 0,
        });
        Self(sensors.collect())
    }

    /// The next sensor to be set up.
    pub(super) fn awaited(&self, now: Stamp<HostClock>, wheels: Wheels) -> Option<usize> {
        let is_due = |sensor: &Sensor| {
            matches!(sensor.state, State::Awaited { from } if from <= now)
                && (sensor.unanswered == 0 || wheels == Wheels::Standing)
        };
        self.0.iter().position(is_due)
    }

    /// When the next sensor is to be asked for again.
    pub(super) fn deadline(&self) -> Option<Stamp<HostClock>> {
        let from = self.0.iter().filter_map(|sensor| match sensor.state {
            State::Awaited { from } => Some(from),
            State::Ready { .. } => None,
        });
        from.min()
    }

    /// Writes the set-up of a sensor.
    pub(super) fn write_set_up(&self, index: usize, command: &mut DirectCommand) {
        if let Some(sensor) = self.0.get(index) {
            let mode = sensor.role.mode();
            command.wait_for(sensor.port, Some(mode), sensor.role.values());
        }
    }

    /// Writes the reading of all that are set up, and says which they are.
    pub(super) fn write_reading(&self, command: &mut DirectCommand) -> Included {
        let mut included = Included::default();
        for (sensor, slot) in self.0.iter().zip(&mut included.0) {
            if !matches!(sensor.state, State::Ready { .. }) {
                continue;
            }
            *slot = Some(sensor.role);
            match sensor.role.values() {
                1 => command.read_value(sensor.port),
                values => command.wait_for(sensor.port, None, values),
            }
        }
        included
    }

    /// A sensor was set up.
    pub(super) fn is_ready(&mut self, index: usize) {
        if let Some(sensor) = self.0.get_mut(index) {
            sensor.state = State::Ready { silent_since: None };
            sensor.is_told = false;
            sensor.unanswered = 0;
        }
    }

    /// A sensor could not be set up, or is gone: what people should know, once.
    pub(super) fn is_absent(&mut self, index: usize, now: Stamp<HostClock>, failed: Failed) -> Option<String> {
        let sensor = self.0.get_mut(index)?;
        sensor.unanswered = match failed {
            Failed::AtOnce => 0,
            Failed::InSilence => sensor.unanswered.saturating_add(1),
        };
        let doublings = sensor.unanswered.saturating_sub(1).min(MOST_DOUBLINGS);
        let from = now + Span::from_nanos(AGAIN_AFTER.as_nanos() << doublings);
        sensor.state = State::Awaited { from };
        let is_news = !std::mem::replace(&mut sensor.is_told, true);
        is_news.then(|| {
            format!(
                "the EV3 finds no {} at port {}; the wheels are read without it",
                sensor.role.name(),
                sensor.port.printed()
            )
        })
    }

    /// The brick would not read all of them together: each is set up anew, which tells the one that is missing.
    pub(super) fn are_in_doubt(&mut self, now: Stamp<HostClock>) {
        for sensor in &mut self.0 {
            sensor.state = State::Awaited { from: now };
        }
    }

    /// A sensor showed something, or nothing: what people should know if it is held to be gone.
    pub(super) fn showed(&mut self, index: usize, now: Stamp<HostClock>, values: &[f64]) -> Option<String> {
        let sensor = self.0.get_mut(index)?;
        let State::Ready { silent_since } = &mut sensor.state else {
            return None;
        };
        if values.iter().all(|value| value.is_finite()) {
            *silent_since = None;
            return None;
        }
        let since = *silent_since.get_or_insert(now);
        if now - since < GONE_AFTER {
            return None;
        }
        self.is_absent(index, now, Failed::AtOnce)
    }
}

impl Role {
    /// Type and mode (EV3 hardware developer kit; ev3dev's table of sensors).
    const fn mode(self) -> Mode {
        let (kind, mode) = match self {
            // GYRO-RATE, GYRO-G&A.
            Self::Gyro(GyroSettings { reading, .. }) => match reading {
                GyroReading::Rate => (32, 1),
                GyroReading::RateAndAngle => (32, 3),
            },
            // US-DIST-CM, NXT-US-CM, IR-PROX.
            Self::Distance(DistanceKind::Ultrasonic) => (30, 0),
            Self::Distance(DistanceKind::NxtUltrasonic) => (5, 0),
            Self::Distance(DistanceKind::Infrared) => (33, 0),
        };
        Mode { kind, mode }
    }

    /// How many values its mode has.
    pub(super) const fn values(self) -> u8 {
        match self {
            Self::Gyro(GyroSettings { reading: GyroReading::RateAndAngle, .. }) => 2,
            Self::Gyro(_) | Self::Distance(_) => 1,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Gyro(_) => "gyro",
            Self::Distance(DistanceKind::Ultrasonic) => "EV3 ultrasonic sensor",
            Self::Distance(DistanceKind::NxtUltrasonic) => "NXT ultrasonic sensor",
            Self::Distance(DistanceKind::Infrared) => "infrared sensor",
        }
    }
}

impl DistanceKind {
    /// The range that a value says, with its sigma as far as that is known; `None` if nothing is in sight.
    pub(super) fn range(self, value: f64) -> Option<(Meters, Option<Meters>)> {
        match self {
            Self::Ultrasonic | Self::NxtUltrasonic => {
                let is_echo = value > 0.0 && value < NO_ECHO_CM;
                is_echo.then_some((Meters(value / 100.0), None))
            }
            Self::Infrared => {
                let is_seen = (0.0..NOTHING_IN_SIGHT).contains(&value);
                // Half of the range at its end: the proximity depends on what is seen.
                let range_m = value * INFRARED_CM / 100.0;
                is_seen.then_some((Meters(range_m), Some(Meters(0.02 + 0.25 * range_m))))
            }
        }
    }
}
