//! The address that is listened at, taken before anything else is done: a start that fails there leaves nothing behind.

use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};

use socket2::SockRef;

use crate::reach::{Families, reachable};
use crate::thread::{PORTS_TRIED, StartError};

/// Where to listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Listen {
    /// There and nowhere else; port 0 takes a free one.
    Exactly(SocketAddr),
    /// There, or at the next free port.
    OrNext(SocketAddr),
}

/// An address that nobody else can take any more; nobody is answered there yet.
#[derive(Debug)]
pub struct Bound {
    pub(crate) listener: TcpListener,
    pub(crate) address: SocketAddr,
}

impl Bound {
    /// Takes an address.
    ///
    /// # Errors
    /// It is taken, or cannot be listened at.
    pub fn new(listen: Listen) -> Result<Self, StartError> {
        let (first, tries) = match listen {
            Listen::Exactly(address) => (address, 0),
            Listen::OrNext(address) => (address, PORTS_TRIED),
        };
        for step in 0..=tries {
            let mut address = first;
            address.set_port(first.port().saturating_add(step));
            match Self::one(address) {
                Ok(bound) => return Ok(bound),
                Err(source) if source.kind() == io::ErrorKind::AddrInUse => {}
                Err(source) => return Err(StartError::Bind { address, source }),
            }
        }
        Err(match listen {
            Listen::Exactly(address) => StartError::Taken { address },
            Listen::OrNext(address) => StartError::AllTaken { address },
        })
    }

    fn one(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address })
    }

    /// The addresses at which others find it, the one of this computer last.
    pub(crate) fn reachable(&self) -> Vec<IpAddr> {
        let own = self.address.ip();
        if !own.is_unspecified() {
            return vec![own];
        }
        let families = match own {
            IpAddr::V4(_) => Families::V4,
            IpAddr::V6(_) if SockRef::from(&self.listener).only_v6().unwrap_or(true) => Families::V6,
            IpAddr::V6(_) => Families::Both,
        };
        reachable(families)
    }
}
