//! Which tags are found, and that nothing else is.

use nalgebra::{Matrix3, Point2};
use posebridge_vision::{DetectedTag, GreyImage, ImageWindow, Tag36h11Detector, TagDetector, TagSearch};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use crate::drawing::{Camera, Picture, View, corners, draw, draw_clutter, view};

const USUAL: Camera = Camera { black: 20.0, white: 210.0, blur_px: 0.7, noise: 2.0 };

fn image(picture: &Picture) -> GreyImage<'_> {
    GreyImage::new(&picture.pixels, picture.width, picture.height, picture.width).unwrap()
}

/// The pictures that OpenCV drew; see `tests/data/make_tags.py`.
#[test]
fn tags_that_opencv_drew_are_found_where_it_drew_them() {
    let listing = include_str!("../data/corners.txt");
    let pictures: [&[u8]; 4] = [
        include_bytes!("../data/plain.pgm"),
        include_bytes!("../data/small.pgm"),
        include_bytes!("../data/oblique.pgm"),
        include_bytes!("../data/dark.pgm"),
    ];
    for (line, bytes) in listing.lines().zip(pictures) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let numbers: Vec<f64> = words[1..].iter().map(|word| word.parse().unwrap()).collect();
        let pixels = bytes.strip_prefix(b"P5\n160 120\n255\n").unwrap();
        let tags = Tag36h11Detector::default().detect(GreyImage::new(pixels, 160, 120, 160).unwrap());
        assert_eq!(tags.len(), 1, "{line}");
        assert_eq!(f64::from(tags[0].id), numbers[0], "{line}");
        for (index, corner) in tags[0].corners.iter().enumerate() {
            // OpenCV's way up is the other one.
            let at = 1 + 2 * ((index + 2) % 4);
            let away = (corner.x - numbers[at]).hypot(corner.y - numbers[at + 1]);
            assert!(away < 0.35, "{line}: corner {index} is {away} px away");
        }
    }
}

#[test]
fn each_tag_is_found_in_each_way_up_with_its_own_first_corner() {
    let mut random = Pcg32::seed_from_u64(3);
    for id in (0..587).step_by(23) {
        let turned_rad = random.random_range(-3.2..3.2);
        let view = view(45.0, 44.0, 40.0, turned_rad, 0.2);
        let picture = draw(90, 90, &[(id, view)], USUAL, &mut random);
        let tags = Tag36h11Detector::default().detect(image(&picture));
        assert_eq!(tags.iter().map(|tag| (tag.id, tag.hamming)).collect::<Vec<_>>(), [(id, 0)]);
        for (found, drawn) in tags[0].corners.iter().zip(corners(&view)) {
            assert!((found - drawn).norm() < 0.25, "{id}: {found} {drawn}");
        }
    }
}

#[test]
fn a_window_shows_the_same_corners_and_without_its_tag_the_whole_picture_is_searched() {
    let mut random = Pcg32::seed_from_u64(4);
    let tags = [(7, view(40.0, 40.0, 32.0, 0.3, 0.0)), (8, view(140.0, 60.0, 32.0, 1.0, 0.1))];
    let picture = draw(190, 100, &tags, USUAL, &mut random);
    let mut detector = Tag36h11Detector::default();
    let mut search = TagSearch::new(3);
    let mut ids = |windows: &[ImageWindow]| -> Vec<u16> {
        let found = search.detect(&mut detector, image(&picture), windows);
        for tag in &found {
            let (_, view) = tags.iter().find(|(id, _)| *id == tag.id).unwrap();
            let away = tag.corners.iter().zip(corners(view)).map(|(found, drawn)| (found - drawn).norm());
            assert!(away.fold(0.0, f64::max) < 0.25);
        }
        found.iter().map(|tag| tag.id).collect()
    };
    let around = ImageWindow { left: 105, top: 25, width: 80, height: 75 };
    let beside = ImageWindow { left: 70, top: 0, width: 20, height: 90 };
    assert_eq!(ids(&[around]), [7, 8], "the first picture is searched whole");
    assert_eq!(ids(&[around]), [8]);
    assert_eq!(ids(&[around, around]), [8]);
    assert_eq!(ids(&[around]), [7, 8], "every third is");
    assert_eq!(ids(&[around, beside]), [7, 8], "one window is empty");
    assert_eq!(ids(&[]), [7, 8]);
    let mut rare = TagSearch::new(u32::MAX);
    let mut count = || rare.detect(&mut detector, image(&picture), &[around]).len();
    assert_eq!([count(), count()], [2, 1], "hardly ever another one");
}

/// Where a lens with this k1, with a focal length of 0.8 of the picture's width, moves a pixel of a picture of 640 x 360.
fn bent(k1: f64, at: Point2<f64>) -> Point2<f64> {
    let middle = Point2::new(319.5, 179.5);
    let ray = (at - middle) / 512.0;
    middle + ray * (1.0 + k1 * ray.norm_squared()) * 512.0
}

