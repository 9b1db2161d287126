//! Bags of rosbags and of the Python package `mcap`, in both byte orders and both compressions (`data/ros2/make_bags.py`).

use std::io::Cursor;
use std::path::Path;

use posebridge_recording::container::{RecordingReader, unpack_recording};
use posebridge_recording::dataset::{BadRowReason, DatasetRun, Descriptor, LoadOptions, load};
use posebridge_recording::ros2::bag::{BagPlan, BagSummary, WheelGeometry};
use posebridge_telemetry::{DriveGeometry, Meters, ObservationKind, Radians, Wiring};

const ZSTD: &[u8] = include_bytes!("../data/ros2/rosbags-zstd.mcap");
const BIG_ENDIAN: &[u8] = include_bytes!("../data/ros2/big-endian-lz4.mcap");
const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(0.03),
    right_wheel_radius: Meters(0.03),
    track_width: Meters(0.1),
    tick: Radians(1.0),
};

fn plan(bag: &[u8], geometry: WheelGeometry) -> BagPlan {
    BagPlan::new(&BagSummary::read(bag).unwrap(), "drive", "drive.mcap", geometry).unwrap()
}

fn read(descriptor: &str, bag: &[u8]) -> DatasetRun {
    let descriptor = Descriptor::from_toml(descriptor).unwrap_or_else(|error| panic!("{error}\n{descriptor}"));
    let options = LoadOptions { run: "drive", geometry: GEOMETRY, wiring: Wiring::default(), use_every: None };
    load(&descriptor, options, &mut |_: &Path| Ok(Box::new(Cursor::new(bag.to_vec())))).unwrap()
}

fn texts(run: &DatasetRun) -> Vec<String> {
    let observations = run.observations.iter();
    let texts = observations.map(|timed| {
        let (stamp, arrival) = (timed.observation.stamp.as_nanos(), timed.arrival.as_nanos());
        format!("{stamp} {arrival} {:?}", timed.observation.measurement)
    });
    texts.collect()
}

#[test]
fn topics_become_sensors_by_their_types_names_and_messages() {
    for bag in [ZSTD, BIG_ENDIAN] {
        let plan = plan(bag, WheelGeometry::Unknown);
        assert_eq!(plan.utc_start_micros, 1_700_000_000_000_000);
        assert_eq!(
            plan.report,
            [
                "took /odom (4 nav_msgs/Odometry): steps of its pose; /imu/data (4 sensor_msgs/Imu): turn rate about y: it is not \
                 mounted upright, gravity lies along this axis; /marker (4 geometry_msgs/PoseStamped): fixes with the configured \
                 noise; /amcl_pose (4 geometry_msgs/PoseWithCovarianceStamped): fixes with their covariance; /scan (4 \
                 sensor_msgs/LaserScan): range straight ahead",
                "left /chatter (1 std_msgs/String); /joint_states (4 sensor_msgs/JointState): the radii and the track of the wheels \
                 are not known: --robot FILE.toml, or --set left_wheel_radius_m=.. and so on; /goal_pose (4 \
                 geometry_msgs/PoseStamped): a goal or an initial pose, by its name",
            ]
        );
        let run = read(&plan.descriptor, bag);
        assert_eq!(run.bad_rows.total(), 0, "{:?}", run.bad_rows.listed);
        // Of the second step. The marker has no stamp: that of the log counts.
        let found = texts(&run);
        let second: Vec<&str> = found.iter().filter(|text| text.contains(" 105000000 ")).map(String::as_str).collect();
        assert_eq!(second.len(), 5, "{found:?}");
        assert!(second[0].starts_with("100000000 105000000 OdometerPose(Transform2 { x: Meters(0.05)"), "{second:?}");
        assert!(second.contains(&"100000000 105000000 TurnRate(RadiansPerSecond(0.101))"), "{second:?}");
        assert!(second.contains(&"100000000 105000000 WallRange(Meters(1.0499999523162842))"), "{second:?}");
        let marker = second.iter().find(|text| text.starts_with("105000000 105000000 Fix(")).unwrap();
        assert!(marker.contains("x: Meters(1.05), y: Meters(2.0)") && marker.contains("covariance: None"), "{marker}");
        let amcl = second.iter().find(|text| text.contains("xx_m2: 0.25")).unwrap();
        assert!(amcl.contains("heading_rad2: 0.0625"), "{amcl}");
        // Nothing was seen in the first scan.
        assert_eq!(found.len(), 4 * 5 - 1);
    }
}

