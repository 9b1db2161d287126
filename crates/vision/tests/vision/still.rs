//! Single pictures by OpenCV and ffmpeg: PNG of every kind, and JPEG without its tables.

use allocation_counter::measure;
use posebridge_vision::GreyPicture;
use proptest::prelude::*;

use crate::recorded::{Damage, MAX_PICTURE_MEMORY, worst_difference};

#[test]
fn a_jpeg_picture_without_huffman_tables_has_the_standard_ones() {
    let (bytes, grey) = recorded!("no_tables", "jpg");
    assert!(!bytes.windows(2).any(|pair| pair == b"\xFF\xC4"));
    assert!(worst_difference(&decoded(bytes), grey) <= 2);
}

fn decoded(bytes: &[u8]) -> Vec<u8> {
    let mut picture = GreyPicture::default();
    picture.decode(bytes).unwrap();
    let image = picture.image().unwrap();
    (0..image.height()).flat_map(|y| image.row(y)).copied().collect()
}

#[test]
fn png_of_every_kind_has_the_brightness_that_opencv_decodes() {
    for (name, (bytes, grey)) in [
        ("grey1", recorded!("grey1", "png")),
        ("grey8", recorded!("grey8", "png")),
        ("grey16", recorded!("grey16", "png")),
        ("grey_alpha8", recorded!("grey_alpha8", "png")),
        ("grey_alpha16", recorded!("grey_alpha16", "png")),
        ("rgb8", recorded!("rgb8", "png")),
        ("rgb16", recorded!("rgb16", "png")),
        ("rgba8", recorded!("rgba8", "png")),
        ("rgba16", recorded!("rgba16", "png")),
        ("palette", recorded!("palette", "png")),
        ("interlaced", recorded!("interlaced", "png")),
    ] {
        let worst = worst_difference(&decoded(bytes), grey);
        assert!(worst <= 1, "{name}: {worst}");
    }
}

#[test]
fn png_that_is_cut_or_too_large_is_refused_before_it_takes_memory() {
    let (bytes, _) = recorded!("rgb8", "png");
    let mut picture = GreyPicture::default();
    for length in 0..bytes.len() - 12 {
        picture.decode(&bytes[..length]).unwrap_err();
        assert!(picture.image().is_none());
    }
    // Width 200,000 with its checksum.
    let mut wide = bytes.to_vec();
    wide[16..20].copy_from_slice(&200_000_u32.to_be_bytes());
    let checksum = crc32(&wide[12..29]);
    wide[29..33].copy_from_slice(&checksum.to_be_bytes());
    let mut error = String::new();
    let memory = measure(|| error = picture.decode(&wide).unwrap_err().to_string());
    assert!(error.contains("200000 x 11 pixels"), "{error}");
    assert!(memory.bytes_max < 500_000, "{memory:?}");
}

#[test]
fn pgm_without_rows_or_columns_is_refused() {
    let mut picture = GreyPicture::default();
    for size in ["0 0", "0 3", "3 0"] {
        let error = picture.decode(format!("P5 {size} 255\nabcdef").as_bytes()).unwrap_err();
        assert!(error.to_string().contains("it has no pixels"), "{error}");
        assert!(picture.image().is_none());
    }
}

fn crc32(bytes: &[u8]) -> u32 {
    let shift = |crc: u32, _| if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), shift))
}

proptest! {
    #[test]
    fn no_damage_fills_the_memory(damage in Damage::any()) {
        for (bytes, _) in [recorded!("palette", "png"), recorded!("interlaced", "png"), recorded!("no_tables", "jpg")] {
            let bytes = damage.apply(bytes);
            let memory = measure(|| drop(GreyPicture::default().decode(&bytes)));
            prop_assert!(memory.bytes_max < MAX_PICTURE_MEMORY, "{memory:?}");
        }
    }
}
