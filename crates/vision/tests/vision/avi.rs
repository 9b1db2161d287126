//! MJPEG in AVI by OpenCV, ffmpeg and by hand, whole, cut and damaged.

use std::io::Read;

use allocation_counter::measure;
use posebridge_vision::{AviCutOff, AviReader, GreyPicture};
use proptest::prelude::*;

use crate::recorded::{Damage, MAX_PICTURE_MEMORY, Reading, trickle, worst_difference};

const OPENCV_AVI: (&[u8], &[u8]) = recorded!("opencv", "avi");

fn read_avi(input: impl Read) -> Reading {
    let mut reading = Reading::default();
    match AviReader::new(input) {
        Ok(mut reader) => {
            let mut picture = GreyPicture::default();
            loop {
                let errors = reading.errors.len();
                if !reading.push(reader.read_frame(&mut picture), &picture) && reading.errors.len() == errors {
                    break;
                }
            }
            assert!(reader.read_frame(&mut picture).unwrap().is_none(), "there is nothing behind the end");
            reading.cut_off = reader.cut_off();
        }
        Err(error) => reading.errors.push(error.to_string()),
    }
    reading
}

#[test]
fn avi_has_the_brightness_that_ffmpeg_decodes() {
    let (twelfth, ntsc) = (1.0 / 12.0, 1_001.0 / 30_000.0);
    for ((bytes, grey), interval_s, cut_off) in [
        (OPENCV_AVI, twelfth, None),
        ((include_bytes!("../data/recorded/two_riffs.avi"), OPENCV_AVI.1), twelfth, None),
        (recorded!("ffmpeg", "avi"), ntsc, None),
        (recorded!("piped", "avi"), ntsc, Some(AviCutOff::Unfinished)),
    ] {
        let whole = read_avi(bytes);
        assert_eq!((&whole.errors[..], whole.frames.len(), whole.cut_off), (&[][..], 3, cut_off));
        let pixels: Vec<u8> = whole.frames.iter().flat_map(|(_, pixels)| pixels).copied().collect();
        assert!(worst_difference(&pixels, grey) <= 2);
        assert!(
            whole.times().iter().zip(0..).all(|(time_s, index)| (time_s - f64::from(index) * interval_s).abs() < 1e-12)
        );
        for (frame, _) in &whole.frames {
            let chunk = &bytes[frame.offset as usize..];
            assert!(chunk[2..].starts_with(b"dc") && chunk[8..].starts_with(b"\xFF\xD8"), "{frame:?}");
        }
        for most in (1..64).chain([1_000, 4_000, bytes.len() - 1, bytes.len()]) {
            assert_eq!(read_avi(trickle(bytes, most)), whole, "{most} bytes at a time");
        }
    }
    assert_eq!(AviReader::new(OPENCV_AVI.0).unwrap().rate().frames_per_second(), 12.0);
}

#[test]
fn avi_that_is_cut_gives_its_whole_frames_and_says_so() {
    let (bytes, _) = OPENCV_AVI;
    let whole = read_avi(bytes);
    let ends: Vec<usize> = whole.frames.iter().map(|(frame, _)| chunk_end(bytes, frame.offset as usize)).collect();
    let movi = whole.frames[0].0.offset as usize;
    for length in 0..bytes.len() {
        let cut = read_avi(&bytes[..length]);
        if length < movi {
            assert_eq!(cut.errors.len(), 1, "{length}");
            continue;
        }
        assert_eq!(cut.errors, [""; 0]);
        let count = ends.iter().filter(|end| **end <= length).count();
        assert_eq!(cut.frames, whole.frames[..count], "{length}");
        assert!(cut.cut_off.is_some(), "{length}");
    }
    let cut_off = |bytes: &[u8]| read_avi(bytes).cut_off.unwrap().to_string();
    let in_chunk = cut_off(&bytes[..ends[1] - 4]);
    assert_eq!(in_chunk, format!("the file ends at byte {}, 4 bytes before the end of a chunk", ends[1] - 4));
    let between = format!("the file ends at byte {}; by its header it ends at {}", ends[1], bytes.len());
    assert_eq!(cut_off(&bytes[..ends[1]]), between);
}

