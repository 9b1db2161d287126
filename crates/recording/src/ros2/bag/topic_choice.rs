//! Chooses which topics of a bag become which sensors of the robot, by their types, names and first messages, and writes the choice down as
//! a descriptor of a foreign recording. To choose otherwise, write a descriptor.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::sensor_messages::SensorType;
use super::summary::{BagSummary, TopicSummary, ValueFacts};

/// Whether the radii of the robot's wheels are known: without them wheel angles cannot be converted to distances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WheelGeometry {
    Known,
    Unknown,
}

/// The bag has nothing of use.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no topic of the bag can be taken; there are: {0}")]
pub struct BagPlanError(String);

/// What is taken of a bag.
#[derive(Clone, Debug, PartialEq)]
pub struct BagPlan {
    /// As a descriptor of a foreign recording.
    pub descriptor: String,
    /// What was taken and what was left, in words.
    pub report: Vec<String>,
    /// UTC of the zero of the descriptor's times; 0 if its times are not UTC.
    pub utc_start_micros: u64,
}

/// Stamps that differ more from the log times are of another clock: a simulation's, or none.
const MAX_CLOCK_DIFFERENCE_NANOS: u64 = 3_600 * 1_000_000_000;
/// Length of the gravity that an accelerometer measures, at least; m/s².
const LEAST_GRAVITY: f64 = 5.0;
/// Share of the gravity that lies along the vertical axis of a sensor that is mounted straight: 26 degrees.
const LEAST_SHARE: f64 = 0.9;
/// Topics that the report lists by name.
const MAX_LISTED: usize = 40;
/// In the names of topics with places where a robot shall go, or start.
const GOALS: &[&str] = &["goal", "initialpose", "plan", "waypoint", "target", "setpoint", "cmd"];

impl BagPlan {
    /// `path` is the bag as the descriptor names it.
    ///
    /// # Errors
    /// No topic can be taken.
    pub fn new(summary: &BagSummary, name: &str, path: &str, geometry: WheelGeometry) -> Result<Self, BagPlanError> {
        let mut planner = Planner::new(geometry);
        planner.choose(summary);
        if planner.taken.is_empty() {
            return Err(BagPlanError(listed(&planner.left)));
        }
        let (is_utc, zero_s) = planner.times();
        let arrival = if is_utc { "" } else { "arrival = { column = \"stamp_ns\", unit = \"ns\" }\n" };
        let mut text = format!(
            "name = {name}\nsource = {path}\nlicence = \"that of the bag\"\ndefault_run = {name}\n\n[[runs]]\nname = {name}\n\
             values = {{ bag = {path} }}\n",
            // Braces in a name would be filled in.
            name = quoted(&name.replace(['{', '}'], "_")),
            path = quoted(path)
        );
        text.push_str(planner.start());
        for (number, stream) in planner.taken.iter().enumerate() {
            let topic = quoted(&stream.topic.name);
            // A sender without a clock of its own leaves all stamps at zero.
            let time =
                if stream.topic.facts.has_stamps { "" } else { "time = { column = \"log_ns\", unit = \"ns\" }\n" };
            let joints = match &stream.topic.facts.joints {
                Some(names) => format!("joints = {}\n", toml::Value::from(names.to_vec())),
                None => String::new(),
            };
            _ = write!(
                text,
                "\n[files.topic_{number}]\npath = \"{{bag}}\"\ntopic = {topic}\n{joints}{time}{arrival}offset_s = {offset}\n\n[[{key}]]\n\
                 file = \"topic_{number}\"\n{columns}",
                offset = zero_s.checked_neg().unwrap_or(0),
                key = stream.key,
                columns = stream.columns,
            );
        }
        let taken: Vec<String> =
            planner.taken.iter().map(|stream| format!("{}: {}", counted(stream.topic), stream.what)).collect();
        let mut report = vec![format!("took {}", taken.join("; "))];
        if !planner.left.is_empty() {
            report.push(format!("left {}", listed(&planner.left)));
        }
        let utc_start_micros = if is_utc { u64::try_from(zero_s).unwrap_or(0).saturating_mul(1_000_000) } else { 0 };
        Ok(Self { descriptor: text, report, utc_start_micros })
    }
}

/// A topic that is taken, as a stream of the descriptor.
struct TakenTopic<'a> {
    topic: &'a TopicSummary,
    /// The section of the stream in the descriptor, such as `gyro`.
    key: &'static str,
    /// The keys and values of that section.
    columns: String,
    /// The description for the report.
    what: String,
}

