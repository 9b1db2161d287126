//! A read-only server of the MAVLink File Transfer Protocol: a few files in memory that describe the vehicle to ground stations.
//!
//! # Model
//! ```text
//!   ListDirectory, OpenFileRO, ReadFile, BurstReadFile, CalcFileCRC32, TerminateSession, ResetSessions  answered
//!   everything that would write                                                                         UnknownCommand
//!   a burst is at most eight answers; the last says that it is complete, and the client asks for the next from there
//! ```
//! A session is opened under the number that the client proposes: clients that let the server choose propose 0, and others insist on
//! theirs. So sessions are kept for each client, [`MAX_OPEN_FILES`] at most, of which the oldest makes room. Of all clients there are as many as
//! [`MAX_SESSIONS`]; then the oldest of the peer with the most makes room, so that nobody ends the transfers of the others. Nothing but an
//! open file is remembered: a request that is repeated gets the same answer.
//!
//! # Source
//! MAVLink guide, "File Transfer Protocol (FTP)": opcodes, errors, payload. The checksum is that of ISO-HDLC (polynomial 04C11DB7, reflected) without
//! inversion before and after, as the flight stacks compute it.

use std::collections::VecDeque;
use std::sync::Arc;

use super::output::SessionSender;
use crate::dialect::vehicle::FILE_DATA;
use crate::message::FileTransfer;

/// Frames that answer one burst request, at most.
const MAX_BURST_FRAMES: usize = 8;
/// Sessions of one client at a time: a ground station transfers one file after another.
const MAX_OPEN_FILES: usize = 2;
/// Sessions at a time, over all clients.
const MAX_SESSIONS: usize = 16;

mod opcode {
    pub(super) const NONE: u8 = 0;
    pub(super) const TERMINATE_SESSION: u8 = 1;
    pub(super) const RESET_SESSIONS: u8 = 2;
    pub(super) const LIST_DIRECTORY: u8 = 3;
    pub(super) const OPEN_FILE_RO: u8 = 4;
    pub(super) const READ_FILE: u8 = 5;
    pub(super) const CALC_FILE_CRC32: u8 = 14;
    pub(super) const BURST_READ_FILE: u8 = 15;
    pub(super) const ACK: u8 = 128;
    pub(super) const NAK: u8 = 129;
}

/// Why a request is refused: the error codes of the guide.
#[derive(Clone, Copy)]
enum Refusal {
    InvalidDataSize = 3,
    InvalidSession = 4,
    EndOfFile = 6,
    UnknownCommand = 7,
    FileNotFound = 10,
}

/// A file that is served, in the root folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServedFile {
    /// Without a slash.
    pub name: &'static str,
    pub content: Vec<u8>,
}

#[derive(Clone, Copy, Debug)]
struct OpenFile {
    client: SessionSender,
    session: u8,
    /// Its place among the files.
    file: usize,
}

#[derive(Debug)]
pub(super) struct FileServer {
    files: Arc<[ServedFile]>,
    open: VecDeque<OpenFile>,
}

/// Frames that answer a request, at most.
pub(super) const fn max_frames(request: &FileTransfer) -> usize {
    if request.opcode == opcode::BURST_READ_FILE { MAX_BURST_FRAMES } else { 1 }
}

/// What one request is answered with.
struct Answer {
    offset: u32,
    data: Vec<u8>,
    burst_complete: bool,
}

impl Answer {
    const fn of(data: Vec<u8>) -> Self {
        Self { offset: 0, data, burst_complete: false }
    }
}

impl FileServer {
    pub(super) const fn new(files: Arc<[ServedFile]>) -> Self {
        Self { files, open: VecDeque::new() }
    }

    /// The answers to a message of `client`; none if it is an answer itself.
    pub(super) fn answer(&mut self, client: SessionSender, request: &FileTransfer) -> Vec<FileTransfer> {
        if matches!(request.opcode, opcode::ACK | opcode::NAK) {
            return Vec::new();
        }
        let outcome = if usize::from(request.size) > FILE_DATA {
            Err(Refusal::InvalidDataSize)
        } else {
            self.carry_out(client, request)
        };
        let empty = FileTransfer {
            target: client.address,
            sequence: request.sequence.wrapping_add(1),
            session: request.session,
            opcode: opcode::ACK,
            size: 0,
            requested_opcode: request.opcode,
            burst_complete: 0,
            offset: request.offset,
            data: Vec::new(),
        };
        match outcome {
            Ok(answers) => {
                let answers = (0..).zip(answers).map(|(number, answer)| FileTransfer {
                    sequence: empty.sequence.wrapping_add(number),
                    size: answer.data.len() as u8,
                    burst_complete: u8::from(answer.burst_complete),
                    offset: answer.offset,
                    data: answer.data,
                    ..empty
                });
                answers.collect()
            }
            Err(why) => vec![FileTransfer { opcode: opcode::NAK, size: 1, data: vec![why as u8], ..empty }],
        }
    }

