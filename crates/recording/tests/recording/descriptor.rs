//! Descriptors: runs, robots, and errors that name the line and the key.

use posebridge_recording::dataset::{Descriptor, LoadError};
use proptest::prelude::*;

use crate::inline::{descriptor_text, parse, try_load};

fn error_of(rest: &str) -> String {
    match Descriptor::from_toml(&descriptor_text(rest)) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("accepted: {rest}"),
    }
}

#[test]
fn a_wrong_key_is_named_with_its_line() {
    let found = error_of("tiem = 3");
    assert!(found.starts_with("line 13: unknown field `tiem`"), "{found}");
    assert!(found.ends_with("in `tiem = 3`"), "{found}");
}

#[test]
fn a_unit_of_another_dimension_is_refused() {
    let found = error_of("[[gyro]]\nfile = \"data\"\nturn_rate = { column = 1, unit = \"ms\" }");
    assert_eq!(
        found,
        "line 15: `ms` is not a unit of turn rate: use one of: rad_per_s, deg_per_s, in \
         `turn_rate = { column = 1, unit = \"ms\" }`"
    );
}

#[test]
fn values_that_make_no_sense_are_refused() {
    let wheels = "[[wheels]]\nfile = \"data\"\ncounting = \"absolute\"\nright = 1";
    for (rest, expected) in [
        (format!("{wheels}\nleft = 2"), "a wheel rotation needs `unit`"),
        ("[[gyro]]\nfile = \"data\"\nturn_rate = -1".to_owned(), "columns count from 0"),
        ("offset_s = nan".to_owned(), "the number must be finite"),
        ("delimiter = \"pipe\"".to_owned(), "unknown variant `pipe`"),
        (
            "[[compass]]\nfile = \"data\"\nheading = { qz = 1 }".to_owned(),
            "{ column, unit, scale, offset } or { qz, qw }",
        ),
        ("[[gyro]]\nfile = \"data\"".to_owned(), "missing field `turn_rate`"),
    ] {
        let found = error_of(&rest);
        assert!(found.contains(expected), "{found}");
    }
}

#[test]
fn keys_that_do_not_fit_together_are_refused_with_their_line() {
    for (rest, expected) in [
        ("[[gyro]]\nfile = \"dta\"\nturn_rate = 1", "line 14: gyro: there is no [files.dta]: use one of: data"),
        (
            "[[gyro]]\nfile = \"data\"\nturn_rate = \"gz\"",
            "line 14: gyro: the column `gz` goes by its name, but the file has no header_lines",
        ),
        (
            "[files.map]\npath = \"m.csv\"\n[[gyro]]\nfile = \"map\"\nturn_rate = 1",
            "line 16: gyro: [files.map] has no `time`",
        ),
        (
            "[[gyro]]\nfile = \"data\"\nruns = [\"other\"]\nturn_rate = 1",
            "line 14: gyro: no run's name begins with `other`",
        ),
        (
            "[[odometer]]\nfile = \"data\"\nx = 1\ny = 2\nturn = 3",
            "line 14: odometer: an odometer is either x, y and heading, or distance and turn",
        ),
        (
            "[[body_velocity]]\nfile = \"data\"\nforward = 1",
            "line 14: body_velocity: a body velocity is either forward and turn, or left and right",
        ),
        (
            "[[beacon_ranges]]\nfile = \"data\"\nid = 1\nrange = 2",
            "line 14: beacon_ranges: ranges need [beacons], the map of their places",
        ),
        (
            "[start]\nx_m = 0\nposition_sigma_m = 0\nheading_sigma_rad = 0",
            "line 13: start: either `from`, or x_m, y_m and one of heading_rad and heading_deg",
        ),
        ("[[runs]]\nname = \"only\"", "line 13: runs: the run `only` is there twice"),
        (
            "[[runs]]\nname = \"{nobody}\"",
            "line 13: runs: `{nobody}` wants `nobody`, which the run's values do not have",
        ),
    ] {
        assert_eq!(error_of(rest), expected);
    }
    let wrap = "[[wheels]]\nfile = \"data\"\ncounting = \"increments\"\nwrap_bits = 16\n\
        left = { column = 1, unit = \"ticks\" }\nright = { column = 2, unit = \"ticks\" }";
    assert!(error_of(wrap).contains("wrap_bits is 8 to 32"));
}

