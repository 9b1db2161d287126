//! Every field of the datagrams. docs/dashboard.md has the same table, and tests compare both with what is sent.

/// A field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Where it stands: the names of the objects around it and its own, with slashes between. ID, SENSOR and N stand for those of a
    /// robot, a sensor, a link.
    pub name: &'static str,
    /// What it is.
    pub help: &'static str,
}

const fn field(name: &'static str, help: &'static str) -> Field {
    Field { name, help }
}

/// Every field. Adding one: a row here, one in the page, and a field in `messages.rs`.
pub const FIELDS: &[Field] = &[
    field("timestamp", "seconds of the session, by the station's clock"),
    field("robot_ID/estimate/x_m", "estimate, east"),
    field("robot_ID/estimate/y_m", "estimate, north"),
    field("robot_ID/estimate/heading_rad", "counter-clockwise from east, in (-pi, pi]"),
    field("robot_ID/estimate/heading_sigma_rad", "one standard deviation of it"),
    field("robot_ID/estimate/ellipse_major_m", "half the longer axis of the ellipse that holds the position with 95 %"),
    field("robot_ID/estimate/ellipse_minor_m", "half its shorter axis"),
    field("robot_ID/estimate/forward_m_per_s", "forward speed"),
    field("robot_ID/estimate/turn_rad_per_s", "turn rate, bias removed"),
    field("robot_ID/estimate/fix_age_s", "time since the last fix that was used; absent before the first"),
    field("robot_ID/estimate/is_dead_reckoning", "1 when nothing absolute was used for too long"),
    field("robot_ID/estimate/reset_counter", "counts jumps that are not motion"),
    field("robot_ID/SENSOR/nis", "normalised innovation squared; absent where nothing was predicted"),
    field("robot_ID/SENSOR/degrees_of_freedom", "of the NIS: its mean, if the filter is honest"),
    field("robot_ID/SENSOR/is_used", "1 when the observation was used, 0 when it was gated, too old or not wanted"),
    field("robot_ID/SENSOR/lag_s", "how far behind the filter's time it was"),
    field("robot_ID/SENSOR/innovation/forward_m", "fixes: observed minus predicted, along the robot"),
    field("robot_ID/SENSOR/innovation/left_m", "fixes: to its left"),
    field("robot_ID/SENSOR/innovation/heading_rad", "fixes with a heading, and compasses"),
    field("robot_ID/SENSOR/innovation/turn_rad", "wheels: the gyro's turn minus theirs over a window"),
    field("robot_ID/SENSOR/innovation/range_m", "ranges to walls, beacons and landmarks"),
    field("robot_ID/SENSOR/innovation/bearing_rad", "bearings of landmarks"),
    field("robot_ID/SENSOR/sigma/forward_m", "one standard deviation of each innovation"),
    field("robot_ID/SENSOR/sigma/left_m", "the same"),
    field("robot_ID/SENSOR/sigma/heading_rad", "the same"),
    field("robot_ID/SENSOR/sigma/turn_rad", "the same"),
    field("robot_ID/SENSOR/sigma/range_m", "the same"),
    field("robot_ID/SENSOR/sigma/bearing_rad", "the same"),
    field("truth/x_m", "where the simulated robot really is, east"),
    field("truth/y_m", "north"),
    field("truth/heading_rad", "its heading"),
    field("odometry/x_m", "where the brick's own dead reckoning believes the simulated robot to be, east"),
    field("odometry/y_m", "north"),
    field("odometry/heading_rad", "its heading"),
    field("errors/odometry_m", "distance of odometry from the truth"),
    field("errors/estimate_m", "distance of the estimate from the truth at the same instant"),
    field("link_N/is_up", "1 when it is"),
    field("link_N/bytes_in_per_s", "received"),
    field("link_N/frames_in_per_s", "received whole"),
    field("link_N/lost", "frames missing in the sequence numbers, since the beginning"),
    field("link_N/checksum_errors", "candidates whose checksum did not match"),
    field("link_N/garbage_bytes", "bytes outside every frame"),
    field("link_N/stalls", "candidates given up because their bytes stopped coming"),
    field("link_N/queued_frames", "frames that wait to be sent"),
    field("link_N/drops_out", "outgoing messages dropped because the link was slow or down"),
    field("link_N/round_trip_s", "of the last answered question for the time; absent where none is answered"),
    field("link_N/clock_uncertainty_s", "how far a converted stamp may be off"),
    field("clock/offset_s", "brick time minus host time"),
    field("clock/skew_ppm", "rate of the brick's clock against the host's, minus one"),
    field("clock/uncertainty_s", "half the distance between the bounds of the offset"),
];

/// The name in [`FIELDS`] of a field that was sent.
pub fn pattern_of(name: &str) -> Option<&'static str> {
    let sent: Vec<&str> = name.split('/').collect();
    let fits = |field: &&Field| {
        let known: Vec<&str> = field.name.split('/').collect();
        known.len() == sent.len() && known.iter().zip(&sent).all(|(known, sent)| fits_part(known, sent))
    };
    FIELDS.iter().find(fits).map(|field| field.name)
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

#[cfg(test)]
mod tests {
    use super::*;

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
            assert_eq!(pattern_of(name), pattern, "{name}");
        }
    }

    #[test]
    fn the_page_has_the_table() {
        let page = include_str!("../../../docs/dashboard.md");
        let (_, page) = page.split_once("\n## PlotJuggler\n").unwrap();
        let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| `")).collect();
        let expected: Vec<String> =
            FIELDS.iter().map(|field| format!("| `{}` | {} |", field.name, field.help)).collect();
        assert_eq!(rows, expected);
    }
}
