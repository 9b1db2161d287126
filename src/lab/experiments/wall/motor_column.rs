//! The column of the motors' input among those of a table, by its usual names.

/// One column, or one for each side.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct MotorColumn {
    pub(super) left: String,
    pub(super) right: String,
}

impl MotorColumn {
    pub(super) fn one(name: &str) -> Self {
        Self { left: name.to_owned(), right: name.to_owned() }
    }

    /// In words, for the report.
    pub(super) fn describe(&self) -> String {
        if self.left == self.right {
            format!("`{}`", self.left)
        } else {
            format!("`{}` and `{}`", self.left, self.right)
        }
    }
}

/// Names without case, spaces and marks, the surest first: `speed` may be a measured one.
const NAMES: [&str; 32] = [
    "pwm",
    "motorpwm",
    "pwmmotor",
    "pwmvalue",
    "pwmout",
    "pwmcmd",
    "motor",
    "motors",
    "motorcommand",
    "motorcmd",
    "motorinput",
    "motoroutput",
    "motorvalue",
    "motorspeed",
    "speedcommand",
    "speedcmd",
    "command",
    "cmd",
    "throttle",
    "duty",
    "dutycycle",
    "power",
    "effort",
    "controlinput",
    "control",
    "controloutput",
    "pidoutput",
    "output",
    "input",
    "drive",
    "u",
    "speed",
];
/// What a name of one side says beside the side.
const SIDED: [&str; 12] =
    ["pwm", "motorpwm", "pwmmotor", "motor", "motorspeed", "motorcmd", "cmd", "command", "power", "speed", "duty", "u"];
const SIDES: [(&str, &str); 5] = [("left", "right"), ("l", "r"), ("1", "2"), ("a", "b"), ("lft", "rgt")];

/// The motors' column among `columns`; `others` are known to be something else.
pub(super) fn find_motor_column(columns: &[String], others: &[&str]) -> Option<MotorColumn> {
    let plain: Vec<(String, &String)> = columns
        .iter()
        .filter(|column| !others.contains(&column.as_str()))
        .map(|column| (normalised(column), column))
        .collect();
    let by_name = |name: &str| plain.iter().find(|(plain, _)| plain == name).map(|(_, column)| (*column).clone());
    if let Some(column) = NAMES.iter().find_map(|name| by_name(name)) {
        return Some(MotorColumn::one(&column));
    }
    for (left, right) in SIDES {
        for stem in SIDED {
            for ahead in [true, false] {
                let name = |side: &str| if ahead { format!("{side}{stem}") } else { format!("{stem}{side}") };
                if let (Some(left), Some(right)) = (by_name(&name(left)), by_name(&name(right))) {
                    return Some(MotorColumn { left, right });
                }
            }
        }
    }
    Some(MotorColumn { left: by_name("left")?, right: by_name("right")? })
}

/// Lower case, letters and digits alone, without a unit that says percent or the range of a register.
fn normalised(column: &str) -> String {
    let plain: String = column.to_lowercase().chars().filter(char::is_ascii_alphanumeric).collect();
    for unit in ["percent", "pct", "255", "100"] {
        if let Some(stem) = plain.strip_suffix(unit).filter(|stem| !stem.is_empty()) {
            return stem.to_owned();
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(columns: &[&str]) -> Option<String> {
        let columns: Vec<String> = columns.iter().map(|name| (*name).to_owned()).collect();
        find_motor_column(&columns, &["distance"]).map(|column| column.describe())
    }

    #[test]
    fn a_motor_column_is_found_by_its_usual_names_and_a_measured_speed_is_none() {
        for name in
            ["pwm", "PWM", "motor", "Motor Speed", "speed", "u", "command", "motor_pwm", "Duty (%)", "power_pct"]
        {
            assert_eq!(found(&["t", "distance", name]), Some(format!("`{name}`")), "{name}");
        }
        for (left, right) in [("left_pwm", "right_pwm"), ("PWM L", "PWM R"), ("motor1", "motor2"), ("left", "right")] {
            assert_eq!(found(&["t", "distance", left, right]), Some(format!("`{left}` and `{right}`")));
        }
        assert_eq!(found(&["t", "speed", "pwm"]), Some("`pwm`".to_owned()));
        assert_eq!(found(&["t", "distance", "velocity_mmps", "kf_mm", "speed_mm_s"]), None);
    }
}
