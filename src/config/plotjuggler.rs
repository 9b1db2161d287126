//! `[plotjuggler]`: what happens, sent to PlotJuggler.

use std::net::SocketAddr;

use anyhow::{Context, Result, ensure};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where PlotJuggler's UDP server listens by default, on this computer. Source: its plugin `DataStreamUDP`.
pub const PLOTJUGGLER_ADDRESS: &str = "127.0.0.1:9870";

/// JSON datagrams for PlotJuggler.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct PlotJugglerSection {
    /// Whether they are sent.
    pub enabled: bool,
    /// IP address and UDP port of PlotJuggler's UDP server.
    pub address: String,
}

impl Default for PlotJugglerSection {
    fn default() -> Self {
        Self { enabled: false, address: PLOTJUGGLER_ADDRESS.to_owned() }
    }
}

impl PlotJugglerSection {
    /// Where they go.
    ///
    /// # Errors
    /// It is no IP address with a port.
    pub fn checked(&self) -> Result<SocketAddr> {
        let address: SocketAddr = self.address.parse().with_context(|| {
            format!(
                "`plotjuggler.address` is `{}`; give an IP address and a port, such as {PLOTJUGGLER_ADDRESS}",
                self.address
            )
        })?;
        ensure!(
            address.port() != 0,
            "`plotjuggler.address` is `{address}`: port 0 has no listener; PlotJuggler's UDP server shows its port, 9870 at first"
        );
        Ok(address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_an_ip_address_with_a_port() {
        let checked =
            |text: &str| PlotJugglerSection { address: text.to_owned(), ..PlotJugglerSection::default() }.checked();
        let default = PlotJugglerSection::default().checked().unwrap();
        assert_eq!(default, "127.0.0.1:9870".parse().unwrap());
        assert_eq!(checked("[::1]:80").unwrap(), "[::1]:80".parse().unwrap());
        let error = checked("localhost:9870").unwrap_err().to_string();
        assert!(error.starts_with("`plotjuggler.address` is `localhost:9870`; give"), "{error}");
        let error = checked("127.0.0.1:0").unwrap_err().to_string();
        assert!(error.contains("port 0 has no listener"), "{error}");
    }
}
