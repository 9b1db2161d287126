//! `--robot FILE`: a profile that overrides the recording's description of its robot, as if each key had been given by `--set`.

use anyhow::{Context, Result};

use crate::config::{RobotProfile, Setting};
use crate::flags::SessionFlags;

/// The profile's keys, then those of `--set`, then those of `--param`; `robot_path` is where the robot's table is in what they
/// are laid over.
///
/// # Errors
/// The profile cannot be read or describes no robot.
pub(super) fn settings(flags: &SessionFlags, robot_path: &[&str]) -> Result<Vec<Setting>> {
    let mut settings = Vec::new();
    if let Some(path) = &flags.robot {
        // Its own reading names what makes no sense better than a laid over table could.
        RobotProfile::read(path)?;
        let name = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("reading the robot from `{name}`"))?;
        let page: toml::Table = toml::from_str(&text)?;
        settings.extend(of_table(&page, "robot", robot_path));
        settings.extend(of_table(&page, "filter", &["filter"]));
    }
    settings.extend_from_slice(&flags.data.settings);
    settings.extend_from_slice(&flags.params);
    Ok(settings)
}

/// The filter is chosen by `--filter`, and where a robot started belongs to the recording.
fn of_table(page: &toml::Table, name: &str, path: &[&str]) -> Vec<Setting> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_laid_over_key_by_key_without_start_and_filter_name() {
        let text = "[robot]\ntrack_width_m = 0.2\n[robot.noise]\nfix_position_m = 0.02\n[robot.start]\nx_m = 1.0\n\
                    [filter]\nname = \"pose\"\naccel_m_s2 = 2.0\n";
        let page: toml::Table = toml::from_str(text).unwrap();
        let paths =
            |settings: Vec<Setting>| -> Vec<String> { settings.iter().map(|setting| setting.path.join(".")).collect() };
        assert_eq!(paths(of_table(&page, "robot", &["robot"])), ["robot.noise.fix_position_m", "robot.track_width_m"]);
        assert_eq!(paths(of_table(&page, "filter", &["filter"])), ["filter.accel_m_s2"]);
    }
}