#[test]
fn avi_whose_writer_did_not_finish_gives_what_it_has() {
    let (bytes, _) = OPENCV_AVI;
    let whole = read_avi(bytes);
    let movi = whole.frames[0].0.offset as usize - 8;
    let mut unfinished = bytes.to_vec();
    unfinished[4..8].fill(0);
    unfinished[movi..movi + 4].fill(0);
    assert_eq!(read_avi(&unfinished[..]), Reading { cut_off: Some(AviCutOff::Unfinished), ..read_avi(bytes) });
    // The last chunk was being written when the power went, and the file system fills up with zeros.
    let last = whole.frames[2].0.offset as usize;
    unfinished[last + 4..last + 8].fill(0);
    let cut = read_avi(&unfinished[..]);
    assert_eq!(cut.frames, whole.frames[..2]);
    assert_eq!(cut.cut_off, Some(AviCutOff::NoChunk { offset: last as u64 + 8 }));
    unfinished.truncate(last);
    unfinished.extend([0; 100]);
    assert_eq!(read_avi(&unfinished[..]).cut_off, Some(AviCutOff::NoChunk { offset: last as u64 }));
    // Behind the end of a whole file there may be anything.
    let padded = [bytes, &[0; 100]].concat();
    assert_eq!(read_avi(&padded[..]), whole);
}

/// Where the chunk that begins here ends, without the byte that rounds it up.
fn chunk_end(bytes: &[u8], at: usize) -> usize {
    let size = u32::from_le_bytes(bytes[at + 4..at + 8].try_into().unwrap());
    at + 8 + size as usize
}

fn chunk(id: &[u8], content: &[u8]) -> Vec<u8> {
    let padding = &[0][..content.len() % 2];
    [id, &(content.len() as u32).to_le_bytes(), content, padding].concat()
}

fn list(name: &[u8], kind: &[u8], chunks: &[Vec<u8>]) -> Vec<u8> {
    chunk(name, &[kind.to_vec(), chunks.concat()].concat())
}

/// An AVI file with sound, pictures of this codec, and these chunks; `rate` is that of the stream, then the microseconds of the file.
fn avi(codec: [u8; 4], rate: [u32; 3], rows: i32, movie: &[Vec<u8>]) -> Vec<u8> {
    let strh = |kind: &[u8], scale: u32, rate: u32| {
        chunk(b"strh", &[kind, &[0; 16], &scale.to_le_bytes()[..], &rate.to_le_bytes(), &[0; 28]].concat())
    };
    let bitmap = [&[0; 8], &rows.to_le_bytes()[..], &[0; 4], &codec, &[0; 20]].concat();
    let streams = [
        list(b"LIST", b"strl", &[strh(b"auds", 1, 8_000), chunk(b"strf", &[0; 17])]),
        list(b"LIST", b"strl", &[strh(b"vids", rate[1], rate[0]), chunk(b"strf", &bitmap)]),
    ];
    let avih = chunk(b"avih", &rate[2].to_le_bytes().iter().copied().chain([0; 52]).collect::<Vec<u8>>());
    let header = list(b"LIST", b"hdrl", &[avih, streams.concat()]);
    let info = list(b"LIST", b"INFO", &[b"not chunks".to_vec()]);
    list(b"RIFF", b"AVI ", &[header, info, list(b"LIST", b"movi", movie)])
}

/// The first picture of OpenCV's file.
fn jpeg() -> &'static [u8] {
    let at = read_avi(OPENCV_AVI.0).frames[0].0.offset as usize;
    &OPENCV_AVI.0[at + 8..chunk_end(OPENCV_AVI.0, at)]
}

