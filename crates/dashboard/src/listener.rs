//! Where the server listens.

use std::io;
use std::net::{SocketAddr, TcpListener};

use crate::thread::StartError;

/// The next free port is looked for among so many.
pub(crate) const PORTS_TRIED: u16 = 20;

/// Where to listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Listen {
    /// There and nowhere else; port 0 takes a free one.
    Exactly(SocketAddr),
    /// There, or at the next free port.
    OrNext(SocketAddr),
}

/// A place to serve at: nobody else can have it any more.
#[derive(Debug)]
pub struct Listener {
    pub(crate) socket: TcpListener,
    pub(crate) address: SocketAddr,
}

impl Listener {
    /// Begins to listen.
    ///
    /// # Errors
    /// The address is taken or cannot be listened on.
    pub fn bind(listen: Listen) -> Result<Self, StartError> {
        let (socket, address) = bind(listen)?;
        Ok(Self { socket, address })
    }
}

fn bind(listen: Listen) -> Result<(TcpListener, SocketAddr), StartError> {
    let (first, tries) = match listen {
        Listen::Exactly(address) => (address, 0),
        Listen::OrNext(address) => (address, PORTS_TRIED),
    };
    for step in 0..=tries {
        let mut address = first;
        address.set_port(first.port().saturating_add(step));
        match bind_one(address) {
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

fn bind_one(address: SocketAddr) -> io::Result<(TcpListener, SocketAddr)> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    let address = listener.local_addr()?;
    Ok((listener, address))
}