#[test]
fn wheels_of_known_radii_take_the_place_of_the_odometry() {
    let plan = plan(ZSTD, WheelGeometry::Known);
    assert!(plan.descriptor.contains("joints = [\"wheel_left_joint\", \"wheel_right_joint\"]"), "{}", plan.descriptor);
    let run = read(&plan.descriptor, ZSTD);
    let wheels: Vec<ObservationKind> = run.observations.iter().map(|timed| timed.observation.measurement).collect();
    let second = ObservationKind::WheelAngles { left: Radians(1.0), right: Radians(1.25) };
    assert!(wheels.contains(&second), "{wheels:?}");
    assert!(!wheels.iter().any(|kind| matches!(kind, ObservationKind::OdometerPose(_))), "the wheels are counted once");
}

#[test]
fn a_descriptor_of_a_person_takes_another_bearing_other_joints_and_other_columns() {
    let descriptor = r#"
        name = "drive"
        source = "made"
        licence = "none"
        default_run = "drive"
        runs = [{ name = "drive" }]
        files.scan = { path = "drive.mcap", topic = "/scan", bearing_deg = -57.3 }
        files.joints = { path = "drive.mcap", topic = "/joint_states", joints = ["arm", "wheel_left_joint"] }
        files.odom = { path = "drive.mcap", topic = "/odom", offset_s = -1700000000 }
        [[wall_range]]
        file = "scan"
        range = "range_m"
        [[wheels]]
        file = "joints"
        counting = "absolute"
        left = { column = "left_rad", unit = "rad" }
        right = { column = "right_rad", unit = "rad" }
        [[body_velocity]]
        file = "odom"
        forward = "forward_m_per_s"
        turn = "turn_rad_per_s"
    "#;
    let found = texts(&read(descriptor, ZSTD)).join("\n");
    assert!(found.contains("WallRange(Meters(3.0))"), "{found}");
    assert!(found.contains("WheelAngles { left: Radians(9.0), right: Radians(3.0) }"), "{found}");
    assert!(
        found.contains(
            "100000000 105000000 BodyVelocity { forward: MetersPerSecond(0.5), turn: RadiansPerSecond(0.1) }"
        )
    );
}

#[test]
fn an_unknown_topic_and_one_of_another_type_are_refused_with_what_there_is() {
    let refused = |topic: &str| {
        let text = format!(
            "name = 'a'\nsource = 'a'\nlicence = 'a'\ndefault_run = 'drive'\nruns = [{{ name = 'drive' }}]\n\
             files.a = {{ path = 'drive.mcap', topic = '{topic}' }}\n[[gyro]]\nfile = 'a'\nturn_rate = 'turn_z_rad_per_s'\n"
        );
        let descriptor = Descriptor::from_toml(&text).unwrap();
        let options = LoadOptions { run: "drive", geometry: GEOMETRY, wiring: Wiring::default(), use_every: None };
        let error = load(&descriptor, options, &mut |_: &Path| Ok(Box::new(Cursor::new(ZSTD)))).unwrap_err();
        let cause = std::error::Error::source(&error).map_or_else(String::new, ToString::to_string);
        format!("{error}: {cause}")
    };
    let error = refused("/imu");
    assert!(
        error.contains("drive.mcap:/imu") && error.contains("there are:") && error.contains("/imu/data"),
        "{error}"
    );
    let error = refused("/chatter");
    assert!(error.contains("the topic /chatter (std_msgs/msg/String) is not read"), "{error}");
    assert!(refused("/odom").contains("there is no column `turn_z_rad_per_s`"));
}

#[test]
fn a_bag_that_is_cut_anywhere_is_read_up_to_there() {
    for bag in [ZSTD, BIG_ENDIAN] {
        let whole = BagSummary::read(bag).unwrap();
        assert!(whole.notes().is_empty(), "{:?}", whole.notes());
        let count = |summary: &BagSummary| summary.topics.iter().map(|topic| topic.messages).sum::<u64>();
        let cuts: Vec<_> = (8..bag.len()).map(|length| BagSummary::read(&bag[..length]).unwrap()).collect();
        assert!(cuts.iter().all(|cut| !cut.notes().is_empty()));
        assert!(cuts.iter().map(count).is_sorted());
        // What follows the last message is the summary.
        assert_eq!(cuts.last().map(count), Some(count(&whole)));
        assert!(BagSummary::read(&bag[..7]).is_err());
    }
}

