//! A webcam that `simulated_webcam.c` makes out of a folder of pictures. It is compiled, and loaded into a second run of the same test:
//! what a process preloads is fixed when it starts.

use std::any::type_name_of_val;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use jpeg_encoder::{ColorType, Encoder};
use posebridge_link::LinkEvent;
use posebridge_telemetry::TimeDelta;
use serde_json::json;

use crate::drawing::{corners, picture_with_tag};
use crate::support::{CameraLink, corners_of, distance};

const DEVICE: &str = "/dev/video-simulated";
const SIZES: [(usize, usize); 2] = [(160, 120), (320, 240)];
const PLACE: (usize, usize) = (60, 40);
/// Tags of the pictures, in turn; the driver flags those of `DAMAGED`.
const TAGS: [u16; 4] = [11, 12, 13, 14];
const DAMAGED: u16 = 13;
/// More than two readings of a clock lie apart, and less than any error of a whole exposure or frame.
const CLOCK_TOLERANCE: TimeDelta = TimeDelta::from_millis(10);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pictures {
    Jpeg,
    Yuyv,
}

/// A webcam that is plugged into this process.
struct Webcam {
    folder: PathBuf,
}

impl Webcam {
    fn link(&self, options: &str) -> CameraLink {
        assert!(self.folder.join("plugged").exists(), "the simulation has its folder");
        CameraLink::new(&format!("{DEVICE}?{options}"))
    }

    /// A link that is open, or the reason why it cannot be.
    async fn open(&self, options: &str) -> Result<CameraLink, String> {
        let mut camera = self.link(options);
        camera.link.try_open().await.map_err(|error| error.to_string())?;
        assert!(camera.link.is_up(), "{:?}", camera.link.next_event().await);
        Ok(camera)
    }

    fn unplug(&self) {
        std::fs::remove_file(self.folder.join("plugged")).expect("it is plugged in");
    }

    fn plug(&self) {
        std::fs::write(self.folder.join("plugged"), "").expect("a folder");
    }

    /// What is in the log behind `word`.
    fn logged(&self, word: &str) -> Vec<String> {
        let log = std::fs::read_to_string(self.folder.join("log")).unwrap_or_default();
        log.lines().filter_map(|line| line.strip_prefix(word)).map(|rest| rest.trim().to_owned()).collect()
    }
}

/// Runs the test that `body` is in once more, as a process that has the webcam, and `body` in there.
fn with_webcam(pictures: Pictures, settings: &[(&str, &str)], body: impl AsyncFn(Webcam)) {
    if let Some(folder) = std::env::var_os("SIMULATED_WEBCAM") {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        return runtime.block_on(body(Webcam { folder: folder.into() }));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let library = compile(folder.path());
    let webcam = folder.path().join("webcam");
    write_pictures(&webcam, pictures);
    Webcam { folder: webcam.clone() }.plug();
    let path = type_name_of_val(&body).trim_end_matches("::{{closure}}");
    let (_, test) = path.split_once("::").expect("a crate before the module");
    let output = Command::new(std::env::current_exe().expect("this test"))
        .args(["--exact", test, "--nocapture"])
        .env("LD_PRELOAD", library)
        .env("SIMULATED_WEBCAM", webcam)
        .env("SIMULATED_WEBCAM_PATH", DEVICE)
        .envs(settings.iter().copied())
        .output()
        .expect("this test starts");
    let [said, complained] = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    assert!(output.status.success() && said.contains("1 passed"), "{}\n{said}\n{complained}", output.status);
}

fn compile(folder: &Path) -> PathBuf {
    let starts = |name: &&str| {
        let found = Command::new(name).arg("--version").stdout(Stdio::null()).status();
        found.is_ok_and(|status| status.success())
    };
    let Some(compiler) = ["cc", "gcc", "clang"].into_iter().find(starts) else {
        panic!("there is no C compiler: none of cc, gcc, clang starts; install gcc to test webcams");
    };
    let (library, source) = (folder.join("webcam.so"), "tests/camera/simulated_webcam.c");
    let output = Command::new(compiler)
        .args(["-std=gnu11", "-Wall", "-O1", "-shared", "-fPIC", "-o"])
        .arg(&library)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join(source))
        .args(["-ldl", "-pthread"])
        .output()
        .expect("it has started before");
    assert!(output.status.success(), "{source}: {}", String::from_utf8_lossy(&output.stderr));
    library
}

fn write_pictures(webcam: &Path, pictures: Pictures) {
    for size in SIZES {
        let folder = webcam.join(format!("{}x{}", size.0, size.1));
        std::fs::create_dir_all(&folder).expect("a folder");
        for tag in TAGS {
            let picture = picture_with_tag(size, tag, PLACE);
            let (ending, bytes) = match pictures {
                Pictures::Jpeg => ("jpg", jpeg_of_webcam(&picture, size)),
                Pictures::Yuyv => ("pgm", picture),
            };
            let word = if tag == DAMAGED { "damaged" } else { "whole" };
            std::fs::write(folder.join(format!("{tag}-{word}.{ending}")), bytes).expect("a file");
        }
    }
}

