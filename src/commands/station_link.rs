//! What `sim` and `play` share: the one link of a brick to its station.

use anyhow::{Context, Result, bail};
use posebridge_link::{HostTimer, LinkUrl, Port, PortConfig, Role};
use posebridge_telemetry::LinkId;

use crate::cli::StationLink;

/// The port that the flags ask for, not yet open.
///
/// # Errors
/// The URL cannot be understood, or there is none.
pub(super) fn port(flags: &StationLink, timer: HostTimer) -> Result<Port> {
    let (text, role) = match (&flags.listen, &flags.link) {
        (Some(url), _) => (url, Role::Listen),
        (None, Some(url)) => (url, Role::Dial),
        (None, None) => bail!("give --listen URL or --link URL"),
    };
    let config = PortConfig { id: LinkId(0), url: LinkUrl::parse(text)?, role };
    Ok(Port::new(config, timer))
}

/// Opens the port, or leaves it trying if waiting may help, and says where it listens.
///
/// # Errors
/// No waiting will help: an address in use, no permission.
pub(super) async fn open(flags: &StationLink, port: &mut Port) -> Result<String> {
    let name = port.url().to_string();
    port.open_first().await.with_context(|| format!("opening `{name}`"))?;
    Ok(match (&flags.listen, port.local_address()) {
        (Some(_), Some(address)) => format!("listening on {address}"),
        _ => format!("on {name}"),
    })
}