/// A picture as the lens shows it.
fn take(straight: &Picture, k1: f64) -> Picture {
    let drawn = image(straight);
    let mut pixels = Vec::new();
    for y in 0..straight.height {
        for x in 0..straight.width {
            let pixel = Point2::new(x as f64, y as f64);
            // The inverse of `bent`, by fixed-point iteration.
            let origin = (0..60).fold(pixel, |at, _| at + (pixel - bent(k1, at)));
            pixels.push(drawn.sample(origin.x, origin.y).round() as u8);
        }
    }
    Picture { pixels, width: straight.width, height: straight.height }
}

/// Its straight edges are bent by a pixel or two, about the middle of the whole picture and not about that of a window.
#[test]
fn a_lens_does_not_move_the_corners_of_a_large_tag() {
    let mut random = Pcg32::seed_from_u64(12);
    let view = view(450.0, 95.0, 84.0, 0.4, 0.2);
    let straight = draw(640, 360, &[(17, view)], USUAL, &mut random);
    let around = ImageWindow { left: 370, top: 20, width: 160, height: 150 };
    let mut detector = Tag36h11Detector::default();
    for k1 in [-0.3, -0.15, 0.0, 0.1] {
        let picture = take(&straight, k1);
        let mut search = TagSearch::new(u32::MAX);
        for windows in [[].as_slice(), &[around]] {
            let tags = search.detect(&mut detector, image(&picture), windows);
            assert_eq!(tags.len(), 1, "{k1}");
            for (found, drawn) in tags[0].corners.iter().zip(corners(&view)) {
                let away = (found - bent(k1, drawn)).norm();
                assert!(away < 0.05, "k1 {k1}, {windows:?}: {away} px");
            }
        }
    }
}

/// A tag of `long_px` x `short_px`, sheared until its angle is `angle_rad`, turned.
fn sheared(long_px: f64, short_px: f64, angle_rad: f64, turned_rad: f64) -> View {
    let (sine, cosine) = turned_rad.sin_cos();
    let turn = Matrix3::new(cosine, -sine, 70.0, sine, cosine, 70.0, 0.0, 0.0, 1.0);
    let [along, across] = [long_px / 8.0, short_px / 8.0];
    let shear = Matrix3::new(along, across * angle_rad.cos(), 0.0, 0.0, across * angle_rad.sin(), 0.0, 0.0, 0.0, 1.0);
    turn * shear * Matrix3::new(1.0, 0.0, -4.0, 0.0, 1.0, -4.0, 0.0, 0.0, 1.0)
}

fn is_found(id: u16, view: View, random: &mut Pcg32) -> bool {
    let picture = draw(140, 140, &[(id, view)], USUAL, random);
    let tags = Tag36h11Detector::default().detect(image(&picture));
    let near =
        |tag: &DetectedTag| tag.corners.iter().zip(corners(&view)).all(|(found, drawn)| (found - drawn).norm() < 1.0);
    tags.len() == 1 && tags[0].id == id && near(&tags[0])
}

/// The rim is 1.4 px thick: the blur mixes it with the white on both sides of it.
#[test]
fn a_tag_is_found_whose_rim_is_hardly_thicker_than_a_pixel() {
    let mut random = Pcg32::seed_from_u64(9);
    let mut missed = Vec::new();
    for index in 0..16 {
        let view = sheared(90.0, 11.5, 1.5, 0.4 * f64::from(index));
        if !is_found(31 * index, view, &mut random) {
            missed.push(index);
        }
    }
    assert_eq!(missed, []);
}

#[test]
fn clutter_is_no_tag() {
    let mut random = Pcg32::seed_from_u64(5);
    let mut detector = Tag36h11Detector::default();
    for _ in 0..200 {
        let picture = draw_clutter(320, 240, &mut random);
        assert!(detector.detect(image(&picture)).is_empty());
    }
}

proptest! {
    #[test]
    fn no_picture_is_too_small_or_too_wild(
        width in 0_usize..60,
        height in 0_usize..60,
        beyond in 0_usize..3,
        coarse in 1_usize..9,
        bytes in prop::collection::vec(prop::sample::select(&[0_u8, 20, 128, 235, 255][..]), 64),
    ) {
        let stride = width + beyond;
        let pixels: Vec<u8> =
            (0..stride * height).map(|at| bytes[(at / stride.max(1) / coarse * 8 + at % stride.max(1) / coarse) % 64]).collect();
        let image = GreyImage::new(&pixels, width, height, stride).unwrap();
        prop_assert!(Tag36h11Detector::default().detect(image).is_empty());
        prop_assert!(Tag36h11Detector::default().detect(image.window(width / 2, height / 3, 100, 100)).is_empty());
    }
}
