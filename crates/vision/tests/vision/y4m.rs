//! YUV4MPEG2 by ffmpeg and by hand, whole, cut and damaged.

use std::io::Read;

use allocation_counter::measure;
use posebridge_vision::{GreyPicture, Y4mReader};
use proptest::prelude::*;

use crate::recorded::{Damage, Reading, trickle};

const MPEG2_Y4M: (&[u8], &[u8]) = recorded!("420mpeg2", "y4m");

fn read_y4m(input: impl Read) -> Reading {
    let mut reading = Reading::default();
    match Y4mReader::new(input) {
        Ok(mut reader) => {
            let mut picture = GreyPicture::default();
            while reading.push(reader.read_frame(&mut picture), &picture) {}
            assert!(reader.read_frame(&mut picture).unwrap().is_none(), "there is nothing behind the end");
        }
        Err(error) => reading.errors.push(error.to_string()),
    }
    reading
}

#[test]
fn y4m_has_the_brightness_that_ffmpeg_decodes() {
    for (bytes, grey) in [
        recorded!("420jpeg", "y4m"),
        recorded!("420paldv", "y4m"),
        MPEG2_Y4M,
        recorded!("411", "y4m"),
        recorded!("422", "y4m"),
        recorded!("444", "y4m"),
        recorded!("mono", "y4m"),
    ] {
        let whole = read_y4m(bytes);
        assert_eq!((&whole.errors[..], whole.frames.len()), (&[][..], 2));
        assert_eq!(whole.frames.iter().flat_map(|(_, pixels)| pixels).copied().collect::<Vec<_>>(), grey);
        assert_eq!(whole.times(), [0.0, 1_001.0 / 30_000.0]);
        for (frame, _) in &whole.frames {
            assert!(bytes[frame.offset as usize..].starts_with(b"FRAME\n"));
        }
        for most in 1..=bytes.len() {
            assert_eq!(read_y4m(trickle(bytes, most)), whole, "{most} bytes at a time");
        }
    }
    let reader = Y4mReader::new(MPEG2_Y4M.0).unwrap();
    assert_eq!((reader.width(), reader.height(), reader.rate().frames_per_second()), (17, 13, 30_000.0 / 1_001.0));
}

#[test]
fn y4m_of_other_kinds_is_read_by_its_header() {
    let alpha = b"YUV4MPEG2 H1 W2 F2:1 C444alpha XNOTE=1\nFRAME Ip XNOTE\nabUUVVAAFRAME\ncdUUVVAA";
    let reading = read_y4m(&alpha[..]);
    assert_eq!(reading.frames.iter().map(|(_, pixels)| &pixels[..]).collect::<Vec<_>>(), [b"ab", b"cd"]);
    assert_eq!(reading.times(), [0.0, 0.5]);
    // Without a colour space it is 4:2:0.
    let unsaid = read_y4m(&b"YUV4MPEG2 W1 H1 F1:1\nFRAME\naUVFRAME\nbUV"[..]);
    assert_eq!(unsaid.frames.iter().map(|(_, pixels)| pixels[0]).collect::<Vec<_>>(), b"ab");
}

#[test]
fn y4m_that_cannot_be_read_is_refused_with_the_byte_and_the_way_out() {
    let deep = include_bytes!("../data/recorded/420p10.y4m");
    assert!(
        read_y4m(&deep[..]).errors[0].contains("byte 38: samples of `C420p10` have more than 8 bits; convert with")
    );
    for (header, words) in [
        ("RIFF", "no YUV4MPEG2 stream"),
        ("", "no YUV4MPEG2 stream"),
        ("YUV4MPEG2 W4", "byte 0: the file ends inside the line"),
        ("YUV4MPEG2 H1 F1:1\n", "no width"),
        ("YUV4MPEG2 W1 F1:1\n", "no height"),
        ("YUV4MPEG2 W1 H1\n", "no rate"),
        ("YUV4MPEG2 W1 Hx F1:1\n", "byte 13: `Hx` is not read as a number of pixels"),
        ("YUV4MPEG2 W\u{e4} H1 F1:1\n", "byte 10: `W\u{e4}`"),
        ("YUV4MPEG2 W0 H1 F1:1\n", "frames of 0 x 1"),
        ("YUV4MPEG2 W4929 H1 F1:1\n", "byte 10: frames of 4929 x 1 pixels; the longest side may have 4928"),
        ("YUV4MPEG2 W99999999999999999999 H1 F1:1\n", "a number of pixels"),
        ("YUV4MPEG2 W1 H1 F0:0\n", "byte 16: the rate of frames is unknown (`F0:0`)"),
        ("YUV4MPEG2 W1 H1 F30\n", "byte 16: `F30` is not read as a fraction"),
        ("YUV4MPEG2 W1 H1 F1:1 C410\n", "byte 21: `C410` is not read as a colour space"),
        ("YUV4MPEG2 W1 H1 F1:1 Cmono16\n", "more than 8 bits"),
        ("YUV4MPEG2 W1 H1 F1:1 C444p9\n", "more than 8 bits"),
        ("YUV4MPEG2 W1 H1 F1:1\nFRAM\n", "byte 21: frame 0 should begin with `FRAME`"),
        ("YUV4MPEG2 W1 H1 F1:1\nFRAME2\n", "byte 21: frame 0 should begin with `FRAME`"),
        ("YUV4MPEG2 W1 H1 F1:1\nFRAME\nabcFRAME\na", "byte 30: frame 1 ends 2 bytes too early, in its colours"),
        ("YUV4MPEG2 W2 H1 F1:1\nFRAME\na", "byte 21: frame 0 ends 3 bytes too early, in its brightness"),
        ("YUV4MPEG2 W2 H1 F1:1\nFRA", "byte 21: the file ends inside the line"),
    ] {
        let errors = read_y4m(header.as_bytes()).errors;
        assert!(errors[0].contains(words), "{errors:?}, not `{words}`");
    }
    let endless = format!("YUV4MPEG2 X{}", "x".repeat(5_000));
    assert!(read_y4m(endless.as_bytes()).errors[0].contains("byte 0: the line has no end"));
}

#[test]
fn y4m_that_is_cut_gives_its_whole_frames_and_says_what_is_missing() {
    let (bytes, _) = MPEG2_Y4M;
    let whole = read_y4m(bytes);
    let begins: Vec<usize> = whole.frames.iter().map(|(frame, _)| frame.offset as usize).collect();
    let ends = [begins[1], bytes.len()];
    for length in 0..bytes.len() {
        let cut = read_y4m(&bytes[..length]);
        let count = ends.iter().filter(|end| **end <= length).count();
        assert_eq!(cut.frames, whole.frames[..count], "{length}");
        assert_eq!(cut.errors.is_empty(), begins.contains(&length), "{length}: {:?}", cut.errors);
    }
}

proptest! {
    #[test]
    fn damage_neither_stops_the_reader_nor_fills_the_memory(damage in Damage::any(), most in 1_usize..1_000) {
        for (bytes, _) in [MPEG2_Y4M, recorded!("mono", "y4m")] {
            let bytes = damage.apply(bytes);
            let memory = measure(|| assert_eq!(read_y4m(&bytes[..]), read_y4m(trickle(&bytes, most))));
            prop_assert!(memory.bytes_max < 100_000, "{memory:?}");
        }
    }
}