/// As webcams send them: without the Huffman tables, which are always those of the JPEG standard.
fn jpeg_of_webcam(pgm: &[u8], (width, height): (usize, usize)) -> Vec<u8> {
    let pixels = &pgm[pgm.len() - width * height..];
    let mut whole = Vec::new();
    Encoder::new(&mut whole, 95).encode(pixels, width as u16, height as u16, ColorType::Luma).expect("it is a picture");
    let (mut short, mut rest) = (whole[..2].to_vec(), &whole[2..]);
    while rest[1] != 0xDA {
        let (segment, after) = rest.split_at(2 + usize::from(u16::from_be_bytes([rest[2], rest[3]])));
        if segment[1] != 0xC4 {
            short.extend(segment);
        }
        rest = after;
    }
    [&short, rest].concat()
}

async fn up(camera: &mut CameraLink) -> String {
    let LinkEvent::Up { detail, .. } = camera.link.next_event().await else {
        panic!("nothing comes before it is open")
    };
    detail
}

/// All tags of pictures that are not flagged come, and no others.
async fn expect_tags(camera: &mut CameraLink, size: (usize, usize)) {
    let mut missing: Vec<u16> = TAGS.into_iter().filter(|tag| *tag != DAMAGED).collect();
    let mut lines = 0;
    while !missing.is_empty() || lines < 2 * TAGS.len() {
        let line = camera.tag().await;
        assert_eq!(line["picture_px"], json!([size.0, size.1]));
        assert!(distance(corners_of(&line), corners(PLACE)) < 0.3, "{line}");
        let tag = line["tag"].as_u64().expect("a number") as u16;
        assert!(TAGS.contains(&tag) && tag != DAMAGED, "{line}");
        missing.retain(|other| *other != tag);
        lines += 1;
    }
}

/// What a link says that a person must do something about.
async fn refusal(webcam: &Webcam, options: &str) -> String {
    webcam.open(options).await.err().expect("it cannot be opened")
}

#[test]
fn tags_of_jpeg_pictures_are_found_in_the_size_and_at_the_rate_that_is_nearest_to_the_asked_one() {
    with_webcam(Pictures::Jpeg, &[], async |webcam| {
        let mut camera = webcam.open("width=300&height=200&fps=18").await.unwrap();
        assert_eq!(up(&mut camera).await, format!("{DEVICE}, 320 x 240 MJPG"));
        expect_tags(&mut camera, (320, 240)).await;
        assert_eq!([webcam.logged("format"), webcam.logged("interval")].concat(), ["320x240", "1/20"]);
        assert_eq!(webcam.logged("control"), [""; 0], "nothing was asked for");
    });
}

#[test]
fn a_webcam_that_gives_yuyv_only_is_read_in_the_size_that_it_has() {
    with_webcam(Pictures::Yuyv, &[], async |webcam| {
        let mut camera = webcam.open("width=0&height=0").await.unwrap();
        assert_eq!(up(&mut camera).await, format!("{DEVICE}, 160 x 120 YUYV"));
        expect_tags(&mut camera, (160, 120)).await;
    });
}

#[test]
fn exposure_and_gain_are_set_and_held() {
    with_webcam(Pictures::Jpeg, &[], async |webcam| {
        let mut camera = webcam.open("exposure_us=5000&gain=64").await.unwrap();
        camera.tag().await;
        let mut set = webcam.logged("control");
        set.sort();
        assert_eq!(set, ["exposure_absolute 51", "exposure_auto 1", "exposure_dynamic_framerate 0", "gain 64"]);
        assert_eq!(webcam.logged("ignored"), [""; 0], "nothing is set while the automatic exposure still runs");
    });
}

#[test]
fn a_webcam_that_refuses_its_exposure_says_so() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_LACKS", "exposure")], async |webcam| {
        let reason = refusal(&webcam, "exposure_us=5000").await;
        assert!(reason.contains("does not let its exposure be set: Invalid argument"), "{reason}");
        assert!(reason.contains("take the option away"), "{reason}");
        expect_tags(&mut webcam.open("gain=64&width=160").await.unwrap(), SIZES[0]).await;
    });
}

#[test]
fn the_other_device_file_of_a_webcam_says_that_it_has_no_pictures() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_LACKS", "capture")], async |webcam| {
        let reason = refusal(&webcam, "").await;
        assert!(reason.contains("gives no pictures") && reason.contains("another device file"), "{reason}");
    });
}

#[test]
fn a_webcam_without_a_first_picture_is_not_open() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_LACKS", "pictures")], async |webcam| {
        let event = webcam.link("").link.next_event().await;
        let LinkEvent::Down { reason, .. } = event else { panic!("{event:?}") };
        assert!(reason.ends_with("did not open within 5 s"), "{reason}");
    });
}

