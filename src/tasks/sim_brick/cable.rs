//! The cable between a simulated brick and its end of the link: whole, as bad as a profile says, or pulled out.

use anyhow::Result;
use posebridge_link::{HostTimer, Port, PortConfig, PortEvent};
use posebridge_sim::Simulation;
use posebridge_sim::impairment::{End, ImpairedLink, LinkEvent, LinkProfile};
use posebridge_telemetry::{HostClock, PeerId, Span, Stamp};

/// A cable.
pub struct Cable {
    /// Without one it is pulled out.
    port: Option<Port>,
    /// What is opened when it is put in again; a port that somebody else has opened stays.
    again: Option<(PortConfig, HostTimer)>,
    /// When it is put in again.
    back_at: Stamp<HostClock>,
    /// Who was heard last.
    station: Option<PeerId>,
    /// What makes it worse than it is.
    bad: Option<ImpairedLink>,
}

impl Cable {
    /// A cable that stays in.
    #[must_use]
    pub const fn fixed(port: Port) -> Self {
        Self { port: Some(port), again: None, back_at: Stamp::ZERO, station: None, bad: None }
    }

    /// A cable that can be pulled out and put in again.
    #[must_use]
    pub fn pluggable(config: PortConfig, timer: HostTimer) -> Self {
        Self { again: Some((config.clone(), timer)), ..Self::fixed(Port::new(config, timer)) }
    }

    /// Opens the port at its end for the first time.
    ///
    /// # Errors
    /// It cannot be opened, now or ever.
    pub async fn open_first(&mut self) -> Result<()> {
        match &mut self.port {
            Some(port) => Ok(port.open_first().await?),
            None => Ok(()),
        }
    }

    /// Waits for something to come; for ever, while it is out.
    pub async fn next(&mut self) -> PortEvent {
        match &mut self.port {
            Some(port) => port.next().await,
            None => std::future::pending().await,
        }
    }

    /// Gives the simulation what has come.
    pub fn take(&mut self, now: Stamp<HostClock>, event: PortEvent, simulation: &mut Simulation) {
        match event {
            PortEvent::Bytes { peer, bytes, .. } => {
                if self.station.is_some_and(|station| station != peer) {
                    simulation.reopen_link();
                }
                self.station = Some(peer);
                match &mut self.bad {
                    // Its number is for those who keep books.
                    Some(bad) => {
                        bad.offer(End::Station, now, &bytes);
                    }
                    None => simulation.receive(&bytes),
                }
            }
            PortEvent::Up { .. } | PortEvent::Down { .. } => {
                self.station = None;
                simulation.reopen_link();
            }
            PortEvent::Finished { .. } => {}
        }
    }

    /// Sends what the brick has to say, and hands over what a bad cable lets through by now.
    pub fn pass(&mut self, now: Stamp<HostClock>, simulation: &mut Simulation) {
        self.put_in_if_due(now, simulation);
        while let Some(bytes) = simulation.poll() {
            match &mut self.bad {
                Some(bad) => {
                    bad.offer(End::Brick, now, &bytes);
                }
                None => self.send(&bytes),
            }
        }
        while let Some(event) = self.bad.as_mut().and_then(|bad| bad.poll(now)) {
            match event {
                LinkEvent::Arrived { end, delivery } => match end {
                    End::Station => self.send(&delivery.bytes),
                    End::Brick => simulation.receive(&delivery.bytes),
                },
                // As with a radio that loses its other end: nobody is told, it is silent.
                LinkEvent::Down { .. } => {}
                LinkEvent::Up { .. } => simulation.reopen_link(),
            }
        }
        if let Some(bad) = &mut self.bad {
            for end in [End::Station, End::Brick] {
                drop(bad.take_log(end));
            }
        }
    }

    /// Makes the cable as bad as this, or whole; what was on its way through a bad one is lost.
    pub fn impair(&mut self, now: Stamp<HostClock>, profile: Option<&LinkProfile>, seed: u64) {
        self.bad = profile.map(|profile| ImpairedLink::new(profile, seed, now));
    }

    /// Pulls the cable out for so long, if it is one that can be pulled out.
    pub fn pull(&mut self, now: Stamp<HostClock>, duration: Span) {
        if self.again.is_some() {
            // The terminal goes with its port, and whoever reads there is hung up.
            self.port = None;
            self.station = None;
            self.back_at = now + duration;
        }
    }

    fn put_in_if_due(&mut self, now: Stamp<HostClock>, simulation: &mut Simulation) {
        if self.port.is_some() || now < self.back_at {
            return;
        }
        if let Some((config, timer)) = &self.again {
            self.port = Some(Port::new(config.clone(), *timer));
            simulation.reopen_link();
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        if let Some(port) = &mut self.port {
            port.send(bytes);
        }
    }
}
