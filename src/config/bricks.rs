//! Configuration of robots and cameras without MAVLink: `[robot.nxt]`, `[robot.ev3]`, `[robot.line]`, `[camera.json]`.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use posebridge_protocol::bricks::camera_json::CameraJsonSettings;
use posebridge_protocol::bricks::ev3::{
    DistanceKind, DistanceSettings, Ev3Settings, GyroMounting, GyroReading, GyroSettings, MotorDirection,
    MotorPort as Ev3MotorPort, SensorPort,
};
use posebridge_protocol::bricks::nxt::{
    AccelerometerMounting, ForwardAxis, GyroSign, MaxOutstanding, MotorMounting, MotorPort, NxtSensor, NxtSettings,
    WheelMotor,
};
use posebridge_protocol::bricks::text_line::{
    ChecksumPolicy, Column, LineLayout, QUANTITIES, Separator, TextLineSettings,
};
use posebridge_telemetry::TimeDelta;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One NXT. Without this section: left wheel at B, right wheel at C, no sensor.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct NxtSection {
    /// The left wheel's motor: A, B or C, with a minus in front if its count falls when the robot drives forward.
    pub left_motor: String,
    /// The right wheel's motor.
    pub right_motor: String,
    /// What is plugged in, one entry for each port.
    #[serde(rename = "sensor", skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<NxtSensorSection>,
    /// What the gyro reads at rest, in counts; without it that is learned while both wheels stand.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyro_rest: Option<f64>,
    /// The gyro reads more when the robot turns clockwise, seen from above: it hangs upside down.
    pub gyro_clockwise: bool,
    /// What the compass reads when the robot points along the arena's x axis.
    pub compass_zero_deg: f64,
    /// The mailbox that takes the estimate, 0 to 9.
    pub mailbox: u8,
    /// Shortest time between two estimates to the brick; without it 200 for `nxt-push`, whose radio each of them turns around, and 0 for `nxt`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimate_interval_ms: Option<u32>,
    /// How many questions may wait at the same time: 1, or 2 if a trial at connect shows that the brick answers both.
    pub outstanding: u8,
    /// Longest wait for an answer.
    pub answer_timeout_ms: u32,
}

/// A sensor of an NXT.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct NxtSensorSection {
    /// Its port, 1 to 4.
    pub port: u8,
    /// What it is.
    pub kind: NxtSensorKind,
    /// The axis of an accelerometer that points forward: x, -x, y, -y, z or -z.
    #[serde(default = "x_axis")]
    pub forward: String,
    /// Where an accelerometer sits.
    #[serde(default)]
    pub place: Place,
}

/// Which sensor.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum NxtSensorKind {
    /// HiTechnic gyro.
    HtGyro,
    /// HiTechnic accelerometer.
    HtAccelerometer,
    /// HiTechnic compass.
    HtCompass,
    /// LEGO's ultrasonic sensor, looking forward.
    Ultrasonic,
    /// LEGO's temperature sensor.
    Temperature,
}

/// Where an accelerometer sits.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Place {
    /// Above the left wheel.
    Left,
    /// Above the right wheel.
    Right,
    /// Between them.
    #[default]
    Centre,
}

fn x_axis() -> String {
    "x".to_owned()
}

impl Default for NxtSection {
    fn default() -> Self {
        Self {
            left_motor: "B".to_owned(),
            right_motor: "C".to_owned(),
            sensors: Vec::new(),
            gyro_rest: None,
            gyro_clockwise: false,
            compass_zero_deg: 0.0,
            mailbox: 0,
            estimate_interval_ms: None,
            outstanding: 1,
            answer_timeout_ms: 500,
        }
    }
}

