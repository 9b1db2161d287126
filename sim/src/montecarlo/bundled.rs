//! The bundled scenarios of the accuracy experiment, in the order of its table.

macro_rules! bundled {
    ($($name:literal),* $(,)?) => {
        /// Name and TOML text of every bundled scenario. Adding one: a file in `config/scenarios/accuracy/` and a line here.
        pub const SCENARIOS: &[(&str, &str)] = &[
            $(($name, include_str!(concat!("../../../config/scenarios/accuracy/", $name, ".toml")))),*
        ];
    };
}

bundled![
    "camera-10hz",
    "camera-1hz",
    "outliers-3pct",
    "outliers-10pct",
    "noise-x4",
    "noise-quarter",
    "noise-x4-outliers",
    "blackout",
    "no-camera",
    "kicks",
    "kicks-camera-1hz",
    "unknown-heading",
    "wpilib",
    "paper-square",
];
