//! Trajectories in the format of the TUM RGB-D benchmark, which evo and most SLAM tools read.
//!
//! ```text
//! line = t x y z qx qy qz qw        s, m, unit quaternion; z = 0 and a turn about z alone
//! ```
//! Seconds have six decimals: evo associates by time, and in the shortest notation timestamps of 10^9 s would lose
//! their fractions in other tools.
//!
//! # Sources
//! TUM RGB-D benchmark, "File Formats", ground-truth trajectories.

use std::fmt::Write as _;

use posebridge_telemetry::{Arena, BrickClock, Pose, TimeDelta, Timestamp};

/// Of a line's timestamp.
const RESOLUTION: TimeDelta = TimeDelta::from_micros(1);

/// Moves sorted times apart until each line has a timestamp of its own, because tools pair poses by timestamp. A late fix makes a second
/// estimate for an instant.
pub fn separate_times<'t>(times: impl Iterator<Item = &'t mut Timestamp<BrickClock>>) {
    let mut free = None;
    for time in times {
        *time = free.map_or(*time, |free| (*time).max(free));
        free = Some(*time + RESOLUTION);
    }
}

/// With line feed.
pub fn format_line(time: Timestamp<BrickClock>, pose: Pose<Arena>) -> String {
    let half_rad = 0.5 * pose.heading.rad();
    let mut line = String::new();
    let micros = time.as_micros();
    let sign = if micros < 0 { "-" } else { "" };
    let (seconds, fraction) = (micros.unsigned_abs() / 1_000_000, micros.unsigned_abs() % 1_000_000);
    // Writing to a String cannot fail.
    let _ = writeln!(
        line,
        "{sign}{seconds}.{fraction:06} {} {} 0 0 0 {} {}",
        pose.x.0,
        pose.y.0,
        half_rad.sin(),
        half_rad.cos()
    );
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Heading, Meters};

    /// As text, because the last digits of a time are lost on its way there.
    #[test]
    fn no_two_lines_have_the_same_timestamp() {
        let nanos = [3_000, -400, 600, 3_000, 1_000, 3_900, 3_000, 999, 1_000_000_000, -1_500, 4_100];
        let mut poses = nanos.map(|nanos| (Timestamp::from_nanos(nanos), nanos));
        poses.sort_by_key(|(time, _)| *time);
        separate_times(poses.iter_mut().map(|(time, _)| time));
        let lines =
            poses.map(|(time, _)| format_line(time, Pose::new(Meters(0.0), Meters(0.0), Heading::from_rad(0.0))));
        let stamps = lines.map(|line| line.split_whitespace().next().unwrap().parse::<f64>().unwrap());
        assert!(stamps.is_sorted_by(|one, next| one < next), "{stamps:?}");
        // Nothing that is apart already is moved, and equal times keep their order.
        for (time, nanos) in poses {
            assert!((0..7_000).contains(&(time.as_nanos() - nanos)), "{nanos} at {time:?}");
        }
        assert_eq!(poses[10].0.as_nanos(), 1_000_000_000);
        assert_eq!(poses[0].0.as_nanos(), -1_500);
    }

    #[test]
    fn a_line_has_whole_microseconds_and_a_turn_about_the_vertical() {
        let pose = Pose::new(Meters(1.5), Meters(-0.25), Heading::from_rad(std::f64::consts::FRAC_PI_2));
        let text = format_line(Timestamp::from_nanos(1_700_000_000_000_001_999), pose);
        let root = std::f64::consts::FRAC_1_SQRT_2;
        let fields: Vec<&str> = text.split_whitespace().collect();
        assert_eq!(fields[..6], ["1700000000.000001", "1.5", "-0.25", "0", "0", "0"]);
        let [qz, qw] = [fields[6], fields[7]].map(|field| field.parse::<f64>().unwrap());
        assert!((qz - root).abs() < 1e-15 && (qw - root).abs() < 1e-15);
        let before_zero = format_line(Timestamp::from_millis(-1_500), pose);
        assert!(before_zero.starts_with("-1.500000 "), "{before_zero}");
    }
}