#[test]
fn a_bus_without_room_says_what_helps() {
    const ENOSPC: &str = "28";
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_BUS_ERROR", ENOSPC)], async |webcam| {
        let reason = refusal(&webcam, "").await;
        assert!(reason.contains("another USB port") && reason.contains("width"), "{reason}");
    });
}

#[test]
fn a_webcam_serves_one_program_and_then_the_next() {
    with_webcam(Pictures::Jpeg, &[], async |webcam| {
        let mut first = webcam.open("width=160").await.unwrap();
        first.tag().await;
        let reason = refusal(&webcam, "width=320").await;
        assert!(reason.contains("in use by another program"), "{reason}");
        drop(first);
        // It ends with its next picture.
        let mut second = loop {
            if let Ok(camera) = webcam.open("width=320&height=240").await {
                break camera;
            }
        };
        expect_tags(&mut second, SIZES[1]).await;
    });
}

#[test]
fn a_webcam_that_is_unplugged_is_lost_until_it_is_there_again() {
    with_webcam(Pictures::Jpeg, &[], async |webcam| {
        let mut camera = webcam.open("width=160&height=120").await.unwrap();
        camera.tag().await;
        webcam.unplug();
        let reason = camera.loss().await;
        assert!(reason.contains("unplugged"), "{reason}");
        assert_eq!(camera.loss().await, format!("{DEVICE} is not there: plug the device in or check the name"));
        webcam.plug();
        expect_tags(&mut camera, SIZES[0]).await;
        assert_eq!(camera.link.counters().reconnects, 1);
    });
}

/// How much a picture's time is left open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Spread {
    Exact,
    /// At most so much.
    Within(TimeDelta),
}

/// The middle of each exposure lies where the lines say.
async fn expect_times(webcam: &Webcam, options: &str, spread: Spread) {
    let mut camera = webcam.open(options).await.expect("it opens");
    for _ in 0..2 * TAGS.len() {
        let (arrival, line) = camera.tag_at().await;
        let ago: [i64; 2] = serde_json::from_value(line["exposed_ago_us"].clone()).expect("the driver stamps");
        let [latest, earliest] = ago.map(|ago| arrival - TimeDelta::from_micros(ago));
        match spread {
            Spread::Exact => assert_eq!(earliest, latest, "{line}"),
            Spread::Within(most) => assert!(latest - earliest <= most, "{line}"),
        }
        let picture = format!("{}-whole.", line["tag"]);
        let is_inside = webcam.logged("frame").iter().filter(|entry| entry.starts_with(&picture)).any(|entry| {
            let micros = entry.rsplit(' ').next().and_then(|micros| micros.parse().ok()).expect("a number");
            let middle = camera.timer.at_monotonic(Duration::from_micros(micros));
            earliest - CLOCK_TOLERANCE <= middle && middle <= latest + CLOCK_TOLERANCE
        });
        assert!(is_inside, "{line} at {arrival:?}: {:?}", webcam.logged("frame"));
    }
}

#[test]
fn a_stamp_of_the_start_and_a_known_exposure_give_the_middle_of_the_exposure() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_STAMPS", "start")], async |webcam| {
        expect_times(&webcam, "width=160&fps=10&exposure_us=50000", Spread::Exact).await;
    });
}

#[test]
fn an_exposure_that_the_webcam_shortens_counts_as_it_is() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_STAMPS", "start")], async |webcam| {
        expect_times(&webcam, "width=160&fps=10&exposure_us=300000", Spread::Exact).await;
    });
}

#[test]
fn an_exposure_counts_at_most_as_long_as_a_frame() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_STAMPS", "start")], async |webcam| {
        expect_times(&webcam, "width=160&fps=30&exposure_us=60000", Spread::Exact).await;
    });
}

#[test]
fn a_stamp_of_the_end_leaves_the_time_of_reading_out_open() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_STAMPS", "end")], async |webcam| {
        expect_times(&webcam, "width=160&fps=10&exposure_us=50000", Spread::Within(TimeDelta::from_millis(101))).await;
    });
}

#[test]
fn an_automatic_exposure_that_slows_the_pictures_down_counts_as_long_as_it_can_be() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_STAMPS", "start")], async |webcam| {
        expect_times(&webcam, "width=160&fps=20", Spread::Within(TimeDelta::from_millis(51))).await;
    });
}

#[test]
fn an_automatic_exposure_is_as_uncertain_before_the_end_of_reading_out() {
    with_webcam(Pictures::Jpeg, &[("SIMULATED_WEBCAM_STAMPS", "end")], async |webcam| {
        expect_times(&webcam, "width=160&fps=20", Spread::Within(TimeDelta::from_millis(151))).await;
    });
}

#[test]
fn a_webcam_that_does_not_tell_its_rate_leaves_as_much_open_as_its_pictures_lie_apart() {
    let settings = [("SIMULATED_WEBCAM_STAMPS", "end"), ("SIMULATED_WEBCAM_LACKS", "interval")];
    with_webcam(Pictures::Jpeg, &settings, async |webcam| {
        expect_times(&webcam, "width=160", Spread::Within(TimeDelta::from_millis(110))).await;
    });
}
