//! The simulated brick in real time, behind a real link: its own thread when it is embedded, the whole process in `posebridge sim`.

mod cable;
mod embedded;
mod hands;

use posebridge_link::{HostTimer, Port, PortEvent};
use posebridge_sim::{STEP, Simulation};
use posebridge_telemetry::{HostClock, Span, Stamp};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

pub use self::cable::Cable;
pub use self::embedded::EmbeddedBrick;
pub use self::hands::{CommandSender, Hands, LiveTruth, Reach, WAITING_COMMANDS, hands};

/// The world is stepped in bites of this length: the host's timers are a millisecond wide, and telemetry of 200 Hz is still on time.
const BITE: Span = Span::from_millis(2);
/// After the path's end the brick still talks for this long, so that the last late fixes are used.
const AFTERGLOW: Span = Span::from_millis(600);

/// Time between two announcements.
const ANNOUNCED_EACH: Span = Span::from_millis(1_000);

/// The links of a simulated brick, open.
pub struct BrickPorts {
    /// To the station.
    pub brick: Cable,
    /// The camera's own, where it does not share the brick's. Without it nobody hears such a camera.
    pub camera: Option<Port>,
    /// Where the camera's images go, if another program looks through it.
    pub images: Option<Port>,
    /// Where the brick is announced.
    pub announcement: Option<Announcement>,
}

/// A text that is sent again and again.
pub struct Announcement {
    port: Port,
    text: Vec<u8>,
    due: Span,
}

impl Announcement {
    /// Sends `text` on `port` from now on.
    #[must_use]
    pub const fn new(port: Port, text: Vec<u8>) -> Self {
        Self { port, text, due: Span::ZERO }
    }

    fn send_if_due(&mut self, elapsed: Span) {
        if elapsed >= self.due {
            self.due = elapsed + ANNOUNCED_EACH;
            self.port.send(&self.text);
        }
    }
}

impl BrickPorts {
    /// The brick's link alone.
    #[must_use]
    pub const fn of(brick: Cable) -> Self {
        Self { brick, camera: None, images: None, announcement: None }
    }

    /// Waits for something to happen and gives it to the simulation, which lives until then first.
    async fn serve(&mut self, simulation: &mut Simulation, (timer, start): (HostTimer, Stamp<HostClock>)) {
        tokio::select! {
            event = self.brick.next() => {
                let now = timer.now();
                step_to(simulation, now - start);
                self.brick.take(now, event, simulation);
            }
            event = next_of(self.camera.as_mut()) => {
                step_to(simulation, timer.now() - start);
                if let PortEvent::Bytes { bytes, .. } = event {
                    simulation.receive_camera(&bytes);
                }
            }
            // Nobody answers an image. Polled, the port takes whoever calls.
            _ = next_of(self.images.as_mut()) => {}
            // Nobody answers an announcement there; polled, the port comes back after a loss.
            _ = next_of(self.announcement.as_mut().map(|announcement| &mut announcement.port)) => {}
        }
    }

    /// Sends what brick and camera have to say.
    fn send_all(&mut self, now: Stamp<HostClock>, simulation: &mut Simulation) {
        self.brick.pass(now, simulation);
        while let Some(bytes) = simulation.poll_camera() {
            if let Some(camera) = &mut self.camera {
                camera.send(&bytes);
            }
        }
        while let Some(image) = simulation.poll_image() {
            if let Some(port) = &mut self.images {
                port.send(format!("{image}\n").as_bytes());
            }
        }
        if let Some(announcement) = &mut self.announcement {
            announcement.send_if_due(simulation.elapsed());
        }
    }
}

/// The next event of a port; never, without one.
async fn next_of(port: Option<&mut Port>) -> PortEvent {
    match port {
        Some(port) => port.next().await,
        None => std::future::pending().await,
    }
}

/// Who can reach a brick while it drives.
pub struct Company<'a> {
    /// Cancelled when it has to stop.
    pub stop: &'a CancellationToken,
    /// Told how much of the path is driven, 0 to 1.
    pub progress: &'a watch::Sender<f64>,
    /// Whoever may do things to it, if anybody.
    pub reach: Option<Reach>,
}

/// Drives a simulation in real time on its ports, until its path ends or somebody stops it.
pub async fn drive(simulation: &mut Simulation, ports: &mut BrickPorts, timer: HostTimer, mut company: Company<'_>) {
    let start = timer.now();
    let mut ends_at: Option<Stamp<HostClock>> = None;
    loop {
        let bite_end = start + simulation.elapsed() + BITE;
        tokio::select! {
            () = ports.serve(simulation, (timer, start)) => {}
            () = timer.sleep_until(bite_end) => step_to(simulation, timer.now() - start),
            () = company.stop.cancelled() => return,
        }
        let now = timer.now();
        if let Some(reach) = &mut company.reach {
            reach.carry_out(now, simulation, &mut ports.brick);
            reach.show(start, simulation);
        }
        ports.send_all(now, simulation);
        company.progress.send_replace(simulation.progress());
        if simulation.is_finished() {
            let end = *ends_at.get_or_insert(now + AFTERGLOW);
            if now >= end {
                return;
            }
        }
    }
}

/// The world follows the host's clock and never runs ahead of it: nothing may be sent before it was measured.
fn step_to(simulation: &mut Simulation, elapsed: Span) {
    while simulation.elapsed() + STEP <= elapsed {
        simulation.step();
    }
}