#[test]
fn a_fix_has_one_kind_of_place_and_one_kind_of_claim() {
    let fixes = |rest: &str| error_of(&format!("[[fixes]]\nfile = \"data\"\n{rest}"));
    let message = "line 14: fixes: a fix is either x and y, or latitude and longitude with an `origin`";
    let origin = "origin = { latitude_deg = 0, longitude_deg = 0 }";
    for incomplete in
        ["x = 1", "latitude = 1\nlongitude = 2", &format!("latitude = 1\n{origin}"), &format!("x = 1\ny = 2\n{origin}")]
    {
        assert_eq!(fixes(incomplete), message, "{incomplete}");
    }
    let claims = "position_sigma_m or variance_x and variance_y, fixes of a pose also heading_sigma_rad, or neither";
    for unfit in [
        "heading_sigma_rad = 0.1",
        "variance_x = 3",
        "variance_x = 3\nvariance_y = 4\nposition_sigma_m = 1.0",
        "variance_x = 3\nvariance_y = 4\nheading = 5",
    ] {
        let found = fixes(&format!("x = 1\ny = 2\n{unfit}"));
        assert!(found.ends_with(claims), "{unfit}: {found}");
    }
}

#[test]
fn the_default_run_must_be_there() {
    let text = descriptor_text("").replace("default_run = \"only\"", "default_run = \"none\"");
    let found = Descriptor::from_toml(&text).unwrap_err().to_string();
    assert_eq!(found, "line 5: default_run: no run's name begins with `none`");
}

const GROUP: &str = r#"
[robot]
track_width_m = 0.2
name = "a"
noise = { gyro_rad_per_s = 0.01, fix_position_m = 0.02 }

[[runs]]
name = "{set}/run-{each}"
each = ["01", "02"]
values = { set = "square" }
robot = { track_width_m = 0.3, noise = { fix_position_m = 0.5 } }

[files.other]
path = "{set}/{run}/log-{each}.csv"
time = { column = 0 }

[[gyro]]
file = "other"
runs = ["square/"]
turn_rate = 1
"#;

#[test]
fn a_group_of_runs_shares_its_values_and_its_robot() {
    let descriptor = parse(GROUP);
    assert_eq!(descriptor.runs, ["only", "square/run-01", "square/run-02"]);
    assert_eq!(descriptor.select("square"), ["square/run-01", "square/run-02"]);
    assert_eq!(descriptor.robot_for("only"), descriptor.robot);
    let merged = descriptor.robot_for("square/run-02");
    let expected: toml::Table =
        toml::from_str("track_width_m = 0.3\nname = \"a\"\nnoise = { gyro_rad_per_s = 0.01, fix_position_m = 0.5 }")
            .unwrap();
    assert_eq!(merged, expected);
}

#[test]
fn the_tunables_of_a_robot_are_handed_on_as_they_stand() {
    let descriptor = parse("[filter]\nhistory_s = 5\n");
    let expected: toml::Table = toml::from_str("history_s = 5").unwrap();
    assert_eq!(descriptor.filter, expected);
    assert!(parse("").filter.is_empty());
}

#[test]
fn the_paths_of_a_run_are_filled_in() {
    let descriptor = parse(GROUP);
    let path = "square/square/run-02/log-02.csv";
    let run = try_load(&descriptor, "square/run-02", &[(path, "0,1\n")]).unwrap();
    assert_eq!(run.observations.len(), 1);
    let elsewhere = try_load(&descriptor, "only", &[]).unwrap();
    assert!(elsewhere.observations.is_empty(), "the stream belongs to the other runs");
}

#[test]
fn a_run_is_found_by_its_name_or_by_a_beginning_that_no_other_has() {
    let descriptor = parse(GROUP);
    assert_eq!(try_load(&descriptor, "on", &[]).unwrap().name, "only");
    let error = try_load(&descriptor, "square", &[]).unwrap_err();
    assert_eq!(error.to_string(), "2 runs begin with `square`: use one of: only, square/run-01, square/run-02");
    let error = try_load(&descriptor, "square/run-01", &[]).unwrap_err();
    assert!(matches!(error, LoadError::Open { .. }), "{error}");
    assert!(error.to_string().contains("square/square/run-01/log-01.csv"));
}

#[test]
fn a_column_that_the_header_does_not_have_is_named() {
    let rest = "header_lines = 1\n[[gyro]]\nfile = \"data\"\nturn_rate = \"gz\"";
    let error = try_load(&parse(rest), "only", &[("data.csv", "t,gx,gy\n0,1,2\n")]).unwrap_err();
    assert_eq!(error.to_string(), "data.csv: there is no column `gz`, the header has: t, gx, gy");
}

proptest! {
    #[test]
    fn no_text_makes_the_descriptor_panic(text in "\\PC*", rest in "[a-z_\\[\\]{}=\" ,0-9\n.-]{0,120}") {
        for text in [text, descriptor_text(&rest)] {
            if let Err(error) = Descriptor::from_toml(&text) {
                prop_assert!(error.to_string().starts_with("line "));
            }
        }
    }
}