struct Planner<'a> {
    geometry: WheelGeometry,
    taken: Vec<TakenTopic<'a>>,
    /// Topics that are not taken, with the reason; empty for a type that no sensor has.
    left: Vec<(&'a TopicSummary, String)>,
    /// The first part of the name of each topic that could be taken.
    first_parts: Vec<&'a str>,
    /// The topics with a motion differ in the first part of their names.
    has_several_robots: bool,
    /// The part before the last slash of the topic with the motion, with that slash.
    robot: Option<&'a str>,
}

impl<'a> Planner<'a> {
    const fn new(geometry: WheelGeometry) -> Self {
        Self {
            geometry,
            taken: Vec::new(),
            left: Vec::new(),
            first_parts: Vec::new(),
            has_several_robots: false,
            robot: None,
        }
    }

    fn choose(&mut self, summary: &'a BagSummary) {
        let [mut odometry, mut joints, mut imus, mut poses, mut uncertain_poses, mut scans, mut truths] =
            [const { Vec::new() }; 7];
        for topic in &summary.topics {
            let sensor = match (topic.sensor, &topic.refusal) {
                (Some(sensor), _) if topic.rows > 0 => sensor,
                (Some(_), _) => {
                    self.left.push((topic, "no message that can be used".to_owned()));
                    continue;
                }
                (None, refusal) => {
                    self.left.push((topic, refusal.clone().unwrap_or_default()));
                    continue;
                }
            };
            self.first_parts.extend(first_part(&topic.name));
            let is_truth = last_part(&topic.name).contains("truth") || topic.name.contains("ground_truth");
            let topics = match sensor {
                SensorType::Odometry | SensorType::PoseStamped | SensorType::PoseWithCovarianceStamped if is_truth => {
                    &mut truths
                }
                SensorType::Odometry => &mut odometry,
                SensorType::JointState => &mut joints,
                SensorType::Imu => &mut imus,
                SensorType::PoseStamped => &mut poses,
                SensorType::PoseWithCovarianceStamped => &mut uncertain_poses,
                SensorType::LaserScan => &mut scans,
            };
            topics.push(topic);
        }
        let motions = odometry.iter().chain(&joints).filter_map(|topic| first_part(&topic.name));
        self.has_several_robots = motions.collect::<BTreeSet<_>>().len() > 1;
        self.choose_motion(odometry, joints);
        self.choose_one(imus, gyro_stream);
        for topic in poses.into_iter().chain(uncertain_poses) {
            self.choose_fixes(topic);
        }
        self.choose_one(scans, |topic| {
            Ok(stream(topic, "wall_range", "range = \"range_m\"\n", "range straight ahead"))
        });
        self.choose_one(truths, |topic| {
            let columns = "x = \"x_m\"\ny = \"y_m\"\nheading = \"heading_rad\"\n";
            Ok(stream(topic, "truth", columns, "truth, for scores only"))
        });
    }

    /// Wheels if their radii are known, else an odometer: it has counted the same wheels.
    fn choose_motion(&mut self, mut odometry: Vec<&'a TopicSummary>, joints: Vec<&'a TopicSummary>) {
        let mut has_wheels = false;
        for topic in joints {
            let why = match (&topic.facts.joints, self.geometry) {
                (Some([left, right]), WheelGeometry::Known) if !has_wheels => {
                    has_wheels = true;
                    let what = format!("angles of the wheels {left} and {right}");
                    let columns = "counting = \"absolute\"\nleft = { column = \"left_rad\", unit = \"rad\" }\n\
                        right = { column = \"right_rad\", unit = \"rad\" }\n";
                    self.take(TakenTopic { topic, key: "wheels", columns: columns.to_owned(), what });
                    continue;
                }
                (Some(_), WheelGeometry::Known) => "other wheels were taken",
                (_, WheelGeometry::Unknown) => {
                    "the radii and the track of the wheels are not known: --robot FILE.toml, or --set left_wheel_radius_m=.. and so on"
                }
                (None, WheelGeometry::Known) => "no two joints with left and right in their names",
            };
            self.left.push((topic, why.to_owned()));
        }
        // Prefer the driver's odometry, named `odom`, to that of filters.
        odometry.sort_by_key(|topic| (last_part(&topic.name) != "odom", std::cmp::Reverse(topic.rows)));
        for topic in odometry {
            if has_wheels {
                self.left.push((topic, "the wheels were taken".to_owned()));
            } else if self.robot.is_some() {
                self.left.push((topic, "another odometry was taken".to_owned()));
            } else {
                self.take(odometer_stream(topic));
            }
        }
    }