#[test]
fn what_a_cut_bag_lacks_is_a_bad_row_of_each_topic() {
    let bag = unchunked(ZSTD);
    let end = bag.len() - 200;
    let run = read(&plan(&bag, WheelGeometry::Unknown).descriptor, &bag[..end]);
    assert_eq!(run.bad_rows.count(BadRowReason::Damaged), 5);
    let line = run.bad_rows.listed[0].to_string();
    assert!(line.contains("part of the bag could not be read: byte "), "{line}");
    assert!(line.contains("the bag is cut off here"), "{line}");
}

/// Files of a bag: a read of no bytes at the end of each.
struct Files<'a>(Vec<&'a [u8]>);

impl std::io::Read for Files<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let Some(first) = self.0.first_mut() else { return Ok(0) };
        let read = first.read(buffer)?;
        if read == 0 {
            self.0.remove(0);
        }
        Ok(read)
    }
}

#[test]
fn a_file_of_a_bag_that_is_cut_loses_nothing_of_the_next() {
    let count = |summary: &BagSummary| summary.topics.iter().map(|topic| topic.messages).sum::<u64>();
    let whole = count(&BagSummary::read(ZSTD).unwrap());
    let (uncompressed, half) = (unchunked(ZSTD), ZSTD.len() / 2);
    for first in [ZSTD, &ZSTD[..half], &uncompressed[..uncompressed.len() - 20], b"no bag"] {
        let expected = BagSummary::read(first).map_or(0, |summary| count(&summary)) + 2 * whole;
        let both = BagSummary::read(Files(vec![ZSTD, first, ZSTD])).unwrap();
        assert_eq!(count(&both), expected, "{:?}", both.notes());
        assert_eq!(both.notes().is_empty(), first == ZSTD, "{:?}", both.notes());
        assert!(both.notes().iter().all(|note| note.starts_with("file 2, byte ")), "{:?}", both.notes());
    }
}

#[test]
fn a_damaged_message_is_a_bad_row_with_its_byte_and_the_rest_is_read() {
    let mut bag = unchunked(BIG_ENDIAN);
    // The length of the first frame's name: "odom" and its zero.
    let at = bag.windows(9).position(|found| found == b"\0\0\0\x05odom\0").unwrap();
    bag[at] = 0x7F;
    let notes = BagSummary::read(&*bag).unwrap().notes();
    let [checksum, note] = &notes[..] else { panic!("{notes:?}") };
    assert!(checksum.ends_with("the checksum of a chunk is wrong"), "{checksum}");
    assert!(note.starts_with("/odom: 1 damaged messages are left out; the first: byte "), "{note}");
    assert!(note.contains("byte 12 of the message: a text of 2130706437 elements, but"), "{note}");
    let run = read(&plan(&bag, WheelGeometry::Unknown).descriptor, &bag);
    // The message, and the checksum for each of five topics.
    assert_eq!(run.bad_rows.count(BadRowReason::Damaged), 6);
    let line = run.bad_rows.listed[0].to_string();
    assert!(line.starts_with("drive.mcap:/odom:2: damaged message: byte "), "{line}");
}

/// The same messages without compression: `unpack_recording` asks for nothing of ours.
fn unchunked(bag: &[u8]) -> Vec<u8> {
    unpack_recording(bag.to_vec(), 1 << 20).unwrap()
}

#[test]
fn a_recording_that_another_program_has_compressed_reads_as_the_original() {
    let original: &[u8] = include_bytes!("../data/ros2/own.mcap");
    let inputs = |bytes: &[u8]| RecordingReader::open(bytes).unwrap().map(Result::unwrap).collect::<Vec<_>>();
    let expected = inputs(original);
    assert!(expected.len() > 10);
    for packed in [&include_bytes!("../data/ros2/own-zstd.mcap")[..], &include_bytes!("../data/ros2/own-lz4.mcap")[..]]
    {
        assert!(packed.len() < original.len());
        let unpacked = unpack_recording(packed.to_vec(), 1 << 30).unwrap();
        assert_eq!(inputs(&unpacked), expected);
        assert_eq!(unpack_recording(original.to_vec(), 1).unwrap(), original);
        assert!(unpack_recording(packed.to_vec(), 1 << 10).is_err());
        let counts = (0..packed.len()).step_by(37).filter_map(|length| {
            let cut = unpack_recording(packed[..length].to_vec(), 1 << 30).unwrap();
            let found: Vec<_> = RecordingReader::open(&cut).ok()?.filter_map(Result::ok).collect();
            assert!(expected.starts_with(&found), "{length}");
            Some(found.len())
        });
        let counts: Vec<usize> = counts.collect();
        assert!(counts.is_sorted() && counts.last() == Some(&expected.len()), "{counts:?}");
    }
}
