//! Foreign recordings for the commands: descriptor, robot, runs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_recording::dataset::{self, Descriptor, LoadOptions};
use posebridge_recording::ros2::bag::{BagPlan, WheelGeometry};
use posebridge_telemetry::ArenaMap;

use super::ros2_bag;
use crate::config::{FilterSection, ProfileFilter, RobotFile, RobotProfile, Setting, filter_config};
use crate::console::print_line;
use crate::flags::DataFlags;
use crate::text_file::read_text;

pub struct DataSet {
    pub descriptor: Descriptor,
    pub runs: Vec<String>,
    /// UTC of the zero of its times, as far as it is known.
    pub utc_start_micros: u64,
    root: PathBuf,
}

pub struct RobotRun {
    pub run: dataset::DatasetRun,
    /// Described by the descriptor and the flags.
    pub robot: RobotFile,
    pub filter: FilterSection,
    pub filter_config: FilterConfig,
}

impl DataSet {
    pub fn open(path: &Path, flags: &DataFlags) -> Result<Self> {
        let name = path.display();
        let bag = ros2_bag::is_bag(path).then(|| BagFile::open(path, flags)).transpose()?;
        let text = match &bag {
            Some(bag) => bag.plan.descriptor.clone(),
            None => read_text(path).with_context(|| format!("reading the descriptor `{name}`"))?,
        };
        let descriptor = Descriptor::from_toml(&text).with_context(|| format!("descriptor `{name}`"))?;
        let prefix = flags.run.clone().unwrap_or_else(|| descriptor.default_run.clone());
        let runs: Vec<String> = descriptor.select(&prefix).into_iter().map(str::to_owned).collect();
        if runs.is_empty() {
            bail!("no run of `{name}` begins with `{prefix}`; there are: {}", descriptor.runs.join(", "));
        }
        if let Some(BagFile { plan, folder }) = bag {
            return Ok(Self { descriptor, runs, utc_start_micros: plan.utc_start_micros, root: folder });
        }
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let own_folder = parent.unwrap_or(Path::new(".")).to_owned();
        Ok(Self { descriptor, runs, utc_start_micros: 0, root: flags.data.clone().unwrap_or(own_folder) })
    }

    pub fn load(&self, run: &str, flags: &DataFlags) -> Result<RobotRun> {
        let (robot, filter) = self.robot_and_filter(run, &flags.settings)?;
        let geometry = robot.geometry()?;
        let options = LoadOptions { run, geometry, wiring: robot.wiring(), use_every: flags.use_every };
        let mut open = |relative: &Path| ros2_bag::open(&self.root.join(relative));
        let run = dataset::load(&self.descriptor, options, &mut open)
            .with_context(|| format!("recording `{}` in `{}`", self.descriptor.name, self.root.display()))?;
        for dialect in &run.dialects {
            print_line(&format!("{}: {dialect}", run.name));
        }
        ensure!(
            !run.observations.is_empty(),
            "run `{}` holds no observation: {}",
            run.name,
            run.bad_rows.listed.first().map_or_else(
                || "no row follows the headers of its files".to_owned(),
                |first| format!("{first} ({} rows could not be used)", run.bad_rows.total())
            )
        );
        let mut config = filter_config(&robot, &filter, world_of(&run))?;
        config.start = run.start.or(config.start);
        Ok(RobotRun { run, robot, filter, filter_config: config })
    }

    /// Robot and tunables of a run, with the flags applied.
    fn robot_and_filter(&self, run: &str, settings: &[Setting]) -> Result<(RobotFile, FilterSection)> {
        let robot: RobotFile =
            self.descriptor.robot_for(run).try_into().with_context(|| format!("robot of run `{run}`"))?;
        let tunables: ProfileFilter = self.descriptor.filter.clone().try_into().context("[filter]")?;
        let is_name = |setting: &Setting| setting.path == ["filter", "name"];
        ensure!(
            tunables.name.is_none() && !settings.iter().any(is_name),
            "`filter.name` does not belong to a recording: choose the filter with --filter"
        );
        let filter = FilterSection { params: tunables.params, ..FilterSection::default() };
        let mut all = toml::Table::try_from(&robot)?;
        let mut tunables = toml::Table::try_from(&filter)?;
        for setting in settings {
            let failed = |why: String| anyhow!("`--set {setting}`: {why}");
            match setting.path.split_first() {
                Some((section, key)) if section == "filter" => {
                    Setting { path: key.to_vec(), value: setting.value.clone() }
                        .apply_to(&mut tunables)
                        .map_err(failed)?;
                }
                _ => setting.apply_to(&mut all).map_err(failed)?,
            }
        }
        let robot = all.try_into().with_context(|| format!("robot of run `{run}`"))?;
        let filter = tunables.try_into().context("[filter]")?;
        Ok((robot, filter))
    }
}

/// A bag, with the descriptor that is made for it.
struct BagFile {
    plan: BagPlan,
    folder: PathBuf,
}

impl BagFile {
    fn open(path: &Path, flags: &DataFlags) -> Result<Self> {
        // A name for `.` as well.
        let path = path.canonicalize().with_context(|| format!("looking for `{}`", path.display()))?;
        let is_radius = |setting: &Setting| setting.path.iter().any(|part| part == "left_wheel_radius_m");
        let geometry = if flags.settings.iter().any(is_radius) { WheelGeometry::Known } else { WheelGeometry::Unknown };
        let folder = path.parent().unwrap_or(Path::new("/")).to_owned();
        Ok(Self { plan: ros2_bag::plan(&path, geometry)?, folder })
    }
}

