//! What `sim` and `play` share: the one link of a brick to its station.

use anyhow::{Context, Result, bail};
use posebridge_link::{ConnectRole, HostTimer, Link, LinkOpenConfig, LinkUrl};
use posebridge_telemetry::LinkId;

use crate::flags::StationLink;

/// The port that the flags ask for, not yet open.
///
/// # Errors
/// The URL cannot be understood, or there is none.
pub(super) fn port(flags: &StationLink, timer: HostTimer) -> Result<Link> {
    let (text, role) = match (&flags.listen, &flags.link) {
        (Some(url), _) => (url, ConnectRole::Listen),
        (None, Some(url)) => (url, ConnectRole::Dial),
        (None, None) => bail!("give --listen URL or --link URL"),
    };
    let config = LinkOpenConfig { id: LinkId(0), url: LinkUrl::parse(text)?, role };
    Ok(Link::new(config, timer))
}

/// Opens the port, or leaves it trying if waiting may help, and says where it listens.
///
/// # Errors
/// No waiting will help: an address in use, no permission.
pub(super) async fn open(flags: &StationLink, port: &mut Link) -> Result<String> {
    let name = port.url().to_string();
    port.try_open().await.with_context(|| format!("opening `{name}`"))?;
    Ok(match (&flags.listen, port.local_address()) {
        (Some(_), Some(address)) => format!("listening on {address}"),
        _ => format!("on {name}"),
    })
}
