//! The scenarios that come with the program.

/// Name and TOML text of every bundled scenario. Adding one: a file in `config/scenarios/` and a line here.
pub const BUNDLED: &[(&str, &str)] = &[
    ("square", include_str!("../../../config/scenarios/square.toml")),
    ("circle", include_str!("../../../config/scenarios/circle.toml")),
    ("figure-eight", include_str!("../../../config/scenarios/figure-eight.toml")),
    ("waypoints", include_str!("../../../config/scenarios/waypoints.toml")),
    ("straight", include_str!("../../../config/scenarios/straight.toml")),
    ("rough", include_str!("../../../config/scenarios/rough.toml")),
    ("thermometer", include_str!("../../../config/scenarios/thermometer.toml")),
];