impl NxtSection {
    pub(super) fn settings(&self) -> Result<NxtSettings> {
        let settings = NxtSettings {
            left_motor: wheel_motor(&self.left_motor).context("`left_motor`")?,
            right_motor: wheel_motor(&self.right_motor).context("`right_motor`")?,
            sensors: self.ports()?,
            gyro_rest_counts: self.gyro_rest,
            gyro_sign: if self.gyro_clockwise { GyroSign::Clockwise } else { GyroSign::CounterClockwise },
            compass_zero_deg: self.compass_zero_deg,
            mailbox: self.mailbox,
            estimate_interval: self.estimate_interval_ms.map(|millis| TimeDelta::from_millis(i64::from(millis))),
            outstanding: match self.outstanding {
                1 => MaxOutstanding::One,
                2 => MaxOutstanding::Two,
                other => bail!("`outstanding` is {other}, must be 1 or 2"),
            },
            answer_timeout: TimeDelta::from_millis(i64::from(self.answer_timeout_ms)),
        };
        settings.validate()?;
        Ok(settings)
    }

    fn ports(&self) -> Result<[NxtSensor; 4]> {
        let mut ports = [NxtSensor::None; 4];
        for (index, sensor) in self.sensors.iter().enumerate() {
            let number = index + 1;
            let slot = usize::from(sensor.port)
                .checked_sub(1)
                .and_then(|slot| ports.get_mut(slot))
                .with_context(|| format!("`sensor`, number {number}: `port` is {}, must be 1 to 4", sensor.port))?;
            ensure!(
                *slot == NxtSensor::None,
                "`sensor`, number {number}: there is a sensor at port {} already",
                sensor.port
            );
            *slot = sensor.sensor().with_context(|| format!("`sensor`, number {number}"))?;
        }
        Ok(ports)
    }
}

impl NxtSensorSection {
    fn sensor(&self) -> Result<NxtSensor> {
        Ok(match self.kind {
            NxtSensorKind::HtGyro => NxtSensor::HtGyro,
            NxtSensorKind::HtAccelerometer => NxtSensor::HtAccelerometer {
                forward: match self.forward.as_str() {
                    "x" => ForwardAxis::X,
                    "-x" => ForwardAxis::MinusX,
                    "y" => ForwardAxis::Y,
                    "-y" => ForwardAxis::MinusY,
                    "z" => ForwardAxis::Z,
                    "-z" => ForwardAxis::MinusZ,
                    other => bail!("`forward` is `{other}`, must be x, -x, y, -y, z or -z"),
                },
                place: match self.place {
                    Place::Left => AccelerometerMounting::Left,
                    Place::Right => AccelerometerMounting::Right,
                    Place::Centre => AccelerometerMounting::Centre,
                },
            },
            NxtSensorKind::HtCompass => NxtSensor::HtCompass,
            NxtSensorKind::Ultrasonic => NxtSensor::Ultrasonic,
            NxtSensorKind::Temperature => NxtSensor::Temperature,
        })
    }
}

fn wheel_motor(text: &str) -> Result<WheelMotor> {
    let (letter, mounting) = match text.strip_prefix('-') {
        Some(letter) => (letter, MotorMounting::Backward),
        None => (text, MotorMounting::Forward),
    };
    let port = match letter {
        "A" => MotorPort::A,
        "B" => MotorPort::B,
        "C" => MotorPort::C,
        _ => bail!("`{text}` is no motor: write A, B or C, or -A, -B or -C for one that is mounted backwards"),
    };
    Ok(WheelMotor { port, mounting })
}

/// One EV3. Without this section it is LEGO's Educator robot: motors B and C, gyro at port 2.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Ev3Section {
    /// The left wheel's motor, A to D.
    pub left_motor: String,
    /// The right wheel's motor, A to D.
    pub right_motor: String,
    /// Both counts fall when the robot drives forward: the motors are built in the other way round.
    pub motors_backward: bool,
    /// The gyro's port, 1 to 4; 0 if there is none.
    pub gyro_port: u8,
    /// Read the gyro's angle, too.
    pub gyro_angle: bool,
    /// The arrows on the gyro's case look down.
    pub gyro_upside_down: bool,
    /// The port of a sensor that looks straight ahead, 1 to 4; 0 if there is none.
    pub distance_port: u8,
    /// What that sensor is.
    pub distance_kind: Ev3Distance,
    /// Most telegrams per second, 0.1 to 50.
    pub rate_hz: f64,
    /// Most requests that may wait for their replies at once, 1 to 4.
    pub outstanding: u8,
    /// The mailbox of a program on the brick that gets the estimate; empty sends none.
    pub mailbox: String,
}

