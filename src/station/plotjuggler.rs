//! Sends events as JSON datagrams to PlotJuggler's UDP server (docs/dashboard.md).
//!
//! Input is the messages of the dashboard page through a channel that drops and counts ([`FrameTap`]). Sending a datagram never blocks,
//! and needs no receiver. A datagram is one event with its time: nested objects of numbers, which PlotJuggler plots as curves;
//! non-finite numbers are omitted. Units are SI and part of the names.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_dashboard::FrameTap;
use posebridge_dashboard::model::{
    ClockRow, ErrorsRow, EstimatePoint, Frame, FusionPoint, LinkRow, Number, TruthPoint,
};
use serde::{Serialize, Serializer};

/// Messages queued for the sender: a bit more than a second.
pub const WAITING_FRAMES: usize = 64;

/// A running sender; it ends with the station.
pub struct PlotJuggler {
    thread: JoinHandle<SendCounts>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SendCounts {
    pub datagrams: u64,
    /// Datagrams that the system rejected: its buffer was full, or the address is unreachable.
    pub dropped: u64,
    /// Messages of the station missed because this sender was slow.
    pub missed: u64,
}

impl PlotJuggler {
    pub fn start(address: SocketAddr, frames: FrameTap) -> Result<Self> {
        let socket =
            socket_for(address).with_context(|| format!("plotjuggler: opening a UDP socket to send to {address}"))?;
        let thread = std::thread::Builder::new()
            .name("plotjuggler".to_owned())
            .spawn(move || send_all(&socket, address, &frames))
            .context("starting PlotJuggler's thread")?;
        Ok(Self { thread })
    }

