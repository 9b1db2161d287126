//! Raw bytes from a file, or into one.
//!
//! Plays a captured byte stream as fast as it is asked for, or appends what is sent. A disk always has an answer, so
//! between two chunks the runtime gets a turn: else timers and signals would starve until the file ends. It knows no
//! time stamps: a recording with times is played by the programs that know its format.

use std::fs::{self, OpenOptions};
use std::io::{self, Read, Write};
use std::path::Path;
use std::pin::pin;
use std::task::{Context, Poll, ready};

use posebridge_telemetry::{HostClock, PeerId, Stamp};

use crate::connection::{Connection, Incoming, Outgoing, Outstanding, PortCounters};
use crate::error::{FileKind, LinkLoss, OpenError};
use crate::host_timer::HostTimer;
use crate::transports::{OpenFuture, OpenRequest, RATE, Transport};
use crate::url::{OptionHelp, OptionKind, TargetKind};

/// What to do with the file.
const MODE: OptionHelp = OptionHelp {
    name: "mode",
    kind: OptionKind::Choice { words: &["read", "append"] },
    help: "read plays the file's bytes in, append writes sent frames to its end and makes it if needed",
};

/// How the file is cut; the default is one page.
const CHUNK: OptionHelp = OptionHelp {
    name: "chunk",
    kind: OptionKind::Integer { min: 1, max: 65_536, default: 4_096 },
    help: "bytes per delivered chunk",
};

/// See the module.
pub(crate) struct File;

impl Transport for File {
    fn scheme(&self) -> &'static str {
        "file"
    }
    fn summary(&self) -> &'static str {
        "raw bytes from a file, or sent frames to the end of one"
    }
    fn example(&self) -> &'static str {
        "file://run.bin"
    }
    fn target_kind(&self) -> TargetKind {
        TargetKind::Path
    }
    fn options(&self) -> &'static [OptionHelp] {
        &[MODE, CHUNK, RATE]
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        // Regular files on a local disk answer without delay, so this needs no thread of its own.
        Box::pin(std::future::ready(open(&request)))
    }
}

fn open(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let path = request.url.path();
    let is_appending = request.url.option_text(&MODE) == "append";
    if let Ok(metadata) = path.metadata()
        && !metadata.is_file()
    {
        return Err(OpenError::WrongKind {
            path: path.to_owned(),
            found: FileKind::from(metadata.file_type()),
            wanted: "a regular file",
        });
    }
    let mut options = OpenOptions::new();
    if is_appending {
        options.append(true).create(true);
    } else {
        options.read(true);
    }
    let file = options.open(path).map_err(|error| name_error(path, error))?;
    if is_appending {
        return Ok(Box::new(Appended { file, detail: format!("appending to {}", path.display()), failure: None }));
    }
    Ok(Box::new(Played {
        file,
        detail: format!("playing {}", path.display()),
        chunk_bytes: request.url.integer(&CHUNK) as usize,
        timer: request.timer,
        owes_turn: false,
    }))
}

fn name_error(path: &Path, source: io::Error) -> OpenError {
    if source.kind() == io::ErrorKind::NotFound {
        OpenError::NoSuchFile { path: path.to_owned(), advice: "check the name and the directory" }
    } else if source.kind() == io::ErrorKind::PermissionDenied {
        OpenError::PermissionDenied {
            what: path.display().to_string(),
            advice: "check the file's owner and mode".to_owned(),
        }
    } else {
        OpenError::Io { what: path.display().to_string(), source }
    }
}

/// A file whose bytes come in.
struct Played {
    file: fs::File,
    detail: String,
    chunk_bytes: usize,
    timer: HostTimer,
    /// A chunk was delivered and nobody else has had a turn since.
    owes_turn: bool,
}

impl Played {
    /// Pending once after each chunk; the runtime wakes us when it has looked after timers and sockets.
    fn poll_turn(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        if !self.owes_turn {
            return Poll::Ready(());
        }
        self.owes_turn = false;
        // A future of its own each time: its first poll leaves the waker with the runtime, there is no second.
        pin!(tokio::task::yield_now()).poll(cx)
    }
}

impl Connection for Played {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    /// What is sent to a played file goes nowhere: nobody is there who could have wanted it.
    fn send(&mut self, _out: &Outgoing<'_>, _counters: &mut PortCounters) {}

    fn poll(&mut self, cx: &mut Context<'_>, _counters: &mut PortCounters) -> Poll<Result<Incoming, LinkLoss>> {
        ready!(self.poll_turn(cx));
        self.owes_turn = true;
        let mut bytes = Vec::with_capacity(self.chunk_bytes);
        let chunk = (&mut self.file).take(self.chunk_bytes as u64).read_to_end(&mut bytes);
        Poll::Ready(match chunk {
            Ok(0) => Ok(Incoming::Finished),
            Ok(_) => Ok(Incoming::Bytes { peer: PeerId(0), arrival: self.timer.now(), bytes }),
            Err(error) => Err(error.into()),
        })
    }

    fn outstanding(&self, _now: Stamp<HostClock>) -> Outstanding {
        Outstanding::default()
    }
}

/// A file to whose end frames go.
struct Appended {
    file: fs::File,
    detail: String,
    failure: Option<io::Error>,
}

impl Connection for Appended {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    fn send(&mut self, out: &Outgoing<'_>, counters: &mut PortCounters) {
        let frame = out.frame;
        match self.file.write_all(frame) {
            Ok(()) => counters.bytes_out += frame.len() as u64,
            Err(error) => {
                counters.drops_out += 1;
                self.failure = Some(error);
            }
        }
    }

    fn poll(&mut self, _cx: &mut Context<'_>, _counters: &mut PortCounters) -> Poll<Result<Incoming, LinkLoss>> {
        match self.failure.take() {
            Some(error) => Poll::Ready(Err(error.into())),
            // A failure is noted by `send`, whose caller polls next; nothing else can happen here.
            None => Poll::Pending,
        }
    }

    fn outstanding(&self, _now: Stamp<HostClock>) -> Outstanding {
        Outstanding::default()
    }
}