/// Which sensor looks straight ahead.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Ev3Distance {
    /// The EV3's ultrasonic sensor.
    #[default]
    Ultrasonic,
    /// The NXT's ultrasonic sensor.
    NxtUltrasonic,
    /// The EV3's infrared sensor.
    Infrared,
}

impl Default for Ev3Section {
    fn default() -> Self {
        Self {
            left_motor: "B".to_owned(),
            right_motor: "C".to_owned(),
            motors_backward: false,
            gyro_port: 2,
            gyro_angle: false,
            gyro_upside_down: false,
            distance_port: 0,
            distance_kind: Ev3Distance::default(),
            rate_hz: 50.0,
            outstanding: 1,
            mailbox: "estimate".to_owned(),
        }
    }
}

impl Ev3Section {
    pub(super) fn settings(&self) -> Result<Ev3Settings> {
        let left_motor = motor(&self.left_motor).context("`left_motor`")?;
        let right_motor = motor(&self.right_motor).context("`right_motor`")?;
        ensure!(left_motor != right_motor, "`left_motor` and `right_motor` are both {}", self.left_motor);
        ensure!((0.1..=50.0).contains(&self.rate_hz), "`rate_hz` is {}, must be 0.1 to 50", self.rate_hz);
        ensure!((1..=4).contains(&self.outstanding), "`outstanding` is {}, must be 1 to 4", self.outstanding);
        let gyro = sensor(self.gyro_port).context("`gyro_port`")?;
        let distance = sensor(self.distance_port).context("`distance_port`")?;
        if let (Some(gyro), Some(distance)) = (gyro, distance) {
            ensure!(gyro != distance, "`gyro_port` and `distance_port` are both {}", self.gyro_port);
        }
        Ok(Ev3Settings {
            left_motor,
            right_motor,
            motors: if self.motors_backward { MotorDirection::Backward } else { MotorDirection::Forward },
            gyro: gyro.map(|port| self.gyro(port)),
            distance: distance.map(|port| DistanceSettings {
                port,
                kind: match self.distance_kind {
                    Ev3Distance::Ultrasonic => DistanceKind::Ultrasonic,
                    Ev3Distance::NxtUltrasonic => DistanceKind::NxtUltrasonic,
                    Ev3Distance::Infrared => DistanceKind::Infrared,
                },
            }),
            rate_hz: self.rate_hz,
            outstanding: self.outstanding,
            mailbox: (!self.mailbox.is_empty()).then(|| self.mailbox.clone()),
        })
    }

    const fn gyro(&self, port: SensorPort) -> GyroSettings {
        GyroSettings {
            port,
            reading: if self.gyro_angle { GyroReading::RateAndAngle } else { GyroReading::Rate },
            mounting: if self.gyro_upside_down { GyroMounting::UpsideDown } else { GyroMounting::Upright },
        }
    }
}

fn motor(text: &str) -> Result<Ev3MotorPort> {
    Ok(match text {
        "A" => Ev3MotorPort::A,
        "B" => Ev3MotorPort::B,
        "C" => Ev3MotorPort::C,
        "D" => Ev3MotorPort::D,
        _ => bail!("`{text}` is no motor: write A, B, C or D"),
    })
}

fn sensor(printed: u8) -> Result<Option<SensorPort>> {
    if printed == 0 {
        return Ok(None);
    }
    let port = SensorPort::from_label(printed);
    Ok(Some(port.with_context(|| format!("{printed} is no port: 1 to 4, or 0 for none"))?))
}

