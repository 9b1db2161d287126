//! The link profiles that come with the program.

/// The clean link, which needs no file.
pub(super) const NONE: &str = "none";

macro_rules! bundled {
    ($($name:literal),* $(,)?) => {
        /// Name and TOML text of every bundled link profile. Adding one: a file in `config/links/` and a line here.
        pub const PROFILES: &[(&str, &str)] = &[
            $(($name, include_str!(concat!("../../../config/links/", $name, ".toml")))),*
        ];
    };
}

bundled!["usb", "bluetooth-spp", "hc05-57600", "sik-radio", "wifi", "ble", "harsh",];

/// The names that exist, joined by commas.
pub(super) fn names() -> String {
    let mut names = vec![NONE];
    names.extend(PROFILES.iter().map(|(name, _)| *name));
    names.join(", ")
}
