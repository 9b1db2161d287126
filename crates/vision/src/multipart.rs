//! The pictures of a stream of the media type `multipart/x-mixed-replace`, as network cameras and phones send it (RFC 2046, section 5.1).
//!
//! A part ends after its Content-Length, or at the next boundary.

/// Longest picture, bytes; a longer one is dropped.
const MAX_PART_BYTES: usize = 8 << 20;
/// Longest header of a part, bytes.
const MAX_HEADER_BYTES: usize = 4_096;
/// Longest blank line behind a header, with the end of the line before it, bytes.
const MAX_BLANK_BYTES: usize = 4;

/// Cuts a stream into parts.
#[derive(Debug)]
pub struct MultipartReader {
    /// With the dashes before it.
    delimiter: Vec<u8>,
    buffer: Vec<u8>,
    state: ReadState,
    /// So many bytes of a part without a length have no boundary.
    searched: usize,
    dropped: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum ReadState {
    /// Before a boundary.
    Between,
    /// In a part with this header.
    Part(PartHeader),
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct PartHeader {
    length: Option<usize>,
    timestamp: Option<String>,
}

/// A part: usually a JPEG picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    pub bytes: Vec<u8>,
    /// The `X-Timestamp` of its header, by the camera's clock in seconds, as ESP32-CAM sends it.
    pub timestamp: Option<String>,
}

impl MultipartReader {
    /// `content_type` is that of the HTTP response; `None` if it has no boundary.
    pub fn new(content_type: &str) -> Option<Self> {
        let parameters = content_type.split(';').skip(1);
        let boundary = parameters.filter_map(|parameter| parameter.split_once('=')).find_map(|(name, value)| {
            name.trim().eq_ignore_ascii_case("boundary").then(|| value.trim().trim_matches('"').to_owned())
        })?;
        // Some cameras write the dashes into the boundary itself.
        let boundary = boundary.trim_start_matches('-');
        (!boundary.is_empty()).then(|| Self {
            delimiter: boundary.as_bytes().to_vec(),
            buffer: Vec::new(),
            state: ReadState::Between,
            searched: 0,
            dropped: 0,
        })
    }

    /// Takes bytes of the stream and passes the parts that they complete to `take`.
    pub fn push(&mut self, bytes: &[u8], mut take: impl FnMut(Part)) {
        self.buffer.extend_from_slice(bytes);
        let mut start = 0;
        while let Some(used) = self.advance(start, &mut take) {
            start += used;
        }
        self.buffer.drain(..start.min(self.buffer.len()));
    }

    /// Parts that were too long, or had no header that makes sense.
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Reads on from `start`: the bytes that were used, or `None` until more come.
    fn advance(&mut self, start: usize, take: &mut impl FnMut(Part)) -> Option<usize> {
        let rest = self.buffer.get(start..).unwrap_or_default();
        let ReadState::Part(header) = &self.state else {
            return self.find_header(start);
        };
        let (length, used) = match header.length {
            Some(length) if rest.len() < length => return None,
            Some(length) => (length, length),
            None => match find(&rest[self.searched.min(rest.len())..], &self.delimiter) {
                Some(at) => (trimmed(&rest[..self.searched + at]), self.searched + at),
                None if rest.len() > MAX_PART_BYTES => {
                    self.dropped += 1;
                    self.searched = 0;
                    self.state = ReadState::Between;
                    return Some(rest.len() - self.delimiter.len());
                }
                None => {
                    // The end of these bytes may be the beginning of a boundary.
                    self.searched = rest.len().saturating_sub(self.delimiter.len());
                    return None;
                }
            },
        };
        take(Part { bytes: rest[..length].to_vec(), timestamp: header.timestamp.clone() });
        self.searched = 0;
        self.state = ReadState::Between;
        Some(used)
    }

    /// Finds the next boundary and the header behind it.
    fn find_header(&mut self, start: usize) -> Option<usize> {
        let rest = self.buffer.get(start..).unwrap_or_default();
        let Some(at) = find(rest, &self.delimiter) else {
            // The end of these bytes may be the beginning of a boundary.
            let used = rest.len().saturating_sub(self.delimiter.len());
            return (used > 0).then_some(used);
        };
        let behind = at + self.delimiter.len();
        // No farther: a stream of nothing but boundaries would else be searched to its end for each of them.
        let header = &rest[behind..rest.len().min(behind + MAX_HEADER_BYTES + MAX_BLANK_BYTES)];
        let ends = [(find(header, b"\r\n\r\n"), 4), (find(header, b"\n\n"), 2)];
        let end = ends.into_iter().filter_map(|(at, length)| Some((at?, length))).min();
        match end {
            Some((length, blank)) if length <= MAX_HEADER_BYTES => {
                let parsed = parse_header(&header[..length]);
                if parsed.length.is_some_and(|length| length > MAX_PART_BYTES) {
                    self.dropped += 1;
                } else {
                    self.state = ReadState::Part(parsed);
                }
                Some(behind + length + blank)
            }
            None if header.len() < MAX_HEADER_BYTES + MAX_BLANK_BYTES => (at > 0).then_some(at),
            _ => {
                self.dropped += 1;
                Some(behind)
            }
        }
    }
}

fn parse_header(bytes: &[u8]) -> PartHeader {
    let mut header = PartHeader::default();
    for line in bytes.split(|byte| *byte == b'\n') {
        let line = String::from_utf8_lossy(line);
        let Some((name, value)) = line.split_once(':') else { continue };
        match name.trim().to_ascii_lowercase().as_str() {
            "content-length" => header.length = value.trim().parse().ok(),
            "x-timestamp" => header.timestamp = Some(value.trim().to_owned()),
            _ => {}
        }
    }
    header
}

/// The length without the line end and the dashes before a boundary.
fn trimmed(part: &[u8]) -> usize {
    let part = part.strip_suffix(b"--").unwrap_or(part);
    let part = part.strip_suffix(b"\n").unwrap_or(part);
    part.strip_suffix(b"\r").unwrap_or(part).len()
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    memchr::memmem::find(bytes, wanted)
}
