//! Pictures of cameras: any bytes end in parts, pictures and tags that can be, whatever their chunks.
#![expect(clippy::expect_used, reason = "what is not as expected is a finding")]

use posebridge_vision::{GreyImage, GreyPicture, MultipartReader, Tag36h11Detector, TagDetector};

const CONTENT_TYPE: &str = "multipart/x-mixed-replace; boundary=frame";
/// Larger pictures take too long to search.
const MAX_SIDE: usize = 400;

/// Input: a byte that says whether the rest is a stream, a JPEG picture, grey pixels or what follows the magic number of a PGM picture; the
/// size of chunks, or the width; the rest.
pub(crate) fn check(data: &[u8]) {
    let [kind, size, rest @ ..] = data else {
        return;
    };
    let size = usize::from(*size).max(1);
    match kind % 4 {
        0 => check_stream(rest, size),
        1 => check_jpeg(rest),
        3 => check_pgm(rest),
        _ => {
            let height = rest.len() / size;
            check_tags(GreyImage::new(rest, size, height, size).expect("there are as many pixels"));
        }
    }
}

fn check_stream(bytes: &[u8], chunk_bytes: usize) {
    let parts = |chunk_bytes: usize| {
        let mut reader = MultipartReader::new(CONTENT_TYPE).expect("it has a boundary");
        let mut parts = Vec::new();
        for chunk in bytes.chunks(chunk_bytes) {
            reader.push(chunk, |part| parts.push(part));
        }
        parts
    };
    let whole = parts(bytes.len().max(1));
    assert_eq!(parts(chunk_bytes), whole, "chunks of {chunk_bytes} bytes make other parts");
    for part in whole {
        check_jpeg(&part.bytes);
    }
}

fn check_jpeg(bytes: &[u8]) {
    let mut picture = GreyPicture::default();
    let decoded = picture.decode_jpeg(bytes);
    assert_eq!(decoded.is_ok(), picture.image().is_some(), "{decoded:?}");
    if let Some(image) = picture.image()
        && image.width().max(image.height()) <= MAX_SIDE
    {
        check_tags(image);
    }
}

fn check_pgm(rest: &[u8]) {
    let mut picture = GreyPicture::default();
    let decoded = picture.decode(&[b"P5", rest].concat());
    assert_eq!(decoded.is_ok(), picture.image().is_some(), "{decoded:?}");
    let Some(image) = picture.image() else {
        return;
    };
    let pixels = image.width() * image.height();
    assert!((1..=rest.len()).contains(&pixels), "{pixels} pixels from {} bytes", rest.len());
    let mut again = GreyPicture::default();
    assert!(again.decode(&picture.to_pgm()).is_ok());
    assert!(again == picture, "what was written reads as another picture");
}

fn check_tags(image: GreyImage<'_>) {
    let tags = Tag36h11Detector::default().detect(image);
    let (width, height) = (image.width() as f64, image.height() as f64);
    for (index, tag) in tags.iter().enumerate() {
        assert!(tag.id < 587 && tag.hamming <= 2 && tag.margin > 0.0, "{tag:?}");
        assert!(tags[..index].iter().all(|other| other.id != tag.id), "{} is there twice", tag.id);
        for corner in &tag.corners {
            let is_near = |of: f64, size: f64| (-size..2.0 * size).contains(&of);
            assert!(is_near(corner.x, width) && is_near(corner.y, height), "{tag:?}");
        }
        assert!(tag.covariance.diagonal().iter().all(|variance| variance.is_finite() && *variance > 0.0), "{tag:?}");
    }
}
