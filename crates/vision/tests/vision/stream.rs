//! Streams of JPEG pictures.

use posebridge_vision::{GreyPicture, MultipartReader, Part, PictureError};
use proptest::prelude::*;

/// What an ESP32-CAM sends (its example `CameraWebServer`), with bytes instead of pictures.
const ESP32: (&str, &[u8]) = (
    "multipart/x-mixed-replace;boundary=123456789000000000000987654321",
    b"\r\n--123456789000000000000987654321\r\nContent-Type: image/jpeg\r\nContent-Length: 5\r\nX-Timestamp: 12.000345\r\n\r\none\r\n\
      \r\n--123456789000000000000987654321\r\nContent-Type: image/jpeg\r\nContent-Length: 3\r\nX-Timestamp: 12.100345\r\n\r\ntwo\
      \r\n--123456789000000000000987654321\r\nContent-Type: image/jpeg\r\nContent-Length: 9000000\r\n\r\n",
);

/// Without lengths, the boundary quoted and with its dashes, line ends without carriage return: mjpg-streamer and its kin.
const WITHOUT_LENGTHS: (&str, &[u8]) = (
    "multipart/x-mixed-replace; Boundary=\"--frame\"",
    b"HTTP rubbish --frame\nContent-Type: image/jpeg\n\none\r\n--frame\r\nContent-type:image/jpeg\r\n\r\nt-o\r\n--frame--\r\n",
);

fn parts(content_type: &str, bytes: &[u8], chunk: usize) -> (Vec<Part>, u64) {
    let mut reader = MultipartReader::new(content_type).unwrap();
    let mut parts = Vec::new();
    for chunk in bytes.chunks(chunk) {
        reader.push(chunk, |part| parts.push(part));
    }
    (parts, reader.dropped())
}

#[test]
fn parts_are_the_same_however_the_stream_is_cut() {
    let part =
        |bytes: &[u8], timestamp: Option<&str>| Part { bytes: bytes.to_vec(), timestamp: timestamp.map(str::to_owned) };
    let esp32 = vec![part(b"one\r\n", Some("12.000345")), part(b"two", Some("12.100345"))];
    let others = vec![part(b"one", None), part(b"t-o", None)];
    for chunk in 1..=ESP32.1.len() {
        assert_eq!(parts(ESP32.0, ESP32.1, chunk), (esp32.clone(), 1), "{chunk}");
        assert_eq!(parts(WITHOUT_LENGTHS.0, WITHOUT_LENGTHS.1, chunk), (others.clone(), 0), "{chunk}");
    }
    assert!(MultipartReader::new("text/html").is_none());
    assert!(MultipartReader::new("multipart/x-mixed-replace; boundary=--").is_none());
}

#[test]
fn the_longest_header_is_read_however_it_is_cut_and_a_longer_one_is_not() {
    for (length, blank, count) in
        [(4_096, "\r\n\r\n", 1), (4_096, "\n\n", 1), (4_097, "\r\n\r\n", 0), (4_097, "\n\n", 0)]
    {
        let header = format!("\r\nContent-Length: 2\r\nX: {:x>1$}", "", length - 24);
        let stream = format!("--frame{header}{blank}ok--frame\n\n");
        assert_eq!(header.len(), length);
        for cut in 4_090..4_115 {
            let mut reader = MultipartReader::new("multipart/x-mixed-replace; boundary=frame").unwrap();
            let mut parts = Vec::new();
            let (before, behind) = stream.as_bytes().split_at(cut);
            for bytes in [before, behind] {
                reader.push(bytes, |part| parts.push(part.bytes));
            }
            assert_eq!(parts, vec![b"ok".to_vec(); count], "{length}, {blank:?}, {cut}");
            assert_eq!(reader.dropped(), 1 - count as u64);
        }
    }
}

#[test]
fn a_part_without_end_and_a_header_without_end_fill_no_memory() {
    let mut reader = MultipartReader::new("multipart/x-mixed-replace; boundary=frame").unwrap();
    for begin in [&b"--frame\r\n\r\n"[..], b"--frame\r\nX: "] {
        let before = reader.dropped();
        reader.push(begin, |_| {});
        let endless = vec![b'x'; 65_536];
        for _ in 0..200 {
            reader.push(&endless, |_| panic!("there is no part"));
        }
        assert_eq!(reader.dropped(), before + 1);
        assert!(format!("{reader:?}").len() < 100_000, "what was dropped is forgotten");
    }
    let mut parts = Vec::new();
    reader.push(b"--frame\r\nContent-Length: 2\r\n\r\nok", |part| parts.push(part.bytes));
    assert_eq!(parts, [b"ok"]);
}

#[test]
fn a_jpeg_picture_is_grey_and_a_damaged_one_is_none() {
    let mut picture = GreyPicture::default();
    assert!(picture.image().is_none());
    let bytes = include_bytes!("../data/plain.jpg");
    picture.decode_jpeg(bytes).unwrap();
    let image = picture.image().unwrap();
    assert_eq!((image.width(), image.height()), (160, 120));
    let drawn = include_bytes!("../data/plain.pgm").strip_prefix(b"P5\n160 120\n255\n").unwrap();
    let worst = (0..120).flat_map(|y| image.row(y)).zip(drawn).map(|(jpeg, drawn)| jpeg.abs_diff(*drawn)).max();
    assert!(worst.unwrap() < 24, "{worst:?}");
    assert!(matches!(picture.decode_jpeg(&bytes[..100]), Err(PictureError::Damaged(_))));
    assert!(picture.image().is_none());
}

#[test]
fn a_pgm_picture_is_read_with_comments_and_refused_when_it_is_cut() {
    let mut picture = GreyPicture::default();
    picture.decode(b"P5 # by hand\n2\t3\n# 9\n255\nabcdef").unwrap();
    let image = picture.image().unwrap();
    assert_eq!([image.row(0), image.row(2), image.row(3)], [&b"ab"[..], b"ef", b""]);
    for (bytes, words) in [
        (&b"P5 2 3 255\nabcde"[..], "ends too early"),
        (b"P5 2 3 65535\nabcdefabcdef", "largest value"),
        (b"P5 2 \n", "header"),
        (b"P5 9999 1 255\n", "9999 x 1"),
        (b"P6 1 1 255\nabc", "neither"),
        (b"", "neither"),
    ] {
        let error = picture.decode(bytes).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
        assert!(picture.image().is_none());
    }
}

proptest! {
    #[test]
    fn no_stream_and_no_picture_is_too_wild(
        bytes in prop::collection::vec(prop::sample::select(&b"--frame\r\n: Content-Length9\xff\xd8"[..]), 0..300),
        chunk in 1_usize..40,
        at in 0_usize..4_000,
        value in any::<u8>(),
    ) {
        let (found, _) = parts("multipart/x-mixed-replace; boundary=frame", &bytes, chunk);
        prop_assert_eq!(found, parts("multipart/x-mixed-replace; boundary=frame", &bytes, 300).0);
        let mut jpeg = include_bytes!("../data/plain.jpg").to_vec();
        let at = at % jpeg.len();
        jpeg[at] = value;
        // Whatever comes of it.
        drop(GreyPicture::default().decode_jpeg(&jpeg));
        drop(GreyPicture::default().decode(&bytes));
        let pgm = [b"P5 ", bytes.as_slice()].concat();
        drop(GreyPicture::default().decode(&pgm));
    }
}
