//! The robot section of a configuration: geometry, noise, calibration, start, thermometers.

use anyhow::{Context, Result, ensure};
use posebridge_estimator::filters::thermometer::{ThermometerResponse, ThermometerSettings};
use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_station::{GoalPolicy, ThermometerConfig};
use posebridge_telemetry::{
    Calibration, ChannelName, DriveGeometry, Heading, Meters, Pose, Radians, SensorId, SensorNoise, StartPose, Wiring,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bricks::{Ev3Section, LineSection, NxtSection};
use super::calibration::{RobotCalibration, RobotNoise};
use super::lengths::{POSITION_SIGMA, TRACK_WIDTH, WHEEL_RADIUS, check_length};
use super::mounting::RobotMounting;
use super::sensor::SensorSection;
use super::wiring::RobotWiring;

/// A robot's geometry, noise and calibration; `[robot]` of a configuration, of a robot profile and of a recording's descriptor.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct RobotFile {
    /// Its name, for people.
    pub name: String,
    /// Radius of the left wheel.
    pub left_wheel_radius_m: f64,
    /// Radius of the right wheel.
    pub right_wheel_radius_m: f64,
    /// Distance between the wheels' contact points.
    pub track_width_m: f64,
    /// Encoder counts per turn of a wheel.
    pub ticks_per_turn: f64,
    /// Let the robot's own description, when it sends one, override this file.
    pub adopt_description: bool,
    /// Whether it drives to goals (SET_POSITION_TARGET_LOCAL_NED), and so along plans. Without the key the bricks of the built-in
    /// simulator do, and no others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accepts_goals: Option<bool>,
    /// The speeds of an autopilot's RPM message are those of the left and the right wheel, forward positive.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub rpm_is_wheels: bool,
    /// Noise of motion and sensors.
    pub noise: RobotNoise,
    /// Systematic errors, and how well they are known.
    pub calibration: RobotCalibration,
    /// Where its sensors sit.
    #[serde(skip_serializing_if = "is_at_mid_axle")]
    pub mounting: RobotMounting,
    /// What is connected or counted otherwise than by the conventions.
    #[serde(skip_serializing_if = "RobotWiring::is_conventional")]
    pub wiring: RobotWiring,
    /// Where it starts; without it the first fixes decide.
    pub start: Option<RobotStart>,
    /// A LEGO NXT's motors and sensors, for a link with brick = "nxt" or "nxt-push".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nxt: Option<NxtSection>,
    /// A LEGO EV3's motors and sensors, for a link with brick = "ev3".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ev3: Option<Ev3Section>,
    /// The lines of a board that prints, for a link with brick = "line" or "columns".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<LineSection>,
    /// What is known of the thermometers without a `[[robot.thermometer]]`; the file of --sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<SensorSection>,
    /// Its thermometers, as far as they are known.
    #[serde(rename = "thermometer", skip_serializing_if = "Vec::is_empty")]
    pub thermometers: Vec<RobotThermometer>,
}

/// Where a robot starts, and how well that is known.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct RobotStart {
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
    /// Counter-clockwise from east.
    pub heading_deg: f64,
    /// One standard deviation of x and of y.
    pub position_sigma_m: f64,
    /// One standard deviation of the heading.
    pub heading_sigma_deg: f64,
}

/// All sensors, so that a file need not say it.
fn is_at_mid_axle(mounting: &RobotMounting) -> bool {
    *mounting == RobotMounting::default()
}

impl Default for RobotFile {
    /// The LEGO NXT of the bundled scenarios: 56 mm wheels, 112 mm track, encoders of one degree.
    fn default() -> Self {
        Self {
            name: "nxt-56mm".to_owned(),
            left_wheel_radius_m: 0.028,
            right_wheel_radius_m: 0.028,
            track_width_m: 0.112,
            ticks_per_turn: 360.0,
            adopt_description: true,
            accepts_goals: None,
            rpm_is_wheels: false,
            noise: RobotNoise::default(),
            calibration: RobotCalibration::default(),
            mounting: RobotMounting::default(),
            wiring: RobotWiring::default(),
            start: None,
            nxt: None,
            ev3: None,
            line: None,
            sensor: None,
            thermometers: Vec::new(),
        }
    }
}