    fn carry_out(&mut self, client: SessionSender, request: &FileTransfer) -> Result<Vec<Answer>, Refusal> {
        let one = |data| Ok(vec![Answer::of(data)]);
        match request.opcode {
            opcode::NONE => one(Vec::new()),
            opcode::TERMINATE_SESSION => {
                self.open.retain(|open| open.client != client || open.session != request.session);
                one(Vec::new())
            }
            opcode::RESET_SESSIONS => {
                self.open.retain(|open| open.client != client);
                one(Vec::new())
            }
            opcode::LIST_DIRECTORY => self.list(request),
            opcode::OPEN_FILE_RO => {
                let file = self.find(request)?;
                let length = self.files.get(file).map_or(0, |file| file.content.len());
                self.open.retain(|open| open.client != client || open.session != request.session);
                self.open.push_back(OpenFile { client, session: request.session, file });
                self.close_excess(client);
                one((length as u32).to_le_bytes().to_vec())
            }
            opcode::CALC_FILE_CRC32 => {
                let file = self.find(request)?;
                let crc = self.files.get(file).map_or(0, |file| crc32(0, &file.content));
                one(crc.to_le_bytes().to_vec())
            }
            opcode::READ_FILE => {
                let (data, _) = self.read(client, request, request.offset)?;
                Ok(vec![Answer { offset: request.offset, data, burst_complete: false }])
            }
            opcode::BURST_READ_FILE => self.burst(client, request),
            _ => Err(Refusal::UnknownCommand),
        }
    }

    /// Closes the oldest file of `client` if it has too many open, else that of the peer with the most if all together have.
    fn close_excess(&mut self, client: SessionSender) {
        let excess = if self.open.iter().filter(|open| open.client == client).count() > MAX_OPEN_FILES {
            self.open.iter().position(|open| open.client == client)
        } else if self.open.len() > MAX_SESSIONS {
            // By peers, because one peer may send under many addresses.
            let count = |peer| self.open.iter().filter(|open| open.client.peer == peer).count();
            let most = self.open.iter().map(|open| count(open.client.peer)).max();
            self.open.iter().position(|open| Some(count(open.client.peer)) == most)
        } else {
            None
        };
        if let Some(excess) = excess {
            self.open.remove(excess);
        }
    }

    /// The part of a session's file from `offset` on, and whether the file ends with it.
    fn read(&self, client: SessionSender, request: &FileTransfer, offset: u32) -> Result<(Vec<u8>, bool), Refusal> {
        let open = self.open.iter().find(|open| open.client == client && open.session == request.session);
        let file = open.and_then(|open| self.files.get(open.file)).ok_or(Refusal::InvalidSession)?;
        let rest = file.content.get(offset as usize..).filter(|rest| !rest.is_empty()).ok_or(Refusal::EndOfFile)?;
        let wanted = if request.size == 0 { FILE_DATA } else { usize::from(request.size) };
        let part = &rest[..wanted.min(rest.len())];
        Ok((part.to_vec(), part.len() == rest.len()))
    }

    fn burst(&self, client: SessionSender, request: &FileTransfer) -> Result<Vec<Answer>, Refusal> {
        let mut answers = Vec::new();
        let mut offset = request.offset;
        while answers.len() < MAX_BURST_FRAMES {
            let (data, is_last) = self.read(client, request, offset)?;
            let next = offset.saturating_add(data.len() as u32);
            let burst_complete = is_last || answers.len() + 1 == MAX_BURST_FRAMES;
            answers.push(Answer { offset, data, burst_complete });
            if is_last {
                break;
            }
            offset = next;
        }
        Ok(answers)
    }

    /// The entries of the root folder from the one on whose number is the offset.
    fn list(&self, request: &FileTransfer) -> Result<Vec<Answer>, Refusal> {
        if !path_of(request)?.is_empty() {
            return Err(Refusal::FileNotFound);
        }
        let mut data = Vec::new();
        for file in self.files.iter().skip(request.offset as usize) {
            let entry = format!("F{}\t{}\0", file.name, file.content.len());
            if data.len() + entry.len() > FILE_DATA {
                break;
            }
            data.extend_from_slice(entry.as_bytes());
        }
        if data.is_empty() {
            return Err(Refusal::EndOfFile);
        }
        Ok(vec![Answer { offset: request.offset, data, burst_complete: false }])
    }

    fn find(&self, request: &FileTransfer) -> Result<usize, Refusal> {
        let path = path_of(request)?;
        self.files.iter().position(|file| file.name.as_bytes() == path).ok_or(Refusal::FileNotFound)
    }
}

/// The path in a request, without the slash or the dot of the root folder.
fn path_of(request: &FileTransfer) -> Result<&[u8], Refusal> {
    let held = request.data.get(..usize::from(request.size)).unwrap_or(&request.data);
    let path = held.split(|byte| *byte == 0).next().unwrap_or_default();
    let path = path.strip_prefix(b".").filter(|rest| rest.is_empty() || rest.starts_with(b"/")).unwrap_or(path);
    let path = path.strip_prefix(b"/").unwrap_or(path);
    if path.starts_with(b"/") { Err(Refusal::FileNotFound) } else { Ok(path) }
}

/// Continues a checksum over more bytes; it begins with 0.
pub fn crc32(crc: u32, bytes: &[u8]) -> u32 {
    bytes.iter().fold(crc, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 })
    })
}
