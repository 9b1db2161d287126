//! `[dashboard]`: the page of the station.

use std::net::SocketAddr;

use anyhow::{Context, Result};
use posebridge_dashboard::ListenAddress;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where the dashboard listens unless configured: loopback, at a port that IANA has not assigned.
const DEFAULT_LISTEN: &str = "127.0.0.1:4680";

/// The dashboard.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct DashboardSection {
    /// Whether there is one.
    pub enabled: bool,
    /// IP address and port. At the default the next free port is taken if this one is in use; another one is taken as it is. A
    /// browser on another computer needs the token that is printed at the start.
    pub listen: String,
    /// Whether the token is needed on this computer as well, because it has several users.
    pub always_token: bool,
}

impl Default for DashboardSection {
    fn default() -> Self {
        Self { enabled: true, listen: DEFAULT_LISTEN.to_owned(), always_token: false }
    }
}

impl DashboardSection {
    /// As the server takes it.
    ///
    /// # Errors
    /// It is no IP address with a port.
    pub fn checked(&self) -> Result<ListenAddress> {
        let address: SocketAddr = self.listen.parse().with_context(|| {
            format!("`dashboard.listen` is `{}`; give an IP address and a port, such as {DEFAULT_LISTEN}", self.listen)
        })?;
        Ok(if self.listen == DEFAULT_LISTEN {
            ListenAddress::FirstFree(address)
        } else {
            ListenAddress::Exact(address)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_may_move_on_and_another_address_is_taken_as_it_is() {
        let listen = |text: &str| {
            let section = DashboardSection { listen: text.to_owned(), ..DashboardSection::default() };
            section.checked()
        };
        let default = DashboardSection::default().checked().unwrap();
        assert_eq!(default, ListenAddress::FirstFree("127.0.0.1:4680".parse().unwrap()));
        let other = "0.0.0.0:80".parse().unwrap();
        assert_eq!(listen("0.0.0.0:80").unwrap(), ListenAddress::Exact(other));
        let error = listen("localhost").unwrap_err().to_string();
        assert!(error.starts_with("`dashboard.listen` is `localhost`; give"), "{error}");
    }
}