/// Lines of text. Without this section they are CSV of time_ms, left_ticks and right_ticks.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct LineSection {
    /// CSV: what stands in each column, from left to right; a minus in front turns the sign.
    pub columns: Vec<String>,
    /// Pairs of a name and a value instead, such as t:123|l:45: what each name means.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub keys: BTreeMap<String, String>,
    /// What stands between columns or pairs: one of , ; | : = or a space; "words" is anything that is no number. A link with brick =
    /// "columns" takes the numbers, whatever this says.
    pub separator: String,
    /// What stands between a name and its value.
    pub key_separator: String,
    /// Lines must end with their checksum; without this it is checked where it stands.
    pub checksum_required: bool,
    /// Print the estimate to the board at most so often; 0 sends it nothing.
    pub estimate_interval_ms: u32,
    /// How old a line without a time may be when it arrives.
    pub delay_ms: u32,
    /// Of a column gyro_counts: what the gyro reads at one degree per second.
    pub gyro_counts_per_deg_per_s: f64,
}

impl Default for LineSection {
    fn default() -> Self {
        Self {
            columns: ["time_ms", "left_ticks", "right_ticks"].map(str::to_owned).into(),
            keys: BTreeMap::new(),
            separator: ",".to_owned(),
            key_separator: ":".to_owned(),
            checksum_required: false,
            estimate_interval_ms: 0,
            delay_ms: 40,
            gyro_counts_per_deg_per_s: TextLineSettings::default().gyro_counts_per_deg_per_s,
        }
    }
}

impl LineSection {
    pub(super) fn settings(&self) -> Result<TextLineSettings> {
        let separator = separator(&self.separator).context("`separator`")?;
        let layout = if self.keys.is_empty() {
            let columns = self.columns.iter().map(|name| column(name));
            LineLayout::Columns { columns: columns.collect::<Result<_>>().context("`columns`")?, separator }
        } else {
            ensure!(self.columns == Self::default().columns, "`keys` and `columns` are two layouts; give one of them");
            let keys = self.keys.iter().map(|(key, name)| {
                let is_plain = !key.is_empty() && key.chars().all(|c| c.is_ascii_graphic());
                ensure!(is_plain, "`{key}` is no name that a board can print");
                Ok((key.clone(), column(name)?))
            });
            LineLayout::Pairs {
                keys: keys.collect::<Result<_>>().context("`keys`")?,
                separator,
                key_separator: self::separator(&self.key_separator).context("`key_separator`")?,
            }
        };
        let settings = TextLineSettings {
            layout,
            checksum: if self.checksum_required { ChecksumPolicy::Required } else { ChecksumPolicy::Optional },
            estimate_interval: (self.estimate_interval_ms > 0)
                .then(|| TimeDelta::from_millis(i64::from(self.estimate_interval_ms))),
            delay: TimeDelta::from_millis(i64::from(self.delay_ms)),
            gyro_counts_per_deg_per_s: self.gyro_counts_per_deg_per_s,
        };
        settings.validate()?;
        Ok(settings)
    }
}

fn column(name: &str) -> Result<Column> {
    Column::from_name(name).with_context(|| {
        let known: Vec<&str> = QUANTITIES.iter().map(|(name, _)| *name).collect();
        format!("`{name}` is no quantity; there are: {}", known.join(", "))
    })
}

fn separator(text: &str) -> Result<Separator> {
    let Some(separator) = Separator::from_text(text) else {
        bail!("`{text}` separates nothing here; there are: , ; | : =, a space and words")
    };
    Ok(separator)
}

const LONGEST_DELAY_MS: f64 = 60_000.0;

/// Cameras that speak JSON.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct FixSection {
    /// How long before its arrival a fix was exposed that does not say when.
    pub delay_ms: f64,
    /// It may be so much more or less.
    pub delay_spread_ms: f64,
    /// Fixes that say a lower quality, in per cent, are left out.
    pub least_quality: f64,
}

impl Default for FixSection {
    fn default() -> Self {
        let usual = CameraJsonSettings::default();
        Self {
            delay_ms: usual.delay.as_millis_f64(),
            delay_spread_ms: usual.delay_spread.as_millis_f64(),
            least_quality: usual.min_quality,
        }
    }
}

