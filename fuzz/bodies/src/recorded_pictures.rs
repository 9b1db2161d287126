//! Recorded pictures: any bytes as a video, a PNG picture or a table of times end in frames that can be, or in an error that says where.

use std::fmt::Write as _;
use std::io::Read;

use posebridge_vision::{
    AviCutOff, AviReader, GreyPicture, PictureTimesError, VideoFrame, Y4mReader, parse_picture_times,
};

/// Larger pictures take too long; a video that has one is read no further.
const MAX_SIDE: usize = 400;
const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1A\n";

/// What a reader gives: each frame with the sum of its pixels, and its errors.
#[derive(Debug, Default, PartialEq)]
struct Reading {
    frames: Vec<(VideoFrame, u64)>,
    errors: Vec<String>,
    cut_off: Option<AviCutOff>,
}

impl Reading {
    /// Returns false after the last frame that is wanted.
    fn push<E: ToString>(&mut self, frame: Result<Option<VideoFrame>, E>, picture: &GreyPicture) -> bool {
        match (frame, picture.image()) {
            (Ok(Some(frame)), Some(image)) => {
                assert!(image.width() > 0 && image.height() > 0);
                let pixels = (0..image.height()).flat_map(|y| image.row(y));
                self.frames.push((frame, pixels.map(|pixel| u64::from(*pixel)).sum()));
                image.width().max(image.height()) <= MAX_SIDE
            }
            (Ok(None), None) => false,
            (Err(error), None) => {
                self.errors.push(error.to_string());
                true
            }
            (_, image) => panic!("a picture is there without its frame, or is not: {}", image.is_some()),
        }
    }

    fn check(&self, bytes: &[u8]) {
        let frames = self.frames.iter().map(|(frame, _)| frame);
        assert!(frames.clone().all(|frame| frame.offset < bytes.len() as u64), "{self:?}");
        let is_behind = |one: &VideoFrame, next: &VideoFrame| {
            one.number < next.number && one.time_s < next.time_s && one.offset < next.offset
        };
        assert!(frames.is_sorted_by(|one, next| is_behind(one, next)), "{self:?}");
        let count = self.frames.len() + self.errors.len();
        assert!(count <= 1 + bytes.len() / 6, "{count} frames and errors from {} bytes", bytes.len());
    }
}

/// Gives at most so many bytes at a time.
struct Trickle<'a> {
    bytes: &'a [u8],
    most: usize,
}

impl Read for Trickle<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let most = self.most.min(buffer.len());
        self.bytes.read(&mut buffer[..most])
    }
}

/// Input: how many bytes come at a time, then the file.
pub(crate) fn check_avi(data: &[u8]) {
    check_video(data, |input| {
        let mut reading = Reading::default();
        match AviReader::new(input) {
            Ok(mut reader) => {
                assert!(reader.rate().frames_per_second() > 0.0);
                let mut picture = GreyPicture::default();
                while reading.push(reader.read_frame(&mut picture), &picture) {}
                reading.cut_off = reader.cut_off();
            }
            Err(error) => reading.errors.push(error.to_string()),
        }
        reading
    });
}

/// Input: how many bytes come at a time, then the stream.
pub(crate) fn check_y4m(data: &[u8]) {
    check_video(data, |input| {
        let mut reading = Reading::default();
        match Y4mReader::new(input) {
            Ok(mut reader) => {
                let mut picture = GreyPicture::default();
                while reading.push(reader.read_frame(&mut picture), &picture) {}
                assert!(reading.errors.len() <= 1, "nothing comes after an error");
            }
            Err(error) => reading.errors.push(error.to_string()),
        }
        reading
    });
}

fn check_video(data: &[u8], read: impl Fn(Trickle<'_>) -> Reading) {
    let [most, bytes @ ..] = data else {
        return;
    };
    let whole = read(Trickle { bytes, most: usize::MAX });
    whole.check(bytes);
    let most = usize::from(*most) + 1;
    assert_eq!(read(Trickle { bytes, most }), whole, "{most} bytes at a time");
}

pub(crate) fn check_png(bytes: &[u8]) {
    // Else it would be another format, which the target `pictures` tries.
    let png = [PNG_SIGNATURE, bytes.strip_prefix(PNG_SIGNATURE).unwrap_or(bytes)].concat();
    let (mut picture, mut used) = (GreyPicture::default(), GreyPicture::default());
    let decoded = picture.decode(&png);
    assert_eq!(decoded.is_ok(), picture.image().is_some(), "{decoded:?}");
    assert!(used.decode(b"P5 3 2 255\nabcdef").is_ok());
    assert_eq!(used.decode(&png).is_ok(), decoded.is_ok());
    if decoded.is_ok() {
        assert!(used == picture, "the picture before changes the next one");
    }
}

pub(crate) fn check_picture_times(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let times = match parse_picture_times(&text) {
        Ok(times) => times,
        Err(PictureTimesError::Header { line } | PictureTimesError::Row { line, .. }) => {
            assert!((1..=text.lines().count() as u64 + 1).contains(&line), "line {line}");
            return;
        }
    };
    assert!(times.len() <= text.len() / 3);
    assert!(times.is_sorted_by(|one, next| one.time_s <= next.time_s));
    let mut written = "file,time_s\n".to_owned();
    for row in &times {
        // Writing to a String cannot fail.
        let _ = writeln!(written, "\"{}\",{:?}", row.file.replace('"', "\"\""), row.time_s);
    }
    assert!(parse_picture_times(&written).is_ok_and(|again| again == times), "{written}");
}
