//! The cable between a simulated brick and its end of the link: intact, impaired by a profile, or disconnected.

use anyhow::Result;
use posebridge_link::{HostTimer, Link, LinkEvent, LinkOpenConfig};
use posebridge_sim::Simulation;
use posebridge_sim::impairment::{ImpairedLink, ImpairedLinkEvent, LinkEnd, LinkProfile};
use posebridge_telemetry::{HostClock, PeerId, TimeDelta, Timestamp};

pub struct SimulatedCable {
    port: Option<Link>,
    /// Settings for reconnection; a port that another program opened stays open.
    reopen_config: Option<(LinkOpenConfig, HostTimer)>,
    replug_at: Timestamp<HostClock>,
    station: Option<PeerId>,
    impairment: Option<ImpairedLink>,
}

impl SimulatedCable {
    pub const fn fixed(port: Link) -> Self {
        Self { port: Some(port), reopen_config: None, replug_at: Timestamp::ZERO, station: None, impairment: None }
    }

    pub fn pluggable(config: LinkOpenConfig, timer: HostTimer) -> Self {
        Self { reopen_config: Some((config.clone(), timer)), ..Self::fixed(Link::new(config, timer)) }
    }

    /// Opens the port at its end for the first time.
    pub async fn open_first(&mut self) -> Result<()> {
        match &mut self.port {
            Some(port) => Ok(port.try_open().await?),
            None => Ok(()),
        }
    }

    /// The next event of the port; pending while disconnected.
    pub async fn next_event(&mut self) -> LinkEvent {
        match &mut self.port {
            Some(port) => port.next_event().await,
            None => std::future::pending().await,
        }
    }

    pub fn on_link_event(&mut self, now: Timestamp<HostClock>, event: LinkEvent, simulation: &mut Simulation) {
        match event {
            LinkEvent::Bytes { peer, bytes, .. } => {
                if self.station.is_some_and(|station| station != peer) {
                    simulation.reopen_link();
                }
                self.station = Some(peer);
                match &mut self.impairment {
                    // Its number is for those who keep books.
                    Some(impaired) => {
                        impaired.offer(LinkEnd::Station, now, &bytes);
                    }
                    None => simulation.receive(&bytes),
                }
            }
            LinkEvent::Up { .. } | LinkEvent::Down { .. } => {
                self.station = None;
                simulation.reopen_link();
            }
            LinkEvent::Finished { .. } => {}
        }
    }

    /// Sends the brick's bytes, and delivers what has arrived through an impaired cable by `now`.
    pub fn transfer(&mut self, now: Timestamp<HostClock>, simulation: &mut Simulation) {
        self.replug_if_due(now, simulation);
        while let Some(bytes) = simulation.poll() {
            match &mut self.impairment {
                Some(impaired) => {
                    impaired.offer(LinkEnd::Brick, now, &bytes);
                }
                None => self.send(&bytes),
            }
        }
        while let Some(event) = self.impairment.as_mut().and_then(|impaired| impaired.poll(now)) {
            match event {
                ImpairedLinkEvent::Arrived { end, delivery } => match end {
                    LinkEnd::Station => self.send(&delivery.bytes),
                    LinkEnd::Brick => simulation.receive(&delivery.bytes),
                },
                // As with a radio that loses its other end: nothing is reported, it is silent.
                ImpairedLinkEvent::Down { .. } => {}
                ImpairedLinkEvent::Up { .. } => simulation.reopen_link(),
            }
        }
        if let Some(impaired) = &mut self.impairment {
            for end in [LinkEnd::Station, LinkEnd::Brick] {
                drop(impaired.take_log(end));
            }
        }
    }

    /// Impairs the cable, or restores it; bytes in transit through an impaired one are lost.
    pub fn impair(&mut self, now: Timestamp<HostClock>, profile: Option<&LinkProfile>, seed: u64) {
        self.impairment = profile.map(|profile| ImpairedLink::new(profile, seed, now));
    }

    /// Disconnects the cable for `duration`, if it can be disconnected.
    pub fn unplug(&mut self, now: Timestamp<HostClock>, duration: TimeDelta) {
        if self.reopen_config.is_some() {
            // The terminal disappears with its port, and its reader gets a hang-up.
            self.port = None;
            self.station = None;
            self.replug_at = now + duration;
        }
    }

    fn replug_if_due(&mut self, now: Timestamp<HostClock>, simulation: &mut Simulation) {
        if self.port.is_some() || now < self.replug_at {
            return;
        }
        if let Some((config, timer)) = &self.reopen_config {
            self.port = Some(Link::new(config.clone(), *timer));
            simulation.reopen_link();
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        if let Some(port) = &mut self.port {
            port.send(bytes);
        }
    }
}