impl RobotFile {
    /// The protocol other than MAVLink of which it has a table; `None` without one or with several.
    pub fn described_brick(&self) -> Option<&'static str> {
        let text = self.line.as_ref().map(|line| if line.keys.is_empty() { "columns" } else { "line" });
        let tables =
            [("nxt", self.nxt.is_some()), ("ev3", self.ev3.is_some()), (text.unwrap_or("line"), text.is_some())];
        let mut described = tables.into_iter().filter_map(|(name, is_described)| is_described.then_some(name));
        described.next().filter(|_| described.next().is_none())
    }

    pub fn geometry(&self) -> Result<DriveGeometry> {
        for (key, value) in [
            ("left_wheel_radius_m", self.left_wheel_radius_m),
            ("right_wheel_radius_m", self.right_wheel_radius_m),
            ("track_width_m", self.track_width_m),
            ("ticks_per_turn", self.ticks_per_turn),
        ] {
            ensure!(value.is_finite() && value > 0.0, "`robot.{key}` is {value}, must be a positive number");
        }
        for (key, value_m, limits) in [
            ("left_wheel_radius_m", self.left_wheel_radius_m, WHEEL_RADIUS),
            ("right_wheel_radius_m", self.right_wheel_radius_m, WHEEL_RADIUS),
            ("track_width_m", self.track_width_m, TRACK_WIDTH),
        ] {
            check_length(&format!("robot.{key}"), value_m, &limits)?;
        }
        Ok(DriveGeometry {
            left_wheel_radius: Meters(self.left_wheel_radius_m),
            right_wheel_radius: Meters(self.right_wheel_radius_m),
            track_width: Meters(self.track_width_m),
            tick: Radians(std::f64::consts::TAU / self.ticks_per_turn),
        })
    }

    pub fn noise(&self) -> Result<SensorNoise> {
        self.noise.checked()
    }

    pub fn calibration(&self) -> Result<Calibration> {
        let calibration = self.calibration.checked(self.noise.gyro_bias_rad_per_s)?;
        Ok(Calibration { mountings: self.mounting.checked()?, ..calibration })
    }

    pub fn wiring(&self) -> Wiring {
        self.wiring.to_wiring()
    }

    pub fn start(&self) -> Result<Option<StartPose>> {
        let Some(start) = self.start else {
            return Ok(None);
        };
        for (key, value) in
            [("position_sigma_m", start.position_sigma_m), ("heading_sigma_deg", start.heading_sigma_deg)]
        {
            ensure!(value.is_finite() && value > 0.0, "`robot.start.{key}` is {value}, must be more than zero");
        }
        check_length("robot.start.position_sigma_m", start.position_sigma_m, &POSITION_SIGMA)?;
        let heading_sigma_deg = start.heading_sigma_deg;
        ensure!(
            heading_sigma_deg <= MAX_HEADING_SIGMA_DEG,
            "`robot.start.heading_sigma_deg` is {heading_sigma_deg}, must be at most {MAX_HEADING_SIGMA_DEG}: an unknown heading"
        );
        let heading = Heading::from_rad(start.heading_deg.to_radians());
        Ok(Some(StartPose {
            pose: Pose::new(Meters(start.x_m), Meters(start.y_m), heading),
            position_sigma_m: start.position_sigma_m,
            heading_sigma_rad: start.heading_sigma_deg.to_radians(),
        }))
    }

    pub fn goals(&self) -> GoalPolicy {
        match self.accepts_goals {
            None => GoalPolicy::ByLink,
            Some(true) => GoalPolicy::Accept,
            Some(false) => GoalPolicy::Refuse,
        }
    }

    pub fn slow_sensor(&self) -> Result<SlowSensor> {
        self.sensor.as_ref().map_or(Ok(SlowSensor::UNKNOWN), |sensor| sensor.checked().context("`robot.sensor`"))
    }

    /// Fails if a channel is named twice.
    pub(super) fn thermometers(&self) -> Result<Vec<ThermometerConfig>> {
        let mut known: Vec<ThermometerConfig> = Vec::with_capacity(self.thermometers.len());
        for (index, thermometer) in self.thermometers.iter().enumerate() {
            let config = thermometer.checked().with_context(|| format!("`robot.thermometer`, number {}", index + 1))?;
            ensure!(
                known.iter().all(|other| other.channel != config.channel),
                "`robot.thermometer` has the channel `{}` twice",
                thermometer.channel
            );
            known.push(config);
        }
        Ok(known)
    }

    /// Replaces the geometry, for instance by the one that the brick described.
    pub fn with_geometry(&self, geometry: &DriveGeometry) -> Self {
        Self {
            left_wheel_radius_m: geometry.left_wheel_radius.0,
            right_wheel_radius_m: geometry.right_wheel_radius.0,
            track_width_m: geometry.track_width.0,
            ticks_per_turn: std::f64::consts::TAU / geometry.tick.0,
            ..self.clone()
        }
    }
}