    fn choose_fixes(&mut self, topic: &'a TopicSummary) {
        let name = last_part(&topic.name).to_ascii_lowercase();
        if GOALS.iter().any(|goal| name.contains(goal)) {
            self.left.push((topic, "a goal or an initial pose, by its name".to_owned()));
        } else if self.is_of_another_robot(topic) {
            self.left.push((topic, "of another robot, by its name".to_owned()));
        } else {
            self.take(fix_stream(topic));
        }
    }

    /// The topic of the robot with the most messages.
    fn choose_one(
        &mut self,
        mut topics: Vec<&'a TopicSummary>,
        stream: impl Fn(&'a TopicSummary) -> Result<TakenTopic<'a>, String>,
    ) {
        topics.sort_by_key(|topic| std::cmp::Reverse(topic.rows));
        let mut is_taken = false;
        for topic in topics {
            let why = if self.is_of_another_robot(topic) {
                "of another robot, by its name".to_owned()
            } else if is_taken {
                "another one was taken".to_owned()
            } else {
                match stream(topic) {
                    Ok(taken) => {
                        self.take(taken);
                        is_taken = true;
                        continue;
                    }
                    Err(why) => why,
                }
            };
            self.left.push((topic, why));
        }
    }

    fn take(&mut self, stream: TakenTopic<'a>) {
        if matches!(stream.key, "wheels" | "odometer" | "body_velocity") {
            self.robot = Some(namespace(&stream.topic.name));
        }
        self.taken.push(stream);
    }

    /// Whether the topic with the motion is in the namespace of one robot, and this topic in another. The first part of a name is that of a robot
    /// where several topics have it, or where several motions differ in it; else it is that of a driver, as in `/imu/data`.
    fn is_of_another_robot(&self, topic: &TopicSummary) -> bool {
        let Some(robot) = self.robot.and_then(first_part) else {
            return false;
        };
        let topics = self.first_parts.iter().filter(|part| **part == robot).count();
        (topics > 1 || self.has_several_robots) && first_part(&topic.name).is_some_and(|part| part != robot)
    }

    /// Whether all times are UTC, and the zero of the times in seconds since 1970.
    fn times(&self) -> (bool, i64) {
        let facts = || self.taken.iter().map(|stream| &stream.topic.facts);
        let is_utc = facts().all(|facts| facts.time_nanos().abs_diff(facts.log_nanos) <= MAX_CLOCK_DIFFERENCE_NANOS);
        let first_nanos =
            facts().map(|facts| if is_utc { facts.time_nanos().min(facts.log_nanos) } else { facts.time_nanos() });
        (is_utc, first_nanos.min().unwrap_or(0).div_euclid(1_000_000_000))
    }

    /// Fixes place the robot; without them a truth does.
    fn start(&self) -> &'static str {
        let has = |key: &str| self.taken.iter().any(|stream| stream.key == key);
        if has("truth") && !has("fixes") {
            "\n[start]\nfrom = \"truth\"\nposition_sigma_m = 0.001\nheading_sigma_rad = 0.001\n"
        } else {
            ""
        }
    }
}

fn stream<'a>(topic: &'a TopicSummary, key: &'static str, columns: &str, what: &str) -> TakenTopic<'a> {
    TakenTopic { topic, key, columns: columns.to_owned(), what: what.to_owned() }
}

/// The steps of its pose, which lose nothing where messages are missing; the speeds where the pose stands still or jumps, as a filter's
/// does in `map`.
fn odometer_stream(topic: &TopicSummary) -> TakenTopic<'_> {
    let varies = |index: usize| topic.facts.values.get(index).is_some_and(|value| value.varies);
    let jumps = topic.facts.frame_changes || last_part(&topic.facts.frame) == "map";
    let has_speeds = varies(3) || varies(4);
    let has_steps = varies(0) || varies(1) || varies(2);
    if has_speeds && (jumps || !has_steps) {
        let columns = "forward = \"forward_m_per_s\"\nturn = \"turn_rad_per_s\"\ninterval = \"previous\"\n";
        stream(topic, "body_velocity", columns, "forward speed and turn rate")
    } else {
        let columns = "x = \"x_m\"\ny = \"y_m\"\nheading = \"heading_rad\"\n";
        stream(topic, "odometer", columns, "steps of its pose")
    }
}

fn fix_stream(topic: &TopicSummary) -> TakenTopic<'_> {
    let is_known = |index: usize| topic.facts.values.get(index).is_some_and(|value| value.is_always_positive);
    let position = "x = \"x_m\"\ny = \"y_m\"\nheading = \"heading_rad\"\n";
    if is_known(3) && is_known(4) && is_known(5) {
        let variances =
            "variance_x = \"var_x_m2\"\nvariance_y = \"var_y_m2\"\nvariance_heading = \"var_heading_rad2\"\n";
        stream(topic, "fixes", &format!("{position}{variances}"), "fixes with their covariance")
    } else {
        stream(topic, "fixes", position, "fixes with the configured noise")
    }
}

