//! What a newcomer with a board takes from here: robot profiles. That the SDKs make the right bytes is tested in brick/rust.
#![expect(
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

mod support;

use std::path::PathBuf;

use posebridge::config::{Config, RobotProfile};

use support::root;

/// The profiles that come with the program.
const PROFILES: &[&str] = &[
    "arduino-2wd",
    "ev3-educator",
    "nxt-43mm",
    "nxt-56mm",
    "pybricks-spike",
    "sim",
];

fn profiles() -> Vec<PathBuf> {
    let files = std::fs::read_dir(root().join("config/robots")).unwrap();
    let mut paths: Vec<PathBuf> = files.map(|file| file.unwrap().path()).collect();
    paths.sort();
    paths
}

#[test]
fn every_robot_profile_loads_and_bears_the_name_of_its_file() {
    let found = profiles();
    let stems: Vec<&str> = found
        .iter()
        .map(|path| path.file_stem().unwrap().to_str().unwrap())
        .collect();
    assert_eq!(stems, PROFILES);
    for (path, stem) in found.iter().zip(stems) {
        let profile = RobotProfile::read(path).unwrap();
        assert_eq!(profile.robot.name, stem);
        let config = Config::default().with_robot(profile);
        config.filter_config().unwrap();
    }
}