const MAX_HEADING_SIGMA_DEG: f64 = 180.0;

/// One thermometer. Those that are not listed are learnt from what they show.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct RobotThermometer {
    /// Its channel: `scaled_pressure`, or the name of a NAMED_VALUE_FLOAT, which begins with `temp`.
    pub channel: String,
    /// What is known of it, with its uncertainty; as `posebridge identify step --save` writes it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<SensorSection>,
    /// Its time constants, one for each lag, if they are exactly known: then the filter of paper 2 is used.
    #[serde(default)]
    pub lags_s: Vec<f64>,
    /// What it shows per degree, once it has settled.
    #[serde(default = "no_gain")]
    pub gain: f64,
    /// Noise of a reading, one standard deviation; 0 takes `robot.noise.temperature_k`.
    #[serde(default)]
    pub sigma_k: f64,
    /// The step between two values that it can show; 0 if fine.
    #[serde(default)]
    pub resolution_k: f64,
}

const fn no_gain() -> f64 {
    1.0
}

impl RobotThermometer {
    fn checked(&self) -> Result<ThermometerConfig> {
        let channel = ChannelName::from_bytes(self.channel.as_bytes());
        let is_spelled = channel.as_str() == self.channel;
        let is_known = self.channel == "scaled_pressure" || self.channel.starts_with("temp");
        ensure!(
            is_spelled && is_known,
            "`channel` is `{}`, must be scaled_pressure or a name of at most ten printable characters that begins with temp",
            self.channel
        );
        for (key, value) in [("sigma_k", self.sigma_k), ("resolution_k", self.resolution_k)] {
            ensure!(value.is_finite() && value >= 0.0, "`{key}` is {value}, must be zero or more");
        }
        let sensor = self.sensor.as_ref().map_or(Ok(SlowSensor::UNKNOWN), SensorSection::checked)?;
        let response = if self.lags_s.is_empty() {
            ensure!(self.gain == 1.0, "`gain` is {}, but without `lags_s` the gain must be 1", self.gain);
            ThermometerResponse::Uncertain(sensor.dynamics)
        } else {
            ensure!(self.sensor.is_none(), "`lags_s` are exact and `sensor` is uncertain: give one of them");
            let model = DynamicModel::empty()
                .with_lags(SensorId::THERMOMETER, self.gain, &self.lags_s)
                .context("`lags_s` and `gain`")?;
            ThermometerResponse::Exact(Box::new(model))
        };
        let or = |own: f64, of_sensor: f64| if own > 0.0 { own } else { of_sensor };
        Ok(ThermometerConfig {
            channel,
            settings: ThermometerSettings {
                response,
                sigma_k: or(self.sigma_k, sensor.noise),
                resolution_k: or(self.resolution_k, sensor.resolution),
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::config::load_text;

    fn thermometers(text: &str) -> anyhow::Result<usize> {
        let loaded = load_text("test", text, &[])?;
        Ok(loaded.config.station_config()?.robot.thermometers.len())
    }

    #[test]
    fn a_thermometer_may_be_known_in_part() {
        let text = "[[robot.thermometer]]\nchannel = \"temp1\"\nlags_s = [5.3, 22]\n\
                    [[robot.thermometer]]\nchannel = \"scaled_pressure\"\nresolution_k = 0.5\n";
        assert_eq!(thermometers(text).unwrap(), 2);
        assert_eq!(thermometers("").unwrap(), 0);
    }

    #[test]
    fn bricks_of_the_simulator_take_goals_and_a_link_without_mavlink_cannot() {
        let load = |text: &str| load_text("test", text, &[]).unwrap().config.station_config();
        let links = load("[[link]]\nurl = \"sim://square\"\n[[link]]\nurl = \"udp://:14550\"\n").unwrap().links;
        assert_eq!(links.iter().map(|link| link.robots_take_goals).collect::<Vec<_>>(), [true, false]);
        let nxt = "[[link]]\nurl = \"tcp://127.0.0.1:5000\"\nbrick = \"nxt\"\n";
        for (value, is_refused) in [("true", true), ("false", false)] {
            let config = load(&format!("{nxt}[robot]\naccepts_goals = {value}\n[robot.nxt]\nsensor = []\n"));
            assert_eq!(
                config.err().map(|error| error.to_string().contains("`robot.accepts_goals`")),
                is_refused.then_some(true)
            );
        }
    }
}