#[test]
fn avi_chunks_in_lists_of_odd_length_and_of_other_streams_are_told_apart() {
    let odd: Vec<u8> = [jpeg(), &[0][..(jpeg().len() + 1) % 2]].concat();
    let movie = [
        chunk(b"00wb", b"sound"),
        list(b"LIST", b"rec ", &[chunk(b"01dc", &odd), chunk(b"00wb", b"odd")]),
        chunk(b"01dc", b""),
        chunk(b"JUNK", b"01dc"),
        chunk(b"02dc", jpeg()),
        chunk(b"01wb", jpeg()),
        chunk(b"01dc", b"no picture"),
        chunk(b"01db", &odd),
        chunk(b"ix01", b"index"),
    ];
    for (codec, rate) in [(*b"MJPG", [10, 1, 0]), (*b"mjpg", [0, 1, 100_000]), (*b"mJpG", [10, 0, 100_000])] {
        let bytes = avi(codec, rate, -32, &movie);
        let reading = read_avi(&bytes[..]);
        // The empty chunk is a frame that was dropped, and the fourth one is damaged.
        let numbers: Vec<u64> = reading.frames.iter().map(|(frame, _)| frame.number).collect();
        assert_eq!((numbers, reading.times()), (vec![0, 3], vec![0.0, 0.3]));
        assert_eq!(reading.frames[0].1, reading.frames[1].1);
        assert_eq!((reading.errors.len(), reading.cut_off), (1, None));
        assert!(reading.errors[0].contains(": picture 2: the picture is damaged"), "{:?}", reading.errors);
    }
}

#[test]
fn avi_that_cannot_be_read_is_refused_with_the_byte_and_the_way_out() {
    let other = read_avi(&include_bytes!("../data/recorded/other_codec.avi")[..]).errors;
    assert!(other[0].contains("the pictures are `FMP4`, only MJPG is read; convert with `ffmpeg"), "{other:?}");
    let frame = [chunk(b"01dc", jpeg())];
    let long = [chunk(b"01dc", &vec![0; (16 << 20) + 1]), chunk(b"01dc", jpeg())];
    let no_video = list(b"RIFF", b"AVI ", &[list(b"LIST", b"movi", &frame)]);
    let short = list(b"RIFF", b"AVI ", &[chunk(b"strh", b"vids")]);
    for (bytes, words) in [
        (b"RIFF\0\0\0\0WAVE".to_vec(), "no AVI file"),
        (b"\x89PNG".to_vec(), "no AVI file"),
        (Vec::new(), "no AVI file"),
        (no_video, "byte 12: none of the streams before has pictures"),
        (short, "byte 12: the chunk `strh` has 4 bytes"),
        (avi(*b"MJPG", [0, 1, 0], 32, &frame), "the rate of frames is unknown"),
        (avi(*b"MJPG", [10, 1, 0], 64, &frame), "picture 0 has half the rows; convert with"),
        (avi(*b"MJPG", [10, 1, 0], 32, &long), "picture 0 has 16777217 bytes; at most 16777216 are read"),
        (avi(*b"\0\0\0\0", [10, 1, 0], 32, &frame), "the pictures are `\\x00\\x00\\x00\\x00`"),
    ] {
        let reading = read_avi(&bytes[..]);
        assert!(reading.errors.len() == 1 && reading.errors[0].contains(words), "{:?}, not `{words}`", reading.errors);
    }
    assert_eq!(read_avi(&avi(*b"MJPG", [10, 1, 0], 32, &long)[..]).frames.len(), 1, "the next picture is read");
}

proptest! {
    #[test]
    fn damage_neither_stops_the_reader_nor_fills_the_memory(damage in Damage::any(), most in 1_usize..5_000) {
        for (bytes, _) in [OPENCV_AVI, recorded!("ffmpeg", "avi")] {
            let bytes = damage.apply(bytes);
            let memory = measure(|| assert_eq!(read_avi(&bytes[..]), read_avi(trickle(&bytes, most))));
            prop_assert!(memory.bytes_max < MAX_PICTURE_MEMORY, "{memory:?}");
        }
    }
}
