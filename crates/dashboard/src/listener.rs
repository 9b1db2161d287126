//! The listening socket, bound before anything else is started: a start that fails here leaves nothing behind.

use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};

use socket2::SockRef;

use crate::api::{DashboardStartError, MAX_PORT_ATTEMPTS};
use crate::local_addresses::{IpFamilies, find_local_addresses};

/// The address to listen on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListenAddress {
    /// Exactly this address; port 0 lets the system choose.
    Exact(SocketAddr),
    /// This address, or the next free port.
    FirstFree(SocketAddr),
}

/// A bound listening socket; connections are accepted later.
#[derive(Debug)]
pub struct BoundListener {
    pub(crate) listener: TcpListener,
    pub(crate) address: SocketAddr,
}

impl BoundListener {
    /// Binds an address.
    ///
    /// # Errors
    /// It is in use, or cannot be bound.
    pub fn new(listen: ListenAddress) -> Result<Self, DashboardStartError> {
        let (first, tries) = match listen {
            ListenAddress::Exact(address) => (address, 0),
            ListenAddress::FirstFree(address) => (address, MAX_PORT_ATTEMPTS),
        };
        for step in 0..=tries {
            let mut address = first;
            address.set_port(first.port().saturating_add(step));
            match Self::bind_address(address) {
                Ok(bound) => return Ok(bound),
                Err(source) if source.kind() == io::ErrorKind::AddrInUse => {}
                Err(source) => return Err(DashboardStartError::Bind { address, source }),
            }
        }
        Err(match listen {
            ListenAddress::Exact(address) => DashboardStartError::AddressInUse { address },
            ListenAddress::FirstFree(address) => DashboardStartError::AllPortsInUse { address },
        })
    }

    fn bind_address(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address })
    }

    /// The addresses at which others reach it, that of this computer last.
    pub(crate) fn reachable_addresses(&self) -> Vec<IpAddr> {
        let own = self.address.ip();
        if !own.is_unspecified() {
            return vec![own];
        }
        let families = match own {
            IpAddr::V4(_) => IpFamilies::V4,
            IpAddr::V6(_) if SockRef::from(&self.listener).only_v6().unwrap_or(true) => IpFamilies::V6,
            IpAddr::V6(_) => IpFamilies::Both,
        };
        find_local_addresses(families)
    }
}