/// The turn rate about the vertical, which gravity shows.
fn gyro_stream(topic: &TopicSummary) -> Result<TakenTopic<'_>, String> {
    let sums = |from: usize| topic.facts.values.get(from..from + 3).map(|three| [three[0], three[1], three[2]]);
    let (Some(turn), Some(gravity)) = (sums(0), sums(3)) else {
        return Err("no turn rates".to_owned());
    };
    if !turn.iter().any(|value: &ValueFacts| value.varies) {
        return Err("its turn rates never change".to_owned());
    }
    let mean = gravity.map(|value| value.sum / topic.rows as f64);
    let length = mean.iter().map(|value| value * value).sum::<f64>().sqrt();
    let vertical = mean.iter().position(|value| value.abs() >= LEAST_SHARE * length);
    let (axis, sign, why) = match vertical {
        _ if length < LEAST_GRAVITY => (2, 1.0, ""),
        Some(axis) if (axis, mean[axis] > 0.0) == (2, true) => (2, 1.0, ""),
        Some(axis) => (axis, mean[axis].signum(), ": it is not mounted upright, gravity lies along this axis"),
        None => (2, 1.0, ": it is mounted askew, gravity lies along none of its axes"),
    };
    let (name, minus) = (["x", "y", "z"][axis], if sign < 0.0 { "-" } else { "" });
    let columns = format!("turn_rate = {{ column = \"turn_{name}_rad_per_s\", scale = {sign:?} }}\n");
    Ok(stream(topic, "gyro", &columns, &format!("turn rate about {minus}{name}{why}")))
}

/// The first part of a name of several.
fn first_part(name: &str) -> Option<&str> {
    name.trim_start_matches('/').split_once('/').map(|(first, _)| first)
}

fn last_part(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

fn namespace(name: &str) -> &str {
    name.rfind('/').and_then(|end| name.get(..=end)).unwrap_or("")
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

fn counted(topic: &TopicSummary) -> String {
    let kind = if topic.type_name.is_empty() { "unknown" } else { &topic.type_name };
    format!("{} ({} {})", topic.name, topic.messages, kind.replace("/msg/", "/"))
}

fn listed(left: &[(&TopicSummary, String)]) -> String {
    if left.is_empty() {
        return "none".to_owned();
    }
    let named = left.iter().take(MAX_LISTED).map(|(topic, why)| {
        let topic = counted(topic);
        if why.is_empty() { topic } else { format!("{topic}: {why}") }
    });
    let mut text = named.collect::<Vec<_>>().join("; ");
    if left.len() > MAX_LISTED {
        _ = write!(text, "; and {} more", left.len() - MAX_LISTED);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::bag_reader::Faults;
    use super::super::summary::TopicFacts;
    use super::*;

    /// The names of the topics that are taken of topics with ten messages each.
    fn taken(topics: &[(&str, SensorType)]) -> Vec<String> {
        let topics = topics.iter().map(|(name, sensor)| TopicSummary {
            name: (*name).to_owned(),
            messages: 10,
            rows: 10,
            sensor: Some(*sensor),
            facts: TopicFacts {
                values: vec![ValueFacts { varies: true, is_always_positive: true, first: 1.0, sum: 98.1 }; 8],
                ..TopicFacts::default()
            },
            type_name: String::new(),
            refusal: None,
            damaged: Faults::default(),
        });
        let topics: Vec<TopicSummary> = topics.collect();
        let mut planner = Planner::new(WheelGeometry::Unknown);
        let summary = BagSummary::of_topics(topics);
        planner.choose(&summary);
        planner.taken.iter().map(|stream| stream.topic.name.clone()).collect()
    }

    #[test]
    fn the_first_part_of_a_name_is_a_robot_where_topics_share_it() {
        use SensorType::{Imu, Odometry};
        assert_eq!(taken(&[("/diff_drive_controller/odom", Odometry), ("/imu/data", Imu)]).len(), 2);
        assert_eq!(taken(&[("/a/odom", Odometry), ("/b/odom", Odometry), ("/b/imu", Imu)]), ["/a/odom"]);
        let of_one = [("/a/odom", Odometry), ("/a/imu", Imu), ("/b/imu", Imu)];
        assert_eq!(taken(&of_one), ["/a/odom", "/a/imu"]);
    }
}