/// The flags of a foreign recording with the keys of a robot's profile before the settings, which override them.
pub fn with_robot(flags: &DataFlags, robot: Option<&Path>) -> Result<DataFlags> {
    let mut flags = flags.clone();
    if let Some(robot) = robot {
        flags.settings.splice(0..0, profile_settings(robot, &[])?);
    }
    Ok(flags)
}

/// The keys of a robot's profile as settings: of its robot below `robot_path`, and of its filter.
pub fn profile_settings(path: &Path, robot_path: &[&str]) -> Result<Vec<Setting>> {
    // Its own reading has better errors than that of the settings.
    RobotProfile::read(path)?;
    let name = path.display();
    let text = read_text(path).with_context(|| format!("reading the robot from `{name}`"))?;
    let page: toml::Table = toml::from_str(&text)?;
    let mut settings = settings_of_table(&page, "robot", robot_path);
    settings.extend(settings_of_table(&page, "filter", &["filter"]));
    Ok(settings)
}

/// Excludes the filter's name, which `--filter` selects, and the robot's start, which belongs to the recording.
pub(super) fn settings_of_table(page: &toml::Table, name: &str, path: &[&str]) -> Vec<Setting> {
    let table = page.get(name).and_then(toml::Value::as_table);
    let entries = table.into_iter().flatten();
    let mut settings = Vec::new();
    for (key, value) in entries {
        let path: Vec<String> = path.iter().copied().chain([key.as_str()]).map(str::to_owned).collect();
        let inner = value.as_table().filter(|_| key == "noise" || key == "calibration");
        match inner {
            Some(inner) => settings.extend(inner.iter().map(|(inner, value)| Setting {
                path: path.iter().cloned().chain([inner.clone()]).collect(),
                value: value.clone(),
            })),
            None if key == "start" || (name == "filter" && key == "name") => {}
            None => settings.push(Setting { path, value: value.clone() }),
        }
    }
    settings
}

fn world_of(run: &dataset::DatasetRun) -> ArenaMap {
    ArenaMap {
        landmarks: run.landmarks.iter().copied().collect(),
        beacons: run.beacons.iter().copied().collect(),
        walls: Vec::new(),
    }
}

/// Prints the number of unusable readings of a sensor.
pub fn report_skipped(name: &str, left_out: usize) {
    if left_out > 0 {
        print_line(&format!(
            "{name}: {left_out} samples are left out: not finite, or of the very instant of another one"
        ));
    }
}

/// Prints the bad rows, which do not end the run; returns their number.
pub fn report_bad_rows(robot_run: &RobotRun) -> u64 {
    let bad = &robot_run.run.bad_rows;
    for row in &bad.listed {
        print_line(&format!("{}: {row}", robot_run.run.name));
    }
    for (reason, count) in &bad.counts {
        print_line(&format!("{}: {count} rows: {}", robot_run.run.name, reason.name()));
    }
    bad.total() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn flags(settings: &[&str]) -> DataFlags {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        DataFlags {
            data: Some(root.join("tests/data")),
            run: Some("circular/250620202104/run-01".to_owned()),
            use_every: None,
            settings: settings.iter().map(|text| Setting::parse(text).unwrap()).collect(),
        }
    }

    fn descriptor() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("config/recordings/optiodom.toml")
    }

    fn load(settings: &[&str]) -> Result<RobotRun> {
        let flags = flags(settings);
        DataSet::open(&descriptor(), &flags)?.load("circular/250620202104/run-01", &flags)
    }

    #[test]
    fn a_station_builds_the_filter_of_the_replay_from_the_same_file() {
        let replayed = load(&[]).unwrap().filter_config;
        let profile = RobotProfile::read(&descriptor()).unwrap();
        let live = Config::default().with_robot(profile).filter_config().unwrap();
        let (from_run, from_file) = (replayed.start.unwrap(), live.start.unwrap());
        assert_eq!(from_run.pose, from_file.pose);
        assert!((from_run.heading_sigma_rad - from_file.heading_sigma_rad).abs() < 1e-15);
        let without_start = |config: FilterConfig| FilterConfig { start: None, ..config };
        assert_eq!(without_start(replayed), without_start(live));
    }

    #[test]
    fn settings_reach_geometry_noise_calibration_and_tunables() {
        let config = load(&[
            "track_width_m=1",
            "noise.beacon_range_m=0.5",
            "calibration.track_scale.sigma=0.1",
            "filter.history_s=5",
        ])
        .unwrap()
        .filter_config;
        assert_eq!(config.geometry.track_width.0, 1.0);
        assert_eq!(config.noise.beacon_range_m, 0.5);
        let track_scale = config.calibration.track_scale;
        assert_eq!((track_scale.value, track_scale.sigma), (0.0, 0.1));
        assert_eq!(config.params.history_s, 5.0);
        assert!(load(&["calibration.track.sigma=0.1"]).is_err());
        assert!(load(&["filter.history=5"]).is_err());
    }

    #[test]
    fn the_places_of_a_recording_are_the_filter_s_world() {
        use posebridge_telemetry::{BeaconId, LandmarkId, Meters, Point2};
        let (here, there) = (Point2::new(Meters(1.0), Meters(2.0)), Point2::new(Meters(3.0), Meters(4.0)));
        let run = dataset::DatasetRun {
            landmarks: vec![(LandmarkId(6), here)],
            beacons: vec![(BeaconId(0), there)],
            ..dataset::DatasetRun::default()
        };
        let world = world_of(&run);
        assert_eq!(world.landmarks[&LandmarkId(6)], here);
        assert_eq!(world.beacons[&BeaconId(0)], there);
    }
}
