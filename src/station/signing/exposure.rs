//! Warns where any sender on the network can pose as the robot.

use std::net::SocketAddr;

use posebridge_link::LinkSet;

use crate::config::{Config, LinkSection};
use crate::console::print_line;

/// Warns of every link that listens beyond this computer and accepts frames from any sender.
pub fn warn_of_open_listeners(ports: &LinkSet, config: &Config) {
    for (index, (port, section)) in ports.iter().zip(&config.links).enumerate() {
        let address = port.local_address().filter(|_| port.is_listening());
        if let Some(warning) = address.and_then(|address| warning(index, section, address)) {
            print_line(&warning);
        }
    }
}

fn warning(index: usize, section: &LinkSection, address: SocketAddr) -> Option<String> {
    if address.ip().to_canonical().is_loopback() {
        return None;
    }
    let (state, cure) = match &section.signing {
        Some(signing) if signing.required => return None,
        Some(_) => ("its signing is not required", "set `required = true` in its `signing`"),
        None => (
            "it is not signed",
            "make a key with `posebridge key new FILE` and give the link `signing = { key_file = \"FILE\" }` (docs/routing.md)",
        ),
    };
    Some(format!(
        "WARNING: link {index} `{}` listens on {address} and {state}: anybody who can reach it can send as the robot. To keep others \
         out, {cure}, or listen on 127.0.0.1.",
        section.url
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SigningSection;

    fn is_warned(address: &str, required: Option<bool>) -> bool {
        let section = LinkSection {
            signing: required.map(|required| SigningSection {
                key_file: "a.key".to_owned(),
                link_id: 0,
                accept_unsigned: vec![],
                required,
                begun: None,
            }),
            ..LinkSection::new("udp://:14550")
        };
        let warning = warning(0, &section, address.parse().unwrap());
        if let Some(text) = &warning {
            assert!(text.contains("link 0 `udp://:14550`"), "{text}");
            assert!(text.contains(address), "{text}");
        }
        warning.is_some()
    }

    #[test]
    fn only_a_listener_that_keeps_nobody_out_is_told() {
        for address in ["0.0.0.0:14550", "192.168.4.1:14550", "[::]:14550"] {
            assert!(is_warned(address, None));
            assert!(is_warned(address, Some(false)));
            assert!(!is_warned(address, Some(true)));
        }
        for address in ["127.0.0.1:14550", "[::1]:14550", "[::ffff:127.0.0.1]:14550"] {
            assert!(!is_warned(address, None));
        }
    }
}
