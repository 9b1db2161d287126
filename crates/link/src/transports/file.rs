//! Raw bytes from a file, or to one.
//!
//! Plays a captured byte stream at full speed, or appends sent frames. Reads never block, so the task yields to the
//! runtime between two chunks; otherwise timers and signals would starve until the end of the file. There are no
//! timestamps: recordings with times are played by the programs that know their format.

use std::fs::{self, OpenOptions};
use std::io::{self, Read, Write};
use std::path::Path;
use std::pin::pin;
use std::task::{Context, Poll, ready};

use posebridge_telemetry::{HostClock, PeerId, Timestamp};

use crate::connection::{Connection, LinkCounters, OutgoingFrame, QueueStatus, ReceivedBytes};
use crate::error::{FileKind, LinkError, OpenError};
use crate::host_timer::HostTimer;
use crate::transport::{CHUNK, MODE};
use crate::transports::open_request::OpenRequest;

pub(super) fn open(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let path = request.url.path();
    let is_appending = request.url.option_text(&MODE) == "append";
    if let Ok(metadata) = path.metadata()
        && !metadata.is_file()
    {
        return Err(OpenError::WrongFileKind {
            path: path.to_owned(),
            found: FileKind::from(metadata.file_type()),
            expected: "a regular file",
        });
    }
    let mut options = OpenOptions::new();
    if is_appending {
        options.append(true).create(true);
    } else {
        options.read(true);
    }
    let file = options.open(path).map_err(|error| classify_error(path, error))?;
    if is_appending {
        return Ok(Box::new(FileAppender { file, detail: format!("appending to {}", path.display()), failure: None }));
    }
    Ok(Box::new(FilePlayback {
        file,
        detail: format!("playing {}", path.display()),
        chunk_bytes: request.url.integer(&CHUNK) as usize,
        timer: request.timer,
        must_yield: false,
    }))
}

fn classify_error(path: &Path, source: io::Error) -> OpenError {
    if source.kind() == io::ErrorKind::NotFound {
        OpenError::FileNotFound { path: path.to_owned(), advice: "check the name and the directory" }
    } else if source.kind() == io::ErrorKind::PermissionDenied {
        OpenError::PermissionDenied {
            what: path.display().to_string(),
            advice: "check the file's owner and mode".to_owned(),
        }
    } else {
        OpenError::Io { what: path.display().to_string(), source }
    }
}

struct FilePlayback {
    file: fs::File,
    detail: String,
    chunk_bytes: usize,
    timer: HostTimer,
    /// A chunk was delivered, and the runtime has not run other tasks since.
    must_yield: bool,
}

impl FilePlayback {
    /// Pending once after each chunk; the runtime wakes this task after it has polled timers and sockets.
    fn poll_yield(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        if !self.must_yield {
            return Poll::Ready(());
        }
        self.must_yield = false;
        // A future of its own each time: its first poll leaves the waker with the runtime, there is no second.
        pin!(tokio::task::yield_now()).poll(cx)
    }
}

impl Connection for FilePlayback {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    /// Frames sent to a played file are discarded.
    fn send(&mut self, _out: &OutgoingFrame<'_>, _counters: &mut LinkCounters) {}

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        _counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        ready!(self.poll_yield(cx));
        self.must_yield = true;
        let mut bytes = Vec::with_capacity(self.chunk_bytes);
        let chunk = (&mut self.file).take(self.chunk_bytes as u64).read_to_end(&mut bytes);
        Poll::Ready(match chunk {
            Ok(0) => Ok(None),
            Ok(_) => Ok(Some(ReceivedBytes { peer: PeerId(0), arrival: self.timer.now(), bytes })),
            Err(error) => Err(error.into()),
        })
    }

    fn queue_status(&self, _now: Timestamp<HostClock>) -> QueueStatus {
        QueueStatus::default()
    }
}

struct FileAppender {
    file: fs::File,
    detail: String,
    failure: Option<io::Error>,
}

impl Connection for FileAppender {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    fn send(&mut self, out: &OutgoingFrame<'_>, counters: &mut LinkCounters) {
        let frame = out.frame;
        match self.file.write_all(frame) {
            Ok(()) => counters.bytes_out += frame.len() as u64,
            Err(error) => {
                counters.drops_out += 1;
                self.failure = Some(error);
            }
        }
    }

    fn poll(
        &mut self,
        _cx: &mut Context<'_>,
        _counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        match self.failure.take() {
            Some(error) => Poll::Ready(Err(error.into())),
            // A failure is noted by `send`, whose caller polls next; nothing else can happen here.
            None => Poll::Pending,
        }
    }

    fn queue_status(&self, _now: Timestamp<HostClock>) -> QueueStatus {
        QueueStatus::default()
    }
}