    /// Waits for the last datagram; call it after the station has ended.
    pub fn finish(self) -> Result<SendCounts> {
        let joined = self.thread.join();
        joined.map_err(|_panic| anyhow!("PlotJuggler's thread died"))
    }
}

/// A non-blocking socket; for a receiver on this computer it is bound to loopback.
fn socket_for(address: SocketAddr) -> std::io::Result<UdpSocket> {
    let any: IpAddr = match (address.ip().is_loopback(), address.is_ipv4()) {
        (true, true) => Ipv4Addr::LOCALHOST.into(),
        (true, false) => Ipv6Addr::LOCALHOST.into(),
        (false, true) => Ipv4Addr::UNSPECIFIED.into(),
        (false, false) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = UdpSocket::bind((any, 0))?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

fn send_all(socket: &UdpSocket, address: SocketAddr, frames: &FrameTap) -> SendCounts {
    let mut sent = SendCounts::default();
    while let Some(frame) = frames.recv() {
        send(socket, address, &frame, &mut sent);
    }
    sent.missed = frames.missed();
    sent
}

fn send(socket: &UdpSocket, address: SocketAddr, frame: &Frame, sent: &mut SendCounts) {
    for message in messages(frame) {
        // Not connected, so that a missing listener is no error.
        match socket.send_to(message.as_bytes(), address) {
            Ok(_) => sent.datagrams += 1,
            Err(_full_or_unreachable) => sent.dropped += 1,
        }
    }
}

/// A field of an object in a datagram.
struct PlotField<T> {
    name: &'static str,
    help: &'static str,
    read: fn(&T) -> Value,
}

const fn field<T>(name: &'static str, help: &'static str, read: fn(&T) -> Value) -> PlotField<T> {
    PlotField { name, help, read }
}

#[rustfmt::skip]
const ESTIMATE: &[PlotField<EstimatePoint>] = &[
    field("x_m", "estimate, east", |of| of.x_m.into()),
    field("y_m", "estimate, north", |of| of.y_m.into()),
    field("heading_rad", "counter-clockwise from east, in (-pi, pi]", |of| of.heading_rad.into()),
    field("heading_sigma_rad", "one standard deviation of it", |of| of.heading_sigma_rad.into()),
    field("ellipse_major_m", "half the longer axis of the ellipse that holds the position with 95 %", |of| of.major_m.into()),
    field("ellipse_minor_m", "half its shorter axis", |of| of.minor_m.into()),
    field("forward_m_per_s", "forward speed", |of| of.forward_m_per_s.into()),
    field("turn_rad_per_s", "turn rate, bias removed", |of| of.turn_rad_per_s.into()),
    field("fix_age_s", "time since the last fix that was used; absent before the first", |of| of.fix_age_s.into()),
    field("is_dead_reckoning", "1 when nothing absolute was used for too long", |of| Value::Count(of.is_dead_reckoning.into())),
    field("reset_counter", "counts jumps that are not motion", |of| Value::Count(of.reset_counter.into())),
];

#[rustfmt::skip]
const FUSION: &[PlotField<FusionPoint>] = &[
    field("nis", "normalised innovation squared; absent where nothing was predicted", |of| of.nis.into()),
    field("degrees_of_freedom", "of the NIS: its mean, if the filter is honest", |of| Value::Count(of.dof.into())),
    field("is_used", "1 when the observation was used, 0 when it was gated, too old or not wanted", |of| {
        Value::Count(matches!(&*of.verdict, "accepted" | "slip" | "reset to").into())
    }),
    field("lag_s", "how far behind the filter's time it was", |of| of.lag_s.into()),
];

/// Innovations and their standard deviations by component.
#[rustfmt::skip]
const COMPONENTS: &[(&str, &str, &str)] = &[
    ("forward_m", "fixes: observed minus predicted, along the robot", "one standard deviation of each innovation"),
    ("left_m", "fixes: to its left", "the same"),
    ("heading_rad", "fixes with a heading, and compasses", "the same"),
    ("turn_rad", "wheels: the gyro's turn minus theirs over a window", "the same"),
    ("range_m", "ranges to walls, beacons and landmarks", "the same"),
    ("bearing_rad", "bearings of landmarks", "the same"),
];

#[rustfmt::skip]
const TRUTH: &[PlotField<[Number; 3]>] = &[
    field("x_m", "where the simulated robot really is, east", |[x_m, ..]| (*x_m).into()),
    field("y_m", "north", |[_, y_m, _]| (*y_m).into()),
    field("heading_rad", "its heading", |[.., heading_rad]| (*heading_rad).into()),
];

#[rustfmt::skip]
const ODOMETRY: &[PlotField<[Number; 3]>] = &[
    field("x_m", "where the brick's own dead reckoning believes the simulated robot to be, east", |[x_m, ..]| (*x_m).into()),
    field("y_m", "north", |[_, y_m, _]| (*y_m).into()),
    field("heading_rad", "its heading", |[.., heading_rad]| (*heading_rad).into()),
];

#[rustfmt::skip]
const ERRORS: &[PlotField<ErrorsRow>] = &[
    field("odometry_m", "distance of odometry from the truth", |of| of.odometry_m.into()),
    field("estimate_m", "distance of the estimate from the truth at the same instant", |of| of.estimate_m.into()),
];

#[rustfmt::skip]
const LINK: &[PlotField<LinkRow>] = &[
    field("is_up", "1 when it is", |of| Value::Count((of.state == "up").into())),
    field("bytes_in_per_s", "received", |of| of.bytes_in_per_s.into()),
    field("frames_in_per_s", "received whole", |of| of.frames_in_per_s.into()),
    field("lost", "frames missing in the sequence numbers, since the beginning", |of| Value::Count(of.lost)),
    field("kernel_drops", "received datagrams that the system dropped, because they were not read in time", |of| Value::Count(of.kernel_drops)),
    field("flood_drops", "received datagrams above the budget of their peer", |of| Value::Count(of.flood_drops)),
    field("excess_requests", "requests that were not answered, because their peer asks too often", |of| Value::Count(of.excess_requests)),
    field("checksum_errors", "candidates whose checksum did not match", |of| Value::Count(of.checksum_errors)),
    field("garbage_bytes", "bytes outside every frame", |of| Value::Count(of.garbage_bytes)),
    field("stalls", "candidates given up because their bytes stopped coming", |of| Value::Count(of.stalls)),
    field("queued_frames", "frames that wait to be sent", |of| Value::Count(of.queued_frames.into())),
    field("drops_out", "outgoing messages dropped because the link was slow or down, or nobody was connected to it", |of| Value::Count(of.drops_out)),
    field("round_trip_s", "of the last answered question for the time; absent where none is answered", |of| seconds(of.round_trip_ms)),
    field("clock_uncertainty_s", "how far a converted stamp may be off", |of| seconds(of.clock_uncertainty_ms)),
];

#[rustfmt::skip]
const CLOCK: &[PlotField<ClockRow>] = &[
    field("offset_s", "brick time minus host time", |of| Value::Exact(of.offset_s)),
    field("skew_ppm", "rate of the brick's clock against the host's, minus one", |of| of.skew_ppm.into()),
    field("uncertainty_s", "half the distance between the bounds of the offset", |of| seconds(of.uncertainty_ms)),
];

/// Every field of the datagrams and its description. docs/dashboard.md has the same table, and tests compare both with the sent
/// datagrams. Adding one: a row above, and one in the page.
///
/// A field is known by its path: the names of the enclosing objects and its own, with slashes between. ID, SENSOR and N are placeholders
/// for a robot, a sensor, a link.
pub fn fields() -> Vec<(String, &'static str)> {
    fn add<T>(all: &mut Vec<(String, &'static str)>, path: &str, fields: &'static [PlotField<T>]) {
        all.extend(fields.iter().map(|field| (format!("{path}/{}", field.name), field.help)));
    }
    let mut all = vec![("timestamp".to_owned(), "seconds of the session, by the station's clock")];
    add(&mut all, "robot_ID/estimate", ESTIMATE);
    add(&mut all, "robot_ID/SENSOR", FUSION);
    all.extend(COMPONENTS.iter().map(|(name, help, _)| (format!("robot_ID/SENSOR/innovation/{name}"), *help)));
    all.extend(COMPONENTS.iter().map(|(name, _, help)| (format!("robot_ID/SENSOR/sigma/{name}"), *help)));
    add(&mut all, "truth", TRUTH);
    add(&mut all, "odometry", ODOMETRY);
    add(&mut all, "errors", ERRORS);
    add(&mut all, "link_N", LINK);
    add(&mut all, "clock", CLOCK);
    all
}

/// The path in [`fields`] that matches a sent field.
pub fn pattern_of(name: &str) -> Option<String> {
    let sent: Vec<&str> = name.split('/').collect();
    let fits = |(path, _): &(String, _)| {
        let known: Vec<&str> = path.split('/').collect();
        known.len() == sent.len() && known.iter().zip(&sent).all(|(known, sent)| fits_part(known, sent))
    };
    fields().into_iter().find(fits).map(|(path, _)| path)
}

fn fits_part(known: &str, sent: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    match known {
        "robot_ID" => sent.strip_prefix("robot_").is_some_and(|id| id.split('_').all(is_number)),
        "link_N" => sent.strip_prefix("link_").is_some_and(is_number),
        "SENSOR" => sent != "estimate",
        _ => known == sent,
    }
}

/// Components of an innovation by the observation's kind, in the order of docs/maths/pose.md; those of fixes are in the body's axes.
const COMPONENTS_OF_KIND: &[(&str, &[&str])] = &[
    ("fix", &["forward_m", "left_m", "heading_rad"]),
    ("wheel_angles", &["turn_rad"]),
    ("odometer_pose", &["turn_rad"]),
    ("compass_heading", &["heading_rad"]),
    ("wall_range", &["range_m"]),
    ("beacon_range", &["range_m"]),
    ("landmark", &["range_m", "bearing_rad"]),
];

#[derive(Serialize)]
struct Message<'a, T: Serialize> {
    timestamp: f64,
    #[serde(flatten)]
    object: BTreeMap<&'a str, T>,
}

struct Object(Vec<(&'static str, Value)>);

impl Object {
    fn new<T>(fields: &'static [PlotField<T>], of: &T) -> Self {
        Self(fields.iter().map(|field| (field.name, (field.read)(of))).collect())
    }
}

#[derive(Serialize)]
#[serde(untagged)]
enum Value {
    Number(Number),
    /// Not rounded to the digits of a [`Number`].
    Exact(f64),
    Count(u64),
    Components(BTreeMap<&'static str, Number>),
}

impl Value {
    fn is_present(&self) -> bool {
        match self {
            Self::Number(number) => number.get().is_some(),
            Self::Exact(_) | Self::Count(_) => true,
            Self::Components(components) => !components.is_empty(),
        }
    }
}

impl Serialize for Object {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().filter(|(_, value)| value.is_present()).map(|(name, value)| (name, value)))
    }
}

impl From<Number> for Value {
    fn from(number: Number) -> Self {
        Self::Number(number)
    }
}

/// Converts a message of the station to datagrams.
fn messages(frame: &Frame) -> Vec<String> {
    let mut all = Vec::new();
    for robot in &frame.robots {
        let name = format!("robot_{}", robot.id.replace('/', "_"));
        for estimate in &robot.estimates {
            let part = BTreeMap::from([("estimate", Object::new(ESTIMATE, estimate))]);
            all.push(message(estimate.t_s, &name, part));
        }
        for record in &robot.fusion {
            let part = BTreeMap::from([(&record.sensor, sensor_object(record))]);
            all.push(message(record.t_s, &name, part));
        }
    }
    for point in &frame.truth {
        all.extend(truth_messages(point));
    }
    if let Some(errors) = &frame.errors {
        all.push(message(frame.now_s, "errors", Object::new(ERRORS, errors)));
    }
    for link in frame.links.iter().flatten() {
        all.push(message(frame.now_s, &format!("link_{}", link.id), Object::new(LINK, link)));
    }
    if let Some(clock) = &frame.clock {
        all.push(message(frame.now_s, "clock", Object::new(CLOCK, clock)));
    }
    all
}

/// Objects of numbers always serialise.
fn message(timestamp: f64, name: &str, object: impl Serialize) -> String {
    let object = BTreeMap::from([(name, object)]);
    serde_json::to_string(&Message { timestamp, object }).unwrap_or_default()
}

fn truth_messages(point: &TruthPoint) -> Vec<String> {
    // One of several robots has series of its own.
    let suffix = point.robot.as_ref().map_or_else(String::new, |id| format!("_{}", id.replace('/', "_")));
    let truth = Object::new(TRUTH, &[point.x_m, point.y_m, point.heading_rad]);
    let odometry = point.odometry.map(|odometry| Object::new(ODOMETRY, &odometry));
    let named = [("truth", Some(truth)), ("odometry", odometry)].into_iter();
    named.filter_map(|(name, pose)| Some(message(point.t_s, &format!("{name}{suffix}"), pose?))).collect()
}

fn sensor_object(record: &FusionPoint) -> Object {
    let known = COMPONENTS_OF_KIND.iter().find(|(kind, _)| *kind == record.kind);
    let names = known.map_or(&[][..], |(_, names)| names);
    let named = |numbers: &[Number]| {
        let pairs = names.iter().copied().zip(numbers.iter().copied());
        Value::Components(pairs.filter(|(_, number)| number.get().is_some()).collect())
    };
    let mut object = Object::new(FUSION, record);
    object.0.extend([("innovation", named(&record.innovation)), ("sigma", named(&record.sigma))]);
    object
}

fn seconds(millis: Number) -> Value {
    Value::Number(millis.get().map_or(f64::NAN, |millis| millis / 1e3).into())
}

#[cfg(test)]
mod tests {
    use posebridge_dashboard::model::RobotFrame;

    use super::*;

    #[test]
    fn what_cannot_be_sent_is_counted_and_what_can_comes() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let here = receiver.local_addr().unwrap();
        let socket = socket_for(here).unwrap();
        assert!(socket.local_addr().unwrap().ip().is_loopback());
        let frame = Frame { clock: Some(ClockRow::default()), ..Frame::default() };
        let mut sent = SendCounts::default();
        send(&socket, here, &frame, &mut sent);
        // No system sends to port 0.
        send(&socket, "127.0.0.1:0".parse().unwrap(), &frame, &mut sent);
        assert_eq!((sent.datagrams, sent.dropped), (1, 1));
        let mut bytes = [0; 1_000];
        let read = receiver.recv(&mut bytes).unwrap();
        assert_eq!(&bytes[..read], messages(&frame)[0].as_bytes());
    }

    #[test]
    fn it_ends_when_nothing_more_can_come() {
        let mut taps = posebridge_dashboard::FrameTaps::default();
        let frames = taps.add(1);
        let sender = PlotJuggler::start("127.0.0.1:9".parse().unwrap(), frames).unwrap();
        drop(taps);
        assert_eq!(sender.finish().unwrap(), SendCounts::default());
    }

    #[test]
    fn names_are_known_by_their_pattern() {
        let cases = [
            ("timestamp", Some("timestamp")),
            ("robot_0_1_1/estimate/x_m", Some("robot_ID/estimate/x_m")),
            ("robot_0_1_1/camera/innovation/left_m", Some("robot_ID/SENSOR/innovation/left_m")),
            ("link_12/lost", Some("link_N/lost")),
            ("link_/lost", None),
            ("robot_x/estimate/x_m", None),
            ("robot_0_1_1/estimate/nis", None),
        ];
        for (name, pattern) in cases {
            assert_eq!(pattern_of(name).as_deref(), pattern, "{name}");
        }
    }

    #[test]
    fn the_page_has_the_table() {
        let page = include_str!("../../docs/dashboard.md");
        let (_, page) = page.split_once("\n## PlotJuggler\n").unwrap();
        let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| `")).collect();
        let expected: Vec<String> = fields().into_iter().map(|(path, help)| format!("| `{path}` | {help} |")).collect();
        assert_eq!(rows, expected);
    }

    #[test]
    fn each_thing_that_happened_is_one_object_with_its_time() {
        let frame = Frame {
            now_s: 2.0,
            robots: vec![RobotFrame {
                id: "0/1/1".to_owned(),
                estimates: vec![EstimatePoint {
                    t_s: 1.5,
                    x_m: 0.1.into(),
                    y_m: f64::NAN.into(),
                    is_dead_reckoning: true,
                    reset_counter: 3,
                    ..EstimatePoint::default()
                }],
                fusion: vec![FusionPoint {
                    t_s: 1.25,
                    sensor: "camera".into(),
                    kind: "fix".into(),
                    verdict: "gated".into(),
                    nis: 20.0.into(),
                    dof: 2,
                    innovation: [0.5.into(), (-0.25).into()].into_iter().collect(),
                    sigma: [0.125.into(), f64::INFINITY.into()].into_iter().collect(),
                    ..FusionPoint::default()
                }],
                ..RobotFrame::default()
            }],
            clock: Some(ClockRow { offset_s: -1.0, uncertainty_ms: 2.0.into(), ..ClockRow::default() }),
            ..Frame::default()
        };
        assert_eq!(
            messages(&frame),
            [
                r#"{"timestamp":1.5,"robot_0_1_1":{"estimate":{"x_m":0.1,"is_dead_reckoning":1,"reset_counter":3}}}"#,
                r#"{"timestamp":1.25,"robot_0_1_1":{"camera":{"nis":20.0,"degrees_of_freedom":2,"is_used":0,"innovation":{"forward_m":0.5,"left_m":-0.25},"sigma":{"forward_m":0.125}}}}"#,
                r#"{"timestamp":2.0,"clock":{"offset_s":-1.0,"uncertainty_s":0.002}}"#,
            ]
        );
    }
}