impl FixSection {
    pub(super) fn settings(&self) -> Result<CameraJsonSettings> {
        for (key, value, most) in [
            ("delay_ms", self.delay_ms, LONGEST_DELAY_MS),
            ("delay_spread_ms", self.delay_spread_ms, LONGEST_DELAY_MS),
            ("least_quality", self.least_quality, 100.0),
        ] {
            ensure!((0.0..=most).contains(&value), "`{key}` is {value}, must lie between 0 and {most}");
        }
        Ok(CameraJsonSettings {
            delay: TimeDelta::from_secs_f64(self.delay_ms * 1e-3),
            delay_spread: TimeDelta::from_secs_f64(self.delay_spread_ms * 1e-3),
            min_quality: self.least_quality,
            ..CameraJsonSettings::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use serde::de::DeserializeOwned;

    use super::*;

    fn parsed<S: DeserializeOwned, T>(text: &str, settings: fn(&S) -> Result<T>) -> Result<T, String> {
        let section: S = toml::from_str(text).map_err(|error| error.to_string())?;
        settings(&section).map_err(|error| format!("{error:#}"))
    }

    fn nxt(text: &str) -> Result<NxtSettings, String> {
        parsed(text, NxtSection::settings)
    }

    fn ev3(text: &str) -> Result<Ev3Settings, String> {
        parsed(text, Ev3Section::settings)
    }

    fn line(text: &str) -> Result<TextLineSettings, String> {
        parsed(text, LineSection::settings)
    }

    fn camera(text: &str) -> Result<CameraJsonSettings, String> {
        parsed(text, FixSection::settings)
    }

    #[test]
    fn an_empty_section_is_the_codecs_default() {
        assert_eq!(nxt(""), Ok(NxtSettings::default()));
        assert_eq!(ev3(""), Ok(Ev3Settings::default()));
        assert_eq!(line(""), Ok(TextLineSettings::default()));
        assert_eq!(camera(""), Ok(CameraJsonSettings::default()));
    }

    #[test]
    fn keys_reach_the_codec() {
        let parsed = nxt(
            "left_motor = \"-A\"\nright_motor = \"B\"\ngyro_rest = 598.5\nsensor = [{ port = 2, kind = \"ht-gyro\" }, \
             { port = 3, kind = \"ht-accelerometer\", forward = \"-y\", place = \"left\" }]",
        )
        .unwrap();
        assert_eq!(parsed.left_motor, WheelMotor { port: MotorPort::A, mounting: MotorMounting::Backward });
        assert_eq!(parsed.sensors[1], NxtSensor::HtGyro);
        let accelerometer =
            NxtSensor::HtAccelerometer { forward: ForwardAxis::MinusY, place: AccelerometerMounting::Left };
        assert_eq!((parsed.sensors[2], parsed.gyro_rest_counts), (accelerometer, Some(598.5)));

        let parsed =
            ev3("left_motor = \"A\"\nright_motor = \"D\"\nmotors_backward = true\ngyro_port = 0\ndistance_port = 4\n\
             distance_kind = \"infrared\"\nmailbox = \"\"")
            .unwrap();
        assert_eq!((parsed.left_motor, parsed.right_motor), (Ev3MotorPort::A, Ev3MotorPort::D));
        assert_eq!((parsed.motors, parsed.gyro), (MotorDirection::Backward, None));
        assert_eq!(parsed.distance.map(|one| one.kind), Some(DistanceKind::Infrared));
        assert_eq!(parsed.mailbox, None);

        let parsed =
            line("separator = \"|\"\nkeys = { t = \"time_ms\", l = \"left_ticks\", r = \"-right_ticks\" }").unwrap();
        assert!(matches!(parsed.layout, LineLayout::Pairs { keys, separator: Separator::Pipe, .. } if keys.len() == 3));
        let parsed = line(
            "columns = [\"time_us\", \"ignore\", \"gyro_deg_per_s\"]\nseparator = \";\"\nchecksum_required = true",
        )
        .unwrap();
        assert_eq!(parsed.checksum, ChecksumPolicy::Required);
        assert!(matches!(parsed.layout, LineLayout::Columns { columns, .. } if columns.len() == 3));

        let parsed = camera("delay_ms = 150.5\nleast_quality = 40").unwrap();
        assert_eq!((parsed.delay, parsed.min_quality), (TimeDelta::from_micros(150_500), 40.0));
    }
}
